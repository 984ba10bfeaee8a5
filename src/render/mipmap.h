#pragma once

#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/render/camera.h"

namespace soft_volume::core {

/// Sides of the next coarser level of a mipmap.
inline Vector3i halvedDims(const Vector3i& dims) {
  return (dims / 2).cwiseMax(1);
}

/// The next coarser level of a volume (x fastest): each voxel is the mean of what lies below it, voxels on its border
/// by the part inside. NaN is left out; what is NaN to more than half stays NaN. The same bits everywhere, which
/// drivers do not promise for their own mipmaps. For std::int16_t, std::uint16_t and float.
template <typename Texel>
std::vector<Texel> halveVolume(const Texel* texels, const Vector3i& dims);

/// Width in voxels of a pixel at a depth of 1 m, or at any depth under parallel projection: along that side where it is
/// wider. `texture_per_m` is how the texture coordinates of a volume of `dims` voxels change in the volume frame.
double pixelWidth(const Camera& camera, const Vector3i& dims, const Matrix3& texture_per_m);

}  // namespace soft_volume::core
