#pragma once

#include <memory>

namespace soft_volume::core {

/// What a maker of contexts (OSMesa now; EGL surfaceless would be another) has to provide: an OpenGL 4.5 core context
/// without a window. All drawing goes to framebuffer objects.
class GlMaker {
 public:
  virtual ~GlMaker() = default;
  virtual bool makeCurrent() = 0;
  virtual void release() = 0;
  using Function = void (*)();
  virtual Function function(const char* name) = 0;
};

/// Software rendering through OSMesa (llvmpipe; LP_NUM_THREADS sets its threads). Null when no context can be had.
std::unique_ptr<GlMaker> makeOsMesa();

}  // namespace soft_volume::core
