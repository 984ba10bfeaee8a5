#include "gl_context.h"

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

}  // namespace

GlContext::GlContext() : maker_(makeGl()) {
  const Current current(*this);
  gl_ = loadFunctions(*maker_);
}

GlContext::~GlContext() = default;

GlContext::Current::Current(GlContext& context) : context_(context) {
  if (!context_.maker_->makeCurrent())
    throw Error("cannot make the OpenGL context current");
}

GlContext::Current::~Current() {
  context_.maker_->release();
}

}  // namespace soft_volume::core
