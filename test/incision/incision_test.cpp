#include "soft_volume/incision/incision.h"

#include <gtest/gtest.h>

#include "lattice_blocks.h"
#include "soft_volume/simulation/simulation.h"

namespace soft_volume::core {
namespace {

constexpr double kH = 0.005;

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

IncisionResult cut(Lattice& lattice, const std::vector<SweptQuad>& quads, const std::vector<Material>& materials) {
  return cutLattice(lattice, materials, lattice.rest_positions, 0.0, quads, {});
}

TEST(Incision, PartsABlockCompletely) {
  Lattice lattice = makeBlock(4, 3, 2, kH);
  const std::vector<Material> materials = oneMaterial(1e4);
  const double mass = totalMass(lattice, materials);
  const std::size_t vertices = lattice.vertexCount();
  const IncisionResult result = cut(lattice, {sweep(2.1 * kH, -kH, 4 * kH, -kH, 3 * kH)}, materials);
  EXPECT_EQ(result.faces_opened, 6U);
  EXPECT_EQ(result.vertices_added, 4U * 3U);
  EXPECT_EQ(lattice.vertexCount(), vertices + 12);
  EXPECT_EQ(lattice.revision, 2U);
  EXPECT_NEAR(totalMass(lattice, materials), mass, 1e-15);
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
  Lattice lattice = makeBlock(4, 6, 4, kH);
  const IncisionResult result = cut(lattice, {sweep(2.1 * kH, 1.6 * kH, 4.4 * kH, 2.1 * kH, 9 * kH)}, oneMaterial(1e4));
  // Cells with centres at y = 2.5, 3.5 and z = 2.5, 3.5 (in h) are parted: 2 x 2 faces. Of their 9 vertices only those
  // at the top (z = 4 h) and inside (z = 3 h) that are not on the front fall apart: y = 3 h.
  EXPECT_EQ(result.faces_opened, 4U);
  EXPECT_EQ(result.vertices_added, 2U);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    if (lattice.origin_vertices[v] == v)
      continue;
    EXPECT_NEAR(lattice.rest_positions[v].y(), 3 * kH, 1e-12);
    EXPECT_GE(lattice.rest_positions[v].z(), 3 * kH - 1e-12);
  }
}

TEST(Incision, ConsecutiveSweepsCutAsOneWhateverTheirNumber) {
  const std::vector<Material> materials = oneMaterial(1e4);
  Lattice once = makeBlock(4, 6, 4, kH);
  cut(once, {sweep(1.9 * kH, -kH, 7 * kH, 1.9 * kH, 9 * kH)}, materials);
  for (const int pieces : {2, 7, 31, 200}) {
    Lattice many = makeBlock(4, 6, 4, kH);
    const double step = 8 * kH / pieces;
    for (int n = 0; n < pieces; ++n) {
      cut(many, {sweep(1.9 * kH, -kH + n * step, -kH + (n + 1) * step, 1.9 * kH, 9 * kH)}, materials);
    }
    EXPECT_EQ(many.vertexCount(), once.vertexCount()) << pieces;
    EXPECT_EQ(many.cut_faces, once.cut_faces) << pieces;
  }
}

TEST(Incision, CuttingTwiceChangesNothing) {
  Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(1e4);
  const std::vector<SweptQuad> quads = {sweep(2.1 * kH, -kH, 5 * kH, -kH, 5 * kH)};
  cut(lattice, quads, materials);
  const std::uint32_t revision = lattice.revision;
  const IncisionResult again = cut(lattice, quads, materials);
  EXPECT_EQ(again.faces_opened, 0U);
  EXPECT_TRUE(again.rest_box_m.isEmpty());
  EXPECT_EQ(lattice.revision, revision);
}

TEST(Incision, CrossingCutsPartFourWays) {
  Lattice lattice = makeBlock(4, 4, 1, kH);
  const std::vector<Material> materials = oneMaterial(1e4);
  cut(lattice, {sweep(2.1 * kH, -kH, 5 * kH, -kH, 5 * kH)}, materials);
  const double y = 1.9 * kH;
  const SweptQuad across = {Vector3(-kH, y, -kH), Vector3(-kH, y, 5 * kH), Vector3(5 * kH, y, 5 * kH),
                            Vector3(5 * kH, y, -kH)};
  cut(lattice, {across}, materials);
  EXPECT_EQ(lattice.vertexCount(), 4U * (3U * 3U * 2U));
  EXPECT_EQ(lattice.revision, 3U);
}

TEST(Incision, LeavesFixedMaterialAndMissesAlone) {
  std::vector<Material> materials = oneMaterial(1e4);
  materials[0].fixed = true;
  Lattice lattice = makeBlock(4, 4, 4, kH);
  EXPECT_EQ(cut(lattice, {sweep(2.1 * kH, -kH, 5 * kH, -kH, 5 * kH)}, materials).faces_opened, 0U);
  materials[0].fixed = false;
  EXPECT_EQ(cut(lattice, {sweep(1.0, -kH, 5 * kH, -kH, 5 * kH)}, materials).faces_opened, 0U);
  const SweptQuad point = {Vector3::Zero(), Vector3::Zero(), Vector3::Zero(), Vector3::Zero()};
  EXPECT_EQ(cut(lattice, {point}, materials).faces_opened, 0U);
  EXPECT_EQ(lattice.revision, 1U);
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
  const IncisionResult result = cutLattice(lattice, materials, simulation.positions(), 0.0,
                                           {sweep(4.1 * kH, 1.6 * kH, 6.4 * kH, 1.9 * kH, 9 * kH)}, IncisionSettings());
  ASSERT_GT(result.faces_opened, 0U);
  simulation.adoptTopology();
  simulation.wake(result.rest_box_m);
  EXPECT_EQ(cutOpening(lattice, simulation.positions()), 0.0);
  for (int n = 0; n < 2500; ++n)
    simulation.step();
  // Each lip draws back by up to (1 - rest_fraction) h; neighbours hold it back a little.
  const double opening = cutOpening(lattice, simulation.positions());
  EXPECT_GT(opening, 0.25 * kH);
  EXPECT_LT(opening, 0.6 * kH);
  EXPECT_LT(simulation.maxSpeed(), 1e-5);
}

}  // namespace
}  // namespace soft_volume::core
