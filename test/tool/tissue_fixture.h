#pragma once

#include <cstring>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "soft_volume/grid/patch.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

using Field = std::function<double(const Vector3&)>;
using Map = std::function<Vector3(const Vector3&)>;

inline Vector3 identity(const Vector3& p) {
  return p;
}

/// A float volume of `dims` voxels that takes its scalars from a function of the point in the volume frame.
inline std::shared_ptr<const Volume> makeVolume(const Vector3i& dims, double spacing_m, const Field& intensity) {
  VolumeGeometry geometry;
  geometry.dims = dims;
  geometry.spacing_m = Vector3::Constant(spacing_m);
  std::vector<std::uint8_t> data(geometry.voxelCount() * sizeof(float));
  for (int k = 0; k < dims.z(); ++k) {
    for (int j = 0; j < dims.y(); ++j) {
      for (int i = 0; i < dims.x(); ++i) {
        const auto value = float(intensity(spacing_m * Vector3(i, j, k)));
        std::memcpy(data.data() + geometry.index(i, j, k) * sizeof(float), &value, sizeof(float));
      }
    }
  }
  return std::make_shared<const Volume>(geometry, ScalarType::kFloat32, std::move(data));
}

/// A lattice of hexahedra over part of a volume, as topology and patch. All of it is the patch unless cut down.
struct Tissue {
  std::shared_ptr<const Volume> volume;
  Topology topology;
  GridPatch patch;
  Vector3i cells = Vector3i::Zero();

  std::uint32_t cellAt(int i, int j, int k) const { return std::uint32_t(i + cells.x() * (j + cells.y() * k)); }
  std::uint32_t vertexAt(int i, int j, int k) const {
    return std::uint32_t(i + (cells.x() + 1) * (j + (cells.y() + 1) * k));
  }

  /// Moves the patch's vertices to where `map` puts their rest positions.
  void deform(
      const Map& map, const Map& velocity = [](const Vector3&) { return Vector3(Vector3::Zero()); }) {
    for (std::size_t v = 0; v < patch.vertex_ids.size(); ++v) {
      const Vector3 rest = topology.rest_positions[patch.vertex_ids[v]].cast<double>();
      patch.positions[v] = map(rest).cast<float>();
      patch.velocities[v] = velocity(rest).cast<float>();
    }
  }
  /// Keeps only the cells of the patch for which `keep` holds at the centre at rest.
  void keepCells(const std::function<bool(const Vector3&)>& keep) {
    std::vector<std::uint32_t> kept;
    for (const std::uint32_t id : patch.cell_ids) {
      Vector3f centre = Vector3f::Zero();
      for (int c = 0; c < 8; ++c)
        centre += topology.rest_positions[topology.connectivity[8 * id + c]] / 8.0F;
      if (keep(centre.cast<double>()))
        kept.push_back(id);
    }
    patch.cell_ids = kept;
    patch.stiffness_pa.resize(kept.size(), 10000.0F);
  }
};

inline std::int32_t neighbourOrNone(const Tissue& tissue, int i, int j, int k) {
  const Vector3i n = tissue.cells;
  const bool inside = i >= 0 && j >= 0 && k >= 0 && i < n.x() && j < n.y() && k < n.z();
  return inside ? std::int32_t(tissue.cellAt(i, j, k)) : -1;
}

inline void addCell(Tissue& tissue, int i, int j, int k) {
  Topology& topology = tissue.topology;
  for (int c = 0; c < 8; ++c) {
    const int dx = (c == 1 || c == 2 || c == 5 || c == 6) ? 1 : 0;
    const int dy = (c == 2 || c == 3 || c == 6 || c == 7) ? 1 : 0;
    topology.connectivity.push_back(tissue.vertexAt(i + dx, j + dy, k + (c >= 4 ? 1 : 0)));
  }
  topology.cell_types.push_back(CellType::kHexahedron);
  topology.cell_offsets.push_back(std::uint32_t(topology.connectivity.size()));
  const int steps[6][3] = {{-1, 0, 0}, {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}};
  for (const auto& s : steps) {
    topology.face_neighbours.push_back(neighbourOrNone(tissue, i + s[0], j + s[1], k + s[2]));
    topology.cut_faces.push_back(0);
  }
}

inline Tissue makeTissue(std::shared_ptr<const Volume> volume, const Vector3i& cells, const Vector3& corner_m,
                         double edge_m) {
  Tissue tissue;
  tissue.volume = std::move(volume);
  tissue.cells = cells;
  Topology& topology = tissue.topology;
  topology.session = tissue.patch.session = 7;
  topology.revision = tissue.patch.revision = 3;
  for (int k = 0; k <= cells.z(); ++k) {
    for (int j = 0; j <= cells.y(); ++j) {
      for (int i = 0; i <= cells.x(); ++i) {
        const Vector3 rest = corner_m + edge_m * Vector3(i, j, k);
        topology.rest_positions.push_back(rest.cast<float>());
        topology.texture_coordinates.push_back(tissue.volume->geometry().toTexture(rest).cast<float>());
        topology.fixed.push_back(0);
      }
    }
  }
  topology.cell_offsets.push_back(0);
  for (int k = 0; k < cells.z(); ++k) {
    for (int j = 0; j < cells.y(); ++j) {
      for (int i = 0; i < cells.x(); ++i)
        addCell(tissue, i, j, k);
    }
  }
  topology.materials.assign(topology.cellCount(), 0);
  GridPatch& patch = tissue.patch;
  patch.tool_id = "probe";
  for (std::uint32_t v = 0; v < topology.vertexCount(); ++v)
    patch.vertex_ids.push_back(v);
  for (std::uint32_t c = 0; c < topology.cellCount(); ++c)
    patch.cell_ids.push_back(c);
  patch.positions.resize(patch.vertex_ids.size());
  patch.velocities.resize(patch.vertex_ids.size());
  patch.stiffness_pa.assign(patch.cell_ids.size(), 10000.0F);
  patch.cut_resistance_j_m2.assign(patch.cell_ids.size(), 0.0F);
  tissue.deform(identity);
  return tissue;
}

/// Tissue below a plane: the intensity is the depth below it in millimetres, so the threshold is 0 and trilinear
/// interpolation is exact. 64 mm wide, 60 mm high; the lattice of 8 x 8 x 7 cells of 7 mm starts at (4, 4, 4) mm.
inline Tissue makeHalfSpace(const Vector3& point_m, const Vector3& normal) {
  const auto volume =
      makeVolume({33, 33, 31}, 0.002, [=](const Vector3& p) { return -1000.0 * normal.dot(p - point_m); });
  return makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007);
}

/// The surface of the half-space in most tests: z = 40 mm.
constexpr double kSurfaceZ = 0.040;
inline Tissue makeFlatHalfSpace() {
  return makeHalfSpace({0.0, 0.0, kSurfaceZ}, Vector3::UnitZ());
}

}  // namespace soft_volume::core
