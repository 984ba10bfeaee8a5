#include "soft_volume/grid/grid_edges.h"

#include <algorithm>
#include <numeric>

namespace soft_volume::core {
namespace {

struct Cells {
  const std::vector<CellType>& types;
  const std::vector<std::uint32_t>& offsets;
  const std::vector<std::uint32_t>& connectivity;

  /// Calls visit(vertex, vertex) in the order of GridEdges::cell_edges.
  template <typename Visit>
  void forEachSide(std::size_t cell, const Visit& visit) const {
    const std::uint32_t* numbers = &connectivity[offsets[cell]];
    if (types[cell] == CellType::kPolyhedron) {
      forEachFace(types[cell], numbers, [&](std::size_t, const std::uint32_t* vertices, std::size_t size) {
        for (std::size_t i = 0; i < size; ++i)
          visit(vertices[i], vertices[i + 1 < size ? i + 1 : 0]);
      });
      return;
    }
    const CellShape& shape = shapeOf(types[cell]);
    for (std::size_t i = 0; i < shape.edge_count; ++i)
      visit(numbers[shape.edges[i][0]], numbers[shape.edges[i][1]]);
  }
};

/// One cell's view of an edge, filed under the edge's smaller vertex.
struct Side {
  std::uint32_t larger_vertex;
  std::uint32_t place;  ///< in GridEdges::cell_edges
};

/// Counts the sides of all cells; begin[v + 1] gets those whose smaller vertex is v.
void countSides(const Cells& cells, GridEdges& edges, std::vector<std::uint32_t>& begin) {
  edges.cell_offsets.assign(1, 0);
  edges.cell_offsets.reserve(cells.types.size() + 1);
  std::uint32_t place = 0;
  for (std::size_t cell = 0; cell < cells.types.size(); ++cell) {
    cells.forEachSide(cell, [&](std::uint32_t a, std::uint32_t b) {
      begin[std::min(a, b) + std::size_t(1)] += a != b ? 1U : 0U;
      ++place;
    });
    edges.cell_offsets.push_back(place);
  }
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
}

/// A counting sort by the smaller vertex.
std::vector<Side> sortSides(const Cells& cells, const std::vector<std::uint32_t>& begin) {
  std::vector<Side> sides(begin.back());
  std::vector<std::uint32_t> next(begin.begin(), begin.end() - 1);
  std::uint32_t place = 0;
  for (std::size_t cell = 0; cell < cells.types.size(); ++cell) {
    cells.forEachSide(cell, [&](std::uint32_t a, std::uint32_t b) {
      if (a != b)
        sides[next[std::min(a, b)]++] = {std::max(a, b), place};
      ++place;
    });
  }
  return sides;
}

}  // namespace

GridEdges edgesOf(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                  const std::vector<std::uint32_t>& connectivity, std::size_t vertex_count) {
  const Cells cells{types, offsets, connectivity};
  GridEdges edges;
  std::vector<std::uint32_t> begin(vertex_count + 1, 0);
  countSides(cells, edges, begin);
  std::vector<Side> sides = sortSides(cells, begin);
  edges.cell_edges.assign(edges.cell_offsets.back(), GridEdges::kNone);
  for (std::uint32_t v = 0; v < vertex_count; ++v) {
    const auto first = sides.begin() + begin[v];
    const auto last = sides.begin() + begin[v + std::size_t(1)];
    std::sort(first, last, [](const Side& l, const Side& r) { return l.larger_vertex < r.larger_vertex; });
    for (auto side = first; side != last; ++side) {
      if (side == first || side->larger_vertex != (side - 1)->larger_vertex)
        edges.ends.push_back({v, side->larger_vertex});
      edges.cell_edges[side->place] = std::uint32_t(edges.ends.size() - 1);
    }
  }
  edges.ends.shrink_to_fit();
  return edges;
}

}  // namespace soft_volume::core
