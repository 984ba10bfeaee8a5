#include <gtest/gtest.h>

#include "simulation_cases.h"
#include "soft_volume/simulation/setting_names.h"

// Which cells are in the solve, and what that costs in exactness.
namespace soft_volume::core {
namespace {

constexpr std::uint64_t kForEver = 1000000000;
constexpr double kPush = 0.05 * kModulus * kH * kH;  ///< dents soft tissue by 0.03 h

struct Slab {
  Lattice lattice;
  std::vector<Material> materials;
  Vector3 top;
  std::uint32_t middle;

  Slab(int width, int height, double poisson_ratio)
      : lattice(standing(makeBlock(width, width, height, kH))),
        materials(oneMaterial(kModulus, 1.0, poisson_ratio)),
        top(Vector3(width / 2, width / 2, height) * kH),
        middle(vertexAt(lattice, top)) {}

  Simulation push(const SimulationSettings& settings) const {
    Simulation simulation(lattice, materials, settings, 1);
    EXPECT_TRUE(simulation.holdForce("tool", Vector3(0, 0, -kPush), top, 1.6 * kH, kForEver));
    return simulation;
  }
  double dent(const Simulation& simulation) const { return -simulation.state().displacements_m[middle].z(); }
  double settledDent() const {
    Simulation simulation = push(wholeLattice());
    run(simulation, 400);
    EXPECT_LT(simulation.maxSpeed(), 1e-5);  // 1e-3 h in a second
    return dent(simulation);
  }
};

/// Steps until nothing is in the solve, 3000 at most.
int stepsToSleep(Simulation& simulation) {
  int steps = 0;
  do {
    simulation.step();
    ++steps;
  } while (simulation.activeCells() > 0 && steps < 3000);
  return steps;
}

// --- growth

TEST(GrowthTest, ALocalPushWakesAPartAndIsNearlyAsDeepAsWithAll) {
  for (const double poisson_ratio : {0.25, 0.4}) {
    SCOPED_TRACE(poisson_ratio);
    const Slab slab(16, 8, poisson_ratio);
    const double expected = slab.settledDent();
    SimulationSettings settings;
    settings.activation_threshold = 1e-2;
    Simulation simulation = slab.push(settings);
    std::size_t most = 0;
    for (int n = 0; n < 300; ++n) {
      simulation.step();
      most = std::max(most, simulation.activeCells());
    }
    EXPECT_GT(most, 100U);
    EXPECT_LT(most, slab.lattice.cellCount() * 2 / 3);
    // The bound.
    EXPECT_NEAR(slab.dent(simulation) / expected, 1.0, 0.05);
  }
}

TEST(GrowthTest, TheDefaultThresholdIsExactWithinAPerCent) {
  const Slab slab(12, 8, 0.3);
  Simulation simulation = slab.push(SimulationSettings());
  run(simulation, 400);
  EXPECT_NEAR(slab.dent(simulation) / slab.settledDent(), 1.0, 0.01);
}

TEST(GrowthTest, SleepsUnderLoadAndAfterIt) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    for (const auto& precision : kChoices<Precision>) {
      SCOPED_TRACE(std::string(precision.name) + ", nu " + std::to_string(poisson_ratio));
      const Slab slab(12, 8, poisson_ratio);
      SimulationSettings settings;
      settings.precision = precision.choice;
      Simulation simulation = slab.push(settings);
      EXPECT_LT(stepsToSleep(simulation), 2000);
      const double dent = slab.dent(simulation);
      EXPECT_GT(dent, 0.02 * kH);
      EXPECT_EQ(simulation.maxSpeed(), 0.0);
      const std::uint64_t asleep = simulation.stateHash();
      run(simulation, 50);
      EXPECT_EQ(simulation.stateHash(), asleep);  // asleep nothing moves
      simulation.releaseForce("tool");
      EXPECT_LT(stepsToSleep(simulation), 2000);
      // It sleeps only when what is left is far below what can be seen.
      EXPECT_LT(simulation.maxDisplacement(), 1e-3 * dent);
    }
  }
}

/// Levers add up: what holds back the tip of a slender part is at its far end.
TEST(GrowthTest, ASlenderCantileverGrowsToItsBase) {
  const Lattice lattice = standing(makeBlock(16, 2, 2, 0.01), 0);
  const std::vector<Material> materials = oneMaterial(100e3, 1.0);
  const auto tipAfter = [&](SimulationSettings settings, std::size_t& most) {
    settings.lifetime_s = 1.0;
    Simulation simulation(lattice, materials, settings, 1);
    std::vector<VertexLoad> loads;
    const auto tip = verticesWhere(lattice, [](const Vector3& p) { return p.x() > 0.159; });
    for (const std::uint32_t v : tip)
      loads.push_back({v, Vector3(0, 0, -1.6e-3 / double(tip.size()))});
    simulation.setLoads(loads);
    for (int n = 0; n < 4000; ++n) {
      simulation.step();
      most = std::max(most, simulation.activeCells());
    }
    return -simulation.state().displacements_m[tip.front()].z();
  };
  std::size_t most = 0, all = 0;
  const double whole = tipAfter(wholeLattice(), all);
  EXPECT_GT(whole, 1e-4);
  EXPECT_NEAR(tipAfter(SimulationSettings(), most) / whole, 1.0, 0.05);
  EXPECT_EQ(most, lattice.cellCount());
}

/// What the tissue pushes back with under the tool.
Vector3 reaction(const Simulation& simulation) {
  const HeldForce& held = simulation.state().forces.at("tool");
  Vector3 sum = -held.force_n;
  for (const std::uint32_t v : held.vertices)
    sum += simulation.forceOn(v);
  return sum;
}

TEST(GrowthTest, FallingAsleepAndWakingUnderLoadChangesNoForceAbruptly) {
  const Slab slab(8, 5, 0.3);
  for (const ActiveSet active_set : {ActiveSet::kGrowth, ActiveSet::kNeighbourhood}) {
    SCOPED_TRACE(nameOf(active_set));
    SimulationSettings settings;
    settings.active_set = active_set;
    // A smaller neighbourhood holds back so much that letting go of it is a jump of more than 5 %.
    settings.activation_radius_m = 3.0 * kH;
    settings.lifetime_s = 0.25;
    Simulation simulation = slab.push(settings);
    run(simulation, 220);
    ASSERT_GT(simulation.activeCells(), 0U);
    Vector3 before = reaction(simulation);
    EXPECT_NEAR(before.z() / kPush, 1.0, 0.05);
    bool slept = false;
    double dent = slab.dent(simulation);
    for (int n = 0; n < 700; ++n) {
      if (n == 500) {
        slept = simulation.activeCells() == 0;
        simulation.wakeAll();
      }
      simulation.step();
      const Vector3 now = reaction(simulation);
      ASSERT_LT((now - before).norm(), 0.05 * kPush) << n;
      ASSERT_LT(std::abs(slab.dent(simulation) - dent), 0.02 * dent) << n;
      before = now;
      dent = slab.dent(simulation);
    }
    EXPECT_TRUE(slept);
  }
}

/// What is asleep around costs nothing: the same push takes as many cells in a lattice 27 times as large.
TEST(GrowthTest, WhatIsActiveDoesNotDependOnTheSizeOfTheLattice) {
  SimulationSettings settings;
  settings.integrator = Integrator::kQuasiStatic;  // settles without damping, which would refer to the lattice's size
  settings.dt_s = 1e-3;
  settings.activation_threshold = 1e-2;
  settings.activation_radius_m = 1.3 * kH;
  std::vector<std::size_t> most;
  std::vector<double> dents;
  for (const int size : {16, 48}) {
    Slab slab(size, size, 0.25);
    slab.materials = oneMaterial(kModulus);
    Simulation simulation = slab.push(settings);
    most.push_back(0);
    for (int n = 0; n < 150; ++n) {
      simulation.step();
      most.back() = std::max(most.back(), simulation.activeCells());
    }
    dents.push_back(slab.dent(simulation));
  }
  EXPECT_GT(most[0], 150U);  // it did grow, from 72
  EXPECT_LT(most[0], 1000U);
  EXPECT_EQ(most[1], most[0]);
  EXPECT_NEAR(dents[1] / dents[0], 1.0, 1e-6);  // float
}

// --- neighbourhood

TEST(NeighbourhoodTest, CellsNearAForceAreInTheSolveForTheirLifetime) {
  const Lattice lattice = makeBlock(20, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kModulus, 1.0);
  SimulationSettings settings;
  settings.active_set = ActiveSet::kNeighbourhood;
  settings.activation_radius_m = 3.1 * kH;
  settings.dt_s = 5e-4;
  settings.lifetime_s = 40 * 5e-4;
  Simulation simulation(lattice, materials, settings, 1);
  const Vector3 point(4 * kH, 2 * kH, 4 * kH);
  const Vector3 force(0, 0, -0.1);
  ASSERT_TRUE(simulation.holdForce("probe", force, point, 1.5 * kH, 5));
  simulation.step();
  // From x = 0.9 h to 7.1 h, all of y, and from z = 0.9 h up: eight by four by four cells.
  EXPECT_EQ(simulation.activeCells(), 8U * 4U * 4U);
  EXPECT_EQ(simulation.stats().active_cells, 8U * 4U * 4U);
  run(simulation, 38);
  EXPECT_EQ(simulation.activeCells(), 128U);
  simulation.step();  // the fortieth
  EXPECT_EQ(simulation.activeCells(), 0U);
  EXPECT_EQ(simulation.maxSpeed(), 0.0);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    if (lattice.rest_positions[v].x() > 8.1 * kH) {
      EXPECT_TRUE(simulation.state().displacements_m[v].isZero(0.0));
    }
  }
  // Another force begins another lifetime; a second one prolongs it.
  simulation.holdForce("probe", force, point, 1.5 * kH, 1000);
  run(simulation, 30);
  simulation.holdForce("probe", force, point, 1.5 * kH, 1000);
  run(simulation, 39);
  EXPECT_GT(simulation.activeCells(), 0U);
  simulation.step();
  EXPECT_EQ(simulation.activeCells(), 0U);
}

TEST(NeighbourhoodTest, TheErrorThatIsReportedIsOfTheSizeOfTheErrorMade) {
  for (const double poisson_ratio : {0.25, 0.4}) {
    const Slab slab(12, 8, poisson_ratio);
    const double expected = slab.settledDent();
    for (const double radius : {1.6, 3.1}) {
      SCOPED_TRACE("nu " + std::to_string(poisson_ratio) + ", radius " + std::to_string(radius) + " h");
      SimulationSettings settings;
      settings.active_set = ActiveSet::kNeighbourhood;
      settings.activation_radius_m = radius * kH;
      settings.lifetime_s = 100.0;
      Simulation simulation = slab.push(settings);
      run(simulation, 300);
      const double error_m = expected - slab.dent(simulation);
      EXPECT_GT(error_m, 0.0);  // what is held back is too stiff
      // An estimate from a half-space: within a factor of three.
      EXPECT_LT(simulation.stats().frontier_error_m, 3.0 * error_m);
      EXPECT_GT(simulation.stats().frontier_error_m, error_m / 3.0);
    }
  }
}

// --- all

TEST(WholeLatticeTest, IsAlwaysInTheSolveAndHasNoFrontier) {
  const Slab slab(6, 4, 0.3);
  SimulationSettings settings = wholeLattice();
  settings.lifetime_s = 0.01;
  Simulation simulation = slab.push(settings);
  run(simulation, 100);
  EXPECT_EQ(simulation.activeCells(), slab.lattice.cellCount());
  EXPECT_EQ(simulation.stats().frontier_error_m, 0.0);
  simulation.releaseForce("tool");
  run(simulation, 500);
  EXPECT_EQ(simulation.activeCells(), slab.lattice.cellCount());
}

TEST(WakeTest, TakesTheCellsAroundABoxOfRestPlaces) {
  const Lattice lattice = makeBlock(10, 10, 10, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  for (const ActiveSet active_set : {ActiveSet::kGrowth, ActiveSet::kNeighbourhood}) {
    SimulationSettings settings;
    settings.active_set = active_set;
    settings.activation_radius_m = 0.9 * kH;
    settings.dt_s = 1e-4;
    Simulation simulation(lattice, materials, settings, 1);
    simulation.wake(Box3(Vector3(4.5, 4.5, 0.5) * kH, Vector3(5.5, 4.5, 0.5) * kH));
    simulation.step();
    EXPECT_EQ(simulation.activeCells(), 4U * 3U * 2U);
    EXPECT_EQ(simulation.stats().active_vertices, 5U * 4U * 3U);
    simulation.wakeAll();
    simulation.step();
    EXPECT_EQ(simulation.activeCells(), lattice.cellCount());
  }
}

}  // namespace
}  // namespace soft_volume::core
