#pragma once

#include <array>
#include <cstdint>

#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {

/// The closed loops that a plane cuts out of one cell, each a list of edge numbers (dissertation, section 3.5). Loops
/// are not triangulated.
struct SliceLoops {
  std::uint8_t loop_count = 0;               ///< 0 to 4
  std::array<std::uint8_t, 4> loop_sizes{};  ///< edges of each loop, at least 3
  std::array<std::uint8_t, 12> edges{};      ///< the loops one after the other
};

/// Loops for each of the ways in which a plane parts the vertices of a cell of any type but the polyhedron (InputError
/// on that): 2^vertices entries, indexed by the signs; bit v is set where vertex v is on the positive side (z >=
/// plane). Edges are numbered as in the type's CellShape.
///
/// One rule decides every face, from its own signs alone: each run of positive corners is cut off on its own, so a
/// quadrilateral with positive corners on one diagonal keeps the two negative ones together. Both cells at the face,
/// whatever their types, therefore draw the same segments on it, in opposite directions, and the slices of neighbours
/// fit without gap or overlap (figures 3.8 to 3.11), whatever the cells' shapes. Seen from the positive side all loops
/// of a cell with outward faces run counter-clockwise.
const SliceLoops* sliceTable(CellType type);

}  // namespace soft_volume::core
