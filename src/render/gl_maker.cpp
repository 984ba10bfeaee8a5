#include "gl_maker.h"

#include <cstdlib>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

std::unique_ptr<GlMaker> makeAnyEgl() {
  auto maker = makeEgl(EglDevice::kHardware);
  return maker ? std::move(maker) : makeEgl(EglDevice::kSoftware);
}

std::unique_ptr<GlMaker> makeAnything() {
  auto maker = makeEgl(EglDevice::kHardware);
  if (!maker)
    maker = makeOsMesa();
  return maker ? std::move(maker) : makeEgl(EglDevice::kSoftware);
}

std::unique_ptr<GlMaker> require(std::unique_ptr<GlMaker> maker, const std::string& advice) {
  if (maker)
    return maker;
  throw Error("cannot create an OpenGL 4.5 core context; " + advice + ", or draw with the native back end");
}

}  // namespace

std::unique_ptr<GlMaker> makeGl() {
  const char* variable = std::getenv("SOFT_VOLUME_GL");
  const std::string wanted = variable != nullptr ? variable : "";
  if (wanted == "osmesa")
    return require(makeOsMesa(), "install Mesa's off-screen library (libosmesa6) or set SOFT_VOLUME_GL=egl");
  if (wanted == "egl")
    return require(makeAnyEgl(), "install EGL (libegl1, libegl-mesa0) or set SOFT_VOLUME_GL=osmesa");
  if (wanted.empty() || wanted == "auto")
    return require(makeAnything(), "install Mesa's off-screen library (libosmesa6) or EGL (libegl1, libegl-mesa0)");
  throw Error("SOFT_VOLUME_GL is '" + wanted + "', use osmesa, egl or auto");
}

}  // namespace soft_volume::core
