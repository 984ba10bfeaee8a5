// The only file that knows EGL.
#define EGL_NO_X11
#include <EGL/egl.h>
#include <EGL/eglext.h>
#include <dlfcn.h>

#include <array>
#include <cstring>
#include <vector>

#include "gl_maker.h"

namespace soft_volume::core {
namespace {

/// EGL's functions; its extensions may be missing.
struct EglLibrary {
  decltype(&eglGetProcAddress) getProcAddress = nullptr;
  decltype(&eglInitialize) initialize = nullptr;
  decltype(&eglBindAPI) bindApi = nullptr;
  decltype(&eglChooseConfig) chooseConfig = nullptr;
  decltype(&eglCreateContext) createContext = nullptr;
  decltype(&eglDestroyContext) destroyContext = nullptr;
  decltype(&eglMakeCurrent) makeCurrent = nullptr;
  PFNEGLQUERYDEVICESEXTPROC queryDevices = nullptr;
  PFNEGLQUERYDEVICESTRINGEXTPROC queryDeviceString = nullptr;
  PFNEGLGETPLATFORMDISPLAYEXTPROC getPlatformDisplay = nullptr;

  /// Never closed: drivers keep threads.
  EglLibrary() {
    void* handle = dlopen("libEGL.so.1", RTLD_NOW | RTLD_LOCAL);
    if (handle == nullptr)
      return;
    const auto load = [handle](auto& function, const char* name) {
      function = reinterpret_cast<std::decay_t<decltype(function)>>(dlsym(handle, name));
    };
    load(getProcAddress, "eglGetProcAddress");
    load(initialize, "eglInitialize");
    load(bindApi, "eglBindAPI");
    load(chooseConfig, "eglChooseConfig");
    load(createContext, "eglCreateContext");
    load(destroyContext, "eglDestroyContext");
    load(makeCurrent, "eglMakeCurrent");
    if (getProcAddress == nullptr)
      return;
    const auto extend = [this](auto& function, const char* name) {
      function = reinterpret_cast<std::decay_t<decltype(function)>>(getProcAddress(name));
    };
    extend(queryDevices, "eglQueryDevicesEXT");
    extend(queryDeviceString, "eglQueryDeviceStringEXT");
    extend(getPlatformDisplay, "eglGetPlatformDisplayEXT");
  }

  bool isUsable() const {
    return initialize != nullptr && bindApi != nullptr && chooseConfig != nullptr && createContext != nullptr &&
           destroyContext != nullptr && makeCurrent != nullptr && queryDevices != nullptr &&
           queryDeviceString != nullptr && getPlatformDisplay != nullptr;
  }
};

const EglLibrary& egl() {
  static const EglLibrary kLibrary;
  return kLibrary;
}

class EglMaker : public GlMaker {
 public:
  EglMaker(EGLDisplay display, EGLContext context) : display_(display), context_(context) {}
  /// The display stays: it is the process's only one for its device, and other contexts may use it.
  ~EglMaker() override { egl().destroyContext(display_, context_); }
  EglMaker(const EglMaker&) = delete;
  EglMaker& operator=(const EglMaker&) = delete;

  bool makeCurrent() override {
    // The API is a state of each thread.
    return egl().bindApi(EGL_OPENGL_API) == EGL_TRUE &&
           egl().makeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, context_) == EGL_TRUE;
  }
  void release() override { egl().makeCurrent(display_, EGL_NO_SURFACE, EGL_NO_SURFACE, EGL_NO_CONTEXT); }
  Function function(const char* name) override { return egl().getProcAddress(name); }
  const char* name() const override { return "EGL"; }

 private:
  EGLDisplay display_;
  EGLContext context_;
};

std::vector<EGLDeviceEXT> devicesOf(EglDevice kind) {
  std::array<EGLDeviceEXT, 64> devices{};
  EGLint count = 0;
  if (egl().queryDevices(EGLint(devices.size()), devices.data(), &count) != EGL_TRUE)
    return {};
  std::vector<EGLDeviceEXT> result;
  for (EGLint i = 0; i < count; ++i) {
    const char* extensions = egl().queryDeviceString(devices[std::size_t(i)], EGL_EXTENSIONS);
    const bool software = extensions != nullptr && std::strstr(extensions, "EGL_MESA_device_software") != nullptr;
    if (software == (kind == EglDevice::kSoftware))
      result.push_back(devices[std::size_t(i)]);
  }
  return result;
}

/// Any configuration does, as nothing is drawn to a surface.
EGLConfig anyConfig(EGLDisplay display) {
  const std::array<EGLint, 5> attributes = {EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT,
                                            EGL_NONE};
  EGLConfig config = EGL_NO_CONFIG_KHR;
  EGLint count = 0;
  if (egl().chooseConfig(display, attributes.data(), &config, 1, &count) != EGL_TRUE || count == 0)
    return EGL_NO_CONFIG_KHR;
  return config;
}

std::unique_ptr<GlMaker> makeOn(EGLDeviceEXT device) {
  EGLDisplay display = egl().getPlatformDisplay(EGL_PLATFORM_DEVICE_EXT, device, nullptr);
  if (display == EGL_NO_DISPLAY || egl().initialize(display, nullptr, nullptr) != EGL_TRUE ||
      egl().bindApi(EGL_OPENGL_API) != EGL_TRUE)
    return nullptr;
  const std::array<EGLint, 7> attributes = {
      EGL_CONTEXT_MAJOR_VERSION,           4,       EGL_CONTEXT_MINOR_VERSION, 5, EGL_CONTEXT_OPENGL_PROFILE_MASK,
      EGL_CONTEXT_OPENGL_CORE_PROFILE_BIT, EGL_NONE};
  EGLContext context = egl().createContext(display, anyConfig(display), EGL_NO_CONTEXT, attributes.data());
  if (context == EGL_NO_CONTEXT)
    return nullptr;
  auto maker = std::make_unique<EglMaker>(display, context);
  if (!maker->makeCurrent())
    return nullptr;
  maker->release();
  return maker;
}

}  // namespace

std::unique_ptr<GlMaker> makeEgl(EglDevice device) {
  if (!egl().isUsable())
    return nullptr;
  for (EGLDeviceEXT candidate : devicesOf(device)) {
    if (auto maker = makeOn(candidate))
      return maker;
  }
  return nullptr;
}

}  // namespace soft_volume::core
