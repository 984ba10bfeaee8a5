// The only file that knows OSMesa. Its header brings the old GL/gl.h, so the newer GL headers stay out of here.
#include <GL/osmesa.h>

#include <array>

#include "gl_maker.h"

namespace soft_volume::core {
namespace {

/// OSMesa wants a window-like buffer; all drawing goes to framebuffer objects, so a small one does.
constexpr int kBufferSize = 16;

class OsMesaMaker : public GlMaker {
 public:
  explicit OsMesaMaker(OSMesaContext context) : context_(context) {}
  ~OsMesaMaker() override { OSMesaDestroyContext(context_); }
  OsMesaMaker(const OsMesaMaker&) = delete;
  OsMesaMaker& operator=(const OsMesaMaker&) = delete;

  bool makeCurrent() override {
    return OSMesaMakeCurrent(context_, buffer_.data(), GL_UNSIGNED_BYTE, kBufferSize, kBufferSize) == GL_TRUE;
  }
  void release() override { OSMesaMakeCurrent(nullptr, nullptr, GL_UNSIGNED_BYTE, 0, 0); }
  Function function(const char* name) override { return OSMesaGetProcAddress(name); }

 private:
  OSMesaContext context_;
  std::array<unsigned char, kBufferSize * kBufferSize * 4> buffer_{};
};

}  // namespace

std::unique_ptr<GlMaker> makeOsMesa() {
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
  OSMesaContext context = OSMesaCreateContextAttribs(attributes.data(), nullptr);
  if (context == nullptr)
    return nullptr;
  return std::make_unique<OsMesaMaker>(context);
}

}  // namespace soft_volume::core
