// Extremes 6, 7, 9 and 10: how far and how fast, precision and place, and active sets that come and go.

#include <cmath>
#include <memory>
#include <sstream>

#include "extremes.h"
#include "soft_volume/simulation/presets.h"

namespace soft_volume::core::validate {
namespace {

constexpr int kReturnSteps = 2000;

/// The 3x3 vertices in the middle of the top.
std::vector<std::uint32_t> toolVertices(const Block& block) {
  const Vector3i middle = block.lattice.dims / 2;
  return block.verticesWhere([&](const Vector3i& n) {
    return n.z() == block.lattice.dims.z() && std::abs(n.x() - middle.x()) <= 1 && std::abs(n.y() - middle.y()) <= 1;
  });
}

/// A rigid tool that holds the 3x3 vertices; its pose is the move away from rest.
Pose lowered(double depth_m) {
  Pose pose;
  pose.position_m = Vector3(0, 0, -depth_m);
  return pose;
}

void lowerTool(WatchedRun& run, double depth_h, double speed_h, int rest_steps) {
  run.simulation().gripVertices("tool", toolVertices(run.block()), Pose(), kForever);
  const int steps = static_cast<int>(std::ceil(depth_h / speed_h));
  for (int n = 1; n <= steps; ++n) {
    run.simulation().moveGrip("tool", lowered(std::min(depth_h, n * speed_h) * run.h()), kForever);
    run.step();
  }
  run.step(rest_steps);
}

using Shape = std::vector<Vector3>;

/// Final shapes of ours and of the dissertation's, against which those of other speeds are held.
struct ToolShapes {
  Shape ours;
  Shape dissertation;
};

std::vector<double> differenceOfSpeed(WatchedRun& run, double speed_h, ToolShapes& slowest) {
  constexpr double kDepth = 2.0;
  constexpr double kSlowest = 0.005;
  lowerTool(run, kDepth, speed_h, kReturnSteps);
  Shape& reference = run.dissertation() ? slowest.dissertation : slowest.ours;
  if (speed_h == kSlowest)
    reference = run.simulation().positions();
  return {largestDistance(run.simulation().positions(), reference) / (kDepth * run.h())};
}

// --- Plates
// -----------------------------------------------------------------------------------------------------------

/// A plate on the top of a block of the given size: where it is at the end, in shares of the way.
using PlatePath = std::function<Pose(double share, const Vector3& size_m)>;

Pose compressed(double share, const Vector3& size_m) {
  return lowered(0.6 * share * size_m.z());
}

Pose stretched(double share, const Vector3& size_m) {
  return lowered(-2.0 * share * size_m.z());
}

Pose sheared(double share, const Vector3& size_m) {
  Pose pose;
  pose.position_m.x() = 2.0 * share * size_m.z();
  return pose;
}

Pose twisted(double share, const Vector3& size_m) {
  Pose pose;
  pose.orientation = Quaternion(Eigen::AngleAxisd(share * M_PI, Vector3::UnitZ()));
  const Vector3 centre(0.5 * size_m.x(), 0.5 * size_m.y(), 0.0);
  pose.position_m = centre - pose.orientation * centre;
  return pose;
}

struct Deformation {
  const char* name;
  PlatePath path;
};

const Deformation kDeformations[] = {{"compression by 60 %", compressed},
                                     {"stretch to 3", stretched},
                                     {"shear 2", sheared},
                                     {"twist by 180 degrees", twisted}};

/// Moves the plate in `steps`, lets go, and says how far from rest the block is after the time to return.
std::vector<double> deformAndRelease(WatchedRun& run, const PlatePath& path, int steps, Shape& deformed) {
  const Lattice& lattice = run.block().lattice;
  const Vector3 size_m = lattice.spacing_m.cwiseProduct(lattice.dims.cast<double>());
  run.simulation().gripVertices("plate", run.block().layer(2, lattice.dims.z()), Pose(), kForever);
  for (int n = 1; n <= steps; ++n) {
    run.simulation().moveGrip("plate", path(double(n) / steps, size_m), kForever);
    run.step();
  }
  run.step(200);
  if (!run.dissertation())
    deformed = run.simulation().positions();
  run.simulation().releaseGrip("plate");
  run.step(kReturnSteps);
  return {run.largestDisplacementInH()};
}

void plotDeformed(const Block& block, const std::vector<Shape>& shapes, const Options& options) {
  std::string data;
  std::string plots;
  for (std::size_t n = 0; n < shapes.size(); ++n) {
    data += layerLines(block, shapes[n], 1, block.lattice.dims.y() / 2, block.edge()) + "\n\n";
    plots += "set title '" + std::string(kDeformations[n].name) + "'\nplot $shapes index " + std::to_string(n) +
             " w l lc rgb '#2060a0' notitle\n";
  }
  options.plot("extremes_deformations", "$shapes << EOD\n" + data +
                                            "EOD\nset size ratio -1\nset xlabel 'x / h'\nset ylabel 'z / h'\n"
                                            "set multiplot layout 2,2\n" +
                                            plots + "unset multiplot\n");
}

// --- Precision and place
// ----------------------------------------------------------------------------------------------

/// Forces that throw a block about, and whether two of them stay together.
void throwAbout(const Block& block, Simulation& simulation) {
  std::vector<VertexLoad> loads;
  for (const std::uint32_t v : toolVertices(block))
    loads.push_back({v, Vector3(0.1, 0.05, -0.2) * block.springForce()});
  simulation.setLoads(loads);
}

struct Variant {
  Precision precision;
  Vector3 origin_m;
};

/// Largest distance, of h, between displacements of the same block at any time.
double largestDifference(const Variant& variant, const SimulationSettings& rule, double damping_ratio,
                         const Options& options) {
  const Vector3i cells = Vector3i::Constant(options.quick ? 6 : 8);
  const Vector3 spacing = Vector3::Constant(kExtremeSpacingM);
  Block here(cells, spacing, tissue(0.25, damping_ratio));
  Block there(cells, spacing, tissue(0.25, damping_ratio), variant.origin_m);
  for (Block* block : {&here, &there})
    block->fixWhere([](const Vector3i& n) { return n.z() == 0; });
  SimulationSettings settings = rule;
  settings.active_set = ActiveSet::kAll;
  settings.precision = Precision::kFloat;
  Simulation first(here.lattice, here.materials, settings, options.threads);
  settings.precision = variant.precision;
  settings.dt_s = first.settings().dt_s;
  Simulation second(there.lattice, there.materials, settings, options.threads);
  throwAbout(here, first);
  throwAbout(there, second);
  double largest = 0.0;
  for (int n = 0; n < (options.quick ? 500 : 2000); ++n) {
    first.step();
    second.step();
    largest = std::max(largest, largestDistance(first.state().displacements_m, second.state().displacements_m));
  }
  return largest / kExtremeSpacingM;
}

// --- Active sets that come and go
// -------------------------------------------------------------------------------------

constexpr double kDepthH = 0.25;
constexpr int kApproachSteps = 100;
/// The force is looked at every so many steps: a bound on its change in one step holds all the more for these.
constexpr int kLookSteps = 10;

double toolForce(const WatchedRun& run) {
  return -totalForce(run.simulation(), toolVertices(run.block())).z();
}

/// The tool's force when the tissue has gone to sleep, or after `steps`.
struct Frozen {
  double force_n = 0.0;
  double largest_jump = 0.0;  ///< between two looks, as a share of the force, after the tool has come to rest
  double most_cells = 0.0;    ///< that were in the solve at once, share of all
};

Frozen pressUntilFrozen(WatchedRun& run, int steps) {
  lowerTool(run, kDepthH, kDepthH / kApproachSteps, kApproachSteps);
  Frozen frozen;
  frozen.force_n = toolForce(run);
  for (int n = 0; n < steps; n += kLookSteps) {
    run.step(kLookSteps);
    const double now_n = toolForce(run);
    frozen.largest_jump = std::max(frozen.largest_jump, std::abs(now_n / frozen.force_n - 1.0));
    frozen.force_n = now_n;
    const double share = double(run.simulation().activeCells()) / double(run.block().lattice.cellCount());
    frozen.most_cells = std::max(frozen.most_cells, share);
  }
  return frozen;
}

/// Largest change of the force while everything is awake again, as a share of the frozen force.
double changeByThawing(WatchedRun& run, double frozen_n) {
  double largest = 0.0;
  run.simulation().wakeAll();
  for (int n = 0; n < 300; n += kLookSteps) {
    run.step(kLookSteps);
    largest = std::max(largest, std::abs(toolForce(run) / frozen_n - 1.0));
  }
  return largest;
}

double fullForce(const Experiment& experiment, bool dissertation, int steps) {
  const std::unique_ptr<Block> block = makeExtremeBlock(experiment, dissertation);
  SimulationSettings settings = dissertation ? experiment.dissertation : experiment.ours;
  settings.active_set = ActiveSet::kAll;
  WatchedRun run(*block, settings, 1, dissertation);
  return pressUntilFrozen(run, steps).force_n;
}

}  // namespace

void toolSpeeds(const Options& options, Report& report) {
  ExtremeItem item(6, "speed", options, report);
  ToolShapes slowest;
  const std::vector<double> speeds =
      options.quick ? std::vector<double>{0.005, 2.0} : std::vector<double>{0.005, 0.02, 0.1, 0.5, 2.0};
  for (const double speed_h : speeds) {
    std::ostringstream name;
    name << "tool to 2 h at " << speed_h << " h a step: shape off that at 0.005, of the depth";
    Experiment experiment;
    experiment.cells = Vector3i::Constant(options.quick ? 6 : 8);
    experiment.quantities = {{name.str(), 0.01}};
    experiment.measure = [&, speed_h](WatchedRun& run) { return differenceOfSpeed(run, speed_h, slowest); };
    item.run(experiment);
  }
  item.reportAlways();
}

void hugeDeformations(const Options& options, Report& report) {
  ExtremeItem item(7, "deformed", options, report);
  Experiment experiment;
  experiment.cells = options.quick ? Vector3i(6, 6, 6) : Vector3i(8, 8, 8);
  std::vector<Shape> shapes;
  for (const Deformation& deformation : kDeformations) {
    shapes.emplace_back();
    experiment.quantities = {{std::string(deformation.name) + ", release: from rest, h", 0.01}};
    experiment.measure = [&](WatchedRun& run) {
      return deformAndRelease(run, deformation.path, options.quick ? 300 : 1000, shapes.back());
    };
    item.run(experiment);
  }
  plotDeformed(*makeExtremeBlock(experiment, false), shapes, options);
  item.reportAlways();
}

void precisionAndOrigin(const Options& options, Report& report) {
  const auto compare = [&](const std::string& name, const Variant& variant) {
    report.atMost("9 precision: " + name, largestDifference(variant, SimulationSettings(), 0.1, options), 1e-3,
                  largestDifference(variant, dissertationSettings(), 0.0, options));
  };
  compare("float against double, at any time, h", {Precision::kDouble, Vector3::Zero()});
  compare("origin 1e4 h away, float, at any time, h", {Precision::kFloat, Vector3::Constant(1e4 * kExtremeSpacingM)});
}

void freezingAndThawing(const Options& options, Report& report) {
  ExtremeItem item(10, "active", options, report);
  const int steps = options.quick ? 500 : 2000;
  Experiment experiment;
  experiment.cells = options.quick ? Vector3i(16, 16, 10) : Vector3i(24, 24, 16);
  experiment.dissertation = simulationPreset("reed1997");
  const double ours_n = fullForce(experiment, false, steps);
  const double dissertation_n = fullForce(experiment, true, steps);
  experiment.measure = [=](WatchedRun& run) {
    const Frozen frozen = pressUntilFrozen(run, steps);
    const double off = std::abs(frozen.force_n / (run.dissertation() ? dissertation_n : ours_n) - 1.0);
    return std::vector<double>{frozen.largest_jump, off, frozen.most_cells, changeByThawing(run, frozen.force_n)};
  };
  // The coarser threshold of `fast` leaves more of the lattice asleep, for which it promises no error.
  for (const std::string preset : {"balanced", "fast"}) {
    if (options.quick && preset == "fast")
      continue;
    const double error_bound = preset == "fast" ? kNoBound : 0.05;
    experiment.ours = simulationPreset(preset);
    experiment.quantities = {{preset + ", growing and freezing under load: largest force jump in 10 steps", 0.05},
                             {preset + ", grown answer's force, off that of the whole lattice", error_bound},
                             {preset + ", most cells in the solve, share of all", kNoBound},
                             {preset + ", thawing under load: largest force change", error_bound}};
    item.run(experiment);
  }
  item.reportAlways();
}

}  // namespace soft_volume::core::validate
