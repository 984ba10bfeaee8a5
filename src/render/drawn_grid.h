#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/grid/topology.h"

namespace soft_volume::core {

/// The grid as the back ends see it, made from a Topology or an IrregularGrid: exactly one of texture, point_scalars
/// and cell_scalars is filled. Valid by construction.
struct DrawnGrid {
  std::vector<CellType> cell_types;
  std::vector<std::uint32_t> cell_offsets;
  std::vector<std::uint32_t> connectivity;
  std::vector<Vector3f> rest_positions;  ///< per vertex, volume frame, metres
  std::vector<Vector3f> texture;         ///< per vertex, [0, 1]^3 of the volume
  std::vector<float> point_scalars;      ///< per vertex
  std::vector<float> cell_scalars;       ///< per cell

  std::size_t cellCount() const { return cell_types.size(); }
  std::size_t vertexCount() const { return rest_positions.size(); }
  bool isTextured() const { return !texture.empty(); }
};

}  // namespace soft_volume::core
