#include "soft_volume/simulation/simulation.h"

#include <gtest/gtest.h>

#include <regex>

#include "simulation_cases.h"
#include "soft_volume/common/error.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/setting_names.h"

namespace soft_volume::core {
namespace {

constexpr std::uint64_t kForEver = 1000000000;

// --- rest, affine deformations, momentum

TEST(Simulation, RestStaysRestExactly) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    for (const auto& precision : kChoices<Precision>) {
      for (const auto& integrator : kChoices<Integrator>) {
        SCOPED_TRACE(std::string(precision.name) + " " + integrator.name);
        const Lattice lattice = makeBlock({4, 3, 3}, {0.005, 0.006, 0.007});
        const std::vector<Material> materials = oneMaterial(kModulus, 0.1, poisson_ratio);
        Simulation simulation(lattice, materials, wholeLattice(precision.choice, integrator.choice), 1);
        run(simulation, 20);
        EXPECT_EQ(simulation.activeCells(), lattice.cellCount());
        EXPECT_EQ(simulation.maxDisplacement(), 0.0);
        EXPECT_EQ(simulation.maxSpeed(), 0.0);
      }
    }
  }
}

/// In a homogeneous deformation only the surface is pulled, however large it is and however it is turned.
TEST(Simulation, AffineDeformationsAreInEquilibriumInside) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    const Lattice lattice = makeBlock({5, 4, 4}, {0.005, 0.006, 0.007});
    const std::vector<Material> materials = oneMaterial(kModulus, 0.0, poisson_ratio);
    SimulationSettings settings = wholeLattice();
    settings.safe_move = SafeMove::kNone;
    Simulation simulation(lattice, materials, settings, 1);
    Matrix3 stretch;
    stretch << 1.3, 0.2, 0.0, 0.2, 0.8, -0.1, 0.0, -0.1, 1.1;
    for (const double angle : {0.0, 1.0, 3.0}) {
      SCOPED_TRACE(angle);
      const Matrix3 turn = Eigen::AngleAxisd(angle, Vector3(1, 2, 3).normalized()).toRotationMatrix();
      for (const bool rigid : {false, true}) {
        std::vector<Vector3> u;
        for (const Vector3& p : lattice.rest_positions)
          u.push_back(turn * (rigid ? p : Vector3(stretch * p)) - p);
        place(simulation, u, noVectors(lattice));
        simulation.step();
        double surface = 0.0, inside = 0.0;
        for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
          const Vector3& p = lattice.rest_positions[v];
          const Vector3 top = lattice.spacing_m.cwiseProduct(lattice.dims.cast<double>());
          const bool at_surface = (p.array() < 1e-9).any() || (p.array() > top.array() - 1e-9).any();
          const double force = simulation.velocities()[v].norm() * simulation.mass(v) / simulation.settings().dt_s;
          (at_surface ? surface : inside) = std::max(at_surface ? surface : inside, force);
        }
        // Forces of some ten springs of k h = 0.1 E h^2 cancel to rounding.
        const double rounding = 1e-13 * kModulus * kH * kH;
        EXPECT_LT(inside, rounding);
        if (rigid)
          EXPECT_LT(surface, rounding);
        else
          EXPECT_GT(surface, 0.01 * kModulus * kH * kH);
      }
    }
  }
}

TEST(Simulation, AFreeBlockKeepsItsMomenta) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    for (const Integrator integrator : {Integrator::kSymplecticEuler, Integrator::kDissertation,
                                        Integrator::kRungeKutta4, Integrator::kAdaptive, Integrator::kBackwardEuler}) {
      SCOPED_TRACE(std::string(nameOf(integrator)) + ", nu " + std::to_string(poisson_ratio) + ", seed 1");
      const Lattice lattice = makeBlock(4, 4, 4, kH);
      const std::vector<Material> materials = oneMaterial(kModulus, 0.0, poisson_ratio);
      Simulation simulation(lattice, materials, wholeLattice(Precision::kDouble, integrator), 1);
      const std::vector<Vector3> speeds = Random(1).boxed(lattice.vertexCount(), 0.01);
      place(simulation, noVectors(lattice), speeds);
      double size = 0.0;  // sum of m |v|: what the rounding of a sum refers to
      for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v)
        size += simulation.mass(v) * speeds[v].norm();
      const Mechanics before = simulation.mechanics();
      run(simulation, 200);
      const Mechanics after = simulation.mechanics();
      EXPECT_EQ(simulation.limitedMoves(), 0U);
      // 200 steps of rounding errors of 1e-16; the issue asks for 1e-10.
      EXPECT_LT((after.linear_momentum_kg_m_s - before.linear_momentum_kg_m_s).norm(), 1e-12 * size);
      // Of the integrators only this one conserves it by construction.
      if (integrator == Integrator::kSymplecticEuler) {
        EXPECT_LT((after.angular_momentum_kg_m2_s - before.angular_momentum_kg_m2_s).norm(), 1e-12 * size * 4.0 * kH);
      }
    }
  }
}

TEST(Simulation, MassIsThatOfTheMaterials) {
  Lattice lattice = makeBlock({3, 2, 2}, {0.005, 0.006, 0.007});
  std::vector<Material> materials = oneMaterial(kModulus);
  materials.push_back(materials[0]);
  materials[1].density_kg_m3 = 3000.0;
  lattice.materials[0] = lattice.materials[5] = 1;
  const Simulation simulation(lattice, materials, wholeLattice(), 1);
  const std::vector<double> masses = oracleMasses(lattice, materials);
  double total = 0.0;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    EXPECT_NEAR(simulation.mass(v), masses[v], 1e-15 * masses[v]);
    total += simulation.mass(v);
  }
  EXPECT_NEAR(total, 5e-9 * 6.0 * 7.0 * (10.0 * 1000.0 + 2.0 * 3000.0), 1e-15);
}

// --- determinism

/// More than 4096 vertices, so that the passes really are divided among threads.
TEST(SimulationThreads, GiveTheSameBitsWhateverTheirNumber) {
  const Lattice lattice = standing(makeBlock(18, 18, 15, kH));
  ASSERT_GT(lattice.vertexCount(), 5000U);
  // Undamped and with a given step nothing needs to be found before the first step.
  const std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.3);
  const std::vector<std::pair<Integrator, Precision>> kinds = {{Integrator::kSymplecticEuler, Precision::kFloat},
                                                               {Integrator::kSymplecticEuler, Precision::kDouble},
                                                               {Integrator::kRungeKutta4, Precision::kFloat},
                                                               {Integrator::kBackwardEuler, Precision::kDouble}};
  for (const auto& kind : kinds) {
    SCOPED_TRACE(nameOf(kind.first));
    const bool implicit = kind.first == Integrator::kBackwardEuler;
    SimulationSettings settings = wholeLattice(kind.second, kind.first);
    settings.dt_s = implicit ? 2e-3 : 4e-4;
    const auto hashAfterSteps = [&](int threads) {
      Simulation simulation(lattice, materials, settings, threads);
      simulation.holdForce("a", Vector3(1.0, 0.3, -3.0), Vector3(6, 6, 15) * kH, 2.2 * kH, 150);
      simulation.holdForce("b", Vector3(-9.0, 0.0, 0.1), Vector3(18, 9, 9) * kH, 2.2 * kH, 3);
      run(simulation, implicit ? 1 : 6);
      return simulation.stateHash();
    };
    const std::uint64_t one = hashAfterSteps(1);
    EXPECT_EQ(hashAfterSteps(2), one);
    EXPECT_EQ(hashAfterSteps(8), one);
    EXPECT_EQ(hashAfterSteps(1), one);
  }
}

/// Growth, sleep, grips, incisions' springs and the guard at work, in the default settings.
TEST(SimulationThreads, GiveTheSameBitsWhileTheActiveSetChanges) {
  const std::vector<Material> materials = oneMaterial(kModulus, 1.0, 0.4);
  const Lattice lattice = standing(cutAcross(makeBlock(12, 8, 6, kH), materials, 5.9 * kH, 2.9 * kH, 1.0, 0.75));
  const auto hashes = [&](int threads) {
    SimulationSettings settings;
    settings.dt_s = 4e-4;
    settings.lifetime_s = 0.02;
    Simulation simulation(lattice, materials, settings, threads);
    std::vector<std::uint64_t> all;
    for (int n = 0; n < 120; ++n) {
      if (n == 3)
        simulation.holdForce("a", Vector3(0.0, 0.1, -2.0), Vector3(3, 4, 6) * kH, 1.6 * kH, 30);
      if (n == 10)
        simulation.closeGrip("b", Vector3(9, 4, 6) * kH, 1.6 * kH, Pose(), 60);
      if (n > 10 && n < 60)
        simulation.moveGrip("b", {Vector3(0.0, 0.0, 0.05 * kH * (n - 10)), Quaternion::Identity()}, 70);
      simulation.step();
      all.push_back(simulation.stateHash());
    }
    return all;
  };
  const std::vector<std::uint64_t> one = hashes(1);
  EXPECT_EQ(hashes(2), one);
  EXPECT_EQ(hashes(8), one);
}

TEST(Simulation, ContinuesBitExactlyFromAStateSavedAtAnyStep) {
  const Lattice lattice = standing(makeBlock(5, 5, 5, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 0.5);
  for (const auto& active_set : kChoices<ActiveSet>) {
    SCOPED_TRACE(active_set.name);
    SimulationSettings settings;
    settings.active_set = active_set.choice;
    settings.activation_radius_m = 1.5 * kH;
    settings.lifetime_s = 0.015;
    Simulation whole(lattice, materials, settings, 1);
    std::vector<SimulationState> saved;
    std::vector<std::uint64_t> hashes;
    // Cells wake, overlap and fall asleep at different steps, so that a save falls on every kind of change.
    for (int n = 0; n < 100; ++n) {
      if (n == 5)
        whole.holdForce("a", Vector3(0.1, 0.2, -0.8), Vector3(2, 3, 5) * kH, 2 * kH, 25);
      if (n == 20)
        whole.holdForce("b", Vector3(0.0, 0.2, -0.3), Vector3(4, 3, 5) * kH, 2 * kH, 60);
      if (n == 30)
        whole.closeGrip("c", Vector3(1, 1, 5) * kH, 1.1 * kH, {Vector3(0, 0, -kH), Quaternion::Identity()}, 50);
      if (n == 31)
        whole.moveGrip("c", {Vector3(0, 0, -0.5 * kH), Quaternion::Identity()}, 50);
      saved.push_back(whole.state());
      whole.step();
      hashes.push_back(whole.stateHash());
    }
    for (std::size_t from = 31; from < saved.size(); from += 9) {
      Simulation continued(lattice, materials, settings, 1);
      continued.restore(saved[from]);
      if (from == 31)
        continued.moveGrip("c", {Vector3(0, 0, -0.5 * kH), Quaternion::Identity()}, 50);
      for (std::size_t n = from; n < saved.size(); ++n) {
        continued.step();
        ASSERT_EQ(continued.stateHash(), hashes[n]) << "saved before step " << from << ", step " << n;
      }
    }
  }
}

TEST(Simulation, SetIntegratorGoesOnLikeANewSimulationThatIsRestored) {
  const Lattice lattice = standing(makeBlock(5, 5, 4, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 0.5, 0.4);
  for (const auto& to : kChoices<Integrator>) {
    for (const double dt_s : {0.0, 1e-4}) {
      SCOPED_TRACE(std::string(to.name) + " " + std::to_string(dt_s));
      SimulationSettings settings;
      Simulation changed(lattice, materials, settings, 1);
      changed.holdForce("a", Vector3(0.1, 0.2, -0.5), Vector3(2, 3, 4) * kH, 2 * kH, 30);
      run(changed, 11);
      changed.setIntegrator(to.choice, dt_s);
      settings.integrator = to.choice;
      settings.dt_s = dt_s;
      Simulation fresh(lattice, materials, settings, 1);
      EXPECT_EQ(fresh.settings().dt_s, changed.settings().dt_s);
      EXPECT_EQ(fresh.substeps(), changed.substeps());
      fresh.restore(SimulationState(changed.state()));
      for (int n = 0; n < 30; ++n) {
        changed.step();
        fresh.step();
        ASSERT_EQ(changed.stateHash(), fresh.stateHash()) << n;
      }
    }
  }
}

// --- forces from outside

TEST(Simulation, AFootprintCarriesTheWholeForceAndNothingElse) {
  const Lattice lattice = makeBlock(6, 6, 6, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  const Vector3 force(0.1, -0.2, 0.3);
  ASSERT_TRUE(simulation.holdForce("a", force, Vector3(3, 3, 6) * kH, 1.6 * kH, 10));
  const auto sum = [&] {
    Vector3 all = Vector3::Zero();
    for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v)
      all += simulation.forceOn(v);
    return all;
  };
  EXPECT_LT((sum() - force).norm(), 1e-15);
  // Where nothing is nearby nothing changes.
  EXPECT_FALSE(simulation.holdForce("b", force, Vector3(1, 1, 1), kH, 10));
  EXPECT_FALSE(simulation.holdForce("a", force, Vector3(1, 1, 1), kH, 10));
  EXPECT_LT((sum() - force).norm(), 1e-15);
  // Another force of the same tool replaces the first, that of another adds.
  ASSERT_TRUE(simulation.holdForce("a", 2.0 * force, Vector3(3, 3, 6) * kH, 1.6 * kH, 10));
  ASSERT_TRUE(simulation.holdForce("b", force, Vector3(3, 3, 0) * kH, 1.6 * kH, 10));
  EXPECT_LT((sum() - 3.0 * force).norm(), 1e-15);
  simulation.releaseForce("a");
  simulation.releaseForce("nobody");
  EXPECT_LT((sum() - force).norm(), 1e-15);
}

TEST(Simulation, AForceActsUntilItExpires) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  const Vector3 force(0.01, 0.02, -0.03);
  ASSERT_TRUE(simulation.holdForce("a", force, Vector3(2, 2, 4) * kH, 1.6 * kH, 7));
  run(simulation, 20);
  EXPECT_TRUE(simulation.state().forces.empty());
  // Seven steps of it, which the momentum shows.
  const Vector3 expected = 7.0 * simulation.settings().dt_s * force;
  EXPECT_LT((simulation.mechanics().linear_momentum_kg_m_s - expected).norm(), 1e-12 * expected.norm());
}

TEST(Simulation, LoadsStayUntilTheyAreReplaced) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  const Vector3 a(0.001, 0.0, 0.002), b(-0.001, 0.003, 0.0);
  simulation.setLoads({{9, a}, {3, b}});
  EXPECT_EQ(simulation.state().loads.front().vertex, 3U);
  run(simulation, 5);
  simulation.setLoads({{3, b}});
  run(simulation, 5);
  simulation.setLoads({});
  run(simulation, 5);
  EXPECT_EQ(simulation.limitedMoves(), 0U);  // a shortened move takes momentum out
  const Vector3 expected = simulation.settings().dt_s * (5.0 * a + 10.0 * b);
  EXPECT_LT((simulation.mechanics().linear_momentum_kg_m_s - expected).norm(), 1e-12 * expected.norm());
  // Bad ones are refused and change nothing.
  EXPECT_THROW(simulation.setLoads({{999, a}}), InputError);
  EXPECT_THROW(simulation.setLoads({{1, Vector3(0, NAN, 0)}}), InputError);
  EXPECT_THROW(simulation.setLoads({{1, Vector3(0, 1e38, 0)}}), InputError);
  EXPECT_TRUE(simulation.state().loads.empty());
}

TEST(Simulation, RefusesForcesThatAreNotNumbers) {
  const Lattice lattice = makeBlock(3, 3, 3, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  const Vector3 top = Vector3(1.5, 1.5, 3) * kH;
  for (const double bad : {double(NAN), double(INFINITY), -double(INFINITY), 1e38}) {
    EXPECT_THROW(simulation.holdForce("a", Vector3(0, bad, 0), top, kH, 10), InputError);
    EXPECT_THROW(simulation.holdForce("a", Vector3::Zero(), Vector3(0, 0, bad), kH, 10), InputError);
    EXPECT_THROW(simulation.holdForce("a", Vector3::Zero(), top, bad, 10), InputError);
    EXPECT_THROW(simulation.closeGrip("a", Vector3(bad, 0, 0), kH, Pose(), 10), InputError);
    EXPECT_THROW(simulation.closeGrip("a", top, bad, Pose(), 10), InputError);
    const Pose pose = {Vector3(bad, 0, 0), Quaternion::Identity()};
    EXPECT_THROW(simulation.closeGrip("a", top, kH, pose, 10), InputError);
    EXPECT_THROW(simulation.gripVertices("a", {1}, pose, 10), InputError);
    EXPECT_THROW(simulation.moveGrip("a", pose, 10), InputError);
    EXPECT_THROW(simulation.leadVertices("a", {1}, {Vector3(0, bad, 0)}, 10), InputError);
  }
  EXPECT_THROW(simulation.holdForce("a", Vector3::Zero(), top, -kH, 10), InputError);
  EXPECT_THROW(simulation.gripVertices("a", {999}, Pose(), 10), InputError);
  EXPECT_THROW(simulation.leadVertices("a", {999}, {Vector3::Zero()}, 10), InputError);
  EXPECT_THROW(simulation.leadVertices("a", {1, 2}, {Vector3::Zero()}, 10), InputError);
  EXPECT_THROW(simulation.gripVertices("a", {1}, {Vector3::Zero(), Quaternion(2, 0, 0, 0)}, 10), InputError);
  EXPECT_TRUE(simulation.state().forces.empty());
  EXPECT_TRUE(simulation.state().grips.empty());
  run(simulation, 3);
  EXPECT_EQ(simulation.maxDisplacement(), 0.0);
}

/// Modulus of a bar that cannot widen.
double confinedModulus(double poisson_ratio) {
  const ElasticConstants constants = elasticConstants(kModulus, poisson_ratio);
  return constants.lambda_pa + 2.0 * constants.mu_pa;
}

constexpr double kSlabHeight = 2.0 * kH;

/// A slab so wide that its middle cannot move sideways: settled, the place of the middle of its top.
double settledTop(const SimulationSettings& settings, double poisson_ratio) {
  const Lattice lattice = standing(makeBlock(32, 32, 2, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 1.0, poisson_ratio);
  Simulation simulation(lattice, materials, settings, 1);
  run(simulation, 500);
  EXPECT_LT(simulation.maxSpeed(), 1e-8);
  return simulation.state().displacements_m[vertexAt(lattice, Vector3(16, 16, 2) * kH)].z();
}

TEST(Simulation, ASlabSagsUnderItsWeightAsKnown) {
  for (const double poisson_ratio : {0.25, 0.4}) {
    SCOPED_TRACE(poisson_ratio);
    SimulationSettings settings = wholeLattice();
    settings.gravity_m_s2 = Vector3(0, 0, -1.0);
    // rho g H^2 / (2 M). The lattice is exact where nothing varies sideways. Strains of 1e-3 are not quite linear, and
    // the edges are eight thicknesses away: at nu = 0.4 their influence falls to a third every two thicknesses.
    const double expected = -1000.0 * kSlabHeight * kSlabHeight / (2.0 * confinedModulus(poisson_ratio));
    EXPECT_NEAR(settledTop(settings, poisson_ratio) / expected, 1.0, 0.01);
  }
}

TEST(Simulation, APressureCompressesASlabAsKnown) {
  for (const double poisson_ratio : {0.25, 0.4}) {
    SCOPED_TRACE(poisson_ratio);
    SimulationSettings settings = wholeLattice();
    const double pressure = 2e-3 * confinedModulus(poisson_ratio);
    settings.pressures = {{Box3(Vector3(-1, -1, 0.9 * kSlabHeight), Vector3(1, 1, 1)), pressure}};
    EXPECT_NEAR(settledTop(settings, poisson_ratio) / (-2e-3 * kSlabHeight), 1.0, 0.01);
  }
}

TEST(Simulation, APressureIsAForcePerAreaAlongTheInwardNormal) {
  const Lattice lattice = makeBlock({3, 4, 5}, {0.005, 0.006, 0.007});
  const std::vector<Material> materials = oneMaterial(kModulus);
  const std::vector<std::pair<Box3, Vector3>> sides = {
      {Box3(Vector3(-1, -1, -1), Vector3(1e-6, 1, 1)), Vector3(0.024 * 0.035, 0, 0)},
      {Box3(Vector3(-1, -1, 0.0349), Vector3(1, 1, 1)), Vector3(0, 0, -0.015 * 0.024)},
      {Box3(Vector3(-1, -1, -1), Vector3(1, 1, 1)), Vector3::Zero()}};
  for (const auto& side : sides) {
    SimulationSettings settings = wholeLattice();
    settings.pressures = {{side.first, 10.0}};
    Simulation simulation(lattice, materials, settings, 1);
    simulation.step();
    const Vector3 force = simulation.mechanics().linear_momentum_kg_m_s / simulation.settings().dt_s;
    EXPECT_LT((force - 10.0 * side.second).norm(), 1e-15);
    EXPECT_GT(simulation.maxSpeed(), 0.0);
  }
}

/// All free vertices are in balance by the oracle, which knows nothing of the engine.
TEST(Simulation, SettlesWhereTheOracleIsInEquilibrium) {
  std::vector<Material> materials = oneMaterial(kModulus, 1.0, 0.45);
  materials.push_back(oneMaterial(4.0 * kModulus, 1.0, 0.3)[0]);
  Lattice lattice = makeBlock({4, 3, 5}, {0.005, 0.006, 0.007});
  for (std::size_t cell = 0; cell < lattice.cellCount(); cell += 3)
    lattice.materials[cell] = 1;
  lattice = standing(cutAcross(lattice, materials, 2.1 * 0.005, 0.02, 1.0, 0.8));
  SimulationSettings settings = wholeLattice();
  settings.gravity_m_s2 = Vector3(0, 3.0, -9.81);
  Simulation simulation(lattice, materials, settings, 1);
  simulation.holdForce("a", Vector3(0.02, 0.0, 0.03), Vector3(0.01, 0.009, 0.035), 0.008, kForEver);
  run(simulation, 6000);
  std::vector<Vector3> forces = oracleForces(lattice, materials, displacements(simulation));
  const std::vector<double> masses = oracleMasses(lattice, materials);
  const HeldForce& held = simulation.state().forces.at("a");
  for (std::size_t n = 0; n < held.vertices.size(); ++n)
    forces[held.vertices[n]] += held.weights[n] * held.force_n;
  double worst = 0.0;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    const Vector3 force = forces[v] + masses[v] * settings.gravity_m_s2;
    EXPECT_LT((force - simulation.forceOn(v)).norm(), 1e-13);
    worst = std::max(worst, lattice.fixed[v] ? 0.0 : force.norm());
  }
  EXPECT_LT(worst, 1e-9);
  EXPECT_GT(simulation.maxDisplacement(), 0.1 * kH);
  EXPECT_GT(simulation.minWidth(), 0.3 * kH);  // no altitude spring at work, which the oracle lacks
}

// --- grips

TEST(Simulation, JawsCarryWhatTheyHold) {
  for (const auto& precision : kChoices<Precision>) {
    SCOPED_TRACE(precision.name);
    const Lattice lattice = standing(makeBlock(4, 4, 5, kH));
    const std::vector<Material> materials = oneMaterial(kModulus, 1.0);
    Simulation simulation(lattice, materials, wholeLattice(precision.choice), 1);
    const Vector3 top = Vector3(2, 2, 5) * kH;
    EXPECT_FALSE(simulation.closeGrip("jaws", Vector3(1, 1, 1), kH, Pose(), kForEver));
    EXPECT_FALSE(simulation.moveGrip("jaws", Pose(), kForEver));
    // The jaws' frame is somewhere else than what they hold.
    const Pose start = {Vector3(0.1, -0.2, 0.3), Quaternion(Eigen::AngleAxisd(0.7, Vector3::UnitY()))};
    ASSERT_TRUE(simulation.closeGrip("jaws", top, 1.1 * kH, start, kForEver));
    const std::vector<std::uint32_t> held = simulation.state().grips.at("jaws").vertices;
    EXPECT_EQ(held.size(), 6U);  // the middle of the top, its four neighbours and the one below
    run(simulation, 5);
    const double rounding_m = precision.choice == Precision::kFloat ? 1e-7 : 1e-15;
    EXPECT_LT(simulation.maxDisplacement(), rounding_m);  // closing moves nothing
    // About the middle of the top.
    const Quaternion turned(Eigen::AngleAxisd(0.4, Vector3::UnitZ()));
    const Pose turn = {top + Vector3(0, 0, 0.8 * kH) - turned * top, turned};
    ASSERT_TRUE(simulation.moveGrip("jaws", turn * start, 100));
    simulation.step();
    const double first_lag_m = simulation.stats().grip_lag_m;
    EXPECT_GT(first_lag_m, 0.2 * kH);  // 0.8 h up is more than one safe move
    run(simulation, 20);
    EXPECT_LT(simulation.stats().grip_lag_m, rounding_m);
    for (const std::uint32_t v : held) {
      EXPECT_LT((simulation.positions()[v] - turn * lattice.rest_positions[v]).norm(), rounding_m);
      EXPECT_LT(simulation.velocities()[v].norm(), rounding_m / simulation.settings().dt_s);  // they stand still
    }
    // Their time runs out at step 100.
    run(simulation, 74);
    EXPECT_EQ(simulation.steps(), 100U);
    EXPECT_EQ(simulation.state().grips.size(), 1U);
    simulation.step();
    EXPECT_TRUE(simulation.state().grips.empty());
    EXPECT_EQ(simulation.stats().grip_lag_m, 0.0);
    run(simulation, 3000);
    EXPECT_LT(simulation.maxDisplacement(), 1e-4 * kH);
  }
}

TEST(Simulation, AReleasedGripLetsGo) {
  const Lattice lattice = standing(makeBlock(3, 3, 3, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 1.0);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  const auto top = verticesWhere(lattice, [](const Vector3& p) { return p.z() > 2.9 * kH; });
  simulation.gripVertices("plate", top, Pose(), kForEver);
  simulation.moveGrip("plate", {Vector3(0, 0, -0.2 * kH), Quaternion::Identity()}, kForEver);
  run(simulation, 300);
  for (const std::uint32_t v : top)
    EXPECT_NEAR(simulation.state().displacements_m[v].z(), -0.2 * kH, 1e-15);
  simulation.releaseGrip("nobody");
  simulation.releaseGrip("plate");
  EXPECT_TRUE(simulation.state().grips.empty());
  run(simulation, 1000);
  EXPECT_LT(simulation.maxDisplacement(), 1e-6 * kH);
}

TEST(Simulation, LedVerticesGoWhereEachIsLed) {
  const Lattice lattice = standing(makeBlock(3, 3, 3, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 1.0);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  // In no order, and with a fixed vertex, which stays.
  const std::vector<std::uint32_t> led = {vertexAt(lattice, Vector3(3, 0, 3) * kH), 0,
                                          vertexAt(lattice, Vector3(1, 2, 3) * kH)};
  std::vector<Vector3> targets = {Vector3(3.1, 0.1, 3.2) * kH, Vector3(1, 1, 1) * kH, Vector3(0.9, 2.2, 2.7) * kH};
  simulation.leadVertices("a", led, targets, kForEver);
  run(simulation, 50);
  EXPECT_LT((simulation.positions()[led[0]] - targets[0]).norm(), 1e-15);
  EXPECT_LT((simulation.positions()[led[2]] - targets[2]).norm(), 1e-15);
  EXPECT_TRUE(simulation.state().displacements_m[0].isZero(0.0));
  EXPECT_EQ(simulation.state().grips.at("a").vertices.size(), 2U);
  // Where two tools hold a vertex the first by name has it.
  simulation.leadVertices("b", {led[0]}, {Vector3(2.8, 0, 3) * kH}, kForEver);
  run(simulation, 50);
  EXPECT_LT((simulation.positions()[led[0]] - targets[0]).norm(), 1e-15);
}

// --- what is refused

TEST(Simulation, RefusesAStateThatDoesNotFit) {
  const Lattice lattice = makeBlock(2, 2, 2, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  simulation.holdForce("x", Vector3(0, 0, 0.1), Vector3(1, 1, 2) * kH, 1.1 * kH, kForEver);
  simulation.closeGrip("y", Vector3(1, 1, 0) * kH, 1.1 * kH, Pose(), kForEver);
  simulation.setLoads({{3, Vector3(0.01, 0, 0)}});
  run(simulation, 3);
  const std::uint64_t before = simulation.stateHash();
  using Damage = void (*)(SimulationState&);
  const std::vector<std::pair<const char*, Damage>> damages = {
      {"fewer displacements", [](SimulationState& s) { s.displacements_m.pop_back(); }},
      {"no velocities", [](SimulationState& s) { s.velocities_m_s.clear(); }},
      {"more lifetimes", [](SimulationState& s) { s.lifetimes.push_back(1); }},
      {"a displacement that is NaN", [](SimulationState& s) { s.displacements_m[3].y() = NAN; }},
      {"a huge displacement", [](SimulationState& s) { s.displacements_m[3].y() = 1e38; }},
      {"an infinite velocity", [](SimulationState& s) { s.velocities_m_s[3].y() = INFINITY; }},
      {"a huge velocity", [](SimulationState& s) { s.velocities_m_s[3].y() = -1e38; }},
      {"a deformation that is NaN", [](SimulationState& s) { s.deformation_m = NAN; }},
      {"a negative deformation", [](SimulationState& s) { s.deformation_m = -1.0; }},
      {"a force on a vertex that is not", [](SimulationState& s) { s.forces["x"].vertices[0] = 999; }},
      {"a force without its weight", [](SimulationState& s) { s.forces["x"].weights.pop_back(); }},
      {"a negative weight", [](SimulationState& s) { s.forces["x"].weights[0] = -0.1; }},
      {"a weight that is NaN", [](SimulationState& s) { s.forces["x"].weights[0] = NAN; }},
      {"a force that is NaN", [](SimulationState& s) { s.forces["x"].force_n.z() = NAN; }},
      {"a huge force", [](SimulationState& s) { s.forces["x"].force_n.z() = 1e38; }},
      {"a force at no place", [](SimulationState& s) { s.forces["x"].point_m.z() = NAN; }},
      {"a grip on a vertex that is not", [](SimulationState& s) { s.grips["y"].vertices[0] = 999; }},
      {"a grip without its anchor", [](SimulationState& s) { s.grips["y"].anchors_m.pop_back(); }},
      {"an anchor that is NaN", [](SimulationState& s) { s.grips["y"].anchors_m[0].x() = NAN; }},
      {"a pose that is NaN", [](SimulationState& s) { s.grips["y"].pose.position_m.x() = NAN; }},
      {"a huge pose", [](SimulationState& s) { s.grips["y"].pose.position_m.x() = 1e38; }},
      {"a pose that is no rotation", [](SimulationState& s) { s.grips["y"].pose.orientation.w() = 2.0; }},
      {"a load on a vertex that is not", [](SimulationState& s) { s.loads[0].vertex = 999; }},
      {"an infinite load", [](SimulationState& s) { s.loads[0].force_n.x() = INFINITY; }},
  };
  for (const auto& damage : damages) {
    SCOPED_TRACE(damage.first);
    SimulationState state = simulation.state();
    damage.second(state);
    EXPECT_THROW(simulation.restore(state), InputError);
    EXPECT_EQ(simulation.stateHash(), before);
    EXPECT_EQ(simulation.steps(), 3U);
    EXPECT_EQ(simulation.state().forces.size() + simulation.state().grips.size() + simulation.state().loads.size(), 3U);
  }
  simulation.restore(SimulationState(simulation.state()));
  EXPECT_EQ(simulation.stateHash(), before);
}

TEST(Simulation, RefusesMaterialsOutOfRange) {
  const Lattice lattice = makeBlock(2, 2, 2, kH);
  const std::vector<std::pair<std::string, double Material::*>> fields = {
      {"density_kg_m3", &Material::density_kg_m3},
      {"youngs_modulus_pa", &Material::youngs_modulus_pa},
      {"poisson_ratio", &Material::poisson_ratio},
      {"damping_ratio", &Material::damping_ratio}};
  for (const auto& field : fields) {
    for (const double bad : {double(NAN), double(INFINITY), -double(INFINITY), 1e38, -0.1}) {
      SCOPED_TRACE(field.first + " " + std::to_string(bad));
      std::vector<Material> materials = oneMaterial(kModulus);
      materials[0].*field.second = bad;
      try {
        const Simulation simulation(lattice, materials, wholeLattice(), 1);
        ADD_FAILURE() << "was accepted";
      } catch (const SceneError& error) {
        EXPECT_NE(std::string(error.what()).find(field.first), std::string::npos) << error.what();
        EXPECT_NE(std::string(error.what()).find("tissue"), std::string::npos) << error.what();
      }
    }
  }
  for (const double bad : {0.0, 0.2, 0.495, 0.5}) {
    std::vector<Material> materials = oneMaterial(kModulus, 0.0, bad);
    EXPECT_THROW(Simulation(lattice, materials, wholeLattice(), 1), SceneError);
  }
  for (double Material::*field : {&Material::density_kg_m3, &Material::youngs_modulus_pa}) {
    std::vector<Material> materials = oneMaterial(kModulus);
    materials[0].*field = 0.0;
    EXPECT_THROW(Simulation(lattice, materials, wholeLattice(), 1), SceneError);
  }
}

TEST(Simulation, RefusesSettingsOutOfRange) {
  const Lattice lattice = makeBlock(2, 2, 2, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  const auto refuses = [&](const char* name, const SimulationSettings& settings) {
    try {
      const Simulation simulation(lattice, materials, settings, 1);
      ADD_FAILURE() << name << " was accepted";
    } catch (const SceneError& error) {
      EXPECT_NE(std::string(error.what()).find(name), std::string::npos) << error.what();
    }
  };
  const std::vector<std::pair<const char*, double SimulationSettings::*>> fields = {
      {"dt_s", &SimulationSettings::dt_s},
      {"dt_fraction", &SimulationSettings::dt_fraction},
      {"activation_radius_m", &SimulationSettings::activation_radius_m},
      {"activation_threshold", &SimulationSettings::activation_threshold},
      {"lifetime_s", &SimulationSettings::lifetime_s},
      {"error_tolerance", &SimulationSettings::error_tolerance}};
  for (const auto& field : fields) {
    for (const double bad : {double(NAN), double(INFINITY), -1.0}) {
      SCOPED_TRACE(bad);
      SimulationSettings settings;
      settings.*field.second = bad;
      refuses(field.first, settings);
    }
  }
  for (const double bad : {double(NAN), double(INFINITY), 1e38}) {
    SimulationSettings settings;
    settings.gravity_m_s2.y() = bad;
    refuses("gravity", settings);
    settings = SimulationSettings();
    settings.pressures = {{Box3(Vector3::Zero(), Vector3::Ones()), bad}};
    refuses("pressure", settings);
  }
  SimulationSettings settings;
  settings.dt_fraction = 1.1;
  refuses("dt_fraction", settings);
  settings = SimulationSettings();
  settings.lifetime_s = 0.0;
  refuses("lifetime_s", settings);
}

// --- time steps

TEST(Simulation, AnAutomaticStepIsTheFractionOfTheIntegratorsLimit) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kModulus);
  const std::vector<std::pair<Integrator, double>> limits = {{Integrator::kSymplecticEuler, 1.0},
                                                             {Integrator::kDissertation, std::sqrt(0.5)},
                                                             {Integrator::kRungeKutta4, std::sqrt(2.0)}};
  for (const auto& limit : limits) {
    for (const double fraction : {0.3, 0.6, 1.0}) {
      SimulationSettings settings = wholeLattice(Precision::kDouble, limit.first);
      settings.dt_fraction = fraction;
      const Simulation simulation(lattice, materials, settings, 1);
      const double expected = fraction * limit.second * simulation.stabilityLimit();
      EXPECT_LE(simulation.settings().dt_s, expected);
      EXPECT_GE(simulation.settings().dt_s, 0.9 * expected);  // two digits, rounded down
      EXPECT_EQ(simulation.substeps(), 1);
    }
  }
  // Nothing that can move: any step will do.
  Lattice rigid = lattice;
  std::fill(rigid.fixed.begin(), rigid.fixed.end(), std::uint8_t(1));
  Simulation simulation(rigid, materials, wholeLattice(), 1);
  EXPECT_GT(simulation.settings().dt_s, 0.0);
  EXPECT_TRUE(std::isinf(simulation.stabilityLimit()));
  run(simulation, 3);
  EXPECT_EQ(simulation.maxDisplacement(), 0.0);
}

/// The number of seconds that a refusal names as the limit.
double limitInMessage(const Lattice& lattice, const std::vector<Material>& materials,
                      const SimulationSettings& settings) {
  try {
    const Simulation simulation(lattice, materials, settings, 1);
  } catch (const SceneError& error) {
    const std::string text = error.what();
    std::smatch match;
    if (std::regex_search(text, match, std::regex("limit of ([0-9.e+-]+)")))
      return std::stod(match[1]);
    ADD_FAILURE() << text;
  }
  return 0.0;
}

TEST(Simulation, RefusesAStepBeyondTheLimitAndNamesTheLimit) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  for (const double modulus : {kModulus, 1e4 * kModulus}) {
    SCOPED_TRACE(modulus);
    const std::vector<Material> materials = oneMaterial(modulus);
    const double limit = Simulation(lattice, materials, wholeLattice(), 1).stabilityLimit();
    SimulationSettings settings = wholeLattice();
    settings.dt_s = 1.01 * limit;
    EXPECT_NEAR(limitInMessage(lattice, materials, settings) / limit, 1.0, 0.01);
    settings.dt_s = 0.99 * limit;
    EXPECT_EQ(Simulation(lattice, materials, settings, 1).settings().dt_s, 0.99 * limit);
    // Integrators without a limit take any step.
    for (const Integrator integrator : {Integrator::kBackwardEuler, Integrator::kAdaptive, Integrator::kQuasiStatic}) {
      settings.integrator = integrator;
      settings.dt_s = 30.0 * limit;
      EXPECT_EQ(Simulation(lattice, materials, settings, 1).substeps(), 1);
    }
    // What is refused at run time leaves everything as it was.
    Simulation simulation(lattice, materials, wholeLattice(), 1);
    const double before = simulation.settings().dt_s;
    EXPECT_THROW(simulation.setIntegrator(Integrator::kDissertation, 0.8 * limit), SceneError);
    EXPECT_THROW(simulation.setIntegrator(Integrator::kRungeKutta4, NAN), SceneError);
    EXPECT_EQ(simulation.settings().dt_s, before);
    EXPECT_EQ(simulation.settings().integrator, Integrator::kSymplecticEuler);
  }
}

TEST(Simulation, SubstepsAreStepsOfAPart) {
  const Lattice lattice = makeBlock(4, 4, 4, kH);
  const std::vector<Material> materials = oneMaterial(kModulus, 0.3);
  const double limit = Simulation(lattice, materials, wholeLattice(), 1).stabilityLimit();
  SimulationSettings settings = wholeLattice();
  settings.substeps = true;
  settings.dt_s = 2.5 * limit;
  Simulation divided(lattice, materials, settings, 1);
  EXPECT_EQ(divided.substeps(), 5);  // 2.5 / 0.6, rounded up
  settings.dt_s /= 5.0;
  Simulation whole(lattice, materials, settings, 1);
  EXPECT_EQ(whole.substeps(), 1);
  for (Simulation* simulation : {&divided, &whole})
    simulation->holdForce("a", Vector3(0.1, 0, -0.2), Vector3(2, 2, 4) * kH, 1.6 * kH, kForEver);
  run(divided, 10);
  run(whole, 50);
  EXPECT_EQ(divided.steps(), 10U);
  EXPECT_EQ(divided.stateHash(), whole.stateHash());
}

TEST(Simulation, TheStabilityLimitIsThatOfTheBulkLessWhatFreeSurfacesTake) {
  for (const double poisson_ratio : {0.25, 0.35, 0.45}) {
    SCOPED_TRACE(poisson_ratio);
    const std::vector<Material> materials = oneMaterial(kModulus, 0.0, poisson_ratio);
    Lattice lattice = makeBlock(10, 10, 10, kH);
    const double bulk = bulkTimeStepLimit(materials[0], lattice.spacing_m);
    const double of_free_block = Simulation(lattice, materials, wholeLattice(), 1).stabilityLimit();
    for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
      const Vector3 n = lattice.rest_positions[v] / kH;
      lattice.fixed[v] = n.minCoeff() < 0.5 || n.maxCoeff() > 9.5;
    }
    const double of_held_block = Simulation(lattice, materials, wholeLattice(), 1).stabilityLimit();
    // Waves do not quite reach the shortest length between walls: 1 / cos(pi / 20) in each direction at most.
    EXPECT_GT(of_held_block / bulk, 1.0);
    EXPECT_LT(of_held_block / bulk, 1.05);
    // Measured: 0.98 at nu = 0.25, 0.89 at 0.45 (there 10 % as in a clear prototype).
    EXPECT_LT(of_free_block / bulk, 1.0);
    EXPECT_GT(of_free_block / bulk, 0.87);
  }
}

/// The dissertation's rule as written takes any step, so that it shows where instability begins: at omega dt = sqrt(2),
/// where symplectic Euler's is at 2. Two per cent beyond it the fastest mode grows by 1.15 a step.
TEST(Simulation, TheStabilityLimitIsWhereMotionBeginsToGrow) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    SCOPED_TRACE(poisson_ratio);
    const Lattice lattice = standing(makeBlock(5, 4, 4, kH));
    const std::vector<Material> materials = oneMaterial(kModulus, 0.0, poisson_ratio);
    const double limit = std::sqrt(0.5) * Simulation(lattice, materials, wholeLattice(), 1).stabilityLimit();
    const auto growth = [&](double fraction) {
      SimulationSettings settings = wholeLattice(Precision::kDouble, Integrator::kDissertation);
      settings.safe_move = SafeMove::kDissertation;
      settings.dt_s = fraction * limit;
      Simulation simulation(lattice, materials, settings, 1);
      const std::vector<Vector3> speeds = Random(2).boxed(lattice.vertexCount(), 1e-9);
      place(simulation, noVectors(lattice), speeds);
      run(simulation, 150);
      return simulation.maxSpeed() / largest(speeds);
    };
    EXPECT_LT(growth(0.98), 2.0);
    EXPECT_GT(growth(1.02), 1e3);
  }
}

TEST(Simulation, MotionBelowTheStabilityLimitStaysBounded) {
  for (const Integrator integrator : {Integrator::kSymplecticEuler, Integrator::kRungeKutta4}) {
    for (const double poisson_ratio : {0.25, 0.45}) {
      SCOPED_TRACE(std::string(nameOf(integrator)) + " nu " + std::to_string(poisson_ratio));
      const Lattice lattice = makeBlock(4, 4, 4, kH);
      const std::vector<Material> materials = oneMaterial(kModulus, 0.0, poisson_ratio);
      SimulationSettings settings = wholeLattice(Precision::kDouble, integrator);
      settings.safe_move = SafeMove::kNone;
      settings.dt_fraction = 0.98;
      Simulation simulation(lattice, materials, settings, 1);
      const std::vector<Vector3> speeds = Random(3).boxed(lattice.vertexCount(), 1e-7);
      place(simulation, noVectors(lattice), speeds);
      run(simulation, 1500);
      // Near the limit symplectic Euler's speeds swing by up to 1 / sqrt(1 - 0.98^2) = 5.
      EXPECT_LT(simulation.maxSpeed(), 10.0 * largest(speeds));
    }
  }
}

// --- damping

struct Pulled {
  Lattice lattice = standing(makeBlock(3, 3, 6, kH));
  std::uint32_t tip = vertexAt(lattice, Vector3(1, 1, 6) * kH);

  /// Sideways places of the tip, step after step, after a sideways body force has gone: nearly the slowest mode.
  std::vector<double> release(double damping_ratio, int steps, double& dt_s) const {
    const std::vector<Material> overdamped = oneMaterial(kModulus, 1.0);
    SimulationSettings settings = wholeLattice();
    settings.gravity_m_s2 = Vector3(0.1, 0, 0);
    Simulation pulled(lattice, overdamped, settings, 1);
    run(pulled, 3000);
    const std::vector<Material> materials = oneMaterial(kModulus, damping_ratio);
    settings.gravity_m_s2.setZero();
    Simulation simulation(lattice, materials, settings, 1);
    place(simulation, displacements(pulled), noVectors(lattice));
    std::vector<double> places = {simulation.state().displacements_m[tip].x()};
    for (int n = 0; n < steps; ++n) {
      simulation.step();
      places.push_back(simulation.state().displacements_m[tip].x());
    }
    dt_s = simulation.settings().dt_s;
    return places;
  }
};

TEST(Simulation, CriticallyDampedTissueDoesNotOvershoot) {
  double dt_s = 0.0;
  const std::vector<double> places = Pulled().release(1.0, 1500, dt_s);
  EXPECT_GT(places[0], 1e-3 * kH);
  // The shape under a body force holds a few per cent of faster modes, which do swing.
  EXPECT_GT(*std::min_element(places.begin(), places.end()), -0.005 * places[0]);
  EXPECT_LT(std::abs(places.back()), 1e-3 * places[0]);
}

TEST(Simulation, DampingRatiosReferToTheSlowestMode) {
  for (const double ratio : {0.05, 0.1, 0.2}) {
    SCOPED_TRACE(ratio);
    double dt_s = 0.0;
    const std::vector<double> places = Pulled().release(ratio, 2500, dt_s);
    // Largest distances between passages through rest, half a period apart each.
    std::vector<std::pair<double, double>> turns;
    double largest = 0.0;
    double at_s = 0.0;
    for (std::size_t n = 1; n < places.size(); ++n) {
      if ((places[n] > 0.0) != (places[n - 1] > 0.0)) {
        if (largest < 0.03 * places[0])
          break;
        turns.emplace_back(at_s, largest);
        largest = 0.0;
      }
      if (std::abs(places[n]) > largest) {
        largest = std::abs(places[n]);
        at_s = dt_s * double(n);
      }
    }
    ASSERT_GE(turns.size(), 4U);
    // Amplitudes fall as exp(-zeta omega t), turns lie pi / (omega sqrt(1 - zeta^2)) apart.
    const double decrement = std::log(turns[1].second / turns.back().second) / double(turns.size() - 2);
    const double measured = decrement / std::sqrt(M_PI * M_PI + decrement * decrement);
    // The frequency is Rayleigh's estimate, 1 to 2 per cent too high; faster modes disturb the turns by as much.
    EXPECT_NEAR(measured / ratio, 1.0, 0.05);
  }
}

// --- incisions

TEST(Simulation, AfterACutTheLoosePartFallsFreely) {
  Lattice lattice = makeBlock(6, 3, 3, kH);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.fixed[v] = lattice.rest_positions[v].x() < 1e-9;
  const std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.4);
  SimulationSettings settings;
  settings.precision = Precision::kDouble;
  settings.gravity_m_s2 = Vector3(0, 0, -9.81);
  Simulation simulation(lattice, materials, settings, 1);
  run(simulation, 20);
  const std::size_t before = lattice.vertexCount();
  const SimulationState intact = simulation.state();
  const SweptQuad blade = {Vector3(2.9 * kH, -1, -1), Vector3(2.9 * kH, -1, 1), Vector3(2.9 * kH, 1, 1),
                           Vector3(2.9 * kH, 1, -1)};
  CutTissue tissue(lattice, {IncisionMethod::kFaces, 1.0});
  tissue.cut(lattice, materials, simulation.positions(), simulation.reach(), "scalpel", {blade}, true);
  ASSERT_EQ(lattice.vertexCount(), before + 16);
  simulation.adoptTopology();
  ASSERT_EQ(simulation.state().displacements_m.size(), lattice.vertexCount());
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    const std::uint32_t origin = lattice.origin_vertices[v];
    EXPECT_EQ(simulation.state().displacements_m[v], intact.displacements_m[origin]);
    EXPECT_EQ(simulation.velocities()[v], intact.velocities_m_s[origin]);
    EXPECT_EQ(simulation.positions()[v], lattice.rest_positions[v] + simulation.state().displacements_m[v]);
  }
  const auto fallingMomentum = [&] {
    Vector3 sum = Vector3::Zero();
    std::vector<std::uint8_t> seen(lattice.vertexCount(), 0);
    for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
      for (const std::uint32_t v : lattice.cells[cell]) {
        if (lattice.cellIndex(lattice.parent_cells[cell]).x() >= 3 && !seen[v]) {
          sum += simulation.mass(v) * simulation.velocities()[v];
          seen[v] = 1;
        }
      }
    }
    return sum;
  };
  const Vector3 start = fallingMomentum();
  run(simulation, 30);
  const Vector3 weight = 27.0 * std::pow(kH, 3) * 1000.0 * settings.gravity_m_s2;
  const Vector3 expected = 30.0 * simulation.settings().dt_s * weight;
  EXPECT_LT((fallingMomentum() - start - expected).norm(), 1e-10 * expected.norm());
}

TEST(Simulation, ACutOpensAndAddsWhatIsNew) {
  Lattice lattice = standing(makeBlock(6, 4, 4, kH));
  const std::vector<Material> materials = oneMaterial(kModulus, 1.0, 0.4);
  Simulation simulation(lattice, materials, SimulationSettings(), 1);
  const std::uint64_t before = simulation.stateHash();
  simulation.adoptTopology();  // nothing was cut
  EXPECT_EQ(simulation.stateHash(), before);
  CutTissue tissue(lattice, {IncisionMethod::kFaces, 0.75});
  const SweptQuad blade = {Vector3(3.1 * kH, -1, 2.1 * kH), Vector3(3.1 * kH, -1, 1), Vector3(3.1 * kH, 1, 1),
                           Vector3(3.1 * kH, 1, 2.1 * kH)};
  const IncisionResult cut =
      tissue.cut(lattice, materials, simulation.positions(), simulation.reach(), "scalpel", {blade}, true);
  simulation.adoptTopology();
  simulation.wake(cut.rest_box_m);
  run(simulation, 300);
  EXPECT_GT(tissue.opening(lattice, simulation.positions()), 0.1 * kH);
  EXPECT_GT(simulation.minWidth(), 0.0);
}

// --- memory

std::size_t bytesOf(const Simulation& simulation, const std::string& what) {
  for (const MemoryUse& use : simulation.memory()) {
    if (use.what.find(what) != std::string::npos)
      return use.bytes;
  }
  ADD_FAILURE() << "no row names " << what;
  return 0;
}

TEST(Simulation, FeaturesThatAreNotUsedAllocateNothing) {
  const Lattice lattice = standing(makeBlock(8, 8, 8, kH));
  std::vector<Material> materials = oneMaterial(kModulus);
  // No cell consists of it.
  materials.push_back(oneMaterial(kModulus, 0.0, 0.45)[0]);
  Simulation simulation(lattice, materials, wholeLattice(Precision::kFloat), 1);
  simulation.holdForce("a", Vector3(0, 0, 0.01), Vector3(4, 4, 8) * kH, 1.6 * kH, kForEver);
  run(simulation, 10);
  const std::vector<std::string> unused = {"volume energy", "incisions", "altitude springs", "mass floor",
                                           "other integrators"};
  std::size_t total = 0;
  for (const std::string& what : unused)
    EXPECT_EQ(bytesOf(simulation, what), 0U) << what;
  for (const MemoryUse& use : simulation.memory())
    total += use.bytes;
  EXPECT_LT(double(total) / double(lattice.vertexCount()), 600.0);
  EXPECT_GT(bytesOf(simulation, "springs"), 0U);
}

TEST(Simulation, MemoryOfFeaturesIsReportedWhereTheyAreUsed) {
  std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.45);
  const Lattice lattice = standing(cutAcross(makeBlock(4, 4, 4, kH), materials, 2.1 * kH, 1.9 * kH, 1.0, 0.75));
  Simulation simulation(lattice, materials, wholeLattice(Precision::kFloat, Integrator::kRungeKutta4), 1);
  run(simulation, 3);
  for (const char* what : {"volume energy", "incisions", "other integrators"})
    EXPECT_GT(bytesOf(simulation, what), 0U) << what;
  simulation.setIntegrator(Integrator::kSymplecticEuler, 0.0);
  run(simulation, 3);
  EXPECT_EQ(bytesOf(simulation, "other integrators"), 0U);  // given back
  simulation.setIntegrator(Integrator::kQuasiStatic, 0.0);
  run(simulation, 3);
  EXPECT_GT(bytesOf(simulation, "mass floor"), 0U);
}

// --- what a caller asks

TEST(Simulation, FindsVerticesAndCellsWhereTheyAreNow) {
  const Lattice lattice = standing(makeBlock(4, 4, 4, kH));
  const std::vector<Material> materials = oneMaterial(kModulus);
  Simulation simulation(lattice, materials, wholeLattice(), 1);
  std::vector<Vector3> u = Random(5).boxed(lattice.vertexCount(), 0.3 * kH);
  const std::uint32_t far = vertexAt(lattice, Vector3(4, 4, 4) * kH);
  u[far] = Vector3::Constant(2.5 * kH);
  place(simulation, u, noVectors(lattice));
  EXPECT_NEAR(simulation.maxDisplacement(), u[far].norm(), 1e-15);
  EXPECT_GE(simulation.reach(), simulation.maxDisplacement());
  Random random(6);
  for (int n = 0; n < 200; ++n) {
    SCOPED_TRACE(n);
    const Vector3 point = Vector3(random.number(-1, 7), random.number(-1, 7), random.number(-1, 7)) * kH;
    const double radius = random.number(0.1, 2.0) * kH;
    std::vector<std::uint32_t> vertices, cells;
    const auto near = [&](std::uint32_t v) { return (simulation.positions()[v] - point).norm() < radius; };
    for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
      if (near(v))
        vertices.push_back(v);
    }
    for (std::uint32_t cell = 0; cell < lattice.cellCount(); ++cell) {
      if (std::any_of(lattice.cells[cell].begin(), lattice.cells[cell].end(), near))
        cells.push_back(cell);
    }
    EXPECT_EQ(simulation.verticesNear(point, radius), vertices);
    EXPECT_EQ(simulation.cellsNear(point, radius), cells);
  }
  EXPECT_EQ(simulation.verticesNear(Vector3::Constant(6.5 * kH), 0.1 * kH), std::vector<std::uint32_t>{far});
}

/// The energy is that whose gradient the forces are, so undamped motion keeps the sum.
TEST(Simulation, MechanicsAddUp) {
  const Lattice lattice = makeBlock(3, 3, 3, kH);
  const std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.4);
  SimulationSettings settings = wholeLattice();
  settings.dt_fraction = 0.01;
  Simulation simulation(lattice, materials, settings, 1);
  place(simulation, Random(7).boxed(lattice.vertexCount(), 0.05 * kH), noVectors(lattice));
  const double start = simulation.mechanics().elastic_j;
  EXPECT_EQ(simulation.mechanics().kinetic_j, 0.0);
  EXPECT_NEAR(start, oracleEnergy(lattice, materials, displacements(simulation)), 1e-12 * start);
  run(simulation, 200);
  const Mechanics now = simulation.mechanics();
  EXPECT_GT(now.kinetic_j, 0.1 * start);
  // First order in omega dt = 0.02 / 2.
  EXPECT_NEAR(now.kinetic_j + now.elastic_j, start, 0.01 * start);
}

}  // namespace
}  // namespace soft_volume::core
