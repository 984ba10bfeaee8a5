#include "simulation_benchmark.h"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "lattice_blocks.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/setting_names.h"
#include "soft_volume/simulation/simulation.h"

namespace soft_volume::core {
namespace {

constexpr double kSpacing_m = 0.005;
constexpr double kYoungsModulus_pa = 10e3;
constexpr double kDampingRatio = 0.3;
/// About the stiffness of a vertex times the spacing: forces of this size fold cells.
constexpr double kStiffForce_n = kYoungsModulus_pa * kSpacing_m * kSpacing_m;

/// What a step is asked for.
enum class Load {
  kQuiet,    ///< a footprint presses steadily; nothing needs the guard
  kViolent,  ///< random forces of three times stiffness times spacing on all vertices, which turn round every 20 steps
};

struct Size {
  const char* name;
  Vector3i dims;
};
const Size kDissertationSize{"144", {6, 6, 4}};
const Size kMriSize{"3200", {10, 20, 16}};
const Size kBlock32{"32768", {32, 32, 32}};
const Size kBlock64{"262144", {64, 64, 64}};

/// A block whose bottom is fixed.
Lattice fixedBlock(const Vector3i& dims) {
  Lattice lattice = makeBlock(dims.x(), dims.y(), dims.z(), kSpacing_m);
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.fixed[v] = lattice.rest_positions[v].z() < 1e-9 ? 1 : 0;
  return lattice;
}

/// 5 x 5 vertices in the middle of the top, pressed by a fifth of the stiffness each.
std::vector<VertexLoad> footprint(const Lattice& lattice) {
  const Vector3 centre = kSpacing_m * Vector3(lattice.dims.x() / 2, lattice.dims.y() / 2, lattice.dims.z());
  std::vector<VertexLoad> loads;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    const Vector3 offset = lattice.rest_positions[v] - centre;
    if (offset.cwiseAbs().maxCoeff() < 2.1 * kSpacing_m && offset.z() > -0.1 * kSpacing_m)
      loads.push_back({v, Vector3(0.0, 0.0, -0.05 * kStiffForce_n)});
  }
  return loads;
}

std::vector<VertexLoad> randomLoads(const Lattice& lattice) {
  std::mt19937 random(1);  // NOLINT: the same forces in every run
  std::vector<VertexLoad> loads;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    Vector3 direction;
    for (int d = 0; d < 3; ++d)
      direction[d] = static_cast<double>(random()) / 2147483648.0 - 1.0;
    if (!lattice.fixed[v])
      loads.push_back({v, 3.0 * kStiffForce_n * direction});
  }
  return loads;
}

std::vector<VertexLoad> loadsFor(const Lattice& lattice, Load load) {
  return load == Load::kQuiet ? footprint(lattice) : randomLoads(lattice);
}

std::vector<VertexLoad> turned(std::vector<VertexLoad> loads) {
  for (VertexLoad& load : loads)
    load.force_n = -load.force_n;
  return loads;
}

/// What is measured, with all that it refers to.
class Subject {
 public:
  Subject(Lattice lattice, std::vector<Material> materials)
      : lattice_(std::move(lattice)), materials_(std::move(materials)) {}
  Subject(const Subject&) = delete;
  Subject& operator=(const Subject&) = delete;

  Simulation& simulate(const SimulationSettings& settings, int threads) {
    simulation_ = std::make_unique<Simulation>(lattice_, materials_, settings, threads);
    return *simulation_;
  }
  void simulate(const OracleSettings& settings) {
    oracle_ = std::make_unique<OracleSimulation>(lattice_, materials_, settings);
  }
  /// Loads that turn round every `turn_steps` steps; 0: never.
  void load(const std::vector<VertexLoad>& loads, std::uint64_t turn_steps) {
    loads_ = loads;
    turned_ = turned(loads);
    turn_steps_ = turn_steps;
    apply(loads_);
  }

  void advance() {
    if (turn_steps_ > 0 && steps_ > 0 && steps_ % turn_steps_ == 0)
      apply((steps_ / turn_steps_) % 2 == 0 ? loads_ : turned_);
    ++steps_;
    if (oracle_)
      oracle_->step();
    else
      simulation_->step();
  }

  const Lattice& lattice() const { return lattice_; }
  const std::vector<Material>& materials() const { return materials_; }
  Simulation* simulation() { return simulation_.get(); }

 private:
  void apply(const std::vector<VertexLoad>& loads) {
    if (simulation_) {
      simulation_->setLoads(loads);
      return;
    }
    std::vector<Vector3> forces(lattice_.vertexCount(), Vector3::Zero());
    for (const VertexLoad& load : loads)
      forces[load.vertex] = load.force_n;
    oracle_->setForces(forces);
  }

  Lattice lattice_;
  std::vector<Material> materials_;
  std::unique_ptr<Simulation> simulation_;
  std::unique_ptr<OracleSimulation> oracle_;
  std::vector<VertexLoad> loads_;
  std::vector<VertexLoad> turned_;
  std::uint64_t turn_steps_ = 0;
  std::uint64_t steps_ = 0;
};

using SubjectMaker = std::function<std::unique_ptr<Subject>()>;

/// Google Benchmark calls a case several times a repetition; large lattices take longer to make than to measure. All
/// subjects together hold about 4 GB.
Subject& subjectOf(const std::string& name, const SubjectMaker& make) {
  static std::map<std::string, std::unique_ptr<Subject>> subjects;
  std::unique_ptr<Subject>& subject = subjects[name];
  if (!subject)
    subject = make();
  return *subject;
}

/// Into the middle of what is measured: tissue in motion, caches filled.
constexpr int kWarmUpSteps = 40;

void countMemory(benchmark::State& state, Subject& subject) {
  double bytes = 0.0;
  for (const MemoryUse& use : subject.simulation()->memory())
    bytes += static_cast<double>(use.bytes);
  state.counters["bytes_per_vertex"] = bytes / static_cast<double>(subject.lattice().vertexCount());
}

void countStep(benchmark::State& state, Subject& subject) {
  const Simulation& simulation = *subject.simulation();
  const SimulationStats stats = simulation.stats();
  const auto steps = static_cast<double>(simulation.steps());
  countMemory(state, subject);
  state.counters["active_cells"] = static_cast<double>(simulation.activeCells());
  state.counters["dt_us"] = 1e6 * simulation.settings().dt_s;
  state.counters["limited_moves_per_step"] = static_cast<double>(stats.limited_moves) / steps;
  state.counters["solver_iterations_per_step"] = static_cast<double>(stats.solver_iterations) / steps;
}

void timeSteps(benchmark::State& state, Subject& subject) {
  for (auto _ : state)
    subject.advance();
  if (subject.simulation() != nullptr)
    countStep(state, subject);
}

struct StepCase {
  Size size = kMriSize;
  Load load = Load::kQuiet;
  double poisson_ratio = 0.25;
  int threads = 1;
  SimulationSettings settings;
};

std::unique_ptr<Subject> makeSubject(const Vector3i& dims, double poisson_ratio = 0.25) {
  return std::make_unique<Subject>(fixedBlock(dims), oneMaterial(kYoungsModulus_pa, kDampingRatio, poisson_ratio));
}

void loadAndWarmUp(Subject& subject, Load load) {
  subject.load(loadsFor(subject.lattice(), load), load == Load::kViolent ? 20 : 0);
  for (int n = 0; n < kWarmUpSteps; ++n)
    subject.advance();
}

std::unique_ptr<Subject> stepSubject(const StepCase& step_case) {
  auto subject = makeSubject(step_case.size.dims, step_case.poisson_ratio);
  subject->simulate(step_case.settings, step_case.threads).wakeAll();
  loadAndWarmUp(*subject, step_case.load);
  return subject;
}

std::unique_ptr<Subject> oracleSubject(const StepCase& step_case) {
  auto subject = makeSubject(step_case.size.dims, step_case.poisson_ratio);
  const Material& material = subject->materials().front();
  OracleSettings settings;
  settings.dt_s = 0.5 * bulkTimeStepLimit(material, subject->lattice().spacing_m);
  settings.damping_per_s = 20.0;
  settings.guard = step_case.settings.safe_move == SafeMove::kWidth;
  subject->simulate(settings);
  loadAndWarmUp(*subject, step_case.load);
  return subject;
}

std::uint32_t vertexAt(const Lattice& lattice, const Vector3i& node) {
  const std::size_t index = lattice.latticeNode(node.x(), node.y(), node.z());
  const auto found = std::find(lattice.lattice_nodes.begin(), lattice.lattice_nodes.end(), index);
  return static_cast<std::uint32_t>(found - lattice.lattice_nodes.begin());
}

/// 8^3 cells near one corner stay in the solve of a lattice of any size, pulled in their middle.
std::unique_ptr<Subject> activeCellsSubject(int lattice_cells, ActiveSet active_set) {
  // Undamped: to find the slowest mode of the large lattice would take minutes and changes nothing here.
  auto subject =
      std::make_unique<Subject>(fixedBlock(Vector3i::Constant(lattice_cells)), oneMaterial(kYoungsModulus_pa));
  SimulationSettings settings;
  settings.active_set = active_set;
  settings.activation_radius_m = 0.0;
  settings.lifetime_s = 1e6;
  settings.activation_threshold = 1e9;  // the same cells stay, whatever moves
  Simulation& simulation = subject->simulate(settings, 1);
  simulation.wake(Box3(Vector3::Constant(4.1 * kSpacing_m), kSpacing_m * Vector3(11.9, 11.9, 11.9)));
  subject->load({{vertexAt(subject->lattice(), {8, 8, 8}), Vector3(0.0, 0.0, 0.1 * kStiffForce_n)}}, 0);
  for (int n = 0; n < kWarmUpSteps; ++n)
    subject->advance();
  return subject;
}

/// A step that puts a region into the solve and one that takes it out again.
void benchmarkWake(benchmark::State& state, const Size& size) {
  const Lattice lattice = fixedBlock(size.dims);
  const std::vector<Material> materials = oneMaterial(kYoungsModulus_pa, kDampingRatio);
  SimulationSettings settings;
  settings.active_set = ActiveSet::kNeighbourhood;
  settings.activation_radius_m = 4.0 * kSpacing_m;
  settings.lifetime_s = 1e-9;  // one step
  Simulation simulation(lattice, materials, settings, 1);
  const Vector3 middle = 0.5 * kSpacing_m * size.dims.cast<double>();
  for (auto _ : state) {
    simulation.wake(Box3(middle, middle));
    simulation.step();
  }
  state.counters["cells_woken"] = static_cast<double>(simulation.cellsNear(middle, 4.0 * kSpacing_m).size());
}

void benchmarkHoldForce(benchmark::State& state, const Size& size) {
  const Lattice lattice = fixedBlock(size.dims);
  const std::vector<Material> materials = oneMaterial(kYoungsModulus_pa, kDampingRatio);
  Simulation simulation(lattice, materials, SimulationSettings(), 1);
  const Vector3 top = kSpacing_m * Vector3(size.dims.x() / 2, size.dims.y() / 2, size.dims.z());
  for (auto _ : state)
    benchmark::DoNotOptimize(simulation.holdForce("probe", -Vector3::UnitZ(), top, 3.0 * kSpacing_m, 1000000));
}

/// A simulation of a new lattice: springs, masses and, for the automatic step, the stability limit.
void benchmarkConstruct(benchmark::State& state, const Size& size) {
  const Lattice lattice = fixedBlock(size.dims);
  const std::vector<Material> materials = oneMaterial(kYoungsModulus_pa, kDampingRatio);
  for (auto _ : state) {
    const Simulation simulation(lattice, materials, SimulationSettings(), 1);
    benchmark::DoNotOptimize(simulation.settings());
  }
}

/// What a scene does not use, but could.
enum class Unused { kNothing, kVolumeEnergy, kSecondIntegrator };

std::unique_ptr<Subject> unusedSubject(Unused unused) {
  std::vector<Material> materials = oneMaterial(kYoungsModulus_pa, kDampingRatio);
  if (unused == Unused::kVolumeEnergy)  // a material that no cell has
    materials.push_back(oneMaterial(kYoungsModulus_pa, kDampingRatio, 0.45).front());
  auto subject = std::make_unique<Subject>(fixedBlock(kBlock32.dims), materials);
  SimulationSettings settings;
  settings.active_set = ActiveSet::kAll;
  Simulation& simulation = subject->simulate(settings, 1);
  if (unused == Unused::kSecondIntegrator) {
    simulation.setIntegrator(Integrator::kRungeKutta4, 0.0);
    simulation.step();
    simulation.setIntegrator(Integrator::kSymplecticEuler, 0.0);
  }
  loadAndWarmUp(*subject, Load::kQuiet);
  return subject;
}

/// The table of what holds memory, as counters; the time is that of making it.
void timeMemory(benchmark::State& state, Subject& subject) {
  for (auto _ : state)
    benchmark::DoNotOptimize(subject.simulation()->memory());
  countMemory(state, subject);
  for (const MemoryUse& use : subject.simulation()->memory())
    state.counters["bytes: " + use.what] = static_cast<double>(use.bytes);
}

// ------------------------------------------------------------------------------------------------------------ names

using Body = std::function<void(benchmark::State&)>;

void add(const std::string& what, const std::string& size, const std::string& variant, const Body& body) {
  benchmark::RegisterBenchmark(("simulation/" + what + "/" + size + "/" + variant).c_str(), body)
      ->Unit(benchmark::kMicrosecond);
}

StepCase stepCase(const Size& size, Precision precision, SafeMove safe_move, double poisson_ratio = 0.25) {
  StepCase result;
  result.size = size;
  result.poisson_ratio = poisson_ratio;
  result.settings.active_set = ActiveSet::kAll;
  result.settings.precision = precision;
  result.settings.safe_move = safe_move;
  return result;
}

/// A case that steps a subject; subjects live until the program ends.
void addSteps(const std::string& what, const std::string& size, const std::string& variant, const SubjectMaker& make) {
  const std::string key = what + "/" + size + "/" + variant;
  add(what, size, variant, [=](benchmark::State& state) { timeSteps(state, subjectOf(key, make)); });
}

void addStep(const std::string& variant, const StepCase& step_case) {
  addSteps("step", step_case.size.name, variant, [step_case] { return stepSubject(step_case); });
}

void addOracle(const std::string& variant, const StepCase& step_case) {
  addSteps("step", step_case.size.name, variant, [step_case] { return oracleSubject(step_case); });
}

StepCase violent(StepCase step_case) {
  step_case.load = Load::kViolent;
  return step_case;
}

void addStepVariants(const Size& size) {
  addOracle("oracle", stepCase(size, Precision::kDouble, SafeMove::kWidth));
  addOracle("oracle_unguarded", stepCase(size, Precision::kDouble, SafeMove::kNone));
  addOracle("oracle_nu_0.45", stepCase(size, Precision::kDouble, SafeMove::kWidth, 0.45));
  for (const Precision precision : {Precision::kFloat, Precision::kDouble}) {
    const std::string name = nameOf(precision);
    addStep(name, stepCase(size, precision, SafeMove::kWidth));
    addStep(name + "_unguarded", stepCase(size, precision, SafeMove::kNone));
    addStep(name + "_nu_0.45", stepCase(size, precision, SafeMove::kWidth, 0.45));
    addStep(name + "_nu_0.45_unguarded", stepCase(size, precision, SafeMove::kNone, 0.45));
    addStep(name + "_violent", violent(stepCase(size, precision, SafeMove::kWidth)));
  }
  addStep("float_dissertation_guard", stepCase(size, Precision::kFloat, SafeMove::kDissertation));
}

/// The largest lattice takes long, so only what its numbers to reach need.
void addLargeSteps(const Size& size) {
  addOracle("oracle", stepCase(size, Precision::kDouble, SafeMove::kWidth));
  addStep("float", stepCase(size, Precision::kFloat, SafeMove::kWidth));
  addStep("float_unguarded", stepCase(size, Precision::kFloat, SafeMove::kNone));
  addStep("float_nu_0.45", stepCase(size, Precision::kFloat, SafeMove::kWidth, 0.45));
}

void addThreads(const Size& size) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    StepCase step_case = stepCase(size, Precision::kFloat, SafeMove::kWidth, poisson_ratio);
    step_case.threads = 2;
    addStep(poisson_ratio == 0.25 ? "float_2_threads" : "float_nu_0.45_2_threads", step_case);
  }
}

/// A step of every integrator at its automatic step; 5 ms where it has no limit.
void addIntegrators(const Size& size) {
  for (const auto& named : kChoices<Integrator>) {
    StepCase step_case = stepCase(size, Precision::kFloat, SafeMove::kWidth, 0.45);
    step_case.settings.integrator = named.choice;
    const bool implicit = named.choice == Integrator::kBackwardEuler || named.choice == Integrator::kQuasiStatic;
    step_case.settings.dt_s = implicit ? 0.005 : 0.0;
    addSteps("integrator", size.name, named.name, [step_case] { return stepSubject(step_case); });
  }
}

void addActiveCells() {
  for (const ActiveSet active_set : {ActiveSet::kNeighbourhood, ActiveSet::kGrowth}) {
    for (const int cells : {16, 128}) {
      addSteps("active_500_of", std::to_string(cells * cells * cells), nameOf(active_set),
               [=] { return activeCellsSubject(cells, active_set); });
    }
  }
}

void addUnused() {
  addSteps("unused", kBlock32.name, "nothing", [] { return unusedSubject(Unused::kNothing); });
  addSteps("unused", kBlock32.name, "volume_energy", [] { return unusedSubject(Unused::kVolumeEnergy); });
  addSteps("unused", kBlock32.name, "second_integrator", [] { return unusedSubject(Unused::kSecondIntegrator); });
}

void addMemory(const Size& size) {
  for (const Precision precision : {Precision::kFloat, Precision::kDouble}) {
    for (const double poisson_ratio : {0.25, 0.45}) {
      const std::string variant = std::string(nameOf(precision)) + (poisson_ratio == 0.25 ? "" : "_nu_0.45");
      const StepCase step_case = stepCase(size, precision, SafeMove::kWidth, poisson_ratio);
      // The subject of the step of the same name.
      const std::string key = std::string("step/") + size.name + "/" + variant;
      add("memory", size.name, variant, [=](benchmark::State& state) {
        timeMemory(state, subjectOf(key, [step_case] { return stepSubject(step_case); }));
      });
    }
  }
}

}  // namespace

void registerSimulationBenchmarks() {
  for (const Size& size : {kDissertationSize, kMriSize, kBlock32})
    addStepVariants(size);
  addLargeSteps(kBlock64);
  addThreads(kBlock64);
  addIntegrators(kMriSize);
  addActiveCells();
  addUnused();
  addMemory(kMriSize);
  addMemory(kBlock32);
  for (const Size& size : {kMriSize, kBlock32}) {
    add("wake", size.name, "neighbourhood", [size](benchmark::State& state) { benchmarkWake(state, size); });
    add("hold_force", size.name, "probe", [size](benchmark::State& state) { benchmarkHoldForce(state, size); });
    add("construct", size.name, "automatic_step", [size](benchmark::State& state) { benchmarkConstruct(state, size); });
  }
}

}  // namespace soft_volume::core
