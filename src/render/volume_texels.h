#pragma once

#include <GL/glcorearb.h>

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// The scalars of a volume as a one-component texture: 8- and 16-bit integers as 16-bit normalised texels, everything
/// else as float32. Refers to the volume, which must outlive it.
class VolumeTexels {
 public:
  explicit VolumeTexels(const Volume& volume);
  GLint internalFormat() const { return internal_format_; }
  GLenum type() const { return type_; }
  const void* data() const { return data_; }
  /// Texel times this is the scalar.
  double scale() const { return scale_; }

 private:
  template <typename Scalar, typename Texel>
  void convert(const Volume& volume);
  void setFormat(GLint internal_format, GLenum type, double scale);

  GLint internal_format_ = GL_R32F;
  GLenum type_ = GL_FLOAT;
  double scale_ = 1.0;
  const void* data_ = nullptr;
  std::vector<std::uint8_t> converted_;
};

/// For each axis-aligned box of texture coordinates the smallest and largest scalar that trilinear look-up can meet
/// there, NaN left out; {0, 0} where all are NaN. Boxes are {low, high}.
std::vector<std::array<double, 2>> scalarRanges(const Volume& volume,
                                                const std::vector<std::array<Vector3f, 2>>& boxes);

}  // namespace soft_volume::core
