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
enum : GLint { kVolumeUnit, kTableUnit, kIntegralUnit, kAccumulatedUnit };
/// Distance of the samples that the gradient is taken from.
constexpr double kNormalStepVoxels = 1.0;
/// A change of the value by the transfer function's range over this, within that distance, is a surface.
constexpr double kEdgesPerRange = 20.0;
/// Clear value of the depth target; a pixel that keeps it was not hit.
constexpr float kFar = std::numeric_limits<float>::max();

/// Behind this opacity a pixel takes nothing more: what is left out is below a quarter of an 8-bit level.
constexpr float kOpaque = 0.999F;
/// Opaque pixels are masked before planes whose number on their ladder is a multiple of this: places that do not depend
/// on the deformation, so that the image changes only where the grid does. More often costs more than it saves.
constexpr int kPlanesPerMask = 8;

const char* const kVertexShader = R"(#version 450 core
layout(location = 0) in vec2 pixel;
layout(location = 1) in vec3 texture_in;
layout(location = 2) in vec3 view_in;
layout(location = 3) in vec3 right_in;
layout(location = 4) in vec3 down_in;
uniform vec2 image_size;
out vec3 texture_coordinate;
out vec3 view;
out vec3 right;
out vec3 down;
void main() {
  texture_coordinate = texture_in;
  view = view_in;
  right = right_in;
  down = down_in;
  // Pixel centres are whole numbers in the image and halves in OpenGL. The top row is drawn, and read, first.
  gl_Position = vec4((pixel + 0.5) / image_size * 2.0 - 1.0, 0.0, 1.0);
}
)";

/// Sets the depth buffer to 0 where a pixel is opaque; slices lie at 0.5 and fail the depth test there before their
/// shader runs.
const char* const kMaskVertexShader = R"(#version 450 core
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  gl_Position = vec4(corner, -1.0, 1.0);
}
)";
const char* const kMaskFragmentShader = R"(#version 450 core
layout(binding = 3) uniform sampler2D accumulated;
uniform float opaque;
void main() {
  if (texelFetch(accumulated, ivec2(gl_FragCoord.xy), 0).a < opaque) discard;
}
)";

/// Compiled with and without each of DEPTH and SHADED: software drivers run both sides of an if, so that a switch at
/// run time would save nothing.
///
/// A slice stands for the slab around it. Its scalar is taken as linear between the values where the ray enters and
/// leaves the slab, so that narrow peaks of the transfer function and the edges of tissue are not stepped over.
const char* const kFragmentShader = R"(
in vec3 texture_coordinate;
in vec3 view;
in vec3 right;
in vec3 down;
layout(binding = 0) uniform sampler3D volume;
layout(binding = 1) uniform sampler1D table;
layout(binding = 2) uniform sampler1D integrals;
uniform float value_scale;
uniform vec2 table_map;        // first value, entries per value
uniform vec4 pinhole;          // cx, cy, 1 / fx, 1 / fy
uniform float slice_distance;
uniform float normal_step;
uniform float shading;
uniform vec3 light;             // towards it, camera frame, unit length
uniform float edge_scale;      // 1 / the value difference that counts as a full edge
layout(location = 0) out vec4 colour;
#ifdef DEPTH
layout(binding = 3) uniform sampler2D accumulated;
uniform float slice_z;
uniform float threshold;
layout(location = 1) out float depth;
#endif

float valueAt(vec3 position) { return texture(volume, position).r * value_scale; }

float entryOf(float value) {
  return clamp((value - table_map.x) * table_map.y, 0.0, float(textureSize(table, 0) - 1));
}

vec4 integralAt(float entry) { return texture(integrals, (entry + 0.5) / float(textureSize(integrals, 0))); }

// Mean colour and absorption while the scalar goes from one value to the other.
vec4 classify(float from, float to) {
  float first = entryOf(from);
  float last = entryOf(to);
  if (abs(last - first) < 4.0) return texelFetch(table, int(0.5 * (first + last) + 0.5), 0);
  vec4 mean = (integralAt(last) - integralAt(first)) / (last - first);
  return mean.a > 0.0 ? vec4(mean.rgb / mean.a, mean.a) : vec4(0.0);
}

// Gradient of the scalar in the camera frame: along the ray from the slab's two values, across it from three samples
// around its middle, as far apart.
vec3 gradientAt(float front, float back, vec2 slope) {
  vec3 aside = -0.5 * normal_step * right;
  vec3 below = 0.8660254 * normal_step * down;
  float first = valueAt(texture_coordinate + normal_step * right);
  float second = valueAt(texture_coordinate + aside + below);
  float third = valueAt(texture_coordinate + aside - below);
  vec2 across = vec2(first - 0.5 * (second + third), 0.8660254 * (second - third)) / (1.5 * normal_step);
  return vec3(across, (back - front) / slice_distance - dot(slope, across));
}

// Diffuse light on the surface that the gradient makes, from either side; where the gradient is weak there is no
// surface, only a mean brightness.
float brightness(vec3 gradient) {
  float strength = length(gradient);
  if (!(strength > 0.0)) return mix(1.0, 0.7, shading);
  float diffuse = abs(dot(gradient, light)) / strength;
  return mix(1.0, mix(0.7, 0.2 + 0.9 * diffuse, min(1.0, strength * normal_step * edge_scale)), shading);
}

void main() {
  vec3 half_way = 0.5 * slice_distance * view;
  float front = valueAt(texture_coordinate - half_way);
  float back = valueAt(texture_coordinate + half_way);
  if (isnan(front + back)) discard;
  vec4 material = classify(front, back);
  if (material.a <= 0.0) discard;
  vec2 slope = (gl_FragCoord.xy - 0.5 - pinhole.xy) * pinhole.zw;
  float way = slice_distance * sqrt(1.0 + dot(slope, slope));
  float opacity = 1.0 - exp2(-material.a * way);
  vec3 lit = material.rgb;
#ifdef SHADED
  lit *= brightness(gradientAt(front, back, slope));
#endif
  colour = vec4(min(lit, 1.0) * opacity, opacity);
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

GLuint link(const GlFunctions& gl, const char* vertex_source, const std::string& fragment_source) {
  const GLuint vertex = compile(gl, GL_VERTEX_SHADER, vertex_source);
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
  throw Error(std::string("the OpenGL driver rejects a shader: ") + log.data());
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

std::string fragmentSource(bool depth, bool shaded) {
  const std::string switches = std::string(depth ? "#define DEPTH\n" : "") + (shaded ? "#define SHADED\n" : "");
  return "#version 450 core\n" + switches + kFragmentShader;
}

}  // namespace

struct SliceCanvas::Program {
  Program(const GlFunctions& gl, bool depth, bool shaded)
      : id(link(gl, kVertexShader, fragmentSource(depth, shaded))), gl_(gl) {}
  GLint operator[](const char* uniform) const { return gl_.GetUniformLocation(id, uniform); }
  const GLuint id;

 private:
  const GlFunctions& gl_;
};

SliceCanvas::SliceCanvas() {
  const GlContext::Current current(context_);
  const GlFunctions& gl = context_.gl();
  for (const bool depth : {false, true}) {
    for (const bool shaded : {false, true}) {
      programs_[programIndex(depth, shaded)] = std::make_unique<Program>(gl, depth, shaded);
    }
  }
  mask_program_ = link(gl, kMaskVertexShader, kMaskFragmentShader);
  gl.UseProgram(mask_program_);
  gl.Uniform1f(gl.GetUniformLocation(mask_program_, "opaque"), kOpaque);
  volume_texture_ = makeTexture(gl, GL_TEXTURE_3D, GL_LINEAR);
  table_texture_ = makeTexture(gl, GL_TEXTURE_1D, GL_NEAREST);
  integral_texture_ = makeTexture(gl, GL_TEXTURE_1D, GL_LINEAR);
  colour_target_ = makeTexture(gl, GL_TEXTURE_2D, GL_NEAREST);
  depth_target_ = makeTexture(gl, GL_TEXTURE_2D, GL_NEAREST);
  mask_target_ = makeTexture(gl, GL_TEXTURE_2D, GL_NEAREST);
  gl.GenFramebuffers(1, &framebuffer_);
  gl.GenVertexArrays(1, &vertex_array_);
  gl.GenBuffers(1, &vertex_buffer_);
  gl.GenBuffers(1, &index_buffer_);
}

SliceCanvas::~SliceCanvas() {
  const GlContext::Current current(context_);
  const GlFunctions& gl = context_.gl();
  for (const auto& program : programs_)
    gl.DeleteProgram(program->id);
  gl.DeleteProgram(mask_program_);
  for (const GLuint texture :
       {volume_texture_, table_texture_, integral_texture_, colour_target_, depth_target_, mask_target_}) {
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
  normal_step_m_ = kNormalStepVoxels * meanSpacing(volume.geometry());
}

void SliceCanvas::setTable(const TransferTable& table) {
  const GlContext::Current current(context_);
  const GlFunctions& gl = context_.gl();
  const auto fill = [&](GLuint texture, const std::vector<TransferTable::Entry>& entries) {
    gl.BindTexture(GL_TEXTURE_1D, texture);
    gl.TexImage1D(GL_TEXTURE_1D, 0, GL_RGBA32F, TransferTable::kSize, 0, GL_RGBA, GL_FLOAT, entries.data());
  };
  fill(table_texture_, table.entries());
  fill(integral_texture_, table.integrals());
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
  attach(gl, GL_DEPTH_ATTACHMENT, mask_target_, GL_DEPTH_COMPONENT24, GL_DEPTH_COMPONENT, width, height);
  if (gl.CheckFramebufferStatus(GL_FRAMEBUFFER) != GL_FRAMEBUFFER_COMPLETE) {
    throw Error("the OpenGL driver has no float32 render target");
  }
  width_ = width;
  height_ = height;
}

void SliceCanvas::upload(const LegacySliceMesh& mesh) {
  const GlFunctions& gl = context_.gl();
  const auto pointTo = [&](GLuint attribute, GLint size, std::size_t offset) {
    gl.EnableVertexAttribArray(attribute);
    gl.VertexAttribPointer(attribute, size, GL_FLOAT, GL_FALSE, sizeof(LegacySliceVertex),
                           reinterpret_cast<const void*>(offset));
  };
  gl.BindVertexArray(vertex_array_);
  gl.BindBuffer(GL_ARRAY_BUFFER, vertex_buffer_);
  gl.BufferData(GL_ARRAY_BUFFER, GLsizeiptr(mesh.vertices.size() * sizeof(LegacySliceVertex)), mesh.vertices.data(),
                GL_STREAM_DRAW);
  pointTo(0, 2, offsetof(LegacySliceVertex, u));
  pointTo(1, 3, offsetof(LegacySliceVertex, texture));
  pointTo(2, 3, offsetof(LegacySliceVertex, view));
  pointTo(3, 3, offsetof(LegacySliceVertex, right));
  pointTo(4, 3, offsetof(LegacySliceVertex, down));
  gl.BindBuffer(GL_ELEMENT_ARRAY_BUFFER, index_buffer_);
  gl.BufferData(GL_ELEMENT_ARRAY_BUFFER, GLsizeiptr(mesh.indices.size() * sizeof(std::uint32_t)), mesh.indices.data(),
                GL_STREAM_DRAW);
}

void SliceCanvas::setUniforms(const Program& program, const Camera& camera, double slice_distance_m,
                              const LegacyRenderOptions& options) {
  const GlFunctions& gl = context_.gl();
  gl.UseProgram(program.id);
  gl.Uniform2f(program["image_size"], float(camera.width), float(camera.height));
  gl.Uniform4f(program["pinhole"], float(camera.cx), float(camera.cy), float(1.0 / camera.fx), float(1.0 / camera.fy));
  gl.Uniform1f(program["value_scale"], float(value_scale_));
  gl.Uniform2f(program["table_map"], float(table_first_), float(table_scale_));
  gl.Uniform1f(program["slice_distance"], float(slice_distance_m));
  gl.Uniform1f(program["normal_step"], float(normal_step_m_));
  gl.Uniform1f(program["shading"], float(options.shading));
  gl.Uniform1f(program["edge_scale"], float(kEdgesPerRange * table_scale_ / TransferTable::kSize));
  const Vector3f light = Vector3f(-0.4F, -0.6F, -1.0F).normalized();
  gl.Uniform3f(program["light"], light.x(), light.y(), light.z());
  gl.Uniform1f(program["threshold"], float(options.depth_threshold));
}

void SliceCanvas::bindTextures() {
  const GlFunctions& gl = context_.gl();
  gl.ActiveTexture(GL_TEXTURE0 + kVolumeUnit);
  gl.BindTexture(GL_TEXTURE_3D, volume_texture_);
  gl.ActiveTexture(GL_TEXTURE0 + kTableUnit);
  gl.BindTexture(GL_TEXTURE_1D, table_texture_);
  gl.ActiveTexture(GL_TEXTURE0 + kIntegralUnit);
  gl.BindTexture(GL_TEXTURE_1D, integral_texture_);
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
  const float not_opaque = 1.0F;
  gl.Enable(GL_DEPTH_TEST);
  gl.DepthFunc(GL_LESS);
  gl.DepthMask(GL_TRUE);
  gl.ClearBufferfv(GL_DEPTH, 0, &not_opaque);
  gl.DepthMask(GL_FALSE);
}

void SliceCanvas::maskOpaquePixels() {
  const GlFunctions& gl = context_.gl();
  gl.TextureBarrier();  // the mask reads what the slices before have left
  gl.UseProgram(mask_program_);
  gl.ColorMask(GL_FALSE, GL_FALSE, GL_FALSE, GL_FALSE);
  gl.DepthMask(GL_TRUE);
  gl.DrawArrays(GL_TRIANGLES, 0, 3);
  gl.DepthMask(GL_FALSE);
  gl.ColorMask(GL_TRUE, GL_TRUE, GL_TRUE, GL_TRUE);
}

void SliceCanvas::drawSlice(const Program& program, const LegacySlice& slice, bool depth) {
  const GlFunctions& gl = context_.gl();
  if (depth) {
    gl.Uniform1f(program["slice_z"], slice.z_m);
    gl.TextureBarrier();  // the shader reads the opacity that the slices before have left
  }
  gl.DrawElements(GL_TRIANGLES, GLsizei(slice.index_count), GL_UNSIGNED_INT,
                  reinterpret_cast<const void*>(slice.first_index * sizeof(std::uint32_t)));
}

void SliceCanvas::drawSlices(const Program& program, const LegacySliceMesh& mesh, int first_number, bool depth) {
  int number = first_number;
  for (const LegacySlice& slice : mesh.slices) {
    if (number++ % kPlanesPerMask == 0)
      maskOpaquePixels();
    if (slice.index_count == 0)
      continue;
    context_.gl().UseProgram(program.id);
    drawSlice(program, slice, depth);
  }
}

void SliceCanvas::read(LegacyFrame& frame, bool depth) {
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

LegacyFrame SliceCanvas::draw(const Camera& camera, const LegacySliceMesh& mesh, const SlicePlanes& planes,
                              const LegacyRenderOptions& options) {
  const GlContext::Current current(context_);
  const Program& program = *programs_[programIndex(options.depth, options.shading > 0.0)];
  resize(camera.width, camera.height);
  bindTextures();
  upload(mesh);
  setUniforms(program, camera, planes.distance_m, options);
  prepareTargets(options.depth);
  drawSlices(program, mesh, planes.first_number, options.depth);
  LegacyFrame frame;
  frame.width = camera.width;
  frame.height = camera.height;
  frame.slices = int(mesh.slices.size());
  frame.polygons = mesh.polygon_count;
  read(frame, options.depth);
  if (context_.gl().GetError() != GL_NO_ERROR)
    throw Error("OpenGL reported an error while a frame was drawn");
  return frame;
}

std::string SliceCanvas::driver() {
  const GlContext::Current current(context_);
  const auto text = [this](GLenum name) { return reinterpret_cast<const char*>(context_.gl().GetString(name)); };
  return std::string(text(GL_RENDERER)) + ", " + text(GL_VERSION);
}

}  // namespace soft_volume::core
