// Extremes 1 to 3: moves and forces far beyond what tissue can follow.

#include <cmath>
#include <random>
#include <sstream>

#include "extremes.h"

namespace soft_volume::core::validate {
namespace {

constexpr int kReturnSteps = 2000;
constexpr double kReturned = 0.01;  ///< of h

Vector3i blockCells(const Options& options) {
  return Vector3i::Constant(options.quick ? 6 : 8);
}

int holdSteps(const Options& options) {
  return options.quick ? 100 : 500;
}

Vector3 randomDirection(std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  return Vector3(normal(random), normal(random), normal(random)).normalized();
}

void throwVertices(WatchedRun& run, const std::function<Vector3(const Vector3i& node)>& move_m) {
  const double dt_s = run.simulation().settings().dt_s;
  std::vector<Vector3> velocities;
  for (std::uint32_t v = 0; v < run.block().lattice.vertexCount(); ++v)
    velocities.push_back(run.block().lattice.fixed[v] ? Vector3(0, 0, 0) : Vector3(move_m(run.block().node(v)) / dt_s));
  setMotion(run.simulation(), run.simulation().state().displacements_m, velocities);
  run.simulation().wakeAll();
  run.step();
}

/// The worst pattern: neighbours move against each other along the space diagonal.
std::vector<double> checkerboard(WatchedRun& run) {
  const double length = 0.4 * run.h() / std::sqrt(3.0);
  throwVertices(run, [&](const Vector3i& n) { return Vector3::Constant(n.sum() % 2 == 0 ? length : -length); });
  return {run.leastWidthInH()};
}

std::vector<double> randomThrows(WatchedRun& run) {
  std::mt19937_64 random(11);
  for (int n = 0; n < 200; ++n)
    throwVertices(run, [&](const Vector3i&) { return Vector3(10.0 * run.h() * randomDirection(random)); });
  return {run.leastWidthInH()};
}

/// A tool's footprint in the middle of the top, pushed by a multiple of k h, then let go.
std::vector<double> pushAndRelease(WatchedRun& run, const Vector3& direction, double times_kh, int hold_steps) {
  const Lattice& lattice = run.block().lattice;
  const Vector3 top = lattice.spacing_m.cwiseProduct(lattice.dims.cast<double>()).cwiseProduct(Vector3(0.5, 0.5, 1.0));
  run.simulation().holdForce("tool", times_kh * run.block().springForce() * direction, top, 1.6 * run.h(), kForever);
  run.step(hold_steps);
  run.simulation().releaseForce("tool");
  run.step(kReturnSteps);
  return {run.largestDisplacementInH()};
}

/// The vertex in the middle and its neighbour along x.
std::vector<std::uint32_t> middlePair(const Block& block) {
  const Vector3i m = block.lattice.dims / 2;
  return {block.vertex(m.x(), m.y(), m.z()), block.vertex(m.x() + 1, m.y(), m.z())};
}

std::vector<double> driveThroughByForce(WatchedRun& run, double times_kh, int hold_steps) {
  const std::vector<std::uint32_t> pair = middlePair(run.block());
  const Vector3 force_n(times_kh * run.block().springForce(), 0, 0);
  run.simulation().setLoads({{pair[0], force_n}, {pair[1], -force_n}});
  run.step(hold_steps);
  run.simulation().setLoads({});
  run.step(kReturnSteps);
  return {run.largestDisplacementInH()};
}

std::vector<double> driveThroughByGrip(WatchedRun& run, int hold_steps) {
  const std::vector<std::uint32_t> pair = middlePair(run.block());
  const auto& rest = run.block().lattice.rest_positions;
  run.simulation().leadVertices("jaws", pair, {rest[pair[1]], rest[pair[0]]}, kForever);
  run.step(hold_steps);
  run.simulation().releaseGrip("jaws");
  run.step(kReturnSteps);
  return {run.largestDisplacementInH()};
}

void randomLoads(WatchedRun& run, double times_kh, int hold_steps) {
  std::mt19937_64 random(12);
  std::vector<VertexLoad> loads;
  for (std::uint32_t v = 0; v < run.block().lattice.vertexCount(); ++v)
    loads.push_back({v, times_kh * run.block().springForce() * randomDirection(random)});
  run.simulation().setLoads(loads);
  run.step(hold_steps);
}

std::vector<double> noiseAndRelease(WatchedRun& run, double times_kh, int hold_steps) {
  randomLoads(run, times_kh, hold_steps);
  run.simulation().setLoads({});
  run.step(kReturnSteps);
  return {run.largestDisplacementInH()};
}

std::string forceName(const std::string& what, double times_kh) {
  std::ostringstream name;
  name << what << " " << times_kh << " kh";
  return name.str();
}

}  // namespace

void fullLimitMoves(const Options& options, Report& report) {
  ExtremeItem item(1, "moves", options, report);
  Experiment experiment;
  experiment.cells = blockCells(options);
  experiment.free = true;
  experiment.quantities = {{"least width after a 0.4 h checkerboard step, h", 0.0, true}};
  experiment.measure = checkerboard;
  item.run(experiment);
  experiment.quantities = {{"least width in 200 random full-limit steps, h", 0.0, true}};
  experiment.measure = randomThrows;
  item.run(experiment);
  item.reportAlways();
}

void hugeToolForces(const Options& options, Report& report) {
  ExtremeItem item(2, "tool", options, report);
  const std::pair<const char*, Vector3> directions[] = {
      {"push", -Vector3::UnitZ()}, {"pull", Vector3::UnitZ()}, {"lateral", Vector3::UnitX()}};
  const std::vector<double> forces = options.quick ? std::vector<double>{1e12} : std::vector<double>{1e3, 1e6, 1e12};
  for (const auto& direction : directions) {
    for (const double times_kh : forces) {
      Experiment experiment;
      experiment.cells = blockCells(options);
      experiment.quantities = {{forceName(direction.first, times_kh) + ", release: from rest, h", kReturned}};
      experiment.measure = [=](WatchedRun& run) {
        return pushAndRelease(run, direction.second, times_kh, holdSteps(options));
      };
      item.run(experiment);
    }
  }
  item.reportAlways();
}

void neighboursAndNoise(const Options& options, Report& report) {
  ExtremeItem item(3, "noise", options, report);
  const int hold = holdSteps(options);
  Experiment experiment;
  experiment.cells = blockCells(options);
  experiment.quantities = {{"neighbours forced through each other: from rest, h", kReturned}};
  experiment.measure = [=](WatchedRun& run) { return driveThroughByForce(run, 1e3, hold); };
  item.run(experiment);
  experiment.quantities = {{"neighbours led to each other's place: from rest, h", kReturned}};
  experiment.measure = [=](WatchedRun& run) { return driveThroughByGrip(run, hold); };
  item.run(experiment);
  for (const double times_kh : {1.0, 3.0, 1000.0}) {
    if (options.quick && times_kh == 1.0)
      continue;
    experiment.quantities = {{forceName("random", times_kh) + " on all, release: from rest, h", kReturned}};
    experiment.measure = [=](WatchedRun& run) { return noiseAndRelease(run, times_kh, hold); };
    item.run(experiment);
  }
  experiment.quantities = {{"random 1e12 kh on all: displacement, block edges", 1.0}};
  experiment.measure = [=](WatchedRun& run) {
    randomLoads(run, 1e12, hold);
    return std::vector<double>{run.largestDisplacementInH() / run.block().lattice.dims.x()};
  };
  item.run(experiment);
  item.reportAlways();
}

}  // namespace soft_volume::core::validate
