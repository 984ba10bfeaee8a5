#pragma once

#include <string>
#include <vector>

namespace soft_volume::core {

/// What the vertices of slices carry besides their place in the image.
enum class GlSource {
  kTexture,  ///< texture coordinates
  kScalar,   ///< the scalar
  kColour,   ///< colour and absorption
};

/// One of the programs that draw slices. Each is compiled of its own: software drivers run both sides of an if, so that
/// a switch at run time would save nothing.
struct GlVariant {
  GlSource source = GlSource::kTexture;
  bool slab_values = true;  ///< the scalar changes along the ray inside a slab
  bool beyond = true;       ///< the scalar leaves the transfer function's range
  bool shaded = false;
  bool depth = false;   ///< depth, and the label if `labels`
  bool labels = false;  ///< of textures
  bool clipped = false;
  bool jitter = false;
  bool parallel = false;
  bool mipmapped = false;
  bool cross_section = false;

  unsigned key() const {
    const bool bits[] = {slab_values, beyond, shaded,   depth,     labels,
                         clipped,     jitter, parallel, mipmapped, cross_section};
    unsigned key = unsigned(source);
    for (const bool bit : bits)
      key = key * 2 + unsigned(bit);
    return key;
  }
};

/// Numbers in each attribute of a vertex behind its place in the image, which is location 0.
/// Textures: coordinates, their change along the ray; if shaded, along the camera's x and y.
/// Scalars: the scalar and its change along the ray; colours: colour and absorption; if shaded, the scalar's gradient.
std::vector<int> attributeSizes(const GlVariant& variant);

std::string vertexShader(const GlVariant& variant);
std::string fragmentShader(const GlVariant& variant);

/// Sets the depth buffer to 0 where a pixel is opaque; slices lie at 0.5 and fail the depth test there before their
/// shader runs.
extern const char* const kMaskVertexShader;
extern const char* const kMaskFragmentShader;

}  // namespace soft_volume::core
