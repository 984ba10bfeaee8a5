#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/grid/topology.h"

namespace soft_volume::core {

/// A grid of any mix of cells with one scalar field, as a file of a simulation holds it (dissertation, section 2.1.1).
/// Positions have the file's unit of length, which is called metre here; scalars have the file's unit.
struct IrregularGrid {
  std::vector<Vector3f> points;             ///< per vertex
  std::vector<CellType> cell_types;         ///< per cell
  std::vector<std::uint32_t> cell_offsets;  ///< cells + 1 entries into `connectivity`
  std::vector<std::uint32_t> connectivity;  ///< as Topology::connectivity
  std::vector<float> point_scalars;         ///< per vertex; or empty
  std::vector<float> cell_scalars;          ///< per cell, constant in it; or empty. Exactly one of the two is filled

  std::size_t vertexCount() const { return points.size(); }
  std::size_t cellCount() const { return cell_types.size(); }

  /// Throws InputError when sizes do not fit together, a cell has the wrong number of vertices, an index is out of
  /// range, a face of a polyhedron has fewer than three vertices, or a point is not finite. Scalars may be NaN: there
  /// nothing is drawn.
  void validate() const;
};

}  // namespace soft_volume::core
