#pragma once

#include <GL/glcorearb.h>

#include <memory>
#include <utility>
#include <vector>

#include "gl_maker.h"

namespace soft_volume::core {

/// The OpenGL functions that this room uses, loaded from the context's own maker. No GL library is linked: mixing one
/// with OSMesa crashes.
#define SOFT_VOLUME_GL_FUNCTIONS(X)                     \
  X(ACTIVETEXTURE, ActiveTexture)                       \
  X(ATTACHSHADER, AttachShader)                         \
  X(BINDBUFFER, BindBuffer)                             \
  X(BINDFRAMEBUFFER, BindFramebuffer)                   \
  X(BINDSAMPLER, BindSampler)                           \
  X(BINDTEXTURE, BindTexture)                           \
  X(BINDVERTEXARRAY, BindVertexArray)                   \
  X(BLENDEQUATIONI, BlendEquationi)                     \
  X(BLENDFUNCI, BlendFunci)                             \
  X(BUFFERDATA, BufferData)                             \
  X(CHECKFRAMEBUFFERSTATUS, CheckFramebufferStatus)     \
  X(CLEARBUFFERFV, ClearBufferfv)                       \
  X(CLEARBUFFERIV, ClearBufferiv)                       \
  X(COLORMASK, ColorMask)                               \
  X(COMPILESHADER, CompileShader)                       \
  X(CREATEPROGRAM, CreateProgram)                       \
  X(CREATESHADER, CreateShader)                         \
  X(DELETEBUFFERS, DeleteBuffers)                       \
  X(DELETEFRAMEBUFFERS, DeleteFramebuffers)             \
  X(DELETEPROGRAM, DeleteProgram)                       \
  X(DELETESAMPLERS, DeleteSamplers)                     \
  X(DELETESHADER, DeleteShader)                         \
  X(DELETETEXTURES, DeleteTextures)                     \
  X(DELETEVERTEXARRAYS, DeleteVertexArrays)             \
  X(DEPTHFUNC, DepthFunc)                               \
  X(DEPTHMASK, DepthMask)                               \
  X(DISABLE, Disable)                                   \
  X(DISABLEVERTEXATTRIBARRAY, DisableVertexAttribArray) \
  X(DRAWARRAYS, DrawArrays)                             \
  X(DRAWBUFFERS, DrawBuffers)                           \
  X(DRAWELEMENTS, DrawElements)                         \
  X(ENABLE, Enable)                                     \
  X(ENABLEVERTEXATTRIBARRAY, EnableVertexAttribArray)   \
  X(FRAMEBUFFERTEXTURE2D, FramebufferTexture2D)         \
  X(GENBUFFERS, GenBuffers)                             \
  X(GENFRAMEBUFFERS, GenFramebuffers)                   \
  X(GENSAMPLERS, GenSamplers)                           \
  X(GENTEXTURES, GenTextures)                           \
  X(GENVERTEXARRAYS, GenVertexArrays)                   \
  X(GETERROR, GetError)                                 \
  X(GETINTEGERV, GetIntegerv)                           \
  X(GETPROGRAMINFOLOG, GetProgramInfoLog)               \
  X(GETPROGRAMIV, GetProgramiv)                         \
  X(GETSTRING, GetString)                               \
  X(GETUNIFORMLOCATION, GetUniformLocation)             \
  X(LINKPROGRAM, LinkProgram)                           \
  X(PIXELSTOREI, PixelStorei)                           \
  X(READBUFFER, ReadBuffer)                             \
  X(READPIXELS, ReadPixels)                             \
  X(SAMPLERPARAMETERI, SamplerParameteri)               \
  X(SCISSOR, Scissor)                                   \
  X(SHADERSOURCE, ShaderSource)                         \
  X(STENCILFUNC, StencilFunc)                           \
  X(STENCILOP, StencilOp)                               \
  X(TEXIMAGE1D, TexImage1D)                             \
  X(TEXIMAGE2D, TexImage2D)                             \
  X(TEXIMAGE3D, TexImage3D)                             \
  X(TEXPARAMETERI, TexParameteri)                       \
  X(TEXTUREBARRIER, TextureBarrier)                     \
  X(UNIFORM1F, Uniform1f)                               \
  X(UNIFORM1I, Uniform1i)                               \
  X(UNIFORM2F, Uniform2f)                               \
  X(UNIFORM3F, Uniform3f)                               \
  X(UNIFORM4F, Uniform4f)                               \
  X(UNIFORM4FV, Uniform4fv)                             \
  X(USEPROGRAM, UseProgram)                             \
  X(VERTEXATTRIBPOINTER, VertexAttribPointer)           \
  X(VIEWPORT, Viewport)

struct GlFunctions {
#define SOFT_VOLUME_GL_MEMBER(type, name) PFNGL##type##PROC name = nullptr;
  SOFT_VOLUME_GL_FUNCTIONS(SOFT_VOLUME_GL_MEMBER)
#undef SOFT_VOLUME_GL_MEMBER
};

/// True once exit() has called what the drivers registered when the first context was made: they must not be called
/// any more.
bool glHasEnded();

/// Keeps, to the end of the process, what was made in a context and cannot be destroyed any more.
template <typename Object>
void keepBeyondGl(std::unique_ptr<Object> object) {
  static auto* const kKept = new std::vector<std::unique_ptr<Object>>;
  kKept->push_back(std::move(object));
}

/// A context with its functions. Used from one thread at a time: it is current only while a Current exists, so calls
/// may come from different threads one after the other.
class GlContext {
 public:
  /// Throws as makeGl() does.
  GlContext();
  ~GlContext();

  /// Makes the context current for the calling thread as long as it lives.
  class Current {
   public:
    explicit Current(GlContext& context);
    ~Current();
    Current(const Current&) = delete;
    Current& operator=(const Current&) = delete;

   private:
    GlContext& context_;
  };

  const GlFunctions& gl() const { return gl_; }
  /// llvmpipe and the like, whose threads need the processor's cores. Needs the context current.
  bool isSoftware() const;
  const char* makerName() const { return maker_->name(); }

 private:
  std::unique_ptr<GlMaker> maker_;
  GlFunctions gl_;
};

}  // namespace soft_volume::core
