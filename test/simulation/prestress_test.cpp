#include "soft_volume/simulation/prestress.h"

#include <gtest/gtest.h>

#include <cstdio>
#include <random>

#include "rest_system.h"
#include "simulation_cases.h"
#include "soft_volume/common/error.h"
#include "soft_volume/incision/lip_contacts.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/setting_names.h"

namespace soft_volume::core {
namespace {

std::vector<Material> taut(double prestretch, double damping_ratio = 0.0, double poisson_ratio = 0.25) {
  std::vector<Material> materials = oneMaterial(kModulus, damping_ratio, poisson_ratio);
  materials[0].prestretch = prestretch;
  return materials;
}

/// Fixes what lies on the block's surface where `held(rest place, size)`.
template <typename Held>
Lattice held(Lattice lattice, const Held& held) {
  const Vector3 size = lattice.dims.cast<double>().cwiseProduct(lattice.spacing_m);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.fixed[v] = held(lattice.rest_positions[v], size) ? 1 : 0;
  return lattice;
}

bool onSurface(const Vector3& p, const Vector3& size) {
  return p.minCoeff() < 1e-9 || (size - p).minCoeff() < 1e-9;
}

bool atEnds(const Vector3& p, const Vector3& size) {
  return p.x() < 1e-9 || p.x() > size.x() - 1e-9;
}

/// Two materials side by side, on a floor, with a step in the surface.
Lattice bumpy() {
  std::vector<std::int32_t> cells(6 * 5 * 4, 0);
  for (std::size_t n = 0; n < cells.size(); ++n) {
    cells[n] = n % 6 < 3 ? 0 : 1;
    if (n / 30 == 3 && n % 5 < 2)
      cells[n] = Lattice::kNone;
  }
  return standing(makeLattice({6, 5, 4}, Vector3(1.0, 1.2, 0.9) * kH, Vector3::Zero(), cells));
}

double largestForce(const std::vector<Vector3>& forces, const Lattice& lattice) {
  double largest = 0.0;
  for (std::size_t v = 0; v < forces.size(); ++v)
    largest = std::max(largest, lattice.fixed[v] ? 0.0 : forces[v].norm());
  return largest;
}

TEST(Prestress, IsNoneUnlessAsked) {
  EXPECT_TRUE(findPrestress(bumpy(), {taut(1.0)[0], taut(1.0)[0]}, SpringRule::kIsotropic).empty());
}

TEST(Prestress, InHomogeneousTissueThatIsHeldAllAroundNothingIsReleased) {
  const Lattice lattice = held(makeBlock(5, 4, 4, kH), onSurface);
  for (const double poisson_ratio : {0.25, 0.45}) {
    const std::vector<Material> materials = taut(1.2, 0.0, poisson_ratio);
    for (const Vector3& slack : findPrestress(lattice, materials, SpringRule::kIsotropic).slack_m)
      EXPECT_LT(slack.norm(), 1e-9 * kH);
    const std::vector<Vector3> rest(lattice.vertexCount(), Vector3::Zero());
    EXPECT_LT(largestForce(oracleForces(lattice, materials, rest), lattice), 1e-9 * kModulus * kH * kH);
    // Every spring is as much too long as the stretch says, every volume likewise.
    const ElasticConstants constants = elasticConstants(kModulus, poisson_ratio);
    const double linear = 1.0 - 1.0 / 1.2;
    const double springs = 0.5 * 15.0 * constants.mu_pa * linear * linear;  // trace of sigma epsilon, lambda = mu
    const double volume = 0.5 * constants.volume_pa * std::pow(3.0 * linear, 2) / (1.0 + 3.0 * linear);
    EXPECT_NEAR(oracleEnergy(lattice, materials, rest) / ((springs + volume) * 80 * kH * kH * kH), 1.0, 1e-6);
  }
}

TEST(Prestress, TheImagedShapeIsInEquilibrium) {
  const Lattice lattice = bumpy();
  for (const SpringRule rule : {SpringRule::kIsotropic, SpringRule::kDissertation}) {
    std::vector<Material> materials = {taut(1.1, 0.0, 0.45)[0], taut(1.3)[0]};
    materials[1].youngs_modulus_pa = 3 * kModulus;
    const std::vector<Vector3> rest(lattice.vertexCount(), Vector3::Zero());
    EXPECT_GT(oracleEnergy(lattice, materials, rest, rule), 1e-3 * kModulus * 120 * kH * kH * kH);
    EXPECT_LT(largestForce(oracleForces(lattice, materials, rest, rule), lattice), 1e-8 * kModulus * kH * kH);
  }
}

TEST(Prestress, WhatNothingHoldsIsNotTaut) {
  const Lattice lattice = makeBlock(4, 3, 3, kH);
  EXPECT_LT(oracleEnergy(lattice, taut(1.2, 0.0, 0.45), std::vector<Vector3>(lattice.vertexCount(), Vector3::Zero())),
            1e-12 * kModulus * 36 * kH * kH * kH);
}

TEST(Prestress, UncutTissueStaysWhereItIs) {
  const Lattice lattice = bumpy();
  for (const auto& integrator : kChoices<Integrator>) {
    for (const Precision precision : {Precision::kDouble, Precision::kFloat}) {
      const std::vector<Material> materials = {taut(1.1, 0.2, 0.45)[0], taut(1.3, 0.2)[0]};
      SimulationSettings settings = wholeLattice(precision, integrator.choice);
      Simulation simulation(lattice, materials, settings, 1);
      run(simulation, 300);
      const double bound = precision == Precision::kFloat ? 1e-5 * kH : 1e-8 * kH;
      EXPECT_LT(simulation.maxDisplacement(), bound) << integrator.name;
    }
  }
}

/// Soft tissue with holes that grows on bone with holes: corners that hang on little, as where a scan's skin is one
/// cell thick. Such a corner's tension may be in equilibrium and still let it buckle at the first touch.
Lattice ragged(unsigned seed) {
  std::mt19937 random(seed);
  std::vector<std::int32_t> cells(8 * 8 * 8);
  for (std::int32_t& cell : cells)
    cell = random() % 10 < 8 ? static_cast<std::int32_t>(random() % 2) : Lattice::kNone;
  Lattice lattice = makeLattice({8, 8, 8}, Vector3::Constant(kH), Vector3::Zero(), cells);
  for (std::size_t c = 0; c < lattice.cellCount(); ++c) {
    for (const std::uint32_t v : lattice.cells[c])
      lattice.fixed[v] = lattice.fixed[v] | std::uint8_t(lattice.materials[c]);
  }
  return lattice;
}

TEST(Prestress, RaggedTissueDoesNotBuckleWhenTouched) {
  for (unsigned seed = 1; seed <= 8; ++seed) {
    const Lattice lattice = ragged(seed);
    std::vector<Material> materials = {taut(1.15, 0.5, 0.45)[0], taut(1.0)[0]};
    materials[1].fixed = true;
    Simulation simulation(lattice, materials, wholeLattice(), 1);
    std::mt19937 random(seed);
    std::vector<Vector3> touched = noVectors(lattice);
    for (Vector3& displacement : touched)
      displacement = 1e-3 * kH / 4294967296.0 * Vector3(random(), random(), random());
    place(simulation, touched, noVectors(lattice));
    run(simulation, 4000);
    EXPECT_LT(simulation.maxDisplacement(), 1e-2 * kH) << "seed " << seed;
  }
}

/// The fast engine and the oracle mean the same by it, cut and deformed.
TEST(Prestress, FastEngineFollowsTheOracle) {
  const std::vector<Material> materials = {taut(1.15, 0.0, 0.45)[0], taut(1.05)[0]};
  const Lattice lattice = cutIntoPieces(bumpy(), materials);
  ASSERT_GT(lattice.cellCount(), 110U);
  const SimulationSettings settings = wholeLattice();
  Simulation fast(lattice, materials, settings, 2);
  OracleSettings oracle_settings;
  oracle_settings.dt_s = fast.settings().dt_s;
  OracleSimulation slow(lattice, materials, oracle_settings);
  for (int n = 0; n < 100; ++n) {
    fast.step();
    slow.step();
  }
  double worst = 0.0;
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    worst = std::max(worst, (fast.state().displacements_m[v] - slow.displacements()[v]).norm());
  EXPECT_GT(fast.maxDisplacement(), 1e-2 * kH) << "the cut does not open";
  EXPECT_LT(worst, 1e-9 * fast.maxDisplacement());
}

/// A cut lattice is as taut as the uncut one was.
TEST(Prestress, SlackDoesNotDependOnCuts) {
  const std::vector<Material> materials = {taut(1.15, 0.0, 0.45)[0], taut(1.05)[0]};
  const Lattice whole = bumpy();
  const Lattice cut = cutIntoPieces(whole, materials);
  Prestress extended = findPrestress(whole, materials, SpringRule::kIsotropic);
  extended.extend(cut);
  const Prestress found = findPrestress(cut, materials, SpringRule::kIsotropic);
  EXPECT_EQ(found.slack_m, extended.slack_m);
  EXPECT_EQ(found.stretch, extended.stretch);
  EXPECT_NEAR(oracleEnergy(cut, materials, std::vector<Vector3>(cut.vertexCount(), Vector3::Zero())) /
                  oracleEnergy(whole, materials, std::vector<Vector3>(whole.vertexCount(), Vector3::Zero())),
              1.0, 1e-12);
}

TEST(Prestress, TensionCountsInTheStableStep) {
  // All directions stretched by s: edges across get (1 - 1 / s) of their stiffness besides.
  const Lattice lattice = held(makeBlock(5, 5, 5, kH), onSurface);
  const auto limit = [&](double prestretch) {
    return Simulation(lattice, taut(prestretch), wholeLattice(), 1).stabilityLimit();
  };
  EXPECT_LT(limit(1.5), 0.97 * limit(1.0));
  EXPECT_GT(limit(1.5), 0.7 * limit(1.0));
}

// --- cuts

/// A bar between two fixed ends, cut through.
struct CutBar {
  Lattice lattice;
  CutMesh mesh;
  Embedding embedding;
  std::vector<LipContact> lips;

  CutBar(const Vector3i& dims, double at_m)
      : lattice(held(makeBlock(dims, Vector3::Constant(kH)), atEnds)), mesh(lattice), embedding(mesh), at(at_m) {}

  void cut(const std::vector<Material>& materials) {
    const SweptQuad quad = {Vector3(at, -1, -1), Vector3(at, 1, -1), Vector3(at, 1, 1), Vector3(at, -1, 1)};
    Lips stroke;
    std::vector<Vector3> positions = lattice.rest_positions;
    cutMesh(mesh, lattice, materials, CutResolution(), {quad}, 0.0, stroke, positions);
    embedding.update(mesh, lattice);
    lips = findLipContacts(mesh, embedding, lattice, materials, IncisionSettings());
  }
  double gap(const Simulation& simulation) const {
    double sum = 0.0;
    double area = 0.0;
    for (std::uint32_t v = 0; v < mesh.vertexCount(); ++v) {
      const CutMesh::Source& source = mesh.source(v);
      if (source.a != source.b || source.a == v)
        continue;
      const auto place = [&](std::uint32_t vertex) {
        return embedding.place(mesh, lattice, simulation.positions(), vertex);
      };
      sum += std::abs(place(v).x() - place(source.a).x());
      area += 1.0;
    }
    return sum / area;
  }
  double at;
};

/// Halves of natural length l / s each: the gap is L (1 - 1 / s), apart from the ends, which hold the breadth, too.
TEST(Prestress, ACutBarGapesByWhatItWasStretchedAndSettles) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    for (const double prestretch : {1.05, 1.2}) {
      const std::vector<Material> materials = taut(prestretch, 1.0, poisson_ratio);
      CutBar bar({20, 2, 2}, 9.4 * kH);
      SimulationSettings settings;
      settings.precision = Precision::kDouble;
      settings.active_set = ActiveSet::kAll;
      Simulation simulation(bar.lattice, materials, settings, 1);
      run(simulation, 20);
      const Mechanics before = simulation.mechanics();
      bar.cut(materials);
      simulation.adoptTopology();
      simulation.setLips(bar.lips);
      EXPECT_NEAR(simulation.mechanics().elastic_j / before.elastic_j, 1.0, 1e-9) << "a cut alone frees nothing";
      double most_j = 0.0;
      double fastest = 0.0;
      for (double t = 0.0; t < 3.0; t += simulation.settings().dt_s) {
        simulation.step();
        fastest = std::max(fastest, simulation.maxSpeed());
        if (simulation.steps() % 20 == 0)
          most_j = std::max(most_j, simulation.mechanics().kinetic_j + simulation.mechanics().elastic_j);
      }
      const double expected = 20 * kH * (1.0 - 1.0 / prestretch);
      std::printf("nu %.2f, stretch %.2f: gap %.3f of L (1 - 1 / s), energy left %.3f\n", poisson_ratio, prestretch,
                  bar.gap(simulation) / expected, simulation.mechanics().elastic_j / before.elastic_j);
      EXPECT_NEAR(bar.gap(simulation) / expected, 1.0, 0.1);
      EXPECT_LT(most_j, 1.01 * before.elastic_j);
      EXPECT_LT(simulation.mechanics().kinetic_j, 1e-9 * before.elastic_j);
      EXPECT_LT(simulation.maxSpeed(), 1e-4 * fastest);
      EXPECT_EQ(simulation.limitedMoves(), 0U);
    }
  }
}

/// Without damping: what a cut lets loose is no more than what was there.
TEST(Prestress, ACutLetsLooseNoMoreThanWasStored) {
  const std::vector<Material> materials = taut(1.2, 0.0, 0.45);
  CutBar bar({8, 3, 3}, 3.5 * kH);
  SimulationSettings settings = wholeLattice();
  settings.dt_fraction = 0.05;  // symplectic Euler's energy is exact to the step squared
  Simulation simulation(bar.lattice, materials, settings, 1);
  const double before = simulation.mechanics().elastic_j;
  bar.cut(materials);
  simulation.adoptTopology();
  simulation.setLips(bar.lips);
  double most = 0.0;
  for (int n = 0; n < 3000; ++n) {
    simulation.step();
    const Mechanics now = simulation.mechanics();
    most = std::max(most, now.kinetic_j + now.elastic_j);
  }
  std::printf("at most %.4f of the energy\n", most / before);
  EXPECT_LT(most, 1.01 * before);
}

/// Skin over bone: fixed below, free above. A cut that does not reach the bone gapes at the top, and what is asleep
/// elsewhere stays so.
TEST(Prestress, AnIncisionInALayerGapesAndTheRestStaysAsleep) {
  const std::vector<Material> materials = taut(1.2, 1.0, 0.45);
  Lattice lattice = standing(makeBlock(20, 9, 4, kH));
  CutMesh mesh(lattice);
  Embedding embedding(mesh);
  SimulationSettings settings;
  Simulation simulation(lattice, materials, settings, 1);
  run(simulation, 10);
  EXPECT_EQ(simulation.activeCells(), 0U);
  EXPECT_EQ(simulation.stats().frontier_error_m, 0.0);
  const double x = 10.3 * kH;
  const SweptQuad quad = {Vector3(x, 2.5 * kH, 1.5 * kH), Vector3(x, 6.5 * kH, 1.5 * kH), Vector3(x, 6.5 * kH, 1),
                          Vector3(x, 2.5 * kH, 1)};
  Lips stroke;
  std::vector<Vector3> positions = lattice.rest_positions;
  const BladeCutResult cut = cutMesh(mesh, lattice, materials, CutResolution(), {quad}, 0.0, stroke, positions);
  embedding.update(mesh, lattice);
  simulation.adoptTopology();
  simulation.setLips(findLipContacts(mesh, embedding, lattice, materials, IncisionSettings()));
  simulation.wake(cut.rest_box_m);
  for (double t = 0.0; t < 1.5; t += simulation.settings().dt_s)
    simulation.step();
  double widest = 0.0;
  for (std::uint32_t v = 0; v < mesh.vertexCount(); ++v) {
    const CutMesh::Source& source = mesh.source(v);
    if (source.a == source.b && source.a != v)
      widest = std::max(widest, (embedding.place(mesh, lattice, simulation.positions(), v) -
                                 embedding.place(mesh, lattice, simulation.positions(), source.a))
                                    .x());
  }
  std::printf("an incision 4 h long and 2.5 h deep in skin stretched by 1.2 gapes %.3f h; %zu of %zu cells active\n",
              std::abs(widest) / kH, simulation.activeCells(), lattice.cellCount());
  EXPECT_GT(std::abs(widest), 0.15 * kH);
  // A crack of length 2 a in a plate under the tension E e / (1 - nu) opens by 4 a e / (1 - nu); bone holds a layer.
  EXPECT_LT(std::abs(widest), 4 * 2 * kH * (1.0 - 1.0 / 1.2) / 0.55);
  EXPECT_LT(simulation.maxSpeed(), 1e-4);
}

TEST(Prestress, OutOfRangeIsRefused) {
  const Lattice lattice = makeBlock(2, 2, 2, kH);
  for (const double prestretch : {0.9, 1.6, double(NAN)})
    EXPECT_THROW(Simulation(lattice, taut(prestretch), SimulationSettings(), 1), SceneError);
}

}  // namespace
}  // namespace soft_volume::core
