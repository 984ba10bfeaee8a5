#include "gl_shaders.h"

#include "light.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

const char* const kVertexMain = R"(
layout(location = 0) in vec2 pixel;
uniform vec2 image_size;
#ifdef TEXTURE
layout(location = 1) in vec3 texture_in;
layout(location = 2) in vec3 view_in;
uniform vec3 brick_scale;   // from the volume's texture coordinates to the brick's
uniform vec3 brick_offset;
out vec3 texture_coordinate;
out vec3 view;
#ifdef SHADED
layout(location = 3) in vec3 right_in;
layout(location = 4) in vec3 down_in;
out vec3 right;
out vec3 down;
#endif
#endif
#ifdef SCALAR
layout(location = 1) in vec2 scalar_in;
out vec2 scalar;
#endif
#ifdef COLOUR
layout(location = 1) in vec4 classified_in;
out vec4 classified;
#endif
#if defined(SHADED) && !defined(TEXTURE)
layout(location = 2) in vec3 gradient_in;
out vec3 gradient;
#endif
void main() {
#ifdef TEXTURE
  texture_coordinate = texture_in * brick_scale + brick_offset;
  view = view_in * brick_scale;
#ifdef SHADED
  right = right_in * brick_scale;
  down = down_in * brick_scale;
#endif
#endif
#ifdef SCALAR
  scalar = scalar_in;
#endif
#ifdef COLOUR
  classified = classified_in;
#endif
#if defined(SHADED) && !defined(TEXTURE)
  gradient = gradient_in;
#endif
  // Pixel centres are whole numbers in the image and halves in OpenGL. The top row is drawn, and read, first.
  gl_Position = vec4((pixel + 0.5) / image_size * 2.0 - 1.0, 0.0, 1.0);
}
)";

/// What comes in and what main() is made of.
const char* const kFragmentDeclarations = R"(
layout(binding = 1) uniform sampler1D table;
layout(binding = 2) uniform sampler1D means;  // the integrals, then the table with colours times absorption
uniform vec2 table_map;        // first value, entries per value
uniform vec2 value_range;      // of the data
uniform vec4 low_end;          // the table's first and last entry, colours times absorption
uniform vec4 high_end;
uniform vec4 pinhole;          // cx, cy, 1 / fx, 1 / fy
uniform vec2 slab;             // from and to, metres of depth behind the slice
uniform float spacing;         // of the planes
uniform float slice_z;
uniform vec4 light;            // towards it, camera frame, unit length; and its strength
uniform vec4 highlight;        // half way between light and viewer; and its strength
uniform float surface_scale;   // gradient times this is the strength of a surface
layout(location = 0) out vec4 colour;
#ifdef CLIPPED
uniform int clip_count;
uniform vec4 clip_planes[MAX_CLIP_PLANES];  // normal in the camera frame, distance that the slice's axis point has left
#endif
#ifdef DEPTH
layout(binding = 3) uniform sampler2D accumulated;
uniform float threshold;
layout(location = 1) out float depth;
#ifdef LABELS
layout(binding = 4) uniform usampler3D labels;
uniform vec3 label_scale;      // from the brick's texture coordinates to the label texture's
uniform vec3 label_offset;
layout(location = 2) out float label;
#endif
#endif

#ifdef TEXTURE
in vec3 texture_coordinate;
in vec3 view;                  // change of the texture coordinates along the ray, per metre of depth
layout(binding = 0) uniform sampler3D volume;
uniform float value_scale;     // texel to scalar
#ifdef MIPMAPPED
uniform float level;
float valueAt(vec3 position) { return textureLod(volume, position, level).r * value_scale; }
#else
float valueAt(vec3 position) { return texture(volume, position).r * value_scale; }
#endif
#endif
#ifdef SCALAR
in vec2 scalar;                // its value, and its change along the ray per metre of depth
#endif
#ifdef COLOUR
in vec4 classified;
#endif

// Which entry of the table a value has; less than 0 and more than the last outside the table, which repeats its ends.
#ifdef BEYOND
float entryOf(float value) { return clamp((value - table_map.x) * table_map.y, -1e9, 1e9); }
#else
float entryOf(float value) { return (value - table_map.x) * table_map.y; }
#endif

vec4 materialOf(float value) {
  return texelFetch(table, int(clamp(entryOf(value), 0.0, float(textureSize(table, 0) - 1)) + 0.5), 0);
}

#if defined(SLAB_VALUES) && !defined(COLOUR)
// Mean colour and absorption while the scalar goes from one value to the other: the difference of two integrals. Where
// the values are close that is too little to be exact, and one look-up half way takes its place.
vec4 classify(float from, float to) {
  int size = textureSize(table, 0);
  float top = float(size - 1);
  float first = entryOf(from);
  float last = entryOf(to);
  float begin = floor(clamp(first, 0.0, top) + 0.5);
  float end = floor(clamp(last, 0.0, top) + 0.5);
  float count = end - begin;
#ifdef BEYOND
  float before = first < 0.0 || first > top ? first - begin : 0.0;
  float behind = last < 0.0 || last > top ? last - end : 0.0;
  count += behind - before;
#endif
  bool near = abs(count) < 4.0;
  vec4 sum = texelFetch(means, near ? size + int(clamp(0.5 * (first + last), 0.0, top) + 0.5) : int(end), 0) -
             texelFetch(means, near ? 0 : int(begin), 0);
#ifdef BEYOND
  if (!near) sum += behind * (behind < 0.0 ? low_end : high_end) - before * (before < 0.0 ? low_end : high_end);
#endif
  return sum.a != 0.0 ? vec4(sum.rgb / sum.a, near ? sum.a : sum.a / count) : vec4(0.0);
}
#endif

#ifdef SHADED
#ifdef TEXTURE
in vec3 right;                 // change of the texture coordinates per metre along the camera's x
in vec3 down;                  // and along its y
uniform float normal_step;     // distance of the samples that the gradient is taken from
// Gradient of the scalar in the camera frame: along the ray from the slab's two values, across it from three samples
// around its middle.
vec3 gradientAt(float along, vec2 slope) {
  vec3 aside = -0.5 * normal_step * right;
  vec3 below = 0.8660254 * normal_step * down;
  float first = valueAt(texture_coordinate + normal_step * right);
  float second = valueAt(texture_coordinate + aside + below);
  float third = valueAt(texture_coordinate + aside - below);
  vec2 across = vec2(first - 0.5 * (second + third), 0.8660254 * (second - third)) / (1.5 * normal_step);
  return vec3(across, along - dot(slope, across));
}
#else
in vec3 gradient;
#endif

// Light on the surface that the gradient makes, from either side; where the gradient is weak there is no surface, only
// a mean brightness.
vec3 lit(vec3 own, vec3 gradient) {
  float steepness = length(gradient);
  if (!(steepness > 0.0)) return own * mix(1.0, MEAN_LIGHT, light.w);
  vec3 normal = gradient / steepness;
  float strength = min(1.0, steepness * surface_scale);
  float diffuse = AMBIENT + DIFFUSE * abs(dot(normal, light.xyz));
  vec3 result = own * mix(1.0, mix(MEAN_LIGHT, diffuse, strength), light.w);
  float gloss = dot(normal, highlight.xyz);
  gloss *= gloss;
  gloss *= gloss;
  gloss *= gloss;
  gloss *= gloss;
  gloss *= gloss;
  return result + highlight.w * strength * gloss;
}
#endif

#ifdef JITTER
// jitterAt() of light.h.
float jitter() {
  uvec2 place = uvec2(gl_FragCoord.xy);
  uint inner = place.x * 288237660u + place.y * 25070368u;
  uint outer = inner * 52u + (inner >> 16) * 64417u;
  return float(outer >> 8) * (1.0 / 16777216.0) - 0.5;
}
#endif
)";

/// A slice stands for the slab around it. Its scalar is taken as linear between the values where the ray enters and
/// leaves the slab, so that narrow peaks of the transfer function and the edges of tissue are not stepped over.
const char* const kFragmentMain = R"(
void main() {
  vec2 image = (gl_FragCoord.xy - 0.5 - pinhole.xy) * pinhole.zw;
#ifdef PARALLEL
  const vec2 slope = vec2(0.0);
  const float lengthening = 1.0;
#else
  vec2 slope = image;
  float lengthening = sqrt(1.0 + dot(slope, slope));
#endif
  float from = slab.x;
  float to = slab.y;
#ifdef JITTER
  float shift = jitter() * spacing;
  from += shift;
  to += shift;
#endif
#ifdef CLIPPED
#ifdef PARALLEL
  vec2 place = image;
#else
  vec2 place = image * slice_z;
#endif
  for (int i = 0; i < clip_count; ++i) {
    vec4 plane = clip_planes[i];
    float gain = dot(plane.xyz, vec3(slope, 1.0));
    float room = plane.w - dot(plane.xy, place);
    if (gain > 0.0) to = min(to, room / gain);
    else if (gain < 0.0) from = max(from, room / gain);
    else if (room < 0.0) to = from;
  }
  if (!(from < to)) discard;
#endif

#ifdef COLOUR
  vec4 material = classified;
  if (isnan(material.a)) discard;
#else
#ifdef CROSS_SECTION
#ifdef TEXTURE
  float value = valueAt(texture_coordinate);
#else
  float value = scalar.x;
#endif
  if (isnan(value)) discard;
  vec4 material = materialOf(value);
#elif defined(SLAB_VALUES)
#ifdef TEXTURE
  float front = valueAt(texture_coordinate + from * view);
  float back = valueAt(texture_coordinate + to * view);
#else
  if (isnan(scalar.x + scalar.y)) discard;
  float front = clamp(scalar.x + from * scalar.y, value_range.x, value_range.y);
  float back = clamp(scalar.x + to * scalar.y, value_range.x, value_range.y);
#endif
  if (isnan(front + back)) discard;
  vec4 material = classify(front, back);
#else
  float value = scalar.x + 0.5 * (from + to) * scalar.y;
  if (isnan(value)) discard;
  vec4 material = materialOf(value);
#endif
#endif

#ifdef CROSS_SECTION
  colour = vec4(material.rgb, 1.0);
#else
  if (material.a <= 0.0) discard;
  float way = (to - from) * lengthening;
  float opacity = 1.0 - exp2(-material.a * way);
  vec3 own = material.rgb;
#ifdef SHADED
#ifdef TEXTURE
  own = lit(own, gradientAt((back - front) / (to - from), slope));
#else
  own = lit(own, gradient);
#endif
#endif
  colour = vec4(min(own, 1.0) * opacity, opacity);
#endif

#ifdef DEPTH
  // Zero for a label is never more than what is there.
  depth = FAR;
#ifdef LABELS
  label = 0.0;
#endif
  float before = texelFetch(accumulated, ivec2(gl_FragCoord.xy), 0).a;
  float after = before + (1.0 - before) * colour.a;
  if (before < threshold && after >= threshold) {
#ifdef CROSS_SECTION
    float behind = 0.0;
#else
    float part = log2((1.0 - before) / (1.0 - threshold)) / (material.a * way);
    float behind = mix(from, to, clamp(part, 0.0, 1.0));
#endif
    depth = slice_z + behind;
#ifdef LABELS
    vec3 position = (texture_coordinate + behind * view) * label_scale + label_offset;
    ivec3 size = textureSize(labels, 0);
    label = float(texelFetch(labels, clamp(ivec3(floor(position * vec3(size))), ivec3(0), size - 1), 0).r);
#endif
  }
#endif
}
)";

std::string switches(const GlVariant& variant) {
  std::string text = "#version 450 core\n";
  const auto define = [&](bool on, const std::string& name) { text += on ? "#define " + name + "\n" : ""; };
  define(variant.source == GlSource::kTexture, "TEXTURE");
  define(variant.source == GlSource::kScalar, "SCALAR");
  define(variant.source == GlSource::kColour, "COLOUR");
  define(variant.slab_values, "SLAB_VALUES");
  define(variant.beyond, "BEYOND");
  define(variant.shaded, "SHADED");
  define(variant.depth, "DEPTH");
  define(variant.labels, "LABELS");
  define(variant.clipped, "CLIPPED");
  define(variant.jitter, "JITTER");
  define(variant.parallel, "PARALLEL");
  define(variant.mipmapped, "MIPMAPPED");
  define(variant.cross_section, "CROSS_SECTION");
  return text;
}

std::string constants() {
  static_assert(kShininess == 32, "lit() squares five times");
  const auto define = [](const char* name, const std::string& value) {
    return std::string("#define ") + name + " " + value + "\n";
  };
  return define("MEAN_LIGHT", std::to_string(kMeanLight)) + define("AMBIENT", std::to_string(kAmbient)) +
         define("DIFFUSE", std::to_string(kDiffuse)) +
         define("MAX_CLIP_PLANES", std::to_string(RenderOptions::kMaxClipPlanes)) + define("FAR", "3.402823466e38");
}

}  // namespace

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

std::vector<int> attributeSizes(const GlVariant& variant) {
  switch (variant.source) {
    case GlSource::kTexture:
      return variant.shaded ? std::vector<int>{3, 3, 3, 3} : std::vector<int>{3, 3};
    case GlSource::kScalar:
      return variant.shaded ? std::vector<int>{2, 3} : std::vector<int>{2};
    default:
      return variant.shaded ? std::vector<int>{4, 3} : std::vector<int>{4};
  }
}

std::string vertexShader(const GlVariant& variant) {
  return switches(variant) + kVertexMain;
}

std::string fragmentShader(const GlVariant& variant) {
  return switches(variant) + constants() + kFragmentDeclarations + kFragmentMain;
}

}  // namespace soft_volume::core
