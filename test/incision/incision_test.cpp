#include <gtest/gtest.h>

#include "lattice_blocks.h"
#include "soft_volume/incision/cut_tissue.h"
#include "soft_volume/simulation/simulation.h"

namespace soft_volume::core {
namespace {

constexpr double kH = 0.005;
constexpr IncisionSettings kByFaces = {IncisionMethod::kFaces, 0.75};

/// A vertical blade (along z, from z_low up) that sweeps along y at the given x.
SweptQuad sweep(double x, double y_from, double y_to, double z_low, double z_high) {
  return {Vector3(x, y_from, z_low), Vector3(x, y_from, z_high), Vector3(x, y_to, z_high), Vector3(x, y_to, z_low)};
}

double totalMass(const Lattice& lattice, const std::vector<Material>& materials) {
  const Simulation simulation(lattice, materials, SimulationSettings(), 1);
  double mass = 0.0;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v)
    mass += simulation.mass(v);
  return mass;
}

/// A block that method 1 parts.
struct PartedBlock {
  PartedBlock(int nx, int ny, int nz)
      : lattice(makeBlock(nx, ny, nz, kH)), materials(oneMaterial(1e4)), tissue(lattice, kByFaces) {}

  IncisionResult cut(const std::vector<SweptQuad>& quads) {
    return tissue.cut(lattice, materials, std::vector<Vector3>(lattice.rest_positions), 0.0, "scalpel", quads, false);
  }

  Lattice lattice;
  std::vector<Material> materials;
  CutTissue tissue;
};

TEST(Incision, PartsABlockCompletely) {
  PartedBlock block(4, 3, 2);
  const Lattice& lattice = block.lattice;
  const double mass = totalMass(lattice, block.materials);
  const std::size_t vertices = lattice.vertexCount();
  const IncisionResult result = block.cut({sweep(2.1 * kH, -kH, 4 * kH, -kH, 3 * kH)});
  EXPECT_EQ(result.faces_opened, 6U);
  EXPECT_EQ(lattice.vertexCount(), vertices + 12);
  EXPECT_EQ(lattice.revision, 2U);
  EXPECT_NEAR(totalMass(lattice, block.materials), mass, 1e-15);
  // No vertex is left that both halves use.
  std::vector<int> side(lattice.vertexCount(), 0);
  for (std::size_t c = 0; c < lattice.cellCount(); ++c) {
    const int bit = lattice.cellIndex(lattice.parent_cells[c]).x() < 2 ? 1 : 2;
    for (const std::uint32_t v : lattice.cells[c])
      side[v] |= bit;
  }
  for (const int s : side)
    EXPECT_NE(s, 3);
}

TEST(Incision, APartialCutKeepsItsFrontClosed) {
  PartedBlock block(4, 6, 4);
  const Lattice& lattice = block.lattice;
  const std::size_t vertices = lattice.vertexCount();
  const IncisionResult result = block.cut({sweep(2.1 * kH, 1.6 * kH, 4.4 * kH, 2.1 * kH, 9 * kH)});
  // Cells with centres at y = 2.5, 3.5 and z = 2.5, 3.5 (in h) are parted: 2 x 2 faces. Of their 9 vertices only those
  // at the top (z = 4 h) and inside (z = 3 h) that are not on the front fall apart: y = 3 h.
  EXPECT_EQ(result.faces_opened, 4U);
  EXPECT_EQ(lattice.vertexCount(), vertices + 2);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    if (lattice.origin_vertices[v] == v)
      continue;
    EXPECT_NEAR(lattice.rest_positions[v].y(), 3 * kH, 1e-12);
    EXPECT_GE(lattice.rest_positions[v].z(), 3 * kH - 1e-12);
  }
}

TEST(Incision, ConsecutiveSweepsCutAsOneWhateverTheirNumber) {
  PartedBlock once(4, 6, 4);
  once.cut({sweep(1.9 * kH, -kH, 7 * kH, 1.9 * kH, 9 * kH)});
  for (const int pieces : {2, 7, 31, 200}) {
    PartedBlock many(4, 6, 4);
    const double step = 8 * kH / pieces;
    for (int n = 0; n < pieces; ++n) {
      many.cut({sweep(1.9 * kH, -kH + n * step, -kH + (n + 1) * step, 1.9 * kH, 9 * kH)});
    }
    EXPECT_EQ(many.lattice.vertexCount(), once.lattice.vertexCount()) << pieces;
    EXPECT_EQ(many.lattice.cut_faces, once.lattice.cut_faces) << pieces;
  }
}

TEST(Incision, CuttingTwiceChangesNothing) {
  PartedBlock block(4, 4, 4);
  const std::vector<SweptQuad> quads = {sweep(2.1 * kH, -kH, 5 * kH, -kH, 5 * kH)};
  block.cut(quads);
  const std::uint32_t revision = block.lattice.revision;
  const IncisionResult again = block.cut(quads);
  EXPECT_EQ(again.faces_opened, 0U);
  EXPECT_TRUE(again.rest_box_m.isEmpty());
  EXPECT_EQ(block.lattice.revision, revision);
}

TEST(Incision, CrossingCutsPartFourWays) {
  PartedBlock block(4, 4, 1);
  block.cut({sweep(2.1 * kH, -kH, 5 * kH, -kH, 5 * kH)});
  const double y = 1.9 * kH;
  const SweptQuad across = {Vector3(-kH, y, -kH), Vector3(-kH, y, 5 * kH), Vector3(5 * kH, y, 5 * kH),
                            Vector3(5 * kH, y, -kH)};
  block.cut({across});
  EXPECT_EQ(block.lattice.vertexCount(), 4U * (3U * 3U * 2U));
  EXPECT_EQ(block.lattice.revision, 3U);
}

TEST(Incision, LeavesFixedMaterialAndMissesAlone) {
  PartedBlock block(4, 4, 4);
  block.materials[0].fixed = true;
  EXPECT_EQ(block.cut({sweep(2.1 * kH, -kH, 5 * kH, -kH, 5 * kH)}).faces_opened, 0U);
  block.materials[0].fixed = false;
  EXPECT_EQ(block.cut({sweep(1.0, -kH, 5 * kH, -kH, 5 * kH)}).faces_opened, 0U);
  const SweptQuad point = {Vector3::Zero(), Vector3::Zero(), Vector3::Zero(), Vector3::Zero()};
  EXPECT_EQ(block.cut({point}).faces_opened, 0U);
  EXPECT_EQ(block.lattice.revision, 1U);
}

TEST(Incision, OpensByItselfAndSettles) {
  Lattice lattice = makeBlock(8, 8, 4, kH);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.fixed[v] = lattice.rest_positions[v].z() < 1e-9;
  const std::vector<Material> materials = oneMaterial(1e4, 0.5);
  SimulationSettings settings;
  settings.dt_s = 0.5 * bulkTimeStepLimit(materials[0], Vector3::Constant(kH));
  settings.activation_radius_m = 1.0;
  Simulation simulation(lattice, materials, settings, 1);
  CutTissue tissue(lattice, kByFaces);
  const IncisionResult result = tissue.cut(lattice, materials, simulation.positions(), 0.0, "scalpel",
                                           {sweep(4.1 * kH, 1.6 * kH, 6.4 * kH, 1.9 * kH, 9 * kH)}, true);
  ASSERT_GT(result.faces_opened, 0U);
  simulation.adoptTopology();
  simulation.wake(result.rest_box_m);
  EXPECT_EQ(tissue.opening(lattice, simulation.positions()), 0.0);
  for (int n = 0; n < 2500; ++n)
    simulation.step();
  // Each lip draws back by up to (1 - rest_fraction) h; neighbours hold it back a little.
  const double opening = tissue.opening(lattice, simulation.positions());
  EXPECT_GT(opening, 0.25 * kH);
  EXPECT_LT(opening, 0.6 * kH);
  EXPECT_LT(simulation.maxSpeed(), 1e-5);
}

}  // namespace
}  // namespace soft_volume::core
