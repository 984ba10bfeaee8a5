#pragma once

#include <string>

#include "gl_context.h"

namespace soft_volume::core {

/// A vertex and a fragment shader. Lives as long as the functions it was made with; needs the context current.
class GlProgram {
 public:
  /// Throws Error when the driver rejects a shader.
  GlProgram(const GlFunctions& gl, const std::string& vertex_source, const std::string& fragment_source);
  ~GlProgram() { gl_.DeleteProgram(id_); }
  GlProgram(const GlProgram&) = delete;
  GlProgram& operator=(const GlProgram&) = delete;

  void use() const { gl_.UseProgram(id_); }
  /// Location of a uniform; -1, which setting it ignores, where the shaders have none of that name.
  GLint operator[](const char* uniform) const { return gl_.GetUniformLocation(id_, uniform); }

 private:
  const GlFunctions& gl_;
  GLuint id_ = 0;
};

/// A texture's name; a movable owner. Needs the context current when it dies.
class GlTexture {
 public:
  GlTexture() = default;
  /// With linear or nearest filtering and clamped to its border; bound to `target` afterwards.
  GlTexture(const GlFunctions& gl, GLenum target, GLint filter);
  ~GlTexture() { reset(); }
  GlTexture(GlTexture&& other) noexcept { *this = std::move(other); }
  GlTexture& operator=(GlTexture&& other) noexcept;

  GLuint id() const { return id_; }

 private:
  void reset();

  const GlFunctions* gl_ = nullptr;
  GLuint id_ = 0;
};

}  // namespace soft_volume::core
