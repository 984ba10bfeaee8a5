#include "simulation_sweep.h"

#include <algorithm>
#include <cmath>
#include <ctime>

#include "soft_volume/common/error.h"
#include "soft_volume/simulation/presets.h"

namespace soft_volume::core {
namespace {

constexpr double kLongRun_s = 2.0;          ///< longer runs are not repeated: they average disturbances by themselves
constexpr double kReferenceFraction = 0.6;  ///< of the stability limit

/// Processor time of this thread, seconds: what other programs take meanwhile does not count.
double processorTime() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

/// What one run of a scene yields.
struct SceneRun {
  std::vector<std::vector<Vector3>> samples;  ///< per sample time, displacement of every probe
  std::vector<double> interval_s;             ///< processor time between samples
  SweepResult facts;                          ///< all but cost and errors
};

double median(std::vector<double> values) {
  const std::size_t middle = values.size() / 2;
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(middle), values.end());
  return values[middle];
}

/// The largest step not over `dt_s` that divides the sample interval.
double dividingStep(const TradeoffScene& scene, double dt_s) {
  return scene.sample_s / std::ceil(scene.sample_s / dt_s * (1.0 - 1e-9));
}

/// A simulation whose steps meet the scene's sample times.
Simulation makeSimulation(const TradeoffScene& scene, const SweepSetting& setting, const Lattice& lattice,
                          const std::vector<Material>& materials) {
  SimulationSettings settings = setting.simulation;
  Simulation simulation(lattice, materials, settings, 1);
  settings.dt_s = dividingStep(scene, simulation.settings().dt_s);
  if (settings.dt_s < simulation.settings().dt_s)
    simulation.setIntegrator(settings.integrator, settings.dt_s);
  if (settings.active_set == ActiveSet::kAll)
    simulation.wakeAll();
  return simulation;
}

/// Follows a scene; only what a user of the simulation would pay for is timed.
class SceneRunner {
 public:
  SceneRunner(const TradeoffScene& scene, const Lattice& lattice, Simulation& simulation)
      : scene_(scene), lattice_(lattice), simulation_(simulation) {}

  /// Processor time of the steps up to a time of the scene.
  double advanceTo(double end_s) {
    const double dt_s = simulation_.settings().dt_s;
    const auto last = static_cast<std::uint64_t>(std::lround(end_s / dt_s));
    double spent_s = 0.0;
    while (simulation_.steps() < last) {
      // The load in the middle of a step makes its error second order for every integrator.
      const double middle_s = (static_cast<double>(simulation_.steps()) + 0.5) * dt_s;
      const std::vector<VertexLoad> loads = vertexLoads(lattice_, scene_.forces(middle_s));
      const double begin_s = processorTime();
      if (!same(loads))
        simulation_.setLoads(loads);
      simulation_.step();
      spent_s += processorTime() - begin_s;
      loads_ = loads;
      active_cells_ += static_cast<double>(simulation_.activeCells());
    }
    return spent_s;
  }

  double meanActiveCells() const { return active_cells_ / static_cast<double>(simulation_.steps()); }

 private:
  bool same(const std::vector<VertexLoad>& loads) const {
    return std::equal(
        loads.begin(), loads.end(), loads_.begin(), loads_.end(),
        [](const VertexLoad& a, const VertexLoad& b) { return a.vertex == b.vertex && a.force_n == b.force_n; });
  }

  const TradeoffScene& scene_;
  const Lattice& lattice_;
  Simulation& simulation_;
  std::vector<VertexLoad> loads_;
  double active_cells_ = 0.0;
};

double bytesPerVertex(const Simulation& simulation, std::size_t vertices) {
  double bytes = 0.0;
  for (const MemoryUse& use : simulation.memory())
    bytes += static_cast<double>(use.bytes);
  return bytes / static_cast<double>(vertices);
}

double largestDisplacement(const SceneRun& run) {
  double largest = 0.0;
  for (const std::vector<Vector3>& sample : run.samples) {
    for (const Vector3& displacement : sample)
      largest = std::max(largest, displacement.norm());
  }
  return largest;
}

SceneRun followScene(const TradeoffScene& scene, const SweepSetting& setting) {
  const Lattice lattice = sceneLattice(scene, setting.spacing_m);
  const std::vector<Material> materials = {scene.material};
  Simulation simulation = makeSimulation(scene, setting, lattice, materials);
  SceneRunner runner(scene, lattice, simulation);
  SceneRun run;
  const auto samples = std::lround(scene.duration_s / scene.sample_s);
  for (long n = 1; n <= samples; ++n) {
    run.interval_s.push_back(runner.advanceTo(static_cast<double>(n) * scene.sample_s));
    run.samples.push_back(displacementsAt(lattice, simulation.state().displacements_m, scene.probes_m));
  }
  run.facts.cells = lattice.cellCount();
  run.facts.vertices = lattice.vertexCount();
  run.facts.dt_s = simulation.settings().dt_s;
  run.facts.limit_s = simulation.stabilityLimit();
  run.facts.mean_active_cells = runner.meanActiveCells();
  run.facts.limited_moves = simulation.limitedMoves();
  run.facts.largest_displacement_m = largestDisplacement(run);
  run.facts.bytes_per_vertex = bytesPerVertex(simulation, lattice.vertexCount());
  return run;
}

/// A setting that the simulation refuses is a result too.
SceneRun tryScene(const TradeoffScene& scene, const SweepSetting& setting) {
  SceneRun run;
  try {
    run = followScene(scene, setting);
  } catch (const Error& error) {
    run.facts.failure = error.what();
  }
  run.facts.setting = setting;
  return run;
}

double relativeError(const SceneRun& run, const SceneRun& reference) {
  double squares = 0.0;
  std::size_t count = 0;
  for (std::size_t n = 0; n < run.samples.size(); ++n) {
    for (std::size_t p = 0; p < run.samples[n].size(); ++p)
      squares += (run.samples[n][p] - reference.samples[n][p]).squaredNorm();
    count += run.samples[n].size();
  }
  const double error = std::sqrt(squares / static_cast<double>(count)) / reference.facts.largest_displacement_m;
  return std::isfinite(error) ? error : std::numeric_limits<double>::infinity();
}

double knownError(const SceneRun& run, const KnownAnswer& known) {
  Vector3 mean = Vector3::Zero();
  for (const Vector3& displacement : run.samples.back())
    mean += displacement / static_cast<double>(run.samples.back().size());
  const double error = std::abs(mean.dot(known.direction) / known.displacement_m - 1.0);
  return std::isfinite(error) ? error : std::numeric_limits<double>::infinity();
}

/// `runs` holds the reference last.
void addErrors(const TradeoffScene& scene, const std::vector<SceneRun>& runs, const SceneRun& run,
               SweepResult& result) {
  result.reference_error = relativeError(run, runs.back());
  if (scene.known)
    result.known_error = knownError(run, *scene.known);
  for (const SceneRun& other : runs) {
    const SweepSetting& setting = other.facts.setting;
    if (setting.is_lattice_reference && setting.spacing_m == run.facts.setting.spacing_m && other.facts.failure.empty())
      result.same_lattice_error = relativeError(run, other);
  }
}

/// Sum over the scene's intervals of the medians over the runs.
double medianCost(const std::vector<std::vector<double>>& interval_s_of_runs) {
  double cost = 0.0;
  for (std::size_t n = 0; n < interval_s_of_runs.front().size(); ++n) {
    std::vector<double> times;
    for (const std::vector<double>& run : interval_s_of_runs)
      times.push_back(run[n]);
    cost += median(times);
  }
  return cost;
}

bool worthRepeating(const SceneRun& run) {
  return run.facts.failure.empty() && medianCost({run.interval_s}) < kLongRun_s;
}

/// Passes over the lattice that a step needs, roughly.
double passes(const SimulationSettings& settings) {
  switch (settings.integrator) {
    case Integrator::kRungeKutta4:
      return 4.0;
    case Integrator::kAdaptive:
      return 14.0;
    case Integrator::kBackwardEuler:
      return 150.0;
    default:
      return 1.0;
  }
}

/// For the progress alone.
double estimatedWork(const TradeoffScene& scene, const SweepSetting& setting) {
  const double cells = scene.size_m.prod() / std::pow(setting.spacing_m, 3);
  const double limit_s = bulkTimeStepLimit(scene.material, Vector3::Constant(setting.spacing_m));
  const double dt_s =
      isExplicit(setting.simulation.integrator) ? setting.simulation.dt_fraction * limit_s : setting.simulation.dt_s;
  const double precision = setting.simulation.precision == Precision::kDouble ? 2.0 : 1.0;
  return (1.0 + cells / 200.0) * passes(setting.simulation) * precision * scene.duration_s / dt_s;
}

SimulationSettings explicitSettings(Integrator integrator, double fraction) {
  SimulationSettings settings;
  settings.integrator = integrator;
  settings.dt_fraction = fraction;
  return settings;
}

SimulationSettings implicitSettings(Integrator integrator, double dt_s) {
  SimulationSettings settings;
  settings.integrator = integrator;
  settings.dt_s = dt_s;
  return settings;
}

SimulationSettings adaptiveSettings(double tolerance) {
  SimulationSettings settings = explicitSettings(Integrator::kAdaptive, 0.9);
  settings.error_tolerance = tolerance;
  return settings;
}

constexpr double kUsualFraction = 0.9;

std::vector<SimulationSettings> timeSteppings(bool quick) {
  std::vector<SimulationSettings> all = {explicitSettings(Integrator::kDissertation, 0.9),
                                         explicitSettings(Integrator::kSymplecticEuler, 0.3),
                                         explicitSettings(Integrator::kSymplecticEuler, kUsualFraction),
                                         explicitSettings(Integrator::kRungeKutta4, 0.9),
                                         implicitSettings(Integrator::kBackwardEuler, 0.005),
                                         adaptiveSettings(1e-4)};
  if (quick)
    return all;
  for (const SimulationSettings& more :
       {explicitSettings(Integrator::kDissertation, 0.3), explicitSettings(Integrator::kSymplecticEuler, 0.6),
        implicitSettings(Integrator::kBackwardEuler, 0.025), implicitSettings(Integrator::kQuasiStatic, 0.001),
        adaptiveSettings(1e-6)})
    all.push_back(more);
  return all;
}

SimulationSettings withActiveSet(SimulationSettings settings, ActiveSet active_set, double threshold) {
  settings.active_set = active_set;
  settings.activation_threshold = threshold;
  return settings;
}

/// The stepping that is tried on every lattice and with every active set.
bool isUsual(const SimulationSettings& settings) {
  return settings.integrator == Integrator::kSymplecticEuler && settings.dt_fraction == kUsualFraction;
}

/// A setting with every active set that is compared.
std::vector<SimulationSettings> activeSets(const SimulationSettings& settings, bool quick) {
  std::vector<SimulationSettings> all = {withActiveSet(settings, ActiveSet::kAll, settings.activation_threshold),
                                         withActiveSet(settings, ActiveSet::kGrowth, settings.activation_threshold)};
  if (quick)
    return all;
  all.push_back(withActiveSet(settings, ActiveSet::kGrowth, 1e-2));
  all.push_back(withActiveSet(settings, ActiveSet::kGrowth, 1e-3));
  all.push_back(withActiveSet(settings, ActiveSet::kNeighbourhood, settings.activation_threshold));
  return all;
}

void addBothPrecisions(std::vector<SweepSetting>& settings, double spacing_m, SimulationSettings simulation) {
  for (const Precision precision : {Precision::kFloat, Precision::kDouble}) {
    simulation.precision = precision;
    settings.push_back({spacing_m, simulation, ""});
  }
}

/// Every way of stepping, and every active set with the usual one.
void addCross(std::vector<SweepSetting>& settings, double spacing_m, bool quick) {
  for (const SimulationSettings& stepping : timeSteppings(quick)) {
    if (!isUsual(stepping)) {
      addBothPrecisions(settings, spacing_m, withActiveSet(stepping, ActiveSet::kAll, stepping.activation_threshold));
      continue;
    }
    for (const SimulationSettings& simulation : activeSets(stepping, quick))
      addBothPrecisions(settings, spacing_m, simulation);
  }
}

void addLine(std::vector<SweepSetting>& settings, double spacing_m) {
  const SimulationSettings stepping = explicitSettings(Integrator::kSymplecticEuler, kUsualFraction);
  for (const SimulationSettings& simulation : activeSets(stepping, true))
    addBothPrecisions(settings, spacing_m, simulation);
}

SimulationSettings convergedSettings() {
  SimulationSettings settings = explicitSettings(Integrator::kRungeKutta4, kReferenceFraction);
  settings.precision = Precision::kDouble;
  settings.active_set = ActiveSet::kAll;
  return settings;
}

}  // namespace

bool isExplicit(Integrator integrator) {
  return integrator != Integrator::kBackwardEuler && integrator != Integrator::kQuasiStatic;
}

std::vector<SweepSetting> sweepSettings(bool quick) {
  std::vector<SweepSetting> settings;
  const std::vector<double> crossed_m = quick ? std::vector<double>{0.01} : std::vector<double>{0.01, 0.005};
  const std::vector<double> lines_m =
      quick ? std::vector<double>{0.02} : std::vector<double>{0.02, 0.02 / 3.0, 0.004, 0.01 / 3.0, 0.0025};
  for (const double spacing_m : crossed_m) {
    addCross(settings, spacing_m, quick);
    for (const std::string& preset : simulationPresetNames())
      settings.push_back({spacing_m, simulationPreset(preset), preset});
    settings.push_back({spacing_m, convergedSettings(), "", false, true});
  }
  for (const double spacing_m : lines_m)
    addLine(settings, spacing_m);
  settings.push_back({quick ? 0.005 : 0.002, convergedSettings(), "", true, true});
  return settings;
}

std::vector<SweepResult> runSweep(const TradeoffScene& scene, const std::vector<SweepSetting>& settings, int repeats,
                                  const std::function<void(double, double)>& progress) {
  const double total = sweepWork(scene, settings, repeats);
  double done = 0.0;
  std::vector<SceneRun> first;
  std::vector<std::vector<std::vector<double>>> interval_s(settings.size());
  for (int repeat = 0; repeat < repeats; ++repeat) {
    for (std::size_t n = 0; n < settings.size(); ++n) {
      done += estimatedWork(scene, settings[n]);
      if (repeat > 0 && !worthRepeating(first[n]))
        continue;
      SceneRun run = tryScene(scene, settings[n]);
      interval_s[n].push_back(run.interval_s);
      if (repeat == 0)
        first.push_back(std::move(run));
      progress(done, total);
    }
  }
  const SceneRun& reference = first.back();
  if (!reference.facts.failure.empty())
    throw SceneError("the reference of scene " + scene.name + " cannot run: " + reference.facts.failure);
  std::vector<SweepResult> results;
  for (std::size_t n = 0; n < settings.size(); ++n) {
    SweepResult result = first[n].facts;
    result.repeats = static_cast<int>(interval_s[n].size());
    if (result.failure.empty()) {
      result.ms_per_simulated_s = 1e3 * medianCost(interval_s[n]) / scene.duration_s;
      addErrors(scene, first, first[n], result);
    }
    results.push_back(result);
  }
  return results;
}

double sweepWork(const TradeoffScene& scene, const std::vector<SweepSetting>& settings, int repeats) {
  double work = 0.0;
  for (const SweepSetting& setting : settings)
    work += repeats * estimatedWork(scene, setting);
  return work;
}

}  // namespace soft_volume::core
