#include "gl_context.h"

#include <algorithm>
#include <array>
#include <cstdlib>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

GlFunctions loadFunctions(GlMaker& maker) {
  GlFunctions gl;
#define SOFT_VOLUME_GL_LOAD(type, name)                                      \
  gl.name = reinterpret_cast<PFNGL##type##PROC>(maker.function("gl" #name)); \
  if (gl.name == nullptr)                                                    \
    throw Error("the OpenGL driver has no gl" #name ", OpenGL 4.5 is needed");
  SOFT_VOLUME_GL_FUNCTIONS(SOFT_VOLUME_GL_LOAD)
#undef SOFT_VOLUME_GL_LOAD
  return gl;
}

bool has_ended = false;

/// Behind the drivers' own handlers in the list of exit(), so before them in time.
void noticeEnd() {
  static const bool kIsRegistered = std::atexit([] { has_ended = true; }) == 0;
  static_cast<void>(kIsRegistered);
}

}  // namespace

bool glHasEnded() {
  return has_ended;
}

GlContext::GlContext() : maker_(makeGl()) {
  const Current current(*this);
  gl_ = loadFunctions(*maker_);
  noticeEnd();
}

/// What is left when the drivers have ended goes with the process.
GlContext::~GlContext() {
  if (glHasEnded())
    keepBeyondGl(std::move(maker_));
}

bool GlContext::isSoftware() const {
  const std::string renderer = reinterpret_cast<const char*>(gl_.GetString(GL_RENDERER));
  const std::array<const char*, 3> names = {"llvmpipe", "softpipe", "SWR"};
  return std::any_of(names.begin(), names.end(),
                     [&](const char* name) { return renderer.find(name) != std::string::npos; });
}

GlContext::Current::Current(GlContext& context) : context_(context) {
  if (!context_.maker_->makeCurrent())
    throw Error("cannot make the OpenGL context current");
}

GlContext::Current::~Current() {
  context_.maker_->release();
}

}  // namespace soft_volume::core
