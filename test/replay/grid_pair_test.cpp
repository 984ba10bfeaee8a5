// Material points of two grids, where their places are known.

#include "grid_pair.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "lattice_blocks.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume {
namespace {

using core::Vector3;

GridPair::Grid block(const core::Vector3i& dims, double spacing_m) {
  core::VolumeGeometry geometry;
  geometry.dims = core::Vector3i::Constant(64);
  geometry.spacing_m = Vector3::Constant(0.001);
  const core::Lattice lattice = core::makeBlock(dims, Vector3::Constant(spacing_m));
  return std::make_shared<core::Topology>(core::makeTopology(lattice, geometry, 1));
}

GridPair::Positions moved(const core::Topology& grid, const std::function<Vector3(const Vector3&)>& move) {
  GridPair::Positions positions;
  for (const core::Vector3f& rest : grid.rest_positions)
    positions.push_back(move(rest.cast<double>()).cast<float>());
  return positions;
}

Vector3 affine(const Vector3& p) {
  core::Matrix3 shear;
  shear << 1.1, 0.05, 0.0, -0.02, 0.9, 0.1, 0.0, 0.03, 1.05;
  return shear * p + Vector3(0.001, -0.002, 0.003);
}

TEST(GridPair, AnAffineMotionIsTheSameInGridsOfAnySpacing) {
  const auto coarse = block({4, 3, 2}, 0.008);
  for (const auto& fine : {block({8, 6, 4}, 0.004), block({11, 8, 6}, 0.0031)}) {
    for (const bool coarse_first : {true, false}) {
      const auto& first = coarse_first ? coarse : fine;
      const auto& second = coarse_first ? fine : coarse;
      const GridPair pair(first, second, first, second);
      EXPECT_FALSE(pair.sameLattice());
      ComparedQuantity quantity;
      pair.compare(0.0, moved(*first, affine), moved(*second, affine), 0.0, quantity);
      EXPECT_GT(quantity.compared, 40U);
      EXPECT_LE(quantity.compared, coarse->vertexCount());
      EXPECT_LT(quantity.largest, 3e-8) << "places are floats";
      ComparedQuantity shifted;
      const Vector3 by(0.0003, 0.0, -0.0004);
      pair.compare(0.0, moved(*first, affine),
                   moved(*second, [&by](const Vector3& p) { return Vector3(affine(p) + by); }), 0.0, shifted);
      EXPECT_NEAR(shifted.largest, 0.0005, 3e-8);
      EXPECT_NEAR(shifted.rms, 0.0005, 3e-8);
    }
  }
}

TEST(GridPair, PointsOutsideOfTheOtherGridAreLeftOut) {
  const auto coarse = block({4, 3, 2}, 0.008);
  const auto fine = block({4, 6, 4}, 0.004);  // half as long in x: 3 of the 5 layers of vertices lie in it
  const GridPair pair(coarse, fine, coarse, fine);
  EXPECT_EQ(pair.leftOut(), coarse->vertexCount() * 2 / 5);
}

TEST(GridPair, RmsCountsWhatMoved) {
  const auto grid = block({4, 4, 4}, 0.008);
  const GridPair pair(grid, grid, grid, grid);
  EXPECT_TRUE(pair.sameLattice());
  GridPair::Positions first = grid->rest_positions;
  GridPair::Positions second = first;
  first[7].x() += 0.002F;
  second[7].x() += 0.002F;
  second[9].y() += 0.004F;
  first[11].z() += 0.00001F;
  ComparedQuantity quantity;
  pair.compare(0.0, first, second, 0.001, quantity);
  EXPECT_NEAR(quantity.largest, 0.004, 1e-8);
  EXPECT_NEAR(quantity.rms, 0.004 / std::sqrt(2.0), 1e-8);
  EXPECT_EQ(quantity.compared, 125U);
}

/// Opens the faces between the cells below and above the plane x = `x_m`.
core::Topology opened(const core::Topology& grid, double x_m) {
  core::Topology open = grid;
  std::size_t face_of_grid = 0;
  for (std::size_t cell = 0; cell < open.cellCount(); ++cell) {
    core::forEachFace(open.cell_types[cell], open.connectivity.data() + open.cell_offsets[cell],
                      [&](std::size_t, const std::uint32_t* vertices, std::size_t size) {
                        bool on_plane = true;
                        for (std::size_t n = 0; n < size; ++n)
                          on_plane = on_plane && std::abs(open.rest_positions[vertices[n]].x() - x_m) < 1e-6;
                        if (on_plane) {
                          open.cut_faces[face_of_grid] = 1;
                          open.face_neighbours[face_of_grid] = -1;
                        }
                        ++face_of_grid;
                      });
  }
  return open;
}

TEST(GridPair, AreaAndPartsOfAKnownCut) {
  const auto grid = block({4, 3, 2}, 0.008);
  EXPECT_EQ(cutArea(*grid), 0.0);
  EXPECT_EQ(partCount(*grid), 1U);
  const core::Topology once = opened(*grid, 0.016);
  EXPECT_NEAR(cutArea(once), 6 * 0.008 * 0.008, 1e-9);
  EXPECT_EQ(partCount(once), 2U);
  const core::Topology twice = opened(once, 0.024);
  EXPECT_NEAR(cutArea(twice), 12 * 0.008 * 0.008, 1e-9);
  EXPECT_EQ(partCount(twice), 3U);
}

}  // namespace
}  // namespace soft_volume
