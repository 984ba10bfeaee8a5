#include "gl_program.h"

#include <array>
#include <utility>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

GLuint compile(const GlFunctions& gl, GLenum kind, const std::string& source) {
  const GLuint shader = gl.CreateShader(kind);
  const char* text = source.c_str();
  gl.ShaderSource(shader, 1, &text, nullptr);
  gl.CompileShader(shader);
  return shader;
}

}  // namespace

GlProgram::GlProgram(const GlFunctions& gl, const std::string& vertex_source, const std::string& fragment_source)
    : gl_(gl), id_(gl.CreateProgram()) {
  const GLuint vertex = compile(gl, GL_VERTEX_SHADER, vertex_source);
  const GLuint fragment = compile(gl, GL_FRAGMENT_SHADER, fragment_source);
  gl.AttachShader(id_, vertex);
  gl.AttachShader(id_, fragment);
  gl.LinkProgram(id_);
  gl.DeleteShader(vertex);
  gl.DeleteShader(fragment);
  GLint good = GL_FALSE;
  gl.GetProgramiv(id_, GL_LINK_STATUS, &good);
  if (good == GL_TRUE)
    return;
  std::array<char, 4096> log{};
  gl.GetProgramInfoLog(id_, GLsizei(log.size()), nullptr, log.data());
  gl.DeleteProgram(id_);
  throw Error(std::string("the OpenGL driver rejects a shader: ") + log.data());
}

GlTexture::GlTexture(const GlFunctions& gl, GLenum target, GLint filter) : gl_(&gl) {
  gl.GenTextures(1, &id_);
  gl.BindTexture(target, id_);
  gl.TexParameteri(target, GL_TEXTURE_MIN_FILTER, filter);
  gl.TexParameteri(target, GL_TEXTURE_MAG_FILTER, filter);
  for (const GLenum wrap : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T, GL_TEXTURE_WRAP_R})
    gl.TexParameteri(target, wrap, GL_CLAMP_TO_EDGE);
}

GlTexture& GlTexture::operator=(GlTexture&& other) noexcept {
  reset();
  gl_ = other.gl_;
  id_ = std::exchange(other.id_, 0);
  return *this;
}

void GlTexture::reset() {
  if (id_ != 0)
    gl_->DeleteTextures(1, &id_);
  id_ = 0;
}

}  // namespace soft_volume::core
