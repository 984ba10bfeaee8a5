// Extremes 4, 5 and 8: steps far beyond the stability limit, masses and stiffness far apart, and what is conserved.

#include <cmath>
#include <random>
#include <sstream>

#include "extremes.h"
#include "soft_volume/simulation/setting_names.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kStill = 1e-6;       ///< of h in a step
constexpr double kSameAnswer = 1e-4;  ///< of the largest displacement
constexpr int kRestSteps = 20000;

Vector3i blockCells(const Options& options) {
  return Vector3i::Constant(options.quick ? 6 : 8);
}

/// A sideways load on the top, which bends and shears the block by some per cent.
void loadTop(WatchedRun& run) {
  std::vector<VertexLoad> loads;
  for (const std::uint32_t v : run.block().layer(2, run.block().lattice.dims.z()))
    loads.push_back({v, Vector3(0.02, 0.0, -0.02) * run.block().springForce()});
  run.simulation().setLoads(loads);
}

/// Steps until the block rests, and returns the largest move of the last steps, of h.
double moveAtRest(WatchedRun& run, int steps) {
  loadTop(run);
  run.step(steps);
  double largest = 0.0;
  for (int n = 0; n < 20; ++n) {
    const std::vector<Vector3> before = run.simulation().positions();
    run.step();
    largest = std::max(largest, largestDistance(before, run.simulation().positions()) / run.h());
  }
  return largest;
}

double limitOf(const Block& block) {
  return Simulation(block.lattice, block.materials, exactSettings(), 1).stabilityLimit();
}

std::vector<Vector3> staticAnswer(const Block& block) {
  WatchedRun run(block, exactSettings(), 1, false);
  loadTop(run);
  if (!settle(run.simulation(), 1e-8 * block.edge(), kRestSteps))
    throw std::runtime_error("the static answer did not come to rest");
  return run.simulation().state().displacements_m;
}

struct Mode {
  Integrator integrator;
  double times_limit;
  bool substeps;
};

SimulationSettings settingsFor(const Mode& mode, double limit_s) {
  SimulationSettings settings = exactSettings();
  settings.integrator = mode.integrator;
  settings.dt_s = mode.times_limit * limit_s;
  settings.substeps = mode.substeps;
  return settings;
}

std::string nameOf(const Mode& mode) {
  std::ostringstream name;
  name << "dt " << mode.times_limit << " limits, " << core::nameOf(mode.integrator)
       << (mode.substeps ? " in substeps" : "");
  return name.str();
}

/// The answer of a few long implicit steps, for contrasts that explicit ones take too long over.
std::vector<Vector3> implicitAnswer(const Block& block, double limit_s) {
  WatchedRun run(block, settingsFor({Integrator::kBackwardEuler, 100.0, false}, limit_s), 1, false);
  loadTop(run);
  if (!settle(run.simulation(), 1e-8 * block.edge(), kRestSteps))
    throw std::runtime_error("the static answer did not come to rest");
  return run.simulation().state().displacements_m;
}

/// Two rows: how still it is, and how far from the answer.
void runMode(ExtremeItem& item, Experiment experiment, const std::string& name, const std::vector<Vector3>& answer,
             int steps) {
  experiment.quantities = {{name + ": move in a step at rest, h", kStill},
                           {name + ": off the static answer", kSameAnswer}};
  experiment.measure = [&](WatchedRun& run) {
    const double move = moveAtRest(run, steps);
    const double off = largestDistance(run.simulation().state().displacements_m, answer) / largestNorm(answer);
    return std::vector<double>{move, off};
  };
  item.run(experiment);
}

/// Small random velocities, which strain the block by less than 1 %.
void shake(WatchedRun& run) {
  std::mt19937_64 random(8);
  const double sound_m_s = std::sqrt(kYoungPa / tissue().density_kg_m3);
  std::uniform_real_distribution<double> speed(-5e-3 * sound_m_s, 5e-3 * sound_m_s);
  std::vector<Vector3> velocities;
  for (std::size_t v = 0; v < run.block().lattice.vertexCount(); ++v)
    velocities.push_back({speed(random), speed(random), speed(random)});
  setMotion(run.simulation(), std::vector<Vector3>(velocities.size(), Vector3::Zero()), velocities);
}

double energy(const Simulation& simulation) {
  const Mechanics mechanics = simulation.mechanics();
  return mechanics.kinetic_j + mechanics.elastic_j;
}

double largestEnergyGrowth(WatchedRun& run, int steps) {
  shake(run);
  const double first = energy(run.simulation());
  double before = first;
  double growth = -first;
  for (int n = 0; n < steps; ++n) {
    run.step();
    const double now = energy(run.simulation());
    growth = std::max(growth, now - before);
    before = now;
  }
  return growth / first;
}

struct Momenta {
  Vector3 linear;
  Vector3 angular;
  double linear_scale = 0.0;   ///< sum of m |v|
  double angular_scale = 0.0;  ///< sum of m |r| |v|
};

Momenta momenta(const WatchedRun& run) {
  const Mechanics mechanics = run.simulation().mechanics();
  Momenta all{mechanics.linear_momentum_kg_m_s, mechanics.angular_momentum_kg_m2_s};
  for (std::uint32_t v = 0; v < run.block().lattice.vertexCount(); ++v) {
    const double momentum = run.simulation().mass(v) * run.simulation().velocities()[v].norm();
    all.linear_scale += momentum;
    all.angular_scale += momentum * run.simulation().positions()[v].norm();
  }
  return all;
}

/// Shares of linear and angular momentum lost, and the drift of the energy: its mean over the last tenth of the run,
/// which is several periods of the slowest mode, against the first.
std::vector<double> conservationIn(WatchedRun& run, int steps) {
  shake(run);
  const Momenta before = momenta(run);
  double first = 0.0;
  double last = 0.0;
  for (int n = 0; n < steps; ++n) {
    run.step();
    if (n < steps / 10)
      first += energy(run.simulation());
    if (n >= steps - steps / 10)
      last += energy(run.simulation());
  }
  const Momenta after = momenta(run);
  return {(after.linear - before.linear).norm() / before.linear_scale,
          (after.angular - before.angular).norm() / before.angular_scale, std::abs(last / first - 1.0)};
}

Experiment shakenBlock(Integrator integrator) {
  Experiment experiment;
  experiment.free = true;
  experiment.damping_ratio = 0.0;
  experiment.ours = exactSettings();
  experiment.ours.integrator = integrator;
  return experiment;
}

/// Cells of the lower half in x get the second material.
void halve(Block& block, const Material& other) {
  block.materials.push_back(other);
  for (std::size_t cell = 0; cell < block.lattice.cellCount(); ++cell) {
    const Vector3i at = block.lattice.cellIndex(block.lattice.parent_cells[cell]);
    block.lattice.materials[cell] = 2 * at.x() < block.lattice.dims.x() ? 1 : 0;
  }
}

}  // namespace

void longSteps(const Options& options, Report& report) {
  ExtremeItem item(4, "steps", options, report);
  Experiment experiment;
  experiment.cells = blockCells(options);
  const std::unique_ptr<Block> block = makeExtremeBlock(experiment, false);
  const double limit_s = limitOf(*block);
  const std::vector<Vector3> answer = staticAnswer(*block);
  const std::vector<Mode> modes{{Integrator::kSymplecticEuler, 1.0, true},   {Integrator::kRungeKutta4, 1.0, false},
                                {Integrator::kSymplecticEuler, 3.0, true},   {Integrator::kBackwardEuler, 3.0, false},
                                {Integrator::kBackwardEuler, 30.0, false},   {Integrator::kQuasiStatic, 30.0, false},
                                {Integrator::kBackwardEuler, 3000.0, false}, {Integrator::kQuasiStatic, 3000.0, false}};
  for (const Mode& mode : modes) {
    if (options.quick && (mode.times_limit == 1.0 || mode.integrator == Integrator::kSymplecticEuler))
      continue;
    experiment.ours = settingsFor(mode, limit_s);
    experiment.dissertation.dt_s = mode.times_limit * limitOf(*makeExtremeBlock(experiment, true));
    runMode(item, experiment, nameOf(mode), answer, mode.integrator == Integrator::kBackwardEuler ? 200 : 2000);
  }
  item.reportAlways();
}

void unequalMassAndStiffness(const Options& options, Report& report) {
  ExtremeItem item(5, "contrast", options, report);
  Experiment uniform;
  uniform.cells = blockCells(options);
  const double dt_s = 0.6 * limitOf(*makeExtremeBlock(uniform, false));
  Material light = tissue(0.25, 1.0);
  light.density_kg_m3 *= 1e-6;
  Material stiff = tissue(0.25, 1.0);
  stiff.youngs_modulus_pa *= 1e6;
  const std::pair<const char*, Material> contrasts[] = {{"masses 1e-6 to 1", light}, {"stiffness times 1e6", stiff}};
  for (const auto& contrast : contrasts) {
    Experiment experiment = uniform;
    experiment.prepare = [&](Block& block) { halve(block, contrast.second); };
    const std::vector<Vector3> answer = implicitAnswer(*makeExtremeBlock(experiment, false), dt_s);
    for (const Integrator integrator : {Integrator::kQuasiStatic, Integrator::kBackwardEuler}) {
      experiment.ours = settingsFor({integrator, 1.0, false}, dt_s);
      const int steps = options.quick ? 1000 : 3000;
      runMode(item, experiment, std::string(contrast.first) + ", " + core::nameOf(integrator), answer, steps);
    }
  }
  item.reportAlways();
}

void conservation(const Options& options, Report& report) {
  ExtremeItem item(8, "conserved", options, report);
  const int steps = options.quick ? 2000 : 10000;
  Experiment experiment = shakenBlock(Integrator::kBackwardEuler);
  experiment.ours.dt_s = 3.0 * limitOf(*makeExtremeBlock(experiment, false));
  experiment.quantities = {{"backward_euler, dt 3 limits: energy growth in a step", 1e-9}};
  experiment.measure = [=](WatchedRun& run) {
    return std::vector<double>{largestEnergyGrowth(run, options.quick ? 200 : 1000)};
  };
  item.run(experiment);

  experiment = shakenBlock(Integrator::kSymplecticEuler);
  experiment.ours.safe_move = SafeMove::kNone;
  experiment.quantities = {{"symplectic_euler: linear momentum lost", 1e-10},
                           {"symplectic_euler: angular momentum lost", 1e-10},
                           {"symplectic_euler: drift of the mean energy", 0.01}};
  experiment.measure = [=](WatchedRun& run) { return conservationIn(run, steps); };
  item.run(experiment);
  for (const Integrator integrator :
       {Integrator::kDissertation, Integrator::kRungeKutta4, Integrator::kBackwardEuler, Integrator::kAdaptive}) {
    const std::string name = core::nameOf(integrator);
    experiment = shakenBlock(integrator);
    experiment.quantities = {{name + ": linear momentum lost", 1e-10}};
    experiment.measure = [=](WatchedRun& run) {
      return std::vector<double>{conservationIn(run, options.quick ? 200 : 1000).front()};
    };
    item.run(experiment);
  }
  item.reportAlways();
}

}  // namespace soft_volume::core::validate
