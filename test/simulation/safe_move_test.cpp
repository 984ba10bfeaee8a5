#include "safe_move.h"

#include <gtest/gtest.h>

#include "simulation_cases.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/setting_names.h"

// The guarantee of safe_move.h, by the definition of widths and in double precision, after every step.
namespace soft_volume::core {
namespace {

struct Kind {
  Integrator integrator;
  Precision precision;
};

std::vector<Kind> kinds() {
  std::vector<Kind> all;
  for (const auto& integrator : kChoices<Integrator>) {
    for (const auto& precision : kChoices<Precision>)
      all.push_back({integrator.choice, precision.choice});
  }
  return all;
}

std::string nameOfKind(const testing::TestParamInfo<Kind>& info) {
  return std::string(nameOf(info.param.integrator)) + "_" + nameOf(info.param.precision);
}

/// Widths of all corner tetrahedra, eight a cell.
std::vector<double> widths(const Lattice& lattice, const std::vector<Vector3>& displacements_m) {
  std::vector<double> all;
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    CellCorners corners;
    for (std::size_t c = 0; c < 8; ++c) {
      const std::uint32_t v = lattice.cells[cell][c];
      corners[c] = lattice.rest_positions[v] - lattice.rest_positions[lattice.cells[cell][0]] + displacements_m[v];
    }
    for (int t = 0; t < 8; ++t)
      all.push_back(cornerWidth(cornerEdges(corners, t)));
  }
  return all;
}

class SafeMoveTest : public testing::TestWithParam<Kind> {
 protected:
  SimulationSettings settings() const { return wholeLattice(GetParam().precision, GetParam().integrator); }
  /// Fewer steps of integrators that try each one many times.
  int stepsOf(int steps) const {
    const Integrator integrator = GetParam().integrator;
    const bool dear = integrator == Integrator::kBackwardEuler || integrator == Integrator::kAdaptive;
    return dear ? steps / 5 : steps;
  }
  /// What rounding may take from a width: stated in safe_move.h.
  double rounding() const { return (GetParam().precision == Precision::kFloat ? 1e-5 : 1e-12) * kH; }

  /// Speed with which a vertex asks for a move of `move_m` in a step. Backward Euler damps such motion within the step,
  /// to about 2 %.
  double speedFor(double move_m, const Simulation& simulation) const {
    const double damped = GetParam().integrator == Integrator::kBackwardEuler ? 50.0 : 1.0;
    return damped * move_m / simulation.settings().dt_s;
  }

  /// Steps once and checks the guarantee.
  void stepSafely(Simulation& simulation, const Lattice& lattice) {
    const std::vector<double> before = widths(lattice, displacements(simulation));
    simulation.step();
    const std::vector<double> after = widths(lattice, displacements(simulation));
    double worst = std::numeric_limits<double>::infinity();
    for (std::size_t n = 0; n < after.size(); ++n) {
      const double bound = std::min(before[n], kLeastWidth * kH) - rounding();
      worst = std::min(worst, after[n] - bound);
    }
    ASSERT_GE(worst, 0.0) << "step " << simulation.steps();
    ASSERT_TRUE(std::isfinite(worst) && std::isfinite(simulation.maxSpeed()));
    ASSERT_NEAR(simulation.minWidth(), *std::min_element(after.begin(), after.end()), 1e-12 * kH);
  }
};

/// Neighbours that fly apart along the diagonals of the cells, alternately: 0.4 h each in one step from rest.
std::vector<Vector3> checkerboard(const Lattice& lattice, double size) {
  std::vector<Vector3> pattern;
  for (const Vector3& p : lattice.rest_positions) {
    const Vector3i n = (p / kH).array().round().cast<int>();
    pattern.push_back((n.sum() % 2 == 0 ? size : -size) * Vector3::Ones().normalized());
  }
  return pattern;
}

TEST_P(SafeMoveTest, KeepsCellsFromInvertingInACheckerboard) {
  const Lattice lattice = makeBlock(6, 6, 6, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  for (const double sign : {1.0, -1.0}) {
    SCOPED_TRACE(sign);
    Simulation simulation(lattice, materials, settings(), 1);
    const double speed = sign * speedFor(0.4 * kH, simulation);
    place(simulation, noVectors(lattice), checkerboard(lattice, speed));
    stepSafely(simulation, lattice);
    EXPECT_GT(simulation.limitedMoves(), 0U);
    EXPECT_GT(simulation.maxDisplacement(), 0.05 * kH);
    for (int n = 0; n < stepsOf(20); ++n)
      stepSafely(simulation, lattice);
  }
}

/// Every vertex asks for the longest move there is, in another direction at every step.
TEST_P(SafeMoveTest, KeepsCellsFromInvertingInRandomStepsOfFullLength) {
  const Lattice lattice = makeBlock(3, 3, 3, kH);
  const std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.45);
  Simulation simulation(lattice, materials, settings(), 1);
  Random random(12);
  SCOPED_TRACE("seed 12");
  for (int n = 0; n < stepsOf(200) && !HasFatalFailure(); ++n) {
    const double speed = speedFor(0.5 * kH, simulation);
    place(simulation, displacements(simulation), random.vectors(lattice.vertexCount(), speed));
    stepSafely(simulation, lattice);
  }
  EXPECT_GT(simulation.limitedMoves(), 500U);
}

/// The same by forces, so that the bounds of widths are kept from step to step; 1e12 times k h, then none.
TEST_P(SafeMoveTest, KeepsCellsFromInvertingUnderHugeLoads) {
  const Lattice lattice = standing(makeBlock({4, 3, 3}, {kH, 1.2 * kH, 1.1 * kH}));
  std::vector<Material> materials = oneMaterial(kModulus, 0.3, 0.3);
  materials.push_back(oneMaterial(1e3 * kModulus, 0.3)[0]);
  Lattice mixed = lattice;
  for (std::size_t cell = 0; cell < mixed.cellCount(); cell += 2)
    mixed.materials[cell] = 1;
  Simulation simulation(mixed, materials, settings(), 1);
  Random random(13);
  SCOPED_TRACE("seed 13");
  const int steps = stepsOf(100);
  for (int n = 0; n < steps && !HasFatalFailure(); ++n) {
    if (n % 5 == 0) {
      std::vector<VertexLoad> loads;
      for (std::uint32_t v = 0; v < mixed.vertexCount() && n < steps / 2; ++v)
        loads.push_back({v, 1e12 * kModulus * kH * kH * random.direction()});
      simulation.setLoads(loads);
    }
    stepSafely(simulation, mixed);
  }
  EXPECT_GT(simulation.stats().saturated_forces, 0U);
}

TEST_P(SafeMoveTest, KeepsCellsFromInvertingWhereGripsWantToCross) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kModulus, 0.5);
  Simulation simulation(lattice, materials, settings(), 1);
  const auto lead = [&](const char* tool, double x_from, double x_to) {
    const auto held = verticesWhere(lattice, [&](const Vector3& p) { return std::abs(p.x() - x_from * kH) < 1e-9; });
    std::vector<Vector3> targets;
    for (const std::uint32_t v : held)
      targets.emplace_back(x_to * kH, lattice.rest_positions[v].y(), lattice.rest_positions[v].z());
    simulation.leadVertices(tool, held, targets, 1000);
  };
  lead("left", 1.0, 3.5);
  lead("right", 3.0, 0.5);
  for (int n = 0; n < stepsOf(100) && !HasFatalFailure(); ++n)
    stepSafely(simulation, lattice);
  // They cannot get through each other, and say so.
  EXPECT_GT(simulation.stats().grip_lag_m, kH);
}

/// Where only a few cells are in the solve, those around them that share their vertices are guarded too.
TEST_P(SafeMoveTest, KeepsCellsFromInvertingAtTheFrontier) {
  const Lattice lattice = standing(makeBlock(6, 6, 3, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 0.3);
  for (const ActiveSet active_set : {ActiveSet::kNeighbourhood, ActiveSet::kGrowth}) {
    SCOPED_TRACE(nameOf(active_set));
    SimulationSettings partly = settings();
    partly.active_set = active_set;
    partly.activation_radius_m = 0.6 * kH;
    Simulation simulation(lattice, materials, partly, 1);
    simulation.holdForce("a", Vector3(1e9, 0.0, -1e9), Vector3(3.0, 3.0, 3.0) * kH, 1.6 * kH, 1000);
    for (int n = 0; n < stepsOf(25) && !HasFatalFailure(); ++n)
      stepSafely(simulation, lattice);
    EXPECT_GT(simulation.limitedMoves(), 0U);
  }
}

/// A tetrahedron that a restored state brings along inverted does not get thinner.
TEST_P(SafeMoveTest, MakesNothingThinnerThatIsInvertedAlready) {
  const Lattice lattice = makeBlock(3, 3, 3, kH);
  const std::vector<Material> materials = oneMaterial(kModulus, 0.5);
  Simulation simulation(lattice, materials, settings(), 1);
  std::vector<Vector3> u = noVectors(lattice);
  u[vertexAt(lattice, Vector3::Constant(kH))] = Vector3(1.3 * kH, 0.1 * kH, 0.2 * kH);
  place(simulation, u, Random(14).vectors(lattice.vertexCount(), 1.0));
  SCOPED_TRACE("seed 14");
  EXPECT_LT(simulation.minWidth(), 0.0);
  for (int n = 0; n < stepsOf(60) && !HasFatalFailure(); ++n)
    stepSafely(simulation, lattice);
}

/// restore() forgets the bounds of widths that are kept from step to step; they only save work.
TEST_P(SafeMoveTest, CachedWidthsChangeNoResult) {
  const Lattice lattice = standing(makeBlock(4, 4, 3, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 0.3, 0.4);
  Simulation kept(lattice, materials, settings(), 1);
  Simulation restored(lattice, materials, settings(), 1);
  const double force = 20.0 * kModulus * kH * kH;
  const int steps = stepsOf(80);
  const std::uint64_t end = static_cast<std::uint64_t>(steps / 2);
  for (Simulation* simulation : {&kept, &restored})
    simulation->holdForce("a", Vector3(force, 0.0, -force), Vector3(2.0, 2.0, 3.0) * kH, 1.6 * kH, end);
  for (int n = 0; n < steps; ++n) {
    kept.step();
    restored.restore(SimulationState(restored.state()));
    restored.step();
    ASSERT_EQ(kept.stateHash(), restored.stateHash()) << "step " << n;
  }
  EXPECT_GT(kept.limitedMoves(), 0U);
}

INSTANTIATE_TEST_SUITE_P(Every, SafeMoveTest, testing::ValuesIn(kinds()), nameOfKind);

/// Nothing winds up while moves are shortened.
TEST(SafeMove, VelocityIsThatOfTheMoveMade) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  for (const auto& precision : kChoices<Precision>) {
    SCOPED_TRACE(precision.name);
    Simulation simulation(lattice, materials, wholeLattice(precision.choice), 1);
    const double dt_s = simulation.settings().dt_s;
    place(simulation, noVectors(lattice), Random(15).vectors(lattice.vertexCount(), 5.0 * kH / dt_s));
    // Adding a move to a displacement of a few h rounds it: 1e-16 or 6e-8 of that.
    const double rounding_m = (precision.choice == Precision::kFloat ? 1e-6 : 1e-14) * kH;
    for (int n = 0; n < 20; ++n) {
      const std::vector<Vector3> before = displacements(simulation);
      simulation.step();
      for (std::size_t v = 0; v < before.size(); ++v) {
        const Vector3 move = simulation.state().displacements_m[v] - before[v];
        ASSERT_LT((move - dt_s * simulation.velocities()[v]).norm(), rounding_m);
        ASSERT_LT(move.norm(), kLongestMove * kH * (1.0 + 1e-6));
      }
    }
    EXPECT_GT(simulation.limitedMoves(), lattice.vertexCount());
  }
}

/// What the width rule is for: 40 % of the way to the nearest neighbour is not enough in three dimensions.
TEST(SafeMove, TheDissertationsRuleInvertsTheCheckerboard) {
  const Lattice lattice = makeBlock(6, 6, 6, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  const auto widthAfterAStep = [&](SafeMove safe_move) {
    SimulationSettings settings = wholeLattice();
    settings.safe_move = safe_move;
    Simulation simulation(lattice, materials, settings, 1);
    const double speed = 0.4 * kH / simulation.settings().dt_s;
    place(simulation, noVectors(lattice), checkerboard(lattice, speed));
    simulation.step();
    return simulation.minWidth();
  };
  EXPECT_LT(widthAfterAStep(SafeMove::kDissertation), -0.05 * kH);
  EXPECT_LT(widthAfterAStep(SafeMove::kNone), -0.05 * kH);
  EXPECT_GE(widthAfterAStep(SafeMove::kWidth), kLeastWidth * kH * (1.0 - 1e-10));
}

/// The 40 % rule does what it says.
TEST(SafeMove, TheDissertationsRuleLimitsMovesToTheNearestNeighbour) {
  const Lattice lattice = makeBlock(3, 3, 3, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  SimulationSettings settings = wholeLattice();
  settings.safe_move = SafeMove::kDissertation;
  Simulation simulation(lattice, materials, settings, 1);
  place(simulation, noVectors(lattice), Random(16).vectors(lattice.vertexCount(), 1e6));
  simulation.step();
  for (const Vector3& u : simulation.state().displacements_m)
    EXPECT_NEAR(u.norm(), 0.4 * kH, 1e-9 * kH);
  EXPECT_EQ(simulation.limitedMoves(), lattice.vertexCount());
  // As written, velocities keep what moves lost.
  EXPECT_GT(simulation.maxSpeed(), 1e5);
}

}  // namespace
}  // namespace soft_volume::core
