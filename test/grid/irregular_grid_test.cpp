#include "soft_volume/grid/irregular_grid.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

#include "grid/grid_files.h"
#include "soft_volume/common/error.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/grid/volume_grid.h"

namespace soft_volume::core {
namespace {

using testing_grid::mixedGrid;
using testing_grid::mixedGridWithCellScalars;

/// Expects an InputError that contains `reason`.
template <typename Grid>
void expectInvalid(Grid grid, const std::function<void(Grid&)>& spoil, const std::string& reason) {
  spoil(grid);
  try {
    grid.validate();
    ADD_FAILURE() << "accepted; expected: " << reason;
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find(reason), std::string::npos) << error.what() << "\n expected: " << reason;
  }
}

TEST(IrregularGrid, EveryCellTypeIsValid) {
  EXPECT_NO_THROW(mixedGrid().validate());
  EXPECT_NO_THROW(mixedGridWithCellScalars().validate());
}

TEST(IrregularGrid, NanScalarsAreValid) {
  IrregularGrid grid = mixedGrid();
  grid.point_scalars[3] = std::nanf("");
  EXPECT_NO_THROW(grid.validate());
}

TEST(IrregularGrid, RefusesWhatDoesNotFit) {
  const auto refused = [](const std::function<void(IrregularGrid&)>& spoil, const std::string& reason) {
    expectInvalid<IrregularGrid>(mixedGrid(), spoil, reason);
  };
  refused([](IrregularGrid& g) { g.point_scalars.clear(); }, "scalars are needed");
  refused([](IrregularGrid& g) { g.cell_scalars.assign(g.cellCount(), 1.0F); }, "not in both");
  refused([](IrregularGrid& g) { g.point_scalars.pop_back(); }, "one scalar per vertex");
  refused([](IrregularGrid& g) { g.points.pop_back(); }, "one scalar per vertex");
  refused([](IrregularGrid& g) { g.cell_offsets.pop_back(); }, "one entry more");
  refused([](IrregularGrid& g) { g.cell_offsets.clear(); }, "one entry more");
  refused([](IrregularGrid& g) { g.cell_offsets[0] = 1; }, "do not span");
  refused([](IrregularGrid& g) { g.connectivity.push_back(0); }, "do not span");
  refused([](IrregularGrid& g) { g.cell_offsets[2] = 1; }, "must not decrease");
  refused([](IrregularGrid& g) { g.cell_offsets[1] = 7; }, "cell 0 has 7 vertices where its type has 8");
  refused([](IrregularGrid& g) { g.cell_types[4] = CellType::kWedge; }, "cell 4 has 4 vertices where its type has 6");
  refused([](IrregularGrid& g) { g.cell_types[1] = CellType(9); }, "cell 1 is of VTK type 9");
  refused([](IrregularGrid& g) { g.connectivity[10] = 26; }, "cell 1 names vertex 26 of a grid with 26 vertices");
  refused([](IrregularGrid& g) { g.points[4].x() = std::nanf(""); }, "1 of 26 points are not finite");
  expectInvalid<IrregularGrid>(
      mixedGridWithCellScalars(), [](IrregularGrid& g) { g.cell_scalars.pop_back(); }, "one scalar per cell");
}

TEST(IrregularGrid, RefusesBadFaceStreams) {
  const std::size_t begin = mixedGrid().cell_offsets[5];
  const auto refused = [begin](std::size_t at, std::uint32_t value, const std::string& reason) {
    expectInvalid<IrregularGrid>(
        mixedGrid(), [=](IrregularGrid& g) { g.connectivity[begin + at] = value; }, reason);
  };
  refused(0, 3, "fewer than four faces");
  refused(0, 6, "face stream is too long");
  refused(0, 8, "face of fewer than three vertices");
  refused(1, 2, "");
  refused(1, 0, "face of fewer than three vertices");
  refused(1, 4000000000U, "face stream is too short");
  refused(2, 26, "cell 5 names vertex 26");
  expectInvalid<IrregularGrid>(
      mixedGrid(),
      [begin](IrregularGrid& g) {
        g.connectivity.resize(begin);
        g.cell_offsets[6] = std::uint32_t(begin);
      },
      "fewer than four faces");
}

/// The same cells as receivers see them, every face at the surface.
Topology mixedTopology() {
  const IrregularGrid grid = mixedGrid();
  Topology topology;
  topology.rest_positions = grid.points;
  topology.texture_coordinates.assign(grid.vertexCount(), Vector3f::Zero());
  topology.fixed.assign(grid.vertexCount(), 0);
  topology.cell_types = grid.cell_types;
  topology.cell_offsets = grid.cell_offsets;
  topology.connectivity = grid.connectivity;
  topology.materials.assign(grid.cellCount(), 0);
  const std::size_t faces = 6 + 6 + 5 + 5 + 4 + 7;
  topology.face_neighbours.assign(faces, -1);
  topology.cut_faces.assign(faces, 0);
  return topology;
}

TEST(TopologyOfAllCells, HasOneNeighbourPerFace) {
  EXPECT_NO_THROW(mixedTopology().validate());
  const auto refused = [](const std::function<void(Topology&)>& spoil, const std::string& reason) {
    expectInvalid<Topology>(mixedTopology(), spoil, reason);
  };
  refused([](Topology& t) { t.face_neighbours.push_back(-1); }, "face_neighbours needs one entry per face");
  refused([](Topology& t) { t.cut_faces.pop_back(); }, "cut_faces needs one entry per face");
  refused([](Topology& t) { t.face_neighbours.back() = 6; }, "a face neighbour does not exist");
  refused([](Topology& t) { t.cell_types[0] = CellType(1); }, "cell 0 is of VTK type 1");
  refused([](Topology& t) { t.cell_types[0] = CellType::kEmpty; }, "where its type has 0");
  refused([](Topology& t) { t.origin_vertices.assign(3, 0); }, "one origin per vertex");
  refused([](Topology& t) { t.origin_vertices.assign(t.vertexCount(), 99); }, "an origin vertex does not exist");
  refused([](Topology& t) { t.parent_cells.assign(2, 0); }, "one parent cell per cell");
  refused([](Topology& t) { t.connectivity.back() = 99; }, "cell 5 names vertex 99");
}

TEST(TopologyOfAllCells, MayHoldEmptyCells) {
  Topology topology = mixedTopology();
  topology.cell_types.push_back(CellType::kEmpty);
  topology.cell_offsets.push_back(std::uint32_t(topology.connectivity.size()));
  topology.materials.push_back(0);
  EXPECT_NO_THROW(topology.validate());
  topology.cut_faces.push_back(0);
  EXPECT_THROW(topology.validate(), InputError);
}

TEST(GridOf, VolumeHasAVertexPerVoxel) {
  VolumeGeometry geometry;
  geometry.dims = {3, 2, 4};
  geometry.spacing_m = {0.5, 0.25, 2.0};
  geometry.origin_m = {10, 20, 30};  // the patient's frame, not the volume's
  std::vector<std::uint8_t> data(geometry.voxelCount());
  for (std::size_t i = 0; i < data.size(); ++i)
    data[i] = std::uint8_t(3 * i);
  const Volume volume(geometry, ScalarType::kUInt8, data);
  const IrregularGrid grid = gridOf(volume);
  EXPECT_NO_THROW(grid.validate());
  EXPECT_EQ(grid.cell_types, std::vector<CellType>(2 * 1 * 3, CellType::kVoxel));
  ASSERT_EQ(grid.vertexCount(), geometry.voxelCount());
  for (std::size_t v = 0; v < grid.vertexCount(); ++v)
    EXPECT_EQ(grid.point_scalars[v], float(volume.sample(grid.points[v].cast<double>())));
  EXPECT_EQ(grid.points.back(), Vector3f(1.0F, 0.25F, 6.0F));
  const Vector3f* p = grid.points.data();
  for (std::size_t cell = 0; cell < grid.cellCount(); ++cell) {
    const std::uint32_t* corners = &grid.connectivity[8 * cell];
    for (unsigned c = 0; c < 8; ++c) {
      const Vector3f expected = p[corners[0]] + Vector3f(c & 1U ? 0.5F : 0, c & 2U ? 0.25F : 0, c & 4U ? 2.0F : 0);
      EXPECT_EQ(p[corners[c]], expected);
    }
  }
}

TEST(GridOf, RefusesVolumesThatAreTooThinOrTooLarge) {
  VolumeGeometry geometry;
  geometry.dims = {3, 1, 4};
  EXPECT_THROW(gridOf(Volume(geometry, ScalarType::kUInt8, std::vector<std::uint8_t>(12))), InputError);
  geometry.dims = {257, 256, 256};
  const Volume large(geometry, ScalarType::kUInt8, std::vector<std::uint8_t>(geometry.voxelCount()));
  EXPECT_THROW(gridOf(large), InputError);
}

}  // namespace
}  // namespace soft_volume::core
