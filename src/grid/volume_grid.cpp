#include "soft_volume/grid/volume_grid.h"

#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

void checkSize(const VolumeGeometry& geometry) {
  if (geometry.dims.minCoeff() < 2) {
    throw InputError("a volume with " + std::to_string(geometry.dims.minCoeff()) +
                     " voxels along an axis has no cells between them; two are needed");
  }
  if (geometry.voxelCount() > kMaxGridVoxels) {
    throw InputError("a volume of " + std::to_string(geometry.voxelCount()) +
                     " voxels is too large for a grid of cells, which may have " + std::to_string(kMaxGridVoxels) +
                     "; take a region or every second voxel, or draw it as a texture");
  }
}

/// Calls visit(i, j, k), x fastest.
template <typename Visit>
void forEachIndex(const Vector3i& dims, const Visit& visit) {
  for (int k = 0; k < dims.z(); ++k) {
    for (int j = 0; j < dims.y(); ++j) {
      for (int i = 0; i < dims.x(); ++i)
        visit(i, j, k);
    }
  }
}

}  // namespace

IrregularGrid gridOf(const Volume& volume) {
  const VolumeGeometry& geometry = volume.geometry();
  checkSize(geometry);
  IrregularGrid grid;
  grid.points.reserve(geometry.voxelCount());
  grid.point_scalars.reserve(geometry.voxelCount());
  forEachIndex(geometry.dims, [&](int i, int j, int k) {
    grid.points.push_back(Vector3(i, j, k).cwiseProduct(geometry.spacing_m).cast<float>());
    grid.point_scalars.push_back(static_cast<float>(volume.at(i, j, k)));
  });
  const Vector3i cells = geometry.dims - Vector3i::Ones();
  const std::size_t count = std::size_t(cells.x()) * std::size_t(cells.y()) * std::size_t(cells.z());
  grid.cell_types.assign(count, CellType::kVoxel);
  grid.connectivity.reserve(8 * count);
  grid.cell_offsets.reserve(count + 1);
  grid.cell_offsets.push_back(0);
  forEachIndex(cells, [&](int i, int j, int k) {
    for (int corner = 0; corner < 8; ++corner) {
      const std::size_t vertex = geometry.index(i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2));
      grid.connectivity.push_back(static_cast<std::uint32_t>(vertex));
    }
    grid.cell_offsets.push_back(static_cast<std::uint32_t>(grid.connectivity.size()));
  });
  return grid;
}

}  // namespace soft_volume::core
