#include <gtest/gtest.h>

#include "simulation_cases.h"
#include "soft_volume/simulation/setting_names.h"

// How exact the integrators are, by order and by energy, on a small block that swings.
namespace soft_volume::core {
namespace {

constexpr std::uint64_t kForEver = 1000000000;

struct Swing {
  Lattice lattice = standing(makeBlock(3, 3, 4, kH));
  std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.35);
  double limit_s = Simulation(lattice, materials, wholeLattice(), 1).stabilityLimit();

  /// Bent sideways by `strain`, at rest.
  Simulation start(Integrator integrator, double dt_s, double strain, const SimulationSettings& more = {}) const {
    SimulationSettings settings = more;
    settings.active_set = ActiveSet::kAll;
    settings.precision = Precision::kDouble;
    settings.safe_move = SafeMove::kNone;
    settings.integrator = integrator;
    settings.dt_s = dt_s;
    Simulation simulation(lattice, materials, settings, 1);
    std::vector<Vector3> u;
    for (const Vector3& p : lattice.rest_positions) {
      const double s = p.z() / (4.0 * kH);
      u.emplace_back(strain * 4.0 * kH * s * s, 0.5 * strain * 4.0 * kH * s * s, 0.0);
    }
    place(simulation, u, noVectors(lattice));
    return simulation;
  }
};

double energy(const Simulation& simulation) {
  const Mechanics mechanics = simulation.mechanics();
  return mechanics.kinetic_j + mechanics.elastic_j;
}

/// Error after a fifth of the slowest period against Runge-Kutta steps of a fiftieth of the limit.
double errorOf(const Swing& swing, Integrator integrator, double dt_s, double time_s) {
  Simulation reference = swing.start(Integrator::kRungeKutta4, time_s / 1000.0, 0.02);
  run(reference, 1000);
  Simulation simulation = swing.start(integrator, dt_s, 0.02);
  run(simulation, static_cast<int>(std::lround(time_s / dt_s)));
  return largestDifference(displacements(simulation), displacements(reference));
}

TEST(Integrators, ConvergeWithTheirOrder) {
  const Swing swing;
  const double time_s = 16.0 * swing.limit_s;
  // Halving the step divides the error by 2^order, where steps are small enough for the first term to lead: 64 and 128
  // of them for those of first order, 16 and 32 for Runge-Kutta, whose error is near rounding beyond.
  for (const Integrator integrator :
       {Integrator::kSymplecticEuler, Integrator::kDissertation, Integrator::kBackwardEuler}) {
    SCOPED_TRACE(nameOf(integrator));
    const double coarse = errorOf(swing, integrator, time_s / 64.0, time_s);
    const double fine = errorOf(swing, integrator, time_s / 128.0, time_s);
    EXPECT_GT(coarse / fine, 1.5);
    EXPECT_LT(coarse / fine, 2.7);
    EXPECT_LT(coarse, 0.02 * kH);
  }
  const double coarse = errorOf(swing, Integrator::kRungeKutta4, time_s / 32.0, time_s);
  const double fine = errorOf(swing, Integrator::kRungeKutta4, time_s / 64.0, time_s);
  EXPECT_GT(coarse / fine, 11.0);
  EXPECT_LT(coarse / fine, 21.0);
}

TEST(Integrators, KeepEnergyAsTheirKindDoes) {
  const Swing swing;
  const auto energies = [&](Integrator integrator, double fraction, int steps) {
    Simulation simulation = swing.start(integrator, fraction * swing.limit_s, 0.01);
    std::vector<double> all = {energy(simulation)};
    for (int n = 0; n < steps; ++n) {
      simulation.step();
      all.push_back(energy(simulation));
    }
    return all;
  };
  const auto mean = [](const std::vector<double>& values, std::size_t from, std::size_t to) {
    double sum = 0.0;
    for (std::size_t n = from; n < to; ++n)
      sum += values[n] / double(to - from);
    return sum;
  };
  // Symplectic Euler's energy swings and keeps its mean: the bound of the issue is 1 %.
  const std::vector<double> symplectic = energies(Integrator::kSymplecticEuler, 0.6, 4000);
  EXPECT_NEAR(mean(symplectic, 3000, 4000) / mean(symplectic, 0, 1000), 1.0, 0.01);
  // Runge-Kutta takes out omega^6 dt^6 / 72 a step: of the slow modes next to nothing.
  const std::vector<double> runge_kutta = energies(Integrator::kRungeKutta4, 0.3, 1000);
  EXPECT_NEAR(runge_kutta.back() / runge_kutta.front(), 1.0, 0.01);
  EXPECT_LE(*std::max_element(runge_kutta.begin(), runge_kutta.end()), runge_kutta.front() * (1.0 + 1e-6));
  // The dissertation's rule damps, though nothing asks it to.
  const std::vector<double> dissertation = energies(Integrator::kDissertation, 0.4, 1000);
  EXPECT_LT(mean(dissertation, 900, 1000), 0.9 * mean(dissertation, 0, 100));
}

TEST(Integrators, BackwardEulersEnergyNeverGrows) {
  for (const double steps_of_limit : {0.5, 3.0, 30.0}) {
    SCOPED_TRACE(steps_of_limit);
    const Swing swing;
    Simulation simulation = swing.start(Integrator::kBackwardEuler, steps_of_limit * swing.limit_s, 0.01);
    const double first = energy(simulation);
    double before = first;
    for (int n = 0; n < 100; ++n) {
      simulation.step();
      const double now = energy(simulation);
      ASSERT_LE(now, before + 1e-9 * first) << n;  // the bound
      before = now;
    }
    EXPECT_LT(before, 0.9 * first);
    EXPECT_GT(simulation.stats().solver_iterations, 0U);
  }
}

TEST(Integrators, AdaptiveStepsMeetTheirTolerance) {
  const Swing swing;
  const double time_s = 16.0 * swing.limit_s;
  Simulation reference = swing.start(Integrator::kRungeKutta4, time_s / 1000.0, 0.05);
  run(reference, 1000);
  std::uint64_t rejected_before = 0;
  double error_before = 1.0;
  for (const double tolerance : {1e-2, 1e-4, 1e-6}) {
    SCOPED_TRACE(tolerance);
    SimulationSettings settings;
    settings.error_tolerance = tolerance;
    constexpr int kSteps = 8;
    Simulation simulation = swing.start(Integrator::kAdaptive, time_s / kSteps, 0.05, settings);
    run(simulation, kSteps);
    const double error_m = largestDifference(displacements(simulation), displacements(reference));
    // Every part of a step may err by the tolerance, and there are fewer than 100.
    EXPECT_LT(error_m, 100.0 * tolerance * kH);
    EXPECT_LT(error_m, error_before);
    EXPECT_GE(simulation.stats().rejected_steps, rejected_before);
    rejected_before = simulation.stats().rejected_steps;
    error_before = error_m;
  }
  EXPECT_GT(rejected_before, 10U);
}

TEST(Integrators, AdaptiveStepsFarBeyondTheLimitStayStable) {
  const Swing swing;
  Simulation simulation = swing.start(Integrator::kAdaptive, 20.0 * swing.limit_s, 0.02);
  const double first = energy(simulation);
  run(simulation, 40);
  EXPECT_LT(energy(simulation), 1.001 * first);
  EXPECT_GT(energy(simulation), 0.9 * first);  // and undamped motion goes on
}

/// Whatever the step and the damping: statics has no time.
TEST(Integrators, QuasiStaticStepsOfAnyLengthFindTheSameBalance) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    const Lattice lattice = standing(makeBlock(5, 5, 5, kH));
    const Vector3 top = Vector3(2, 3, 5) * kH;
    const Vector3 force(0.1, 0.05, -0.2);
    const std::vector<Material> undamped = oneMaterial(kModulus, 0.0, poisson_ratio);
    const std::vector<Material> damped = oneMaterial(kModulus, 1.0, poisson_ratio);
    Simulation dynamic(lattice, damped, wholeLattice(), 1);
    dynamic.holdForce("a", force, top, 1.6 * kH, kForEver);
    run(dynamic, 2500);
    EXPECT_LT(dynamic.maxSpeed(), 1e-9);
    const std::vector<Vector3> expected = displacements(dynamic);
    EXPECT_GT(largest(expected), 0.05 * kH);
    for (const double steps_of_limit : {1.0, 30.0, 3000.0}) {
      for (const auto* materials : {&undamped, &damped}) {
        SCOPED_TRACE("nu " + std::to_string(poisson_ratio) + ", dt " + std::to_string(steps_of_limit) + " limits");
        SimulationSettings settings = wholeLattice(Precision::kDouble, Integrator::kQuasiStatic);
        settings.dt_s = steps_of_limit * dynamic.stabilityLimit();
        Simulation simulation(lattice, *materials, settings, 1);
        simulation.holdForce("a", force, top, 1.6 * kH, kForEver);
        run(simulation, 800);
        // The bounds: the same answer within 1e-4 of the largest displacement, and moves below 1e-6 h a step.
        EXPECT_LT(largestDifference(displacements(simulation), expected), 1e-4 * largest(expected));
        const std::vector<Vector3> before = displacements(simulation);
        simulation.step();
        EXPECT_LT(largestDifference(displacements(simulation), before), 1e-6 * kH);
        EXPECT_EQ(simulation.limitedMoves(), 0U);
        EXPECT_EQ(simulation.stats().solver_iterations, 0U);
      }
    }
  }
}

/// Led vertices go all the way in every integrator, and those between follow.
TEST(Integrators, AllLeadGrippedVertices) {
  for (const auto& integrator : kChoices<Integrator>) {
    SCOPED_TRACE(integrator.name);
    const Lattice lattice = standing(makeBlock(3, 3, 3, kH));
    const std::vector<Material> materials = oneMaterial(kModulus, 1.0, 0.3);
    Simulation simulation(lattice, materials, wholeLattice(Precision::kDouble, integrator.choice), 1);
    const auto plate = verticesWhere(lattice, [](const Vector3& p) { return p.z() > 2.9 * kH; });
    simulation.gripVertices("plate", plate, Pose(), kForEver);
    simulation.moveGrip("plate", {Vector3(0.3 * kH, 0, 0.6 * kH), Quaternion::Identity()}, kForEver);
    run(simulation, 600);
    EXPECT_LT(simulation.stats().grip_lag_m, 1e-15);
    const std::uint32_t between = vertexAt(lattice, Vector3(1, 1, 1) * kH);
    EXPECT_NEAR(simulation.state().displacements_m[between].z(), 0.2 * kH, 0.06 * kH);
    EXPECT_LT(simulation.maxSpeed(), 1e-6);
  }
}

}  // namespace
}  // namespace soft_volume::core
