#include "soft_volume/grid/grid_edges.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

namespace soft_volume::core {
namespace {

using Ends = std::array<std::uint32_t, 2>;

TEST(GridEdges, NeighboursShareTheirEdges) {
  // A hexahedron with a pyramid on its top, and a tetrahedron as a face stream on the pyramid's side 5 6 8.
  const std::vector<CellType> types = {CellType::kHexahedron, CellType::kPyramid, CellType::kPolyhedron};
  const std::vector<std::uint32_t> connectivity = {0, 1, 2, 3, 4, 5, 6, 7, 4, 5, 6, 7, 8,  //
                                                   4, 3, 5, 8, 6, 3, 8, 5, 9, 3, 6, 8, 9, 3, 5, 6, 9};
  const GridEdges edges = edgesOf(types, {0, 8, 13, 30}, connectivity, 10);
  EXPECT_EQ(edges.ends.size(), 12U + 4U + 3U);
  EXPECT_TRUE(std::is_sorted(edges.ends.begin(), edges.ends.end()));
  EXPECT_EQ(std::set<Ends>(edges.ends.begin(), edges.ends.end()).size(), edges.ends.size());
  EXPECT_EQ(edges.cell_offsets, (std::vector<std::uint32_t>{0, 12, 20, 32}));
  for (std::size_t cell = 0; cell < 2; ++cell) {
    const CellShape& shape = shapeOf(types[cell]);
    const std::size_t begin = cell == 0 ? 0 : 8;
    for (std::size_t e = 0; e < shape.edge_count; ++e) {
      const auto [a, b] = std::minmax(connectivity[begin + shape.edges[e][0]], connectivity[begin + shape.edges[e][1]]);
      EXPECT_EQ(edges.ends.at(edges.cell_edges[edges.cell_offsets[cell] + e]), (Ends{a, b}));
    }
  }
  const std::vector<Ends> sides = {{5, 8}, {6, 8}, {5, 6}, {5, 8}, {5, 9}, {8, 9},
                                   {6, 8}, {8, 9}, {6, 9}, {5, 6}, {6, 9}, {5, 9}};
  for (std::size_t i = 0; i < sides.size(); ++i)
    EXPECT_EQ(edges.ends.at(edges.cell_edges[20 + i]), sides[i]) << "side " << i;
}

TEST(GridEdges, CollapsedEdgesAreNone) {
  const GridEdges edges = edgesOf({CellType::kTetrahedron}, {0, 4}, {2, 2, 1, 0}, 3);
  // 0-1 of the tetrahedron is a point, and its vertices 0 and 1 have the same edges.
  EXPECT_EQ(edges.ends, (std::vector<Ends>{{0, 1}, {0, 2}, {1, 2}}));
  EXPECT_EQ(edges.cell_edges, (std::vector<std::uint32_t>{GridEdges::kNone, 2, 2, 1, 1, 0}));
}

TEST(GridEdges, EmptyGridHasNone) {
  const GridEdges edges = edgesOf({}, {0}, {}, 5);
  EXPECT_TRUE(edges.ends.empty());
  EXPECT_EQ(edges.cell_offsets, std::vector<std::uint32_t>{0});
}

}  // namespace
}  // namespace soft_volume::core
