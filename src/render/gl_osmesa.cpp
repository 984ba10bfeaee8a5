// The only file that knows OSMesa. Its header brings the old GL/gl.h, so the newer GL headers stay out of here.
#include <GL/osmesa.h>
#include <dlfcn.h>

#include <array>

#include "gl_maker.h"

namespace soft_volume::core {
namespace {

/// OSMesa wants a window-like buffer; all drawing goes to framebuffer objects, so a small one does.
constexpr int kBufferSize = 16;

struct OsMesaLibrary {
  decltype(&OSMesaCreateContextAttribs) createContextAttribs = nullptr;
  decltype(&OSMesaDestroyContext) destroyContext = nullptr;
  decltype(&OSMesaMakeCurrent) makeCurrent = nullptr;
  decltype(&OSMesaGetProcAddress) getProcAddress = nullptr;

  /// Never closed: the driver keeps threads.
  OsMesaLibrary() {
    void* handle = nullptr;
    for (const char* name : {"libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"}) {
      if (handle == nullptr)
        handle = dlopen(name, RTLD_NOW | RTLD_LOCAL);
    }
    if (handle == nullptr)
      return;
    load(createContextAttribs, handle, "OSMesaCreateContextAttribs");
    load(destroyContext, handle, "OSMesaDestroyContext");
    load(makeCurrent, handle, "OSMesaMakeCurrent");
    load(getProcAddress, handle, "OSMesaGetProcAddress");
  }

  bool isUsable() const {
    return createContextAttribs != nullptr && destroyContext != nullptr && makeCurrent != nullptr &&
           getProcAddress != nullptr;
  }

 private:
  template <typename Function>
  static void load(Function& function, void* handle, const char* name) {
    function = reinterpret_cast<Function>(dlsym(handle, name));
  }
};

const OsMesaLibrary& library() {
  static const OsMesaLibrary kLibrary;
  return kLibrary;
}

class OsMesaMaker : public GlMaker {
 public:
  explicit OsMesaMaker(OSMesaContext context) : context_(context) {}
  ~OsMesaMaker() override { library().destroyContext(context_); }
  OsMesaMaker(const OsMesaMaker&) = delete;
  OsMesaMaker& operator=(const OsMesaMaker&) = delete;

  bool makeCurrent() override {
    return library().makeCurrent(context_, buffer_.data(), GL_UNSIGNED_BYTE, kBufferSize, kBufferSize) == GL_TRUE;
  }
  void release() override { library().makeCurrent(nullptr, nullptr, GL_UNSIGNED_BYTE, 0, 0); }
  Function function(const char* name) override { return library().getProcAddress(name); }
  const char* name() const override { return "OSMesa"; }

 private:
  OSMesaContext context_;
  std::array<unsigned char, kBufferSize * kBufferSize * 4> buffer_{};
};

}  // namespace

std::unique_ptr<GlMaker> makeOsMesa() {
  if (!library().isUsable())
    return nullptr;
  const std::array<int, 11> attributes = {OSMESA_FORMAT,
                                          OSMESA_RGBA,
                                          OSMESA_PROFILE,
                                          OSMESA_CORE_PROFILE,
                                          OSMESA_CONTEXT_MAJOR_VERSION,
                                          4,
                                          OSMESA_CONTEXT_MINOR_VERSION,
                                          5,
                                          OSMESA_DEPTH_BITS,
                                          0,
                                          0};
  OSMesaContext context = library().createContextAttribs(attributes.data(), nullptr);
  if (context == nullptr)
    return nullptr;
  return std::make_unique<OsMesaMaker>(context);
}

}  // namespace soft_volume::core
