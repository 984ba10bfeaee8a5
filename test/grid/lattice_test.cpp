#include "soft_volume/grid/lattice.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

Lattice block(int nx, int ny, int nz, double h = 0.01) {
  return makeLattice({nx, ny, nz}, Vector3::Constant(h), Vector3(1.0, 2.0, 3.0),
                     std::vector<std::int32_t>(std::size_t(nx) * ny * nz, 0));
}

VolumeGeometry smallVolume() {
  VolumeGeometry geometry;
  geometry.dims = {10, 10, 10};
  geometry.spacing_m = Vector3::Constant(0.01);
  return geometry;
}

TEST(Lattice, FullBlockHasTheRegularCounts) {
  const Lattice lattice = block(3, 4, 5);
  EXPECT_EQ(lattice.cellCount(), 60U);
  EXPECT_EQ(lattice.vertexCount(), 4U * 5U * 6U);
  EXPECT_EQ(lattice.revision, 1U);
}

TEST(Lattice, CornersLieWhereVtkPutsThem) {
  const Lattice lattice = block(2, 2, 2);
  for (std::uint32_t cell = 0; cell < lattice.cellCount(); ++cell) {
    const Vector3i index = lattice.cellIndex(lattice.parent_cells[cell]);
    for (int c = 0; c < 8; ++c) {
      const Vector3 corner(index.x() + kHexahedronCorners[c][0], index.y() + kHexahedronCorners[c][1],
                           index.z() + kHexahedronCorners[c][2]);
      const Vector3 expected = lattice.origin_m + corner * 0.01;
      EXPECT_TRUE(lattice.rest_positions[lattice.cells[cell][c]].isApprox(expected, 1e-14));
    }
  }
}

TEST(Lattice, NeighboursShareTheFourVerticesOfTheirFace) {
  const Lattice lattice = block(3, 3, 3);
  for (std::uint32_t cell = 0; cell < lattice.cellCount(); ++cell) {
    for (int face = 0; face < 6; ++face) {
      const std::int32_t other = lattice.face_neighbours[cell][face];
      if (other == Lattice::kNone)
        continue;
      EXPECT_EQ(lattice.face_neighbours[other][oppositeFace(face)], static_cast<std::int32_t>(cell));
      for (const int corner : kHexahedronFaces[face]) {
        const auto& theirs = lattice.cells[other];
        EXPECT_NE(std::find(theirs.begin(), theirs.end(), lattice.cells[cell][corner]), theirs.end());
      }
    }
  }
}

TEST(Lattice, AbsentCellsHaveNoVerticesOfTheirOwn) {
  std::vector<std::int32_t> materials(8, Lattice::kNone);
  materials[0] = 2;
  const Lattice lattice = makeLattice({2, 2, 2}, Vector3::Ones(), Vector3::Zero(), materials);
  EXPECT_EQ(lattice.cellCount(), 1U);
  EXPECT_EQ(lattice.vertexCount(), 8U);
  EXPECT_EQ(lattice.materials[0], 2U);
  for (const std::int32_t neighbour : lattice.face_neighbours[0])
    EXPECT_EQ(neighbour, Lattice::kNone);
}

TEST(Lattice, RejectsWhatCannotBeALattice) {
  const std::vector<std::int32_t> one(1, 0);
  EXPECT_THROW(makeLattice({0, 1, 1}, Vector3::Ones(), Vector3::Zero(), {}), InputError);
  EXPECT_THROW(makeLattice({1, 1, 1}, Vector3(1, 0, 1), Vector3::Zero(), one), InputError);
  EXPECT_THROW(makeLattice({1, 1, 1}, Vector3::Ones(), Vector3(NAN, 0, 0), one), InputError);
  EXPECT_THROW(makeLattice({2, 1, 1}, Vector3::Ones(), Vector3::Zero(), one), InputError);
  EXPECT_THROW(makeLattice({1 << 14, 1 << 14, 1}, Vector3::Ones(), Vector3::Zero(), one), InputError);
}

TEST(Lattice, BoxesAreCutToTheLattice) {
  const Lattice lattice = block(4, 4, 4);
  const LatticeBox all = latticeBox(lattice, Box3(Vector3(-9, -9, -9), Vector3(9, 9, 9)));
  EXPECT_EQ(all.begin, Vector3i(0, 0, 0));
  EXPECT_EQ(all.end, Vector3i(4, 4, 4));
  const LatticeBox one = latticeBox(lattice, Box3(Vector3(1.011, 2.011, 3.011), Vector3(1.019, 2.019, 3.019)));
  EXPECT_EQ(one.begin, Vector3i(1, 1, 1));
  EXPECT_EQ(one.end, Vector3i(2, 2, 2));
  const LatticeBox outside = latticeBox(lattice, Box3(Vector3(5, 5, 5), Vector3(6, 6, 6)));
  EXPECT_EQ(outside.begin, outside.end);
  const LatticeBox empty = latticeBox(lattice, Box3());
  EXPECT_EQ(empty.begin, empty.end);
}

TEST(Topology, MirrorsTheLattice) {
  const Lattice lattice = block(2, 3, 2);
  const Topology topology = makeTopology(lattice, smallVolume(), 7);
  EXPECT_NO_THROW(topology.validate());
  EXPECT_EQ(topology.session, 7U);
  EXPECT_EQ(topology.cellCount(), 12U);
  const Vector3f expected = smallVolume().toTexture(lattice.rest_positions[5]).cast<float>();
  EXPECT_TRUE(topology.texture_coordinates[5].isApprox(expected));
}

TEST(Topology, RejectsEachInconsistentField) {
  const Topology good = makeTopology(block(1, 1, 2), smallVolume(), 1);
  const auto rejects = [&good](const auto& damage) {
    Topology bad = good;
    damage(bad);
    EXPECT_THROW(bad.validate(), InputError);
  };
  rejects([](Topology& t) { t.texture_coordinates.pop_back(); });
  rejects([](Topology& t) { t.fixed.push_back(0); });
  rejects([](Topology& t) { t.cell_offsets.pop_back(); });
  rejects([](Topology& t) { t.cell_offsets.back() += 1; });
  rejects([](Topology& t) { t.cell_offsets[1] = 4; });
  rejects([](Topology& t) { t.connectivity[3] = 1000; });
  rejects([](Topology& t) { t.materials.clear(); });
  rejects([](Topology& t) { t.face_neighbours[0] = 2; });
  rejects([](Topology& t) { t.face_neighbours[0] = -2; });
  rejects([](Topology& t) { t.cut_faces.pop_back(); });
  rejects([](Topology& t) { t.cell_types[0] = CellType::kWedge; });
  rejects([](Topology& t) { t.rest_positions[0].x() = std::numeric_limits<float>::quiet_NaN(); });
  rejects([](Topology& t) { t.texture_coordinates[0].x() = std::numeric_limits<float>::infinity(); });
}

}  // namespace
}  // namespace soft_volume::core
