#include "soft_volume/simulation/simulation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "lattice_blocks.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr double kH = 0.005;
constexpr double kE = 10000.0;

SimulationSettings allActive(double dt_s) {
  SimulationSettings settings;
  settings.dt_s = dt_s;
  settings.activation_radius_m = 10.0;
  settings.lifetime_steps = 1000000;
  return settings;
}

double limit(const std::vector<Material>& materials) {
  return bulkTimeStepLimit(materials[0], kH);
}

/// Moves every vertex of a simulation by an affine map and returns the force that the springs put on the vertices whose
/// rest place has the largest coordinate along `axis`.
Vector3 tractionForce(const Lattice& lattice, Simulation& simulation, const Matrix3& gradient, int axis) {
  SimulationState state = simulation.state();
  double top = 0.0;
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    state.positions_m[v] = lattice.rest_positions[v] + gradient * lattice.rest_positions[v];
    top = std::max(top, lattice.rest_positions[v][axis]);
  }
  simulation.restore(state);
  Vector3 force = Vector3::Zero();
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    if (lattice.rest_positions[v][axis] > top - 1e-9)
      force += simulation.forceOn(v);
  }
  return force;
}

TEST(PatchTest, StretchAndShearGiveTheElasticConstants) {
  const Lattice lattice = makeBlock(4, 3, 5, kH);
  const std::vector<Material> materials = oneMaterial(kE);
  Simulation simulation(lattice, materials, allActive(1e-4), 1);
  // Small strain: the springs' geometric nonlinearity is of the order of the strain itself, hence the tolerance.
  constexpr double kStrain = 1e-8;
  const double area_x = 3 * kH * 5 * kH;
  Matrix3 stretch = Matrix3::Zero();
  stretch(0, 0) = kStrain;
  // nu = 1/4: C11 = 1.2 E, C12 = C44 = 0.4 E. The tissue pulls back, so the signs are negative.
  EXPECT_NEAR(tractionForce(lattice, simulation, stretch, 0).x() / (area_x * kStrain), -1.2 * kE, 1e-6 * kE);
  const double area_y = 4 * kH * 5 * kH;
  EXPECT_NEAR(tractionForce(lattice, simulation, stretch, 1).y() / (area_y * kStrain), -0.4 * kE, 1e-6 * kE);
  Matrix3 shear = Matrix3::Zero();
  shear(1, 0) = kStrain;
  EXPECT_NEAR(tractionForce(lattice, simulation, shear, 0).y() / (area_x * kStrain), -0.4 * kE, 1e-6 * kE);
}

TEST(PatchTest, RigidMotionNeedsNoForce) {
  const Lattice lattice = makeBlock(3, 3, 3, kH);
  const std::vector<Material> materials = oneMaterial(kE);
  Simulation simulation(lattice, materials, allActive(1e-4), 1);
  SimulationState state = simulation.state();
  const Quaternion turn(Eigen::AngleAxisd(1.1, Vector3(1, 2, 3).normalized()));
  for (Vector3& p : state.positions_m)
    p = turn * p + Vector3(0.3, -0.2, 0.1);
  simulation.restore(state);
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    EXPECT_LT(simulation.forceOn(v).norm(), 1e-11 * kE * kH * kH);  // rounding of coordinates 60 h away
  }
}

TEST(SpringNetwork, MassIsThatOfTheCells) {
  const Lattice lattice = makeBlock(4, 3, 2, kH);
  const SpringNetwork network = buildSpringNetwork(lattice, oneMaterial(kE));
  double mass = 0.0;
  for (const double m : network.mass_kg)
    mass += m;
  EXPECT_NEAR(mass, 24 * 1000.0 * kH * kH * kH, 1e-15);
}

TEST(SpringNetwork, InteriorVerticesHave26MergedSprings) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const SpringNetwork network = buildSpringNetwork(lattice, oneMaterial(kE));
  const std::uint32_t centre = 2 + 5 * (2 + 5 * 2);
  EXPECT_EQ(network.row_begin[centre + 1] - network.row_begin[centre], 26U);
}

TEST(Simulation, StaysAtRestWithoutForces) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kE);
  Simulation simulation(lattice, materials, allActive(1e-4), 1);
  simulation.wake(Box3(Vector3::Zero(), Vector3::Zero()));
  EXPECT_EQ(simulation.activeCells(), 0U);
  for (int n = 0; n < 100; ++n)
    simulation.step();
  EXPECT_EQ(simulation.activeCells(), 64U);
  // Rest lengths come from spacing, positions from multiples of it: they differ by rounding only.
  EXPECT_LT(simulation.maxDisplacement(), 1e-12 * kH);
}

/// A free block with random velocities: total momentum must not change.
TEST(Simulation, KeepsMomentumOfAFreeBlock) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kE);
  Simulation simulation(lattice, materials, allActive(0.5 * limit(materials)), 1);
  std::mt19937 random(1);
  std::uniform_real_distribution<double> speed(-0.05, 0.05);
  SimulationState state = simulation.state();
  for (Vector3& v : state.velocities_m_s)
    v = Vector3(speed(random), speed(random), speed(random));
  simulation.restore(state);
  simulation.wake(Box3(Vector3::Zero(), Vector3::Zero()));
  const SpringNetwork network = buildSpringNetwork(lattice, materials);
  const auto momentum = [&] {
    Vector3 sum = Vector3::Zero();
    for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
      sum += network.mass_kg[v] * simulation.velocities()[v];
    return sum;
  };
  const Vector3 before = momentum();
  for (int n = 0; n < 1000; ++n)
    simulation.step();
  EXPECT_EQ(simulation.limitedMoves(), 0U);
  EXPECT_LT((momentum() - before).norm(), 1e-12 * before.norm() + 1e-18);
}

TEST(Simulation, CantileverBendsAsKnown) {
  // 8:1 cantilever, 4 cells across, end load: 0.922 of Timoshenko's deflection (nu = 1/4).
  constexpr int kAcross = 4;
  Lattice lattice = makeBlock(8 * kAcross, kAcross, kAcross, kH);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.fixed[v] = lattice.rest_positions[v].x() < 1e-9;
  // Damping of twice the first bending frequency, 3.52 sqrt(E I / (rho A L^4)) = 2.5 / s: the beam settles fastest.
  const std::vector<Material> materials = oneMaterial(kE, 5.0);
  Simulation simulation(lattice, materials, allActive(0.7 * limit(materials)), 2);
  const double length = 8 * kAcross * kH;
  const double side = kAcross * kH;
  const double load = 1e-5;
  // The load acts on the whole end face, which no footprint does.
  SimulationState state = simulation.state();
  HeldForce held;
  held.force_n = Vector3(0, 0, -load);
  held.expires_at_step = 10000000;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    if (lattice.rest_positions[v].x() > length - 1e-9)
      held.vertices.push_back(v);
  }
  held.weights.assign(held.vertices.size(), 1.0 / static_cast<double>(held.vertices.size()));
  state.forces["end"] = held;
  simulation.restore(state);
  simulation.wake(Box3(Vector3::Zero(), Vector3::Zero()));
  for (int n = 0; n < 6000; ++n)
    simulation.step();
  double tip = 0.0;
  for (const std::uint32_t v : held.vertices) {
    tip += (lattice.rest_positions[v] - simulation.positions()[v]).z() / static_cast<double>(held.vertices.size());
  }
  const double inertia = std::pow(side, 4) / 12.0;
  const double shear = load * length / (5.0 / 6.0 * 0.4 * kE * side * side);
  const double timoshenko = load * std::pow(length, 3) / (3.0 * kE * inertia) + shear;
  EXPECT_NEAR(tip / timoshenko, 0.922, 0.01);
}

TEST(Simulation, SymplecticIsStableBelowTheLimitAndNotAbove) {
  const Lattice lattice = makeBlock(6, 6, 6, kH);
  const std::vector<Material> materials = oneMaterial(kE);
  const auto largest = [&](double fraction) {
    Simulation simulation(lattice, materials, allActive(fraction * limit(materials)), 1);
    SimulationState state = simulation.state();
    std::mt19937 random(2);
    std::uniform_real_distribution<double> speed(-1e-6, 1e-6);
    for (Vector3& v : state.velocities_m_s)
      v = Vector3(speed(random), speed(random), speed(random));
    simulation.restore(state);
    simulation.wake(Box3(Vector3::Zero(), Vector3::Zero()));
    for (int n = 0; n < 2000; ++n)
      simulation.step();
    return simulation.maxSpeed();
  };
  EXPECT_LT(largest(0.85), 1e-4);  // a free surface lowers the limit a little below that of the bulk
  EXPECT_GT(largest(1.15), 1e-2);
}

TEST(Simulation, PushedTissueRecovers) {
  for (const Integrator integrator : {Integrator::kSymplecticEuler, Integrator::kDissertation}) {
    Lattice lattice = makeBlock(8, 8, 4, kH);
    for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
      lattice.fixed[v] = lattice.rest_positions[v].z() < 1e-9;
    const std::vector<Material> materials = oneMaterial(kE, 60.0);
    SimulationSettings settings = allActive(0.5 * limit(materials));
    settings.integrator = integrator;
    Simulation simulation(lattice, materials, settings, 1);
    const Vector3 top(4 * kH, 4 * kH, 4 * kH);
    ASSERT_TRUE(simulation.holdForce("probe", Vector3(0, 0, -0.2), top, 2.1 * kH, 500));
    for (int n = 0; n < 500; ++n)
      simulation.step();
    EXPECT_GT(simulation.maxDisplacement(), 0.1 * kH);
    for (int n = 0; n < 4000; ++n)
      simulation.step();
    EXPECT_TRUE(simulation.state().forces.empty());
    EXPECT_LT(simulation.maxDisplacement(), 1e-4 * kH);
  }
}

TEST(Simulation, FootprintCarriesTheWholeForceAndNothingElse) {
  const Lattice lattice = makeBlock(6, 6, 6, kH);
  const std::vector<Material> materials = oneMaterial(kE);
  Simulation simulation(lattice, materials, allActive(1e-4), 1);
  const Vector3 force(0.1, -0.2, 0.3);
  ASSERT_TRUE(simulation.holdForce("a", force, Vector3(3 * kH, 3 * kH, 6 * kH), 1.6 * kH, 10));
  Vector3 sum = Vector3::Zero();
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v)
    sum += simulation.forceOn(v);
  EXPECT_LT((sum - force).norm(), 1e-10);
  EXPECT_FALSE(simulation.holdForce("b", force, Vector3(1, 1, 1), kH, 10));
  EXPECT_EQ(simulation.state().forces.size(), 1U);
}

TEST(Simulation, NoMoveIsLongerThanTheSafeFractionWhateverTheForce) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kE, 60.0);
  Simulation simulation(lattice, materials, allActive(0.5 * limit(materials)), 1);
  ASSERT_TRUE(simulation.holdForce("giant", Vector3(0, 0, -1e6), Vector3(2 * kH, 2 * kH, 4 * kH), 1.5 * kH, 50));
  for (int n = 0; n < 50; ++n) {
    const std::vector<Vector3> before = simulation.positions();
    simulation.step();
    for (std::size_t v = 0; v < before.size(); ++v) {
      const double move = (simulation.positions()[v] - before[v]).norm();
      EXPECT_TRUE(std::isfinite(move));
      EXPECT_LE(move, 0.4 * 3.0 * kH);
      // The velocity is that of the move that was made: nothing winds up.
      EXPECT_NEAR(simulation.velocities()[v].norm() * simulation.settings().dt_s, move, 1e-9);
    }
  }
  EXPECT_GT(simulation.limitedMoves(), 0U);
}

TEST(Simulation, BitIdenticalForAnyNumberOfThreads) {
  const Lattice lattice = makeBlock(12, 12, 12, kH);
  const std::vector<Material> materials = oneMaterial(kE, 20.0);
  const auto run = [&](int threads) {
    Simulation simulation(lattice, materials, allActive(0.5 * limit(materials)), threads);
    simulation.holdForce("a", Vector3(0.1, 0.2, -0.8), Vector3(6 * kH, 6 * kH, 12 * kH), 2 * kH, 150);
    simulation.holdForce("b", Vector3(-0.3, 0.0, 0.1), Vector3(12 * kH, 6 * kH, 6 * kH), 2 * kH, 90);
    for (int n = 0; n < 200; ++n)
      simulation.step();
    return simulation.stateHash();
  };
  const std::uint64_t one = run(1);
  EXPECT_EQ(run(2), one);
  EXPECT_EQ(run(7), one);
  EXPECT_EQ(run(1), one);
}

TEST(Simulation, OnlyCellsNearTheForceAreInTheSolveAndForTheirLifetime) {
  const Lattice lattice = makeBlock(20, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kE, 60.0);
  SimulationSettings settings = allActive(0.5 * limit(materials));
  settings.activation_radius_m = 3 * kH;
  settings.lifetime_steps = 40;
  Simulation simulation(lattice, materials, settings, 1);
  ASSERT_TRUE(simulation.holdForce("probe", Vector3(0, 0, -0.1), Vector3(4 * kH, 2 * kH, 4 * kH), 1.5 * kH, 5));
  simulation.step();
  EXPECT_GT(simulation.activeCells(), 0U);
  EXPECT_LT(simulation.activeCells(), lattice.cellCount() / 2);
  for (int n = 0; n < 60; ++n)
    simulation.step();
  EXPECT_EQ(simulation.activeCells(), 0U);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    EXPECT_TRUE(simulation.velocities()[v].isZero(0.0));
    if (lattice.rest_positions[v].x() > 9 * kH) {
      EXPECT_TRUE(simulation.positions()[v] == lattice.rest_positions[v]);
    }
  }
}

TEST(Simulation, ContinuesBitExactlyFromAStateSavedAtAnyStep) {
  const Lattice lattice = makeBlock(6, 6, 6, kH);
  const std::vector<Material> materials = oneMaterial(kE, 20.0);
  SimulationSettings settings = allActive(0.5 * limit(materials));
  settings.activation_radius_m = 2 * kH;
  settings.lifetime_steps = 30;
  Simulation whole(lattice, materials, settings, 1);
  std::vector<SimulationState> saved;
  std::vector<std::uint64_t> hashes;
  // Cells wake, overlap and fall asleep at different steps, so that a save falls on every kind of change.
  for (int n = 0; n < 100; ++n) {
    if (n == 5)
      whole.holdForce("a", Vector3(0.1, 0.2, -0.8), Vector3(2 * kH, 3 * kH, 6 * kH), 2 * kH, 25);
    if (n == 20)
      whole.holdForce("b", Vector3(0.0, 0.2, -0.3), Vector3(5 * kH, 3 * kH, 6 * kH), 2 * kH, 60);
    saved.push_back(whole.state());
    whole.step();
    hashes.push_back(whole.stateHash());
  }
  for (std::size_t from = 21; from < saved.size(); ++from) {
    Simulation continued(lattice, materials, settings, 1);
    continued.restore(saved[from]);
    for (std::size_t n = from; n < saved.size(); ++n) {
      continued.step();
      ASSERT_EQ(continued.stateHash(), hashes[n]) << "saved before step " << from << ", step " << n;
    }
  }
}

TEST(Simulation, RefusesAStateThatDoesNotFit) {
  const Lattice lattice = makeBlock(2, 2, 2, kH);
  const std::vector<Material> materials = oneMaterial(kE);
  Simulation simulation(lattice, materials, allActive(1e-4), 1);
  const std::uint64_t before = simulation.stateHash();
  const auto refuses = [&](const auto& damage) {
    SimulationState state = simulation.state();
    damage(state);
    EXPECT_THROW(simulation.restore(state), InputError);
    EXPECT_EQ(simulation.stateHash(), before);
  };
  refuses([](SimulationState& s) { s.positions_m.pop_back(); });
  refuses([](SimulationState& s) { s.velocities_m_s.clear(); });
  refuses([](SimulationState& s) { s.lifetimes.push_back(1); });
  refuses([](SimulationState& s) { s.positions_m[3].y() = NAN; });
  refuses([](SimulationState& s) { s.velocities_m_s[3].y() = INFINITY; });
  refuses([](SimulationState& s) { s.forces["x"].vertices = {999}; });
}

}  // namespace
}  // namespace soft_volume::core
