#include "slice_canvas.h"

#include <array>
#include <cmath>
#include <limits>
#include <string>

#include "soft_volume/common/error.h"
#include "volume_texels.h"

namespace soft_volume::core {
namespace {

/// Texture units.
enum : GLint { kVolumeUnit, kTableUnit, kAccumulatedUnit };
/// How far towards the light the second sample of a fragment lies.
constexpr double kLightStepVoxels = 2.0;
/// A fall of the value by the transfer function's whole range over this counts as a surface that faces the light.
constexpr double kEdgesPerTable = 3.5;
/// Clear value of the depth target; a pixel that keeps it was not hit.
constexpr float kFar = std::numeric_limits<float>::max();

const char* const kVertexShader = R"(#version 450 core
layout(location = 0) in vec2 pixel;
layout(location = 1) in vec3 texture_in;
layout(location = 2) in vec3 light_in;
uniform vec2 image_size;
out vec3 texture_coordinate;
out vec3 light;
void main() {
  texture_coordinate = texture_in;
  light = light_in;
  // Pixel centres are whole numbers in the image and halves in OpenGL. The top row is drawn, and read, first.
  gl_Position = vec4((pixel + 0.5) / image_size * 2.0 - 1.0, 0.0, 1.0);
}
)";

/// Compiled twice, behind a version line and, for depth, "#define DEPTH".
const char* const kFragmentShader = R"(
in vec3 texture_coordinate;
in vec3 light;
layout(binding = 0) uniform sampler3D volume;
layout(binding = 1) uniform sampler1D table;
uniform float value_scale;
uniform vec2 table_map;        // first value, entries per value
uniform vec4 pinhole;          // cx, cy, 1 / fx, 1 / fy
uniform float slice_distance;
uniform float light_step;
uniform float shading;
uniform float edge_scale;      // 1 / the value difference that counts as a full edge
layout(location = 0) out vec4 colour;
#ifdef DEPTH
layout(binding = 2) uniform sampler2D accumulated;
uniform float slice_z;
uniform float threshold;
layout(location = 1) out float depth;
#endif

float valueAt(vec3 position) { return texture(volume, position).r * value_scale; }

vec4 classify(float value) {
  float entry = (value - table_map.x) * table_map.y + 0.5;
  return texelFetch(table, int(clamp(entry, 0.0, float(textureSize(table, 0) - 1))), 0);
}

float brightness(float value) {
  float fall = clamp((value - valueAt(texture_coordinate + light_step * light)) * edge_scale, 0.0, 1.0);
  return mix(1.0, 0.3 + 0.85 * fall, shading);
}

void main() {
  float value = valueAt(texture_coordinate);
  if (isnan(value)) discard;
  vec4 material = classify(value);
  if (material.a <= 0.0) discard;
  vec2 slope = (gl_FragCoord.xy - 0.5 - pinhole.xy) * pinhole.zw;
  float way = slice_distance * sqrt(1.0 + dot(slope, slope));
  float opacity = 1.0 - exp2(-material.a * way);
  vec3 lit = material.rgb;
  if (shading > 0.0) lit = min(lit * brightness(value), 1.0);
  colour = vec4(lit * opacity, opacity);
#ifdef DEPTH
  float before = texelFetch(accumulated, ivec2(gl_FragCoord.xy), 0).a;
  float after = before + (1.0 - before) * opacity;
  depth = 3.402823466e38;
  if (before < threshold && after >= threshold) {
    float part = log2((1.0 - before) / (1.0 - threshold)) / (material.a * way);
    depth = slice_z + (clamp(part, 0.0, 1.0) - 0.5) * slice_distance;
  }
#endif
}
)";

GLuint compile(const GlFunctions& gl, GLenum kind, const std::string& source) {
  const GLuint shader = gl.CreateShader(kind);
  const char* text = source.c_str();
  gl.ShaderSource(shader, 1, &text, nullptr);
  gl.CompileShader(shader);
  return shader;
}

GLuint link(const GlFunctions& gl, const std::string& fragment_source) {
  const GLuint vertex = compile(gl, GL_VERTEX_SHADER, kVertexShader);
  const GLuint fragment = compile(gl, GL_FRAGMENT_SHADER, fragment_source);
  const GLuint program = gl.CreateProgram();
  gl.AttachShader(program, vertex);
  gl.AttachShader(program, fragment);
  gl.LinkProgram(program);
  gl.DeleteShader(vertex);
  gl.DeleteShader(fragment);
  GLint good = GL_FALSE;
  gl.GetProgramiv(program, GL_LINK_STATUS, &good);
  if (good == GL_TRUE)
    return program;
  std::array<char, 4096> log{};
  gl.GetProgramInfoLog(program, GLsizei(log.size()), nullptr, log.data());
  throw Error(std::string("the OpenGL driver rejects the slice shader: ") + log.data());
}

GLuint makeTexture(const GlFunctions& gl, GLenum target, GLint filter) {
  GLuint texture = 0;
  gl.GenTextures(1, &texture);
  gl.BindTexture(target, texture);
  gl.TexParameteri(target, GL_TEXTURE_MIN_FILTER, filter);
  gl.TexParameteri(target, GL_TEXTURE_MAG_FILTER, filter);
  for (const GLenum wrap : {GL_TEXTURE_WRAP_S, GL_TEXTURE_WRAP_T, GL_TEXTURE_WRAP_R}) {
    gl.TexParameteri(target, wrap, GL_CLAMP_TO_EDGE);
  }
  return texture;
}

void attach(const GlFunctions& gl, GLenum attachment, GLuint texture, GLint format, GLenum components, int width,
            int height) {
  gl.BindTexture(GL_TEXTURE_2D, texture);
  gl.TexImage2D(GL_TEXTURE_2D, 0, format, width, height, 0, components, GL_FLOAT, nullptr);
  gl.FramebufferTexture2D(GL_FRAMEBUFFER, attachment, GL_TEXTURE_2D, texture, 0);
}

double meanSpacing(const VolumeGeometry& geometry) {
  return std::cbrt(geometry.spacing_m.prod());
}

}  // namespace

struct SliceCanvas::Program {
  Program(const GlFunctions& gl, const char* head) : id(link(gl, std::string(head) + kFragmentShader)), gl_(gl) {}
  GLint operator[](const char* uniform) const { return gl_.GetUniformLocation(id, uniform); }
  const GLuint id;

 private:
  const GlFunctions& gl_;
};

SliceCanvas::SliceCanvas() {
  const GlContext::Current current(context_);
  const GlFunctions& gl = context_.gl();
  colour_program_ = std::make_unique<Program>(gl, "#version 450 core\n");
  depth_program_ = std::make_unique<Program>(gl, "#version 450 core\n#define DEPTH\n");
  volume_texture_ = makeTexture(gl, GL_TEXTURE_3D, GL_LINEAR);
  table_texture_ = makeTexture(gl, GL_TEXTURE_1D, GL_NEAREST);
  colour_target_ = makeTexture(gl, GL_TEXTURE_2D, GL_NEAREST);
  depth_target_ = makeTexture(gl, GL_TEXTURE_2D, GL_NEAREST);
  gl.GenFramebuffers(1, &framebuffer_);
  gl.GenVertexArrays(1, &vertex_array_);
  gl.GenBuffers(1, &vertex_buffer_);
  gl.GenBuffers(1, &index_buffer_);
}

SliceCanvas::~SliceCanvas() {
  const GlContext::Current current(context_);
  const GlFunctions& gl = context_.gl();
  gl.DeleteProgram(colour_program_->id);
  gl.DeleteProgram(depth_program_->id);
  for (const GLuint texture : {volume_texture_, table_texture_, colour_target_, depth_target_}) {
    gl.DeleteTextures(1, &texture);
  }
  gl.DeleteFramebuffers(1, &framebuffer_);
  gl.DeleteVertexArrays(1, &vertex_array_);
  gl.DeleteBuffers(1, &vertex_buffer_);
  gl.DeleteBuffers(1, &index_buffer_);
}

void SliceCanvas::setVolume(const Volume& volume) {
  const GlContext::Current current(context_);
  const GlFunctions& gl = context_.gl();
  const Vector3i& dims = volume.geometry().dims;
  GLint limit = 0;
  gl.GetIntegerv(GL_MAX_3D_TEXTURE_SIZE, &limit);
  if (dims.maxCoeff() > limit) {
    throw InputError("the volume has " + std::to_string(dims.maxCoeff()) +
                     " voxels along one side and the driver takes " + std::to_string(limit) +
                     "; read it with a stride or a region of interest");
  }
  const VolumeTexels texels(volume);
  const GLuint texture = makeTexture(gl, GL_TEXTURE_3D, GL_LINEAR);
  gl.PixelStorei(GL_UNPACK_ALIGNMENT, 1);
  gl.TexImage3D(GL_TEXTURE_3D, 0, texels.internalFormat(), dims.x(), dims.y(), dims.z(), 0, GL_RED, texels.type(),
                texels.data());
  if (gl.GetError() != GL_NO_ERROR) {
    gl.DeleteTextures(1, &texture);
    throw InputError("the volume does not fit into texture memory; read it with a stride or a region of interest");
  }
  gl.DeleteTextures(1, &volume_texture_);
  volume_texture_ = texture;
  value_scale_ = texels.scale();
  light_step_m_ = kLightStepVoxels * meanSpacing(volume.geometry());
}

void SliceCanvas::setTable(const TransferTable& table) {
  const GlContext::Current current(context_);
  const GlFunctions& gl = context_.gl();
  gl.BindTexture(GL_TEXTURE_1D, table_texture_);
  gl.TexImage1D(GL_TEXTURE_1D, 0, GL_RGBA32F, TransferTable::kSize, 0, GL_RGBA, GL_FLOAT, table.entries().data());
  table_first_ = table.firstValue();
  table_scale_ = table.entriesPerValue();
}

void SliceCanvas::resize(int width, int height) {
  const GlFunctions& gl = context_.gl();
  gl.BindFramebuffer(GL_FRAMEBUFFER, framebuffer_);
  gl.Viewport(0, 0, width, height);
  if (width == width_ && height == height_)
    return;
  attach(gl, GL_COLOR_ATTACHMENT0, colour_target_, GL_RGBA32F, GL_RGBA, width, height);
  attach(gl, GL_COLOR_ATTACHMENT1, depth_target_, GL_R32F, GL_RED, width, height);
  if (gl.CheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    throw Error("the OpenGL driver has no float32 render target");
  }
  width_ = width;
  height_ = height;
}

void SliceCanvas::upload(const SliceMesh& mesh) {
  const GlFunctions& gl = context_.gl();
  const auto pointTo = [&](GLuint attribute, GLint size, std::size_t offset) {
    gl.EnableVertexAttribArray(attribute);
    gl.VertexAttribPointer(attribute, size, GL_FLOAT, GL_FALSE, sizeof(SliceVertex),
                           reinterpret_cast<const void*>(offset));
  };
  gl.BindVertexArray(vertex_array_);
  gl.BindBuffer(GL_ARRAY_BUFFER, vertex_buffer_);
  gl.BufferData(GL_ARRAY_BUFFER, GLsizeiptr(mesh.vertices.size() * sizeof(SliceVertex)), mesh.vertices.data(),
                GL_STREAM_DRAW);
  pointTo(0, 2, offsetof(SliceVertex, u));
  pointTo(1, 3, offsetof(SliceVertex, texture));
  pointTo(2, 3, offsetof(SliceVertex, light));
  gl.BindBuffer(GL_ELEMENT_ARRAY_BUFFER, index_buffer_);
  gl.BufferData(GL_ELEMENT_ARRAY_BUFFER, GLsizeiptr(mesh.indices.size() * sizeof(std::uint32_t)), mesh.indices.data(),
                GL_STREAM_DRAW);
}

void SliceCanvas::setUniforms(const Program& program, const Camera& camera, double slice_distance_m,
                              const RenderOptions& options) {
  const GlFunctions& gl = context_.gl();
  gl.UseProgram(program.id);
  gl.Uniform2f(program["image_size"], float(camera.width), float(camera.height));
  gl.Uniform4f(program["pinhole"], float(camera.cx), float(camera.cy), float(1.0 / camera.fx), float(1.0 / camera.fy));
  gl.Uniform1f(program["value_scale"], float(value_scale_));
  gl.Uniform2f(program["table_map"], float(table_first_), float(table_scale_));
  gl.Uniform1f(program["slice_distance"], float(slice_distance_m));
  gl.Uniform1f(program["light_step"], float(light_step_m_));
  gl.Uniform1f(program["shading"], float(options.shading));
  gl.Uniform1f(program["edge_scale"], float(kEdgesPerTable * table_scale_ / TransferTable::kSize));
  gl.Uniform1f(program["threshold"], float(options.depth_threshold));
}

void SliceCanvas::bindTextures() {
  const GlFunctions& gl = context_.gl();
  gl.ActiveTexture(GL_TEXTURE0 + kVolumeUnit);
  gl.BindTexture(GL_TEXTURE_3D, volume_texture_);
  gl.ActiveTexture(GL_TEXTURE0 + kTableUnit);
  gl.BindTexture(GL_TEXTURE_1D, table_texture_);
  gl.ActiveTexture(GL_TEXTURE0 + kAccumulatedUnit);
  gl.BindTexture(GL_TEXTURE_2D, colour_target_);
}

/// Colour goes under what is there; of the depths the nearest stays.
void SliceCanvas::prepareTargets(bool depth) {
  const GlFunctions& gl = context_.gl();
  const std::array<GLenum, 2> targets = {GL_COLOR_ATTACHMENT0, GL_COLOR_ATTACHMENT1};
  gl.DrawBuffers(depth ? 2 : 1, targets.data());
  gl.Enable(GL_BLEND);
  gl.BlendFunci(0, GL_ONE_MINUS_DST_ALPHA, GL_ONE);
  gl.BlendEquationi(0, GL_FUNC_ADD);
  gl.BlendEquationi(1, GL_MIN);
  const std::array<float, 4> transparent{};
  const std::array<float, 4> far{kFar, kFar, kFar, kFar};
  gl.ClearBufferfv(GL_COLOR, 0, transparent.data());
  if (depth)
    gl.ClearBufferfv(GL_COLOR, 1, far.data());
}

void SliceCanvas::drawSlices(const Program& program, const SliceMesh& mesh, bool depth) {
  const GlFunctions& gl = context_.gl();
  if (!depth) {
    gl.DrawElements(GL_TRIANGLES, GLsizei(mesh.indices.size()), GL_UNSIGNED_INT, nullptr);
    return;
  }
  const GLint slice_z = program["slice_z"];
  for (const Slice& slice : mesh.slices) {
    if (slice.index_count == 0)
      continue;
    gl.Uniform1f(slice_z, slice.z_m);
    gl.TextureBarrier();  // the shader reads the opacity that the slices before have left
    gl.DrawElements(GL_TRIANGLES, GLsizei(slice.index_count), GL_UNSIGNED_INT,
                    reinterpret_cast<const void*>(slice.first_index * sizeof(std::uint32_t)));
  }
}

void SliceCanvas::read(Frame& frame, bool depth) {
  const GlFunctions& gl = context_.gl();
  const std::size_t pixels = std::size_t(frame.width) * std::size_t(frame.height);
  gl.PixelStorei(GL_PACK_ALIGNMENT, 1);
  frame.rgba.resize(pixels * 4);
  gl.ReadBuffer(GL_COLOR_ATTACHMENT0);
  gl.ReadPixels(0, 0, frame.width, frame.height, GL_RGBA, GL_FLOAT, frame.rgba.data());
  if (!depth)
    return;
  frame.depth_m.resize(pixels);
  gl.ReadBuffer(GL_COLOR_ATTACHMENT1);
  gl.ReadPixels(0, 0, frame.width, frame.height, GL_RED, GL_FLOAT, frame.depth_m.data());
  for (float& depth_m : frame.depth_m) {
    if (depth_m == kFar)
      depth_m = std::numeric_limits<float>::quiet_NaN();
  }
}

Frame SliceCanvas::draw(const Camera& camera, const SliceMesh& mesh, double slice_distance_m,
                        const RenderOptions& options) {
  const GlContext::Current current(context_);
  const Program& program = options.depth ? *depth_program_ : *colour_program_;
  bindTextures();
  resize(camera.width, camera.height);
  upload(mesh);
  setUniforms(program, camera, slice_distance_m, options);
  prepareTargets(options.depth);
  drawSlices(program, mesh, options.depth);
  Frame frame;
  frame.width = camera.width;
  frame.height = camera.height;
  frame.slices = int(mesh.slices.size());
  frame.polygons = mesh.polygon_count;
  read(frame, options.depth);
  if (context_.gl().GetError() != GL_NO_ERROR)
    throw Error("OpenGL reported an error while a frame was drawn");
  return frame;
}

}  // namespace soft_volume::core
