#include "soft_volume/simulation/oracle.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "lattice_blocks.h"

namespace soft_volume::core {
namespace {

constexpr double kModulus = 10000.0;

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  Vector3 direction() {
    const Vector3 v(normal_(engine_), normal_(engine_), normal_(engine_));
    return v.normalized();
  }
  std::vector<Vector3> displacements(std::size_t count, double size_m) {
    std::vector<Vector3> all(count);
    for (Vector3& v : all)
      v = size_m * direction();
    return all;
  }

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
};

/// Two materials, box-shaped cells and a cell that an incision shortened.
struct Mixed {
  Lattice lattice = makeBlock({3, 2, 2}, {0.005, 0.006, 0.007});
  std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.25);

  Mixed() {
    materials.push_back(oneMaterial(3.0 * kModulus, 0.0, 0.45)[0]);
    for (std::size_t cell = 0; cell < lattice.cellCount(); cell += 2)
      lattice.materials[cell] = 1;
    lattice.rest_stretch[2] = {0.8, 1.0, 0.9};
    lattice.rest_stretch[3] = {1.0, 0.95, 1.0};
  }
};

std::vector<Vector3> nothing(const Lattice& lattice) {
  return std::vector<Vector3>(lattice.vertexCount(), Vector3::Zero());
}

double largest(const std::vector<Vector3>& values) {
  double largest = 0.0;
  for (const Vector3& v : values)
    largest = std::max(largest, v.norm());
  return largest;
}

class OracleByRule : public testing::TestWithParam<SpringRule> {};

TEST_P(OracleByRule, ForceIsTheNegativeGradientOfTheEnergy) {
  const Mixed mixed;
  const OracleModel model(mixed.lattice, mixed.materials, GetParam());
  std::vector<Vector3> u = Random(1).displacements(mixed.lattice.vertexCount(), 0.001);
  const std::vector<Vector3> forces = oracleForces(mixed.lattice, mixed.materials, u, GetParam());
  constexpr double kStep = 1e-8;
  for (std::size_t v = 0; v < u.size(); ++v) {
    for (int d = 0; d < 3; ++d) {
      const double at = u[v][d];
      u[v][d] = at + kStep;
      const double above = model.energy(u);
      u[v][d] = at - kStep;
      const double below = model.energy(u);
      u[v][d] = at;
      EXPECT_NEAR(forces[v][d], (below - above) / (2.0 * kStep), 1e-5 * largest(forces));
    }
  }
}

TEST_P(OracleByRule, RigidMotionExertsNoForce) {
  const Lattice lattice = makeBlock({3, 2, 2}, {0.005, 0.006, 0.007});
  const std::vector<Material> materials = oneMaterial(kModulus, 0.0, 0.45);
  Random random(2);
  for (int n = 0; n < 20; ++n) {
    const Matrix3 rotation = Eigen::AngleAxisd(0.3 * n, random.direction()).toRotationMatrix();
    const Vector3 shift = 0.1 * random.direction();
    std::vector<Vector3> u;
    for (const Vector3& p : lattice.rest_positions)
      u.push_back(rotation * p + shift - p);
    EXPECT_LT(largest(oracleForces(lattice, materials, u, GetParam())), 1e-12 * kModulus * 0.005);
    EXPECT_LT(oracleEnergy(lattice, materials, u, GetParam()), 1e-20);
  }
}

TEST_P(OracleByRule, InnerForcesHaveNoSumAndNoTorque) {
  const Mixed mixed;
  const std::vector<Vector3> u = Random(3).displacements(mixed.lattice.vertexCount(), 0.003);
  const std::vector<Vector3> forces = oracleForces(mixed.lattice, mixed.materials, u, GetParam());
  Vector3 sum = Vector3::Zero();
  Vector3 torque = Vector3::Zero();
  for (std::size_t v = 0; v < u.size(); ++v) {
    sum += forces[v];
    torque += (mixed.lattice.rest_positions[v] + u[v]).cross(forces[v]);
  }
  EXPECT_LT(sum.norm(), 1e-12 * largest(forces));
  EXPECT_LT(torque.norm(), 1e-13 * largest(forces));
}

INSTANTIATE_TEST_SUITE_P(Rules, OracleByRule, testing::Values(SpringRule::kIsotropic, SpringRule::kDissertation));

TEST(Oracle, ShortenedCellsAreAtRestWhenTheyAreShort) {
  Lattice lattice = makeBlock({1, 1, 1}, {0.005, 0.006, 0.007});
  lattice.rest_stretch[0] = {0.8, 0.9, 1.1};
  std::vector<Vector3> u;
  for (const Vector3& p : lattice.rest_positions)
    u.push_back(p.cwiseProduct(lattice.rest_stretch[0]) - p);
  EXPECT_LT(largest(oracleForces(lattice, oneMaterial(kModulus, 0.0, 0.45), u)), 1e-12 * kModulus * 0.005);
}

TEST(Oracle, TheVolumeEnergyIsThatOfItsFormula) {
  const Lattice lattice = makeBlock({2, 2, 2}, {0.005, 0.006, 0.007});
  std::vector<Vector3> u;
  for (const Vector3& p : lattice.rest_positions)
    u.push_back(0.1 * p);
  // The springs of nu = 0.45 are those of nu = 0.25 with the same shear modulus.
  const ElasticConstants constants = elasticConstants(kModulus, 0.45);
  const double springs_j = oracleEnergy(lattice, oneMaterial(2.5 * constants.mu_pa), u);
  const double growth = 1.1 * 1.1 * 1.1 - 1.0;
  const double volume_j = 0.5 * constants.volume_pa * 8 * (0.005 * 0.006 * 0.007) * growth * growth;
  EXPECT_NEAR(oracleEnergy(lattice, oneMaterial(kModulus, 0.0, 0.45), u), springs_j + volume_j, 1e-12 * volume_j);
}

TEST(Oracle, TheDissertationsSpringsHaveOneStrengthHoweverManyShareThem) {
  const double h = 0.005;
  const Lattice lattice = makeBlock(4, 4, 4, h);
  const std::vector<Material> materials = oneMaterial(kModulus);
  const double k = dissertationStrength(lattice, materials);
  // One vertex moves along x by a tiny way: all its springs answer with k times the square of their direction's cosine.
  for (const Vector3i& node : {Vector3i(2, 2, 2), Vector3i(0, 2, 2), Vector3i(0, 0, 0)}) {
    const auto v = static_cast<std::size_t>(std::find(lattice.lattice_nodes.begin(), lattice.lattice_nodes.end(),
                                                      lattice.latticeNode(node.x(), node.y(), node.z())) -
                                            lattice.lattice_nodes.begin());
    double expected = 0.0;
    for (int n = 0; n < 27; ++n) {
      const Vector3i offset(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
      const Vector3i other = node + offset;
      if (offset != Vector3i::Zero() && other.minCoeff() >= 0 && other.maxCoeff() <= 4)
        expected += k * offset.x() * offset.x() / double(offset.squaredNorm());
    }
    std::vector<Vector3> u = nothing(lattice);
    u[v].x() = 1e-9;
    const double force = -oracleForces(lattice, materials, u, SpringRule::kDissertation)[v].x();
    EXPECT_NEAR(force / 1e-9, expected, 1e-5 * expected);
  }
}

TEST(Oracle, MassesAreThoseOfTheCells) {
  Lattice lattice = makeBlock({2, 1, 1}, {0.005, 0.006, 0.007});
  std::vector<Material> materials = oneMaterial(kModulus);
  materials.push_back(materials[0]);
  materials[1].density_kg_m3 = 2000.0;
  lattice.materials[1] = 1;
  lattice.fixed[0] = 1;
  const double eighth = 0.005 * 0.006 * 0.007 / 8.0;
  const std::vector<double> masses = oracleMasses(lattice, materials);
  EXPECT_NEAR(masses[0], 1000.0 * eighth, 1e-15);
  EXPECT_NEAR(masses[1], 3000.0 * eighth, 1e-15);
  EXPECT_NEAR(masses[2], 2000.0 * eighth, 1e-15);
  const std::vector<double> uniform = oracleMasses(lattice, materials, SpringRule::kDissertation);
  EXPECT_NEAR(uniform[0], 1000.0 * masses[0], 1e-12);
  EXPECT_EQ(uniform[1], masses[1]);
}

// --- the simulation

/// A block on a fixed floor, with a step of 0.6 of the bulk limit and enough damping to come to rest.
struct OnFloor {
  explicit OnFloor(const Vector3i& dims, const Vector3& spacing_m = Vector3::Constant(0.005), double nu = 0.25)
      : lattice(makeBlock(dims, spacing_m)), materials(oneMaterial(kModulus, 0.0, nu)) {
    for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
      lattice.fixed[v] = lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
    settings.dt_s = 0.6 * bulkTimeStepLimit(materials[0], spacing_m);
    settings.damping_per_s = 60.0;
  }

  Lattice lattice;
  std::vector<Material> materials;
  OracleSettings settings;
};

/// A force on every vertex of the top within `radius_m` of its centre along x and y, 0 elsewhere.
std::vector<Vector3> onTop(const Lattice& lattice, const Vector3& force_n, double radius_m) {
  std::vector<Vector3> forces = nothing(lattice);
  const Vector3 end = lattice.rest_positions.back();
  const Vector3 centre(0.5 * end.x(), 0.5 * end.y(), end.z());
  for (std::size_t v = 0; v < forces.size(); ++v) {
    const Vector3 away = (lattice.rest_positions[v] - centre).cwiseAbs();
    if (away.z() < 1e-9 && away.maxCoeff() < radius_m)
      forces[v] = force_n;
  }
  return forces;
}

/// Steps and checks after every one that nothing got thinner than the guard allows.
void runGuarded(OracleSimulation& simulation, const Lattice& lattice, int steps) {
  const double least = 0.02 * lattice.spacing_m.minCoeff() * (1.0 - 1e-9);
  for (int n = 0; n < steps; ++n) {
    simulation.step();
    ASSERT_GE(oracleMinWidth(lattice, simulation.displacements()), least) << "step " << n;
    ASSERT_TRUE(std::isfinite(largest(simulation.velocities())));
  }
}

TEST(OracleSimulation, ReturnsToRestAfterViolentForces) {
  const double kh = 0.14 * kModulus * 0.005 * 0.005;
  std::uint64_t limited = 0;
  for (const double nu : {0.25, 0.45}) {
    for (const Vector3& direction : {Vector3(0, 0, -1), Vector3(0, 0, 1), Vector3(1, 0, 0), Vector3(1, 1, -1)}) {
      OnFloor block({6, 6, 6}, Vector3::Constant(0.005), nu);
      OracleSimulation simulation(block.lattice, block.materials, block.settings);
      simulation.setForces(onTop(block.lattice, 1e12 * kh * direction, 1.1 * 0.005));
      runGuarded(simulation, block.lattice, 100);
      EXPECT_GT(largest(simulation.displacements()), 0.005) << "the case tests nothing";
      limited += simulation.limitedMoves();
      simulation.setForces(nothing(block.lattice));
      runGuarded(simulation, block.lattice, 2000);
      EXPECT_LT(largest(simulation.displacements()), 0.01 * 0.005) << direction.transpose() << ", nu " << nu;
    }
  }
  EXPECT_GT(limited, 1000U) << "the guard had nothing to do";
}

TEST(OracleSimulation, ReturnsToRestAfterRandomForcesOnEverything) {
  const double kh = 0.14 * kModulus * 0.005 * 0.005;
  for (const double strength : {1.0, 3.0, 1000.0}) {
    OnFloor block({6, 6, 6});
    OracleSimulation simulation(block.lattice, block.materials, block.settings);
    simulation.setForces(Random(4).displacements(block.lattice.vertexCount(), strength * kh));
    runGuarded(simulation, block.lattice, 200);
    simulation.setForces(nothing(block.lattice));
    runGuarded(simulation, block.lattice, 2000);
    EXPECT_LT(largest(simulation.displacements()), 0.01 * 0.005) << strength << " k h";
  }
}

TEST(OracleSimulation, ACheckerboardOfFullMovesStaysUninverted) {
  const double h = 0.005;
  OnFloor block({6, 6, 6});
  std::vector<Vector3> velocities;
  for (const Vector3& p : block.lattice.rest_positions) {
    const Vector3i node = (p / h).array().round().cast<int>();
    velocities.push_back((node.sum() % 2 == 0 ? 1.0 : -1.0) * 0.4 * h / block.settings.dt_s *
                         Vector3::Ones().normalized());
  }
  OracleSimulation guarded(block.lattice, block.materials, block.settings);
  guarded.setState(nothing(block.lattice), velocities);
  runGuarded(guarded, block.lattice, 1);
  block.settings.guard = false;
  OracleSimulation bare(block.lattice, block.materials, block.settings);
  bare.setState(nothing(block.lattice), velocities);
  bare.step();
  EXPECT_LT(oracleMinWidth(block.lattice, bare.displacements()), 0.0) << "the case tests nothing";
}

TEST(OracleSimulation, RandomFullMovesNeverInvert) {
  const double h = 0.005;
  OnFloor block({5, 5, 5}, {0.005, 0.006, 0.008});
  OracleSimulation simulation(block.lattice, block.materials, block.settings);
  Random random(5);
  for (int n = 0; n < 200; ++n) {
    simulation.setState(simulation.displacements(),
                        random.displacements(block.lattice.vertexCount(), 0.5 * h / block.settings.dt_s));
    runGuarded(simulation, block.lattice, 1);
  }
}

TEST(OracleSimulation, AStateThatIsInsideOutGetsNoWorseAndComesBack) {
  OnFloor block({4, 4, 4});
  std::vector<Vector3> u = nothing(block.lattice);
  for (std::size_t v = 0; v < u.size(); ++v) {
    const Vector3 p = block.lattice.rest_positions[v] / 0.005;
    if ((p - Vector3(2, 2, 2)).norm() < 0.1)
      u[v].z() = -0.007;
  }
  ASSERT_LT(oracleMinWidth(block.lattice, u), 0.0);
  OracleSimulation simulation(block.lattice, block.materials, block.settings);
  simulation.setState(u, nothing(block.lattice));
  double width = oracleMinWidth(block.lattice, u);
  for (int n = 0; n < 2000; ++n) {
    simulation.step();
    const double now = oracleMinWidth(block.lattice, simulation.displacements());
    ASSERT_GE(now, std::min(width, 0.02 * 0.005) - 1e-12) << "step " << n;
    width = now;
  }
  EXPECT_LT(largest(simulation.displacements()), 0.01 * 0.005);
}

TEST(OracleSimulation, AFreeBlockKeepsItsMomenta) {
  Mixed mixed;
  mixed.lattice.rest_stretch.assign(mixed.lattice.cellCount(), Vector3::Ones());
  OracleSettings settings;
  settings.dt_s = 0.3 * bulkTimeStepLimit(mixed.materials[1], mixed.lattice.spacing_m);
  OracleSimulation simulation(mixed.lattice, mixed.materials, settings);
  const std::vector<Vector3> velocities = Random(6).displacements(mixed.lattice.vertexCount(), 0.05);
  simulation.setState(nothing(mixed.lattice), velocities);
  const auto momenta = [&] {
    std::pair<Vector3, Vector3> sum(Vector3::Zero(), Vector3::Zero());
    for (std::size_t v = 0; v < velocities.size(); ++v) {
      const Vector3 p = simulation.masses()[v] * simulation.velocities()[v];
      sum.first += p;
      sum.second += (mixed.lattice.rest_positions[v] + simulation.displacements()[v]).cross(p);
    }
    return sum;
  };
  const auto before = momenta();
  for (int n = 0; n < 2000; ++n)
    simulation.step();
  EXPECT_EQ(simulation.limitedMoves(), 0U);
  EXPECT_GT(largest(simulation.displacements()), 1e-5);
  EXPECT_LT((momenta().first - before.first).norm(), 1e-11 * before.first.norm());
  EXPECT_LT((momenta().second - before.second).norm(), 1e-11 * before.second.norm());
}

TEST(OracleSimulation, GravityPullsAndWhatIsFixedStays) {
  OnFloor block({3, 3, 3});
  block.settings.gravity_m_s2 = {0.0, 0.0, -9.81};
  OracleSimulation simulation(block.lattice, block.materials, block.settings);
  for (int n = 0; n < 4000; ++n)
    simulation.step();
  // At rest, every section carries the weight above it: what the floor holds is the weight of the whole.
  double weight = 0.0;
  double floor = 0.0;
  const std::vector<Vector3> forces = oracleForces(block.lattice, block.materials, simulation.displacements());
  for (std::size_t v = 0; v < forces.size(); ++v) {
    weight += 9.81 * (block.lattice.fixed[v] ? 0.0 : simulation.masses()[v]);
    floor -= block.lattice.fixed[v] ? forces[v].z() : 0.0;
    EXPECT_TRUE(!block.lattice.fixed[v] || simulation.displacements()[v].isZero());
  }
  EXPECT_NEAR(floor, weight, 1e-6 * weight);
}

TEST(OracleSimulation, RigidTissueOfTheDissertationIsHeavyInsteadOfFixed) {
  OnFloor block({3, 3, 3});
  block.settings.spring_rule = SpringRule::kDissertation;
  OracleSimulation simulation(block.lattice, block.materials, block.settings);
  simulation.setForces(onTop(block.lattice, {0.0, 0.0, 0.01}, 1.0));
  for (int n = 0; n < 10; ++n)
    simulation.step();
  const double bottom = simulation.displacements().front().z();
  EXPECT_GT(bottom, 0.0);
  EXPECT_LT(bottom, 0.05 * simulation.displacements().back().z());
}

}  // namespace
}  // namespace soft_volume::core
