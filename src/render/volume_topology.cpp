#include <algorithm>
#include <array>
#include <vector>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

/// Texture coordinates at which the cells of one axis begin and end.
std::vector<double> cuts(int voxels, int cell_voxels) {
  const int step = cell_voxels > 0 ? cell_voxels : voxels;
  std::vector<double> places;
  for (int voxel = 0; voxel < voxels; voxel += step)
    places.push_back(double(voxel) / voxels);
  places.push_back(1.0);
  return places;
}

/// Of a box of cells.
struct Raster {
  std::array<int, 3> cells;

  int cell(const std::array<int, 3>& at) const { return at[0] + cells[0] * (at[1] + cells[1] * at[2]); }
  std::uint32_t vertex(int i, int j, int k) const {
    return std::uint32_t(i + (cells[0] + 1) * (j + (cells[1] + 1) * k));
  }
  std::int32_t neighbour(std::array<int, 3> at, int face) const {
    const int axis = face / 2;
    at[std::size_t(axis)] += face % 2 == 0 ? -1 : 1;
    const bool outside = at[std::size_t(axis)] < 0 || at[std::size_t(axis)] >= cells[std::size_t(axis)];
    return outside ? -1 : cell(at);
  }
};

void addCell(const Raster& raster, const std::array<int, 3>& at, Topology& topology) {
  for (const auto& corner : kHexahedronCorners)
    topology.connectivity.push_back(raster.vertex(at[0] + corner[0], at[1] + corner[1], at[2] + corner[2]));
  topology.cell_types.push_back(CellType::kHexahedron);
  topology.cell_offsets.push_back(std::uint32_t(topology.connectivity.size()));
  topology.materials.push_back(0);
  for (int face = 0; face < 6; ++face) {
    topology.face_neighbours.push_back(raster.neighbour(at, face));
    topology.cut_faces.push_back(0);
  }
}

}  // namespace

Topology volumeTopology(const VolumeGeometry& geometry, int cell_voxels) {
  if (cell_voxels < 0 || geometry.dims.minCoeff() < 1)
    throw InputError("a volume without voxels, or a negative size of its cells, has no grid");
  std::array<std::vector<double>, 3> places;
  Raster raster{};
  for (int axis = 0; axis < 3; ++axis) {
    places[std::size_t(axis)] = cuts(geometry.dims[axis], cell_voxels);
    raster.cells[std::size_t(axis)] = int(places[std::size_t(axis)].size()) - 1;
  }
  Topology topology;
  for (const double z : places[2]) {
    for (const double y : places[1]) {
      for (const double x : places[0]) {
        topology.texture_coordinates.push_back(Vector3(x, y, z).cast<float>());
        topology.rest_positions.push_back(geometry.fromTexture(Vector3(x, y, z)).cast<float>());
      }
    }
  }
  topology.fixed.assign(topology.rest_positions.size(), 1);
  topology.cell_offsets.assign(1, 0);
  for (int k = 0; k < raster.cells[2]; ++k) {
    for (int j = 0; j < raster.cells[1]; ++j) {
      for (int i = 0; i < raster.cells[0]; ++i)
        addCell(raster, {i, j, k}, topology);
    }
  }
  return topology;
}

}  // namespace soft_volume::core
