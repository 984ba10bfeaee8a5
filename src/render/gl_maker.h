#pragma once

#include <memory>

namespace soft_volume::core {

/// What a maker of contexts has to provide: an OpenGL 4.5 core context without a window. All drawing goes to
/// framebuffer objects.
class GlMaker {
 public:
  virtual ~GlMaker() = default;
  virtual bool makeCurrent() = 0;
  virtual void release() = 0;
  using Function = void (*)();
  virtual Function function(const char* name) = 0;
  virtual const char* name() const = 0;
};

// Both load their library when they are called, so that programs run, and the other back ends draw, without it. No GL
// library is linked: each maker's functions are its own. Both give null where there is no library or no context.

/// Software rendering through OSMesa (llvmpipe; LP_NUM_THREADS sets its threads).
std::unique_ptr<GlMaker> makeOsMesa();

enum class EglDevice { kHardware, kSoftware };
/// EGL without a surface, on the first device of that kind that has OpenGL 4.5.
std::unique_ptr<GlMaker> makeEgl(EglDevice device);

/// The maker that the environment variable SOFT_VOLUME_GL names: "osmesa", "egl" (a GPU if there is one, software
/// otherwise), or "auto", which is also what an empty or missing one means: a GPU through EGL if there is one, else
/// OSMesa, else EGL's software. Throws Error, which says what to install, when there is none, and on other values.
std::unique_ptr<GlMaker> makeGl();

}  // namespace soft_volume::core
