#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {

/// The edges of a grid, each once, and which of them every cell has.
struct GridEdges {
  static constexpr std::uint32_t kNone = 0xFFFFFFFF;

  std::vector<std::array<std::uint32_t, 2>> ends;  ///< vertices a < b, ascending by a, then b
  std::vector<std::uint32_t> cell_offsets;         ///< cells + 1 entries into `cell_edges`
  /// Per cell an index into `ends` for each edge of its shape in CellShape's order; for a polyhedron one for each side
  /// of each face in the order of its face stream, the side after a corner at that corner's place. kNone where both
  /// ends are the same vertex.
  std::vector<std::uint32_t> cell_edges;
};

/// Takes time in proportion to the grid as long as no vertex has very many edges. The grid is a valid one as in
/// Topology.
GridEdges edgesOf(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                  const std::vector<std::uint32_t>& connectivity, std::size_t vertex_count);

}  // namespace soft_volume::core
