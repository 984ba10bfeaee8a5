#include "soft_volume/incision/lip_contacts.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <numeric>

#include "incision/embedded_block.h"
#include "soft_volume/common/error.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/setting_names.h"
#include "soft_volume/simulation/simulation.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 20040802;
constexpr double kModulus = 1e4;

using Contacts = std::vector<LipContact>;

Contacts contactsOf(const EmbeddedBlock& block, double opening_pressure_pa = 0.0) {
  IncisionSettings settings;
  settings.opening_pressure_pa = opening_pressure_pa;
  return findLipContacts(block.mesh, block.embedding, block.lattice, block.materials, settings);
}

double areaOf(const Contacts& contacts) {
  return std::accumulate(contacts.begin(), contacts.end(), 0.0,
                         [](double sum, const LipContact& contact) { return sum + contact.area_m2; });
}

Vector3 restPlace(const Lattice& lattice, const LipContact& contact, std::size_t side) {
  const Vector3 low = lattice.cellIndex(lattice.parent_cells[contact.cells[side]]).cast<double>();
  return lattice.origin_m + lattice.spacing_m.cwiseProduct(low + contact.places[side]);
}

/// Of all lips, both sides, and of those whose other side the same cell carries.
double openedArea(const EmbeddedBlock& block) {
  double area_m2 = 0.0;
  for (const auto& face : block.mesh.faces())
    area_m2 += face.opened ? 0.5 * areaVector(block.mesh.restPositions(), face.loop).norm() : 0.0;
  return area_m2;
}

SimulationSettings whole(Integrator integrator = Integrator::kSymplecticEuler) {
  SimulationSettings settings;
  settings.integrator = integrator;
  settings.active_set = ActiveSet::kAll;
  settings.precision = Precision::kDouble;
  return settings;
}

// --- what is found

TEST(LipContacts, CoverACutOnce) {
  for (const double share : {0.1, 0.3, 0.5, 0.0}) {
    EmbeddedBlock block({3, 4, 3});
    EXPECT_TRUE(contactsOf(block).empty());
    block.cutAndFollow({squareQuad(Vector3(1.5, 2, 1 + share) * kH, {0, 0, 1}, 10 * kH)});
    const Contacts contacts = contactsOf(block);
    EXPECT_EQ(contacts.size(), 4U * 12U) << "four to a square";
    EXPECT_NEAR(areaOf(contacts) / (12 * kH * kH), 1.0, 1e-9);
    for (const LipContact& contact : contacts) {
      EXPECT_NE(contact.cells[0], contact.cells[1]);
      EXPECT_NEAR(std::abs(contact.normal.z()), 1.0, 1e-12);
      EXPECT_LT((restPlace(block.lattice, contact, 0) - restPlace(block.lattice, contact, 1)).norm(), 1e-9 * kH);
      EXPECT_NEAR(restPlace(block.lattice, contact, 0).z(), (1 + share) * kH, 1e-9 * kH);
      EXPECT_NEAR(contact.stiffness_n_m, 20.0 * kModulus * contact.area_m2 / kH, 1e-9 * contact.stiffness_n_m);
    }
  }
}

/// Whatever crosses them later, of one lip or both: the lips of all cuts that go through stay covered.
TEST(LipContacts, FollowLaterCuts) {
  std::mt19937 random(kSeed);
  std::normal_distribution<double> normal;
  std::size_t most = 0;
  for (int n = 0; n < caseCount(8); ++n) {
    EmbeddedBlock block({4, 4, 4});
    for (int cut = 0; cut < 5; ++cut) {
      const Vector3 direction(normal(random), normal(random), normal(random));
      const Vector3 at = 0.5 * block.size() + 0.3 * kH * Vector3(normal(random), normal(random), normal(random));
      block.cutAndFollow({squareQuad(at, direction, 20 * kH)});
      const Contacts contacts = contactsOf(block);
      // Dents of faces that snapping bent are left out.
      EXPECT_NEAR(areaOf(contacts) / (0.5 * openedArea(block)), 1.0, 5e-3) << n << ", " << cut;
      most = std::max(most, contacts.size());
      for (const LipContact& contact : contacts)
        ASSERT_LT((restPlace(block.lattice, contact, 0) - restPlace(block.lattice, contact, 1)).norm(), 1e-6 * kH);
    }
  }
  EXPECT_GT(most, 200U);
}

TEST(LipContacts, BeginWhereTheFrontHasLeftACell) {
  EmbeddedBlock block({4, 3, 3});
  block.cutAndFollow({squareQuad(Vector3(1.6 - 10, 1.5, 1.4) * kH, {0, 0, 1}, 10 * kH)});
  const Contacts contacts = contactsOf(block);
  // The cells of the front, from 1 to 2 along x, are one body; so are their lips.
  EXPECT_NEAR(areaOf(contacts) / (3 * kH * kH), 1.0, 1e-9);
  for (const LipContact& contact : contacts)
    EXPECT_LT(restPlace(block.lattice, contact, 0).x(), kH);
}

TEST(LipContacts, ShortenTheRestLengthsAcross) {
  EmbeddedBlock block({3, 3, 2});
  block.cutAndFollow({squareQuad(Vector3(1.5, 1.5, 1.5) * kH, {0, 0, 1}, 10 * kH)});
  shortenAcrossLips(block.lattice, contactsOf(block), 0.8);
  for (std::size_t cell = 0; cell < block.lattice.cellCount(); ++cell) {
    const bool cut = block.lattice.shares[cell] < 1.0;
    EXPECT_LT((block.lattice.rest_stretch[cell] - Vector3(1, 1, cut ? 0.8 : 1.0)).norm(), 1e-12);
  }
  EmbeddedBlock slanted({3, 3, 2});
  slanted.cutAndFollow({squareQuad(Vector3(1.5, 1.5, 1.5) * kH, {1, 0, 1}, 10 * kH)});
  shortenAcrossLips(slanted.lattice, contactsOf(slanted), 0.8);
  EXPECT_LT((slanted.lattice.rest_stretch[slanted.lattice.cellCount() - 1] - Vector3(0.9, 1, 0.9)).norm(), 1e-6);
}

// --- lips on each other

/// Two cells tall and wide enough that nothing tilts, cut at a share of the upper cell.
EmbeddedBlock tall(double share, double damping_ratio = 1.0, double poisson_ratio = 0.25) {
  EmbeddedBlock block({3, 3, 2});
  block.materials = oneMaterial(kModulus, damping_ratio, poisson_ratio);
  if (share > 0.0)
    block.cutAndFollow({squareQuad(Vector3(1.5, 1.5, 1 + share) * kH, {0, 0, 1}, 10 * kH)});
  return block;
}

/// An even pressure on the top and the bottom of the block; positive: presses.
std::vector<VertexLoad> pressure(const EmbeddedBlock& block, double pressure_pa) {
  std::vector<VertexLoad> loads;
  const Vector3 size = block.size();
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    const Vector3& p = block.lattice.rest_positions[v];
    const bool bottom = p.z() < 1e-9 && block.lattice.origin_vertices[v] == v;
    const bool top = p.z() > size.z() - 1e-9 && block.lattice.origin_vertices[v] == v;
    if (!bottom && !top)
      continue;
    double area_m2 = kH * kH;
    for (int d = 0; d < 2; ++d)
      area_m2 *= p[d] < 1e-9 || p[d] > size[d] - 1e-9 ? 0.5 : 1.0;
    loads.push_back({v, Vector3(0, 0, (bottom ? 1.0 : -1.0) * pressure_pa * area_m2)});
  }
  return loads;
}

void runFor(Simulation& simulation, double time_s) {
  for (double t = 0.0; t < time_s; t += simulation.settings().dt_s)
    simulation.step();
}

/// By how much the block has become shorter.
double shortening(const EmbeddedBlock& block, const Simulation& simulation) {
  double sum = 0.0;
  const std::vector<VertexLoad> loads = pressure(block, 1.0 / (block.size().x() * block.size().y()));
  for (const VertexLoad& load : loads)
    sum += load.force_n.dot(simulation.state().displacements_m[load.vertex]);
  return sum;
}

/// How deep the lips are in each other at most.
double penetration(const EmbeddedBlock& block, const Simulation& simulation) {
  double deepest = 0.0;
  for (const LipContact& contact : contactsOf(block)) {
    std::array<Vector3, 2> at = {Vector3::Zero(), Vector3::Zero()};
    for (std::size_t side = 0; side < 2; ++side) {
      for (std::size_t c = 0; c < 8; ++c) {
        double weight = 1.0;
        for (int d = 0; d < 3; ++d)
          weight *= kHexahedronCorners[c][d] != 0 ? contact.places[side][d] : 1.0 - contact.places[side][d];
        at[side] += weight * simulation.positions()[block.lattice.cells[contact.cells[side]][c]];
      }
    }
    deepest = std::max(deepest, -contact.normal.dot(at[1] - at[0]));
  }
  return deepest;
}

TEST(LipContacts, PressedHalvesAreAsStiffAsTheWhole) {
  const double pressure_pa = 0.02 * kModulus;
  const auto pressed = [&](const EmbeddedBlock& block) {
    Simulation simulation(block.lattice, block.materials, whole(), 1);
    simulation.setLips(contactsOf(block));
    simulation.setLoads(pressure(block, pressure_pa));
    runFor(simulation, 2.0);
    EXPECT_LT(simulation.maxSpeed(), 1e-9);
    const double depth = penetration(block, simulation);
    EXPECT_LT(depth, 1.01 * pressure_pa / kModulus * kH / kLipStiffness) << "p h / (20 E)";
    for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v)
      EXPECT_LT(simulation.forceOn(v).norm(), 1e-6 * pressure_pa * kH * kH) << v;
    return shortening(block, simulation);
  };
  for (const double poisson_ratio : {0.25, 0.45}) {
    const double uncut = pressed(tall(0.0, 1.0, poisson_ratio));
    EXPECT_NEAR(uncut / (pressure_pa / kModulus * 2 * kH), 1.0, 0.03);
    for (const double share : {0.1, 0.3, 0.5}) {
      const double stiffness = uncut / pressed(tall(share, 1.0, poisson_ratio));
      std::printf("nu %.2f, cut at %.0f %%: stiffness %.4f of the whole\n", poisson_ratio, 100 * share, stiffness);
      EXPECT_NEAR(stiffness, 1.0, 0.05);
    }
  }
}

/// Two cuts through one cell: the slab between them is pressed from both sides.
TEST(LipContacts, ASlabBetweenTwoCutsIsCarried) {
  EmbeddedBlock block = tall(0.3);
  block.cutAndFollow({squareQuad(Vector3(1.5, 1.5, 1.7) * kH, {0, 0, 1}, 10 * kH)});
  const double pressure_pa = 0.02 * kModulus;
  Simulation simulation(block.lattice, block.materials, whole(), 1);
  simulation.setLips(contactsOf(block));
  simulation.setLoads(pressure(block, pressure_pa));
  runFor(simulation, 2.0);
  EXPECT_LT(simulation.maxSpeed(), 1e-9);
  const double stiffness = pressure_pa / kModulus * 2 * kH / shortening(block, simulation);
  std::printf("two cuts through a cell: stiffness %.4f of the whole, depth %.4f h\n", stiffness,
              penetration(block, simulation) / kH);
  EXPECT_GT(stiffness, 0.4);
  EXPECT_LT(penetration(block, simulation), 0.02 * kH);
}

TEST(LipContacts, EveryIntegratorFindsTheSameRest) {
  const EmbeddedBlock block = tall(0.3);
  double expected = 0.0;
  for (const auto& integrator : kChoices<Integrator>) {
    for (const Precision precision : {Precision::kDouble, Precision::kFloat}) {
      SimulationSettings settings = whole(integrator.choice);
      settings.precision = precision;
      Simulation simulation(block.lattice, block.materials, settings, 1);
      simulation.setLips(contactsOf(block));
      simulation.setLoads(pressure(block, 0.02 * kModulus));
      runFor(simulation, 2.0);
      const double found = shortening(block, simulation);
      expected = expected > 0.0 ? expected : found;
      EXPECT_NEAR(found / expected, 1.0, 1e-3) << integrator.name;
    }
  }
}

/// Displacements of the part above the cut, and of the other.
std::vector<Vector3> displaced(const EmbeddedBlock& block, const Vector3& upper_m) {
  std::vector<std::uint8_t> above(block.lattice.vertexCount(), 0);
  const auto islands = block.mesh.islands();
  for (std::uint32_t piece = 0; piece < islands.size(); ++piece) {
    for (const std::uint32_t v : block.lattice.cells[block.embedding.cellOf(piece)])
      above[v] = islands[piece] != islands[0] ? 1 : 0;
  }
  std::vector<Vector3> displacements;
  for (const std::uint8_t upper : above)
    displacements.push_back(upper ? upper_m : Vector3::Zero());
  return displacements;
}

TEST(LipContacts, ActAlongTheNormalAndOnlyWhenPressed) {
  const EmbeddedBlock block = tall(0.3);
  const double scale = kModulus * kH * kH;
  Simulation simulation(block.lattice, block.materials, whole(), 1);
  simulation.setLips(contactsOf(block));
  const auto forceOnUpper = [&](const Vector3& upper_m) {
    SimulationState state = simulation.state();
    state.displacements_m = displaced(block, upper_m);
    simulation.restore(state);
    Vector3 sum = Vector3::Zero();
    Vector3 all = Vector3::Zero();
    for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
      sum += state.displacements_m[v].isZero(0.0) ? Vector3::Zero() : simulation.forceOn(v);
      all += simulation.forceOn(v);
    }
    EXPECT_LT(all.norm(), 1e-12 * scale) << "equal and opposite";
    return sum;
  };
  const double depth = 0.01 * kH;
  const Vector3 pressed(0, 0, kLipStiffness * kModulus * 9 * kH * depth);
  EXPECT_LT((forceOnUpper({0, 0, -depth}) - pressed).norm(), 1e-9 * scale);
  EXPECT_LT((forceOnUpper({0.3 * kH, -0.2 * kH, -depth}) - pressed).norm(), 1e-9 * scale) << "slides freely";
  EXPECT_LT(forceOnUpper({0, 0, 0.01 * kH}).norm(), 1e-9 * scale) << "pulled apart";
  EXPECT_LT(forceOnUpper({1.1 * kH, 0, -depth}).norm(), 1e-9 * scale) << "slid off";
  EXPECT_GT(simulation.mechanics().elastic_j, -1e-12);
  forceOnUpper({0, 0, -depth});
  EXPECT_NEAR(simulation.mechanics().elastic_j / (0.5 * pressed.z() * depth), 1.0, 1e-9);
}

/// The normal turns with the lips.
TEST(LipContacts, TurnWithTheTissue) {
  const EmbeddedBlock block = tall(0.3);
  Simulation simulation(block.lattice, block.materials, whole(), 1);
  simulation.setLips(contactsOf(block));
  const Matrix3 turn = Eigen::AngleAxisd(2.0, Vector3(1, 2, -1).normalized()).toRotationMatrix();
  SimulationState state = simulation.state();
  state.displacements_m = displaced(block, {0, 0, -0.01 * kH});
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    const Vector3& rest = block.lattice.rest_positions[v];
    state.displacements_m[v] = turn * (rest + state.displacements_m[v]) - rest;
  }
  simulation.restore(state);
  EXPECT_NEAR(simulation.mechanics().elastic_j, 0.5 * kLipStiffness * kModulus * 9 * kH * 1e-4 * kH * kH,
              1e-9 * kModulus * kH * kH * kH);
  Vector3 force = Vector3::Zero();
  for (const std::uint32_t v : block.lattice.cells[block.embedding.cellOf(0)])
    force += simulation.forceOn(v);
  EXPECT_LT((force.normalized() + turn * Vector3(0, 0, 1)).norm(), 1e-6);
}

/// The force is the derivative of the energy, by differences (steps of 1e-6 h: exact to about 1e-8), wherever the lips
/// are: slid, turned, at the ends of their reach. So they make no energy, and turn with everything without a moment.
TEST(LipContacts, ForcesAreTheDerivativeOfTheEnergy) {
  const EmbeddedBlock block = tall(0.3);
  Simulation simulation(block.lattice, block.materials, whole(), 1);
  std::mt19937 random(kSeed);
  std::normal_distribution<double> normal;
  const Contacts contacts = contactsOf(block);
  int pressed = 0;
  for (int n = 0; n < 12; ++n) {
    const double turn = 0.12 * n;
    const Matrix3 turned = Eigen::AngleAxisd(turn, Vector3(0.2, 1, 0)).toRotationMatrix();
    SimulationState state = simulation.state();
    const std::vector<Vector3> upper = displaced(block, Vector3(0.7, 0.5, -0.05) * (n % 4) / 3.0 * kH);
    for (std::size_t v = 0; v < upper.size(); ++v) {
      const Vector3 at = block.lattice.rest_positions[v] - Vector3(1.5, 1.5, 1.3) * kH;
      state.displacements_m[v] = upper[v] + 0.02 * kH * Vector3(normal(random), normal(random), normal(random));
      if (!upper[v].isZero(0.0))
        state.displacements_m[v] += turned * at - at;
    }
    const auto lipsAlone = [&](const SimulationState& at, bool with) {
      simulation.setLips(with ? contacts : Contacts());
      simulation.restore(at);
      return simulation.mechanics().elastic_j;
    };
    const double energy = lipsAlone(state, true) - lipsAlone(state, false);
    pressed += energy > 0.0 ? 1 : 0;
    Vector3 moment = Vector3::Zero();
    const double step = 1e-6 * kH;
    double largest = 0.0;
    double wrong = 0.0;
    for (std::uint32_t v = 0; v < upper.size(); ++v) {
      lipsAlone(state, false);
      const Vector3 inner = simulation.forceOn(v);
      lipsAlone(state, true);
      const Vector3 force = simulation.forceOn(v) - inner;
      moment += simulation.positions()[v].cross(force);
      largest = std::max(largest, force.norm());
      for (int d = 0; d < 3; ++d) {
        SimulationState moved = state;
        moved.displacements_m[v][d] += step;
        const double up = lipsAlone(moved, true) - lipsAlone(moved, false);
        moved.displacements_m[v][d] -= 2 * step;
        const double down = lipsAlone(moved, true) - lipsAlone(moved, false);
        wrong = std::max(wrong, std::abs((down - up) / (2 * step) - force[d]));
      }
    }
    EXPECT_LE(wrong, 1e-5 * std::max(largest, 1e-3 * kModulus * kH * kH)) << n;
    EXPECT_LE(moment.norm(), 1e-10 * kModulus * kH * kH * kH) << n;
  }
  EXPECT_GT(pressed, 6);
}

/// Halves that are thrown at each other.
TEST(LipContacts, ImpactsKeepMomentumAndTakeEnergyOut) {
  for (const Integrator integrator :
       {Integrator::kSymplecticEuler, Integrator::kRungeKutta4, Integrator::kAdaptive, Integrator::kBackwardEuler}) {
    const EmbeddedBlock block = tall(0.3, 0.0);
    Simulation simulation(block.lattice, block.materials, whole(integrator), 1);
    simulation.setLips(contactsOf(block));
    SimulationState state = simulation.state();
    const std::vector<Vector3> upper = displaced(block, {0.02, 0.01, -0.2});
    for (std::size_t v = 0; v < upper.size(); ++v)
      state.velocities_m_s[v] = upper[v];
    state.displacements_m = displaced(block, {0, 0, 0.02 * kH});
    simulation.restore(state);
    const Mechanics before = simulation.mechanics();
    double deepest = 0.0;
    for (double t = 0.0; t < 0.1; t += simulation.settings().dt_s) {
      simulation.step();
      deepest = std::max(deepest, penetration(block, simulation));
      const Mechanics now = simulation.mechanics();
      ASSERT_LT((now.linear_momentum_kg_m_s - before.linear_momentum_kg_m_s).norm(),
                (integrator == Integrator::kBackwardEuler ? 1e-6 : 1e-12) * before.linear_momentum_kg_m_s.norm());
      // Within a step of Runge-Kutta lips answer with less than their stiffness, so the energy of a depth is less, too.
      if (integrator == Integrator::kSymplecticEuler || integrator == Integrator::kBackwardEuler) {
        ASSERT_LT(now.kinetic_j + now.elastic_j, 1.02 * before.kinetic_j) << t;
      }
    }
    EXPECT_LT(simulation.mechanics().kinetic_j + simulation.mechanics().elastic_j, before.kinetic_j);
    std::printf("integrator %d: deepest %.4f h, energy left %.3f\n", int(integrator), deepest / kH,
                (simulation.mechanics().kinetic_j + simulation.mechanics().elastic_j) / before.kinetic_j);
    EXPECT_LT(deepest, 0.05 * kH);
    EXPECT_GT(deepest, 0.0) << "no impact in the test";
  }
}

/// Cut at random, again and again, on a fixed floor.
EmbeddedBlock cutOnFloor(double damping_ratio, double poisson_ratio, const Vector3i& dims = {6, 5, 5}) {
  std::mt19937 random(kSeed);
  EmbeddedBlock block(dims);
  block.materials = oneMaterial(kModulus, damping_ratio, poisson_ratio);
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v)
    block.lattice.fixed[v] = block.lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
  cutAtRandom(block, 6, random);
  return block;
}

/// The most energy that there is at any time, in units of that at the start.
double mostEnergy(const EmbeddedBlock& block, const Contacts& contacts, Integrator integrator, double dt_fraction) {
  SimulationSettings settings = whole(integrator);
  settings.dt_fraction = dt_fraction;
  Simulation simulation(block.lattice, block.materials, settings, 1);
  const int parts = simulation.substeps();
  simulation.setLips(contacts);
  EXPECT_EQ(simulation.substeps(), parts);
  SimulationState state = simulation.state();
  std::mt19937 random(kSeed);
  std::normal_distribution<double> normal;
  for (std::size_t v = 0; v < state.velocities_m_s.size(); ++v) {
    if (!block.lattice.fixed[v])
      state.velocities_m_s[v] = 0.02 * Vector3(normal(random), normal(random), normal(random));
  }
  simulation.restore(state);
  const double before = simulation.mechanics().kinetic_j;
  double most = 0.0;
  for (int n = 0; n < 1500; ++n) {
    simulation.step();
    if (n % 50 == 0)
      most = std::max(most, simulation.mechanics().kinetic_j + simulation.mechanics().elastic_j);
  }
  return most / before;
}

/// The step that is stable without contacts is stable with them, close to its limit too.
TEST(LipContacts, DoNotShortenTheStableStep) {
  const EmbeddedBlock block = cutOnFloor(0.0, 0.45, {4, 4, 4});
  for (const Integrator integrator : {Integrator::kSymplecticEuler, Integrator::kRungeKutta4}) {
    const double with = mostEnergy(block, contactsOf(block), integrator, 0.95);
    const double without = mostEnergy(block, {}, integrator, 0.95);
    std::printf("integrator %d: at most %.3f of the energy at the start, %.3f without contacts\n", int(integrator),
                with, without);
    EXPECT_LT(with, 1.1 * without);
  }
}

TEST(LipContacts, ACutBlockStandsViolentLoadsAndSettles) {
  const EmbeddedBlock block = cutOnFloor(0.3, 0.45, {4, 4, 5});
  for (const auto& integrator : kChoices<Integrator>) {
    SimulationSettings settings;
    settings.integrator = integrator.choice;
    Simulation simulation(block.lattice, block.materials, settings, 1);
    simulation.setLips(contactsOf(block));
    std::vector<VertexLoad> loads;
    for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
      const Vector3& p = block.lattice.rest_positions[v];
      if (p.z() > 4.9 * kH)
        loads.push_back({v, 1e6 * simulation.mass(v) * Vector3(std::sin(300 * p.x()), 0.3, std::cos(500 * p.y()))});
    }
    simulation.setLoads(loads);
    for (int n = 0; n < 50; ++n) {
      simulation.step();
      ASSERT_GT(simulation.minWidth(), 0.0) << integrator.name;
    }
    const double speed = simulation.maxSpeed();
    simulation.setLoads({});
    runFor(simulation, 0.75);
    EXPECT_LT(simulation.maxSpeed(), std::max(0.2 * speed, 1e-3)) << integrator.name;
    EXPECT_GT(simulation.minWidth(), 0.0);
  }
}

TEST(LipContacts, ThreadsDoNotChangeTheBits) {
  EmbeddedBlock block({18, 18, 2});
  block.materials = oneMaterial(kModulus, 0.3, 0.45);
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v)
    block.lattice.fixed[v] = block.lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
  block.cutAndFollow({squareQuad(Vector3(9, 9, 1.4) * kH, {0.02, 0, 1}, 20 * kH)});
  const Contacts contacts = contactsOf(block);
  ASSERT_GT(contacts.size(), 1024U) << "too few for several threads";
  std::vector<std::uint64_t> hashes;
  for (const int threads : {1, 2, 3}) {
    Simulation simulation(block.lattice, block.materials, SimulationSettings(), threads);
    simulation.setLips(contacts);
    simulation.holdForce("press", {0, 0.1, -0.3}, Vector3(9, 9, 2) * kH, 2.5 * kH, 1000000);
    for (int n = 0; n < 30; ++n)
      simulation.step();
    EXPECT_GT(penetration(block, simulation), 1e-4 * kH) << "nothing is pressed";
    hashes.push_back(simulation.stateHash());
  }
  EXPECT_EQ(hashes, std::vector<std::uint64_t>(3, hashes[0]));
}

/// What is pressed wakes what it is pressed on.
TEST(LipContacts, BringTheOtherLipIntoTheSolve) {
  EmbeddedBlock block({14, 14, 3});
  block.materials = oneMaterial(kModulus, 1.0, 0.25);
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v)
    block.lattice.fixed[v] = block.lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
  block.cutAndFollow({squareQuad(Vector3(7, 7, 1.5) * kH, {0, 0, 1}, 20 * kH)});
  const auto depthUnder = [&](ActiveSet active_set) {
    SimulationSettings settings;
    settings.active_set = active_set;
    settings.activation_radius_m = 0.6 * kH;
    Simulation simulation(block.lattice, block.materials, settings, 1);
    simulation.setLips(contactsOf(block));
    simulation.holdForce("press", {0, 0, -0.05}, Vector3(7, 7, 3) * kH, 2.5 * kH, 1000000);
    runFor(simulation, 1.0);
    EXPECT_LT(penetration(block, simulation), 0.02 * kH);
    EXPECT_EQ(simulation.activeCells() < block.lattice.cellCount(), active_set != ActiveSet::kAll);
    double depth = 0.0;
    for (const std::uint32_t v : block.lattice.cells[block.embedding.cellOf(7 + 14 * 7)])
      depth = std::max(depth, -simulation.state().displacements_m[v].z());
    return depth;
  };
  const double all = depthUnder(ActiveSet::kAll);
  EXPECT_GT(all, 1e-3 * kH);
  EXPECT_NEAR(depthUnder(ActiveSet::kGrowth) / all, 1.0, 0.1);
}

TEST(LipContacts, OutwardForcesOpenACut) {
  const EmbeddedBlock block = tall(0.3, 1.0);
  const double pressure_pa = 0.02 * kModulus;
  Simulation simulation(block.lattice, block.materials, whole(), 1);
  simulation.setLips(contactsOf(block, pressure_pa));
  Vector3 sum = Vector3::Zero();
  double upward_n = 0.0;
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    sum += simulation.forceOn(v);
    upward_n += std::max(0.0, simulation.forceOn(v).z());
  }
  EXPECT_LT(sum.norm(), 1e-12 * upward_n);
  EXPECT_NEAR(upward_n / (pressure_pa * 9 * kH * kH), 1.0, 1e-9);
  for (int n = 0; n < 20; ++n)
    simulation.step();
  double gap = HUGE_VAL;
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    const std::uint32_t origin = block.lattice.origin_vertices[v];
    if (origin != v)
      gap = std::min(gap, std::abs(simulation.positions()[v].z() - simulation.positions()[origin].z()));
  }
  EXPECT_GT(gap, 1e-3 * kH);
}

TEST(LipContacts, AreRefusedWhereTheyDoNotFit) {
  const EmbeddedBlock block = tall(0.3);
  Simulation simulation(block.lattice, block.materials, whole(), 1);
  Contacts contacts = contactsOf(block);
  contacts[0].cells[1] = 100000;
  EXPECT_THROW(simulation.setLips(contacts), InputError);
  contacts[0].cells[1] = contacts[0].cells[0];
  EXPECT_THROW(simulation.setLips(contacts), InputError);
}

}  // namespace
}  // namespace soft_volume::core
