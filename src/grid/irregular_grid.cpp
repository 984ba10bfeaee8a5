#include "soft_volume/grid/irregular_grid.h"

#include <algorithm>
#include <string>

#include "check_cells.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {

void IrregularGrid::validate() const {
  const auto require = [](bool good, const std::string& what) {
    if (!good)
      throw InputError("irregular grid: " + what);
  };
  const bool has_point_scalars = !point_scalars.empty();
  require(has_point_scalars != !cell_scalars.empty(), "scalars are needed at the points or in the cells, not in both");
  if (has_point_scalars) {
    require(point_scalars.size() == vertexCount(), "one scalar per vertex is needed");
  } else {
    require(cell_scalars.size() == cellCount(), "one scalar per cell is needed");
  }
  checkCells("irregular grid", cell_types, cell_offsets, connectivity, vertexCount());
  const auto bad = std::count_if(points.begin(), points.end(), [](const Vector3f& p) { return !p.allFinite(); });
  require(bad == 0, std::to_string(bad) + " of " + std::to_string(vertexCount()) + " points are not finite");
}

}  // namespace soft_volume::core
