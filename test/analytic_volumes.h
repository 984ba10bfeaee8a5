#pragma once

#include <cstring>
#include <functional>
#include <vector>

#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// A float volume whose voxels hold `value(p)` at their centres p in the volume frame, metres.
inline Volume makeVolume(const Vector3i& dims, double spacing_m, const std::function<double(const Vector3&)>& value) {
  VolumeGeometry geometry;
  geometry.dims = dims;
  geometry.spacing_m = Vector3::Constant(spacing_m);
  std::vector<float> scalars;
  scalars.reserve(geometry.voxelCount());
  for (int k = 0; k < dims.z(); ++k) {
    for (int j = 0; j < dims.y(); ++j) {
      for (int i = 0; i < dims.x(); ++i)
        scalars.push_back(static_cast<float>(value(Vector3(i, j, k) * spacing_m)));
    }
  }
  std::vector<std::uint8_t> data(scalars.size() * sizeof(float));
  std::memcpy(data.data(), scalars.data(), data.size());
  return Volume(geometry, ScalarType::kFloat32, std::move(data));
}

}  // namespace soft_volume::core
