#pragma once

#include <cmath>
#include <cstring>
#include <memory>
#include <random>
#include <vector>

#include "soft_volume/grid/topology.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/volume/transfer_function.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// A block of `cells` equal hexahedra that fills `box`; texture coordinates [0, 1]^3 over the box.
inline Topology makeBlock(const Box3& box, const Vector3i& cells) {
  Topology topology;
  const Vector3i vertices = cells + Vector3i::Ones();
  const auto number = [&](int i, int j, int k) { return std::uint32_t(i + vertices.x() * (j + vertices.y() * k)); };
  for (int k = 0; k < vertices.z(); ++k) {
    for (int j = 0; j < vertices.y(); ++j) {
      for (int i = 0; i < vertices.x(); ++i) {
        const Vector3 part = Vector3(i, j, k).cwiseQuotient(cells.cast<double>());
        topology.rest_positions.push_back((box.min() + part.cwiseProduct(box.sizes())).cast<float>());
        topology.texture_coordinates.push_back(part.cast<float>());
      }
    }
  }
  topology.fixed.assign(topology.rest_positions.size(), 0);
  topology.cell_offsets.push_back(0);
  for (int k = 0; k < cells.z(); ++k) {
    for (int j = 0; j < cells.y(); ++j) {
      for (int i = 0; i < cells.x(); ++i) {
        for (const std::uint32_t corner :
             {number(i, j, k), number(i + 1, j, k), number(i + 1, j + 1, k), number(i, j + 1, k), number(i, j, k + 1),
              number(i + 1, j, k + 1), number(i + 1, j + 1, k + 1), number(i, j + 1, k + 1)}) {
          topology.connectivity.push_back(corner);
        }
        topology.cell_types.push_back(CellType::kHexahedron);
        topology.cell_offsets.push_back(std::uint32_t(topology.connectivity.size()));
      }
    }
  }
  topology.materials.assign(topology.cellCount(), 0);
  topology.face_neighbours.assign(topology.cellCount() * 6, -1);
  topology.cut_faces.assign(topology.cellCount() * 6, 0);
  return topology;
}

/// Float volume of `dims` voxels that fills `size_m`, with value(texture coordinate of the voxel's centre).
template <typename Value>
std::shared_ptr<const Volume> makeVolume(const Vector3i& dims, const Vector3& size_m, const Value& value) {
  VolumeGeometry geometry;
  geometry.dims = dims;
  geometry.spacing_m = size_m.cwiseQuotient(dims.cast<double>());
  std::vector<float> scalars;
  for (int k = 0; k < dims.z(); ++k) {
    for (int j = 0; j < dims.y(); ++j) {
      for (int i = 0; i < dims.x(); ++i) {
        scalars.push_back(float(value((Vector3(i, j, k) + Vector3::Constant(0.5)).cwiseQuotient(dims.cast<double>()))));
      }
    }
  }
  std::vector<std::uint8_t> data(scalars.size() * sizeof(float));
  std::memcpy(data.data(), scalars.data(), data.size());
  return std::make_shared<const Volume>(geometry, ScalarType::kFloat32, std::move(data));
}

/// White for all values from `low` on, with the given opacity per `unit_distance_m`, and nothing below `low` - 0.01.
inline TransferFunction makeStep(double low, float opacity, double unit_distance_m) {
  TransferFunction function;
  const Vector3f white = Vector3f::Ones();
  function.points = {{-1.0, white, 0.0F}, {low - 0.01, white, 0.0F}, {low, white, opacity}, {2.0, white, opacity}};
  function.unit_distance_m = unit_distance_m;
  return function;
}

/// Looks along the volume frame's +z, image right = +x, image down = +y.
inline Camera straightCamera(const Vector3& eye, int width = 64, int height = 48, double focal = 100.0) {
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.fx = camera.fy = focal;
  camera.cx = 0.5 * (width - 1);
  camera.cy = 0.5 * (height - 1);
  camera.T_volume_camera.position_m = eye;
  return camera;
}

}  // namespace soft_volume::core
