#include "light.h"

#include <cmath>

#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

/// Sum over the cells of the volumes of the boxes around them.
double boxVolumes(const DrawnGrid& grid, const std::vector<Vector3f>& points) {
  double sum = 0.0;
  for (std::size_t cell = 0; cell < grid.cellCount(); ++cell) {
    const std::uint32_t* begin = &grid.connectivity[grid.cell_offsets[cell]];
    Eigen::AlignedBox3f box;
    if (grid.cell_types[cell] == CellType::kPolyhedron) {
      for (const std::uint32_t vertex : verticesOfPolyhedron(begin))
        box.extend(points[vertex]);
    } else {
      for (std::uint32_t i = grid.cell_offsets[cell]; i < grid.cell_offsets[cell + 1]; ++i)
        box.extend(points[grid.connectivity[i]]);
    }
    sum += box.sizes().cast<double>().prod();
  }
  return sum;
}

}  // namespace

double shadingStep(const DrawnGrid& grid, const VolumeGeometry* volume) {
  const double space = boxVolumes(grid, grid.rest_positions);
  const double parts =
      volume != nullptr ? boxVolumes(grid, grid.texture) * double(volume->voxelCount()) : double(grid.cellCount());
  const double step_m = std::cbrt(space / parts);
  if (std::isfinite(step_m) && step_m > 0.0)
    return step_m;
  return volume != nullptr ? std::cbrt(volume->spacing_m.prod()) : 1.0;
}

}  // namespace soft_volume::core
