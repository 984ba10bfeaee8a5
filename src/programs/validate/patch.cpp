// Affine deformations, which a consistent lattice reproduces exactly (FEM's patch test).

#include <cmath>
#include <random>
#include <sstream>

#include "blocks.h"
#include "report.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kBound = 1e-6;
constexpr int kCells = 4;
/// Springs are linear in length and not in displacement: the error that this strain leaves is of its own size.
constexpr double kStrain = 1e-7;
constexpr int kMaxSteps = 20000;

struct Sample {
  std::string name;
  double poisson_ratio;
  Vector3 spacing_m;
};

constexpr char kAxisNames[] = "xyz";

std::vector<VertexLoad> pullBothEnds(const Block& block, int axis, double stress_pa) {
  std::vector<VertexLoad> loads;
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    const int n = block.node(v)[axis];
    if (n != 0 && n != block.lattice.dims[axis])
      continue;
    const double sign = n == 0 ? -1.0 : 1.0;
    loads.push_back({v, sign * stress_pa * block.faceArea(v, axis) * Vector3::Unit(axis)});
  }
  return loads;
}

/// Mean strain along an axis: how much farther apart the two end faces are.
double strainAlong(const Block& block, const Simulation& simulation, int axis) {
  const int end = block.lattice.dims[axis];
  double stretch = 0.0;
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    const int n = block.node(v)[axis];
    if (n == 0 || n == end)
      stretch += (n == 0 ? -1.0 : 1.0) * simulation.state().displacements_m[v][axis] * block.faceArea(v, axis);
  }
  const double face = block.lattice.spacing_m.prod() * block.lattice.dims.prod() /
                      (block.lattice.spacing_m[axis] * block.lattice.dims[axis]);
  return stretch / face / (block.lattice.spacing_m[axis] * end);
}

/// A free block pulled at two opposite faces: nothing but the tissue decides how long and how thin it gets.
void stretch(const Sample& sample, int axis, const Options& options, Report& report) {
  const Block block(Vector3i::Constant(kCells), sample.spacing_m, tissue(sample.poisson_ratio, 1.0));
  Simulation simulation(block.lattice, block.materials, staticSettings(), options.threads);
  simulation.setLoads(pullBothEnds(block, axis, kStrain * kYoungPa));
  settle(simulation, 1e-8 * kStrain * block.edge(), kMaxSteps);
  const double along = strainAlong(block, simulation, axis);
  const double across_1 = strainAlong(block, simulation, (axis + 1) % 3);
  const double across_2 = strainAlong(block, simulation, (axis + 2) % 3);
  const std::string name = sample.name + ", stretch " + kAxisNames[axis];
  report.equal(name + ": E, Pa", kStrain * kYoungPa / along, kYoungPa, kBound);
  const double worse =
      std::abs(across_1 / along + sample.poisson_ratio) > std::abs(across_2 / along + sample.poisson_ratio) ? across_1
                                                                                                            : across_2;
  report.equal(name + ": nu", -worse / along, sample.poisson_ratio, kBound);
}

Vector3 sheared(const Vector3& rest_m, int axis) {
  return kStrain * rest_m[(axis + 1) % 3] * Vector3::Unit(axis);
}

bool isInside(const Block& block, std::uint32_t vertex) {
  const Vector3i n = block.node(vertex);
  return (n.array() > 0).all() && (n.array() < block.lattice.dims.array()).all();
}

/// The surface is held in simple shear, the inside is disturbed and has to find the same shear by itself.
void shear(const Sample& sample, int axis, const Options& options, Report& report) {
  const Block block(Vector3i::Constant(kCells), sample.spacing_m, tissue(sample.poisson_ratio, 1.0));
  Simulation simulation(block.lattice, block.materials, staticSettings(), options.threads);
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> noise(-0.1 * kStrain * block.edge(), 0.1 * kStrain * block.edge());
  std::vector<std::uint32_t> surface;
  std::vector<Vector3> places;
  std::vector<Vector3> affine;
  std::vector<Vector3> start;
  for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v) {
    affine.push_back(sheared(block.lattice.rest_positions[v], axis));
    start.push_back(affine.back());
    if (isInside(block, v)) {
      start.back() += Vector3(noise(random), noise(random), noise(random));
    } else {
      surface.push_back(v);
      places.push_back(block.lattice.rest_positions[v] + affine.back());
    }
  }
  setMotion(simulation, start, std::vector<Vector3>(start.size(), Vector3::Zero()));
  simulation.leadVertices("surface", surface, places, kForever);
  settle(simulation, 1e-8 * kStrain * block.edge(), kMaxSteps);

  const int normal = (axis + 1) % 3;
  const double area = block.lattice.spacing_m.prod() * kCells * kCells / block.lattice.spacing_m[normal];
  const double stress_pa = -totalForce(simulation, block.layer(normal, kCells))[axis] / area;
  const std::string name = sample.name + ", shear " + kAxisNames[axis] + kAxisNames[normal];
  report.equal(name + ": G, Pa", stress_pa / kStrain, kYoungPa / (2.0 * (1.0 + sample.poisson_ratio)), kBound);
  report.atMost(name + ": inside off the shear, of the strain",
                largestDistance(simulation.state().displacements_m, affine) / (kStrain * block.edge()), kBound);
}

Pose randomPose(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  Pose pose;
  pose.orientation = Quaternion(normal(random), normal(random), normal(random), normal(random)).normalized();
  pose.position_m = Vector3(normal(random), normal(random), normal(random));
  return pose;
}

void rigidMotion(double poisson_ratio, Precision precision, double bound, const Options& options, Report& report) {
  const Block block(Vector3i::Constant(kCells), Vector3::Constant(0.01), tissue(poisson_ratio));
  SimulationSettings settings = exactSettings();
  settings.precision = precision;
  Simulation simulation(block.lattice, block.materials, settings, options.threads);
  std::mt19937_64 random(2);
  double force_n = 0.0;
  double moved_m = 0.0;
  for (int n = 0; n < (options.quick ? 3 : 20); ++n) {
    const Pose pose = randomPose(random);
    std::vector<Vector3> displacements;
    for (const Vector3& rest : block.lattice.rest_positions)
      displacements.push_back(pose * rest - rest);
    setMotion(simulation, displacements, std::vector<Vector3>(displacements.size(), Vector3::Zero()));
    for (std::uint32_t v = 0; v < block.lattice.vertexCount(); ++v)
      force_n = std::max(force_n, simulation.forceOn(v).norm());
    for (int step = 0; step < 200; ++step)
      simulation.step();
    moved_m = std::max(moved_m, largestDistance(displacements, simulation.state().displacements_m));
  }
  std::ostringstream name;
  name << "rigid motion, nu " << poisson_ratio << (precision == Precision::kFloat ? ", float" : ", double");
  if (precision == Precision::kDouble)
    report.atMost(name.str() + ": largest force, kh", force_n / block.springForce(), bound);
  report.atMost(name.str() + ": moved in 200 steps, h", moved_m / block.edge(), bound);
}

std::vector<Sample> samples(bool quick) {
  const Vector3 cube = Vector3::Constant(0.01);
  std::vector<Sample> chosen;
  for (const double nu : {0.25, 0.3, 0.4, 0.45, 0.49}) {
    if (quick && nu != 0.25 && nu != 0.49)
      continue;
    std::ostringstream name;
    name << "nu " << nu;
    chosen.push_back({name.str() + ", cubes", nu, cube});
    chosen.push_back({name.str() + ", 1:1.3:1.6", nu, Vector3(0.01, 0.013, 0.016)});
    if (!quick)
      chosen.push_back({name.str() + ", 1.6:1:1", nu, Vector3(0.016, 0.01, 0.01)});
  }
  return chosen;
}

}  // namespace

std::vector<Case> patchCases(const Options& options) {
  std::vector<Case> cases;
  for (const Sample& sample : samples(options.quick)) {
    for (int axis = 0; axis < (options.quick ? 1 : 3); ++axis) {
      cases.push_back(
          {sample.name + ", stretch", 0.3, [=](Report& report) { stretch(sample, axis, options, report); }});
      cases.push_back({sample.name + ", shear", 0.3, [=](Report& report) { shear(sample, axis, options, report); }});
    }
  }
  for (const double nu : {0.25, 0.49}) {
    cases.push_back({"rigid motion", 0.3, [=](Report& report) {
                       rigidMotion(nu, Precision::kDouble, 1e-9, options, report);
                       rigidMotion(nu, Precision::kFloat, 1e-3, options, report);
                     }});
  }
  return cases;
}

}  // namespace soft_volume::core::validate
