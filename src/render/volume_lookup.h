#pragma once

#include "soft_volume/common/geometry.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// A volume's trilinear interpolant by texture coordinates: voxel centres at (i + 0.5) / n, clamped at the edge.
/// Refers to the volume.
class VolumeLookup {
 public:
  explicit VolumeLookup(const Volume& volume)
      : volume_(&volume), spacing_(volume.geometry().spacing_m), dims_(volume.geometry().dims.cast<double>()) {}

  double at(const Vector3& texture) const {
    const Vector3 voxel = texture.cwiseProduct(dims_) - Vector3::Constant(0.5);
    return volume_->sample(voxel.cwiseProduct(spacing_));
  }
  /// How many voxels lie along each axis of the texture coordinates.
  const Vector3& dims() const { return dims_; }

 private:
  const Volume* volume_;
  Vector3 spacing_;
  Vector3 dims_;
};

}  // namespace soft_volume::core
