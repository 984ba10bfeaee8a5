// Undamped vibration in the lattice's own modes, whose motion is known exactly: what is left is the integrator's error.

#include <Eigen/Eigenvalues>
#include <array>
#include <cmath>
#include <memory>
#include <sstream>

#include "blocks.h"
#include "report.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/setting_names.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kSpacingM = 0.01;
/// Of a cell edge: small enough for the stiffness at rest to hold.
constexpr double kAmplitude = 1e-4;
constexpr double kDtFraction = 0.6;

/// The slowest mode of a block: exact for small motion.
struct Mode {
  double frequency_rad_s = 0.0;
  std::vector<Vector3> shape;  ///< largest displacement 1
};

/// Central differences of the oracle's forces at rest.
Eigen::MatrixXd stiffnessAtRest(const Block& block, const std::vector<std::uint32_t>& movable) {
  const OracleModel model(block.lattice, block.materials, SpringRule::kIsotropic);
  const double tiny_m = 1e-6 * kSpacingM;
  const auto size = static_cast<Eigen::Index>(3 * movable.size());
  Eigen::MatrixXd stiffness(size, size);
  std::vector<Vector3> displacements(block.lattice.vertexCount(), Vector3::Zero());
  const auto forces = [&](Eigen::Index column, double displacement_m) {
    std::vector<Vector3> sum(displacements.size(), Vector3::Zero());
    displacements[movable[column / 3]][column % 3] = displacement_m;
    model.addForces(displacements, sum);
    displacements[movable[column / 3]][column % 3] = 0.0;
    return sum;
  };
  for (Eigen::Index column = 0; column < size; ++column) {
    const std::vector<Vector3> forward = forces(column, tiny_m);
    const std::vector<Vector3> backward = forces(column, -tiny_m);
    for (Eigen::Index row = 0; row < size; ++row) {
      const std::uint32_t v = movable[row / 3];
      stiffness(row, column) = -(forward[v] - backward[v])[row % 3] / (2.0 * tiny_m);
    }
  }
  return 0.5 * (stiffness + stiffness.transpose());
}

Mode slowestMode(const Block& block) {
  const std::vector<std::uint32_t> movable =
      block.verticesWhere([&](const Vector3i& n) { return !block.lattice.fixed[block.vertex(n.x(), n.y(), n.z())]; });
  const std::vector<double> masses = oracleMasses(block.lattice, block.materials);
  Eigen::MatrixXd matrix = stiffnessAtRest(block, movable);
  Eigen::VectorXd inverse_root(matrix.rows());
  for (Eigen::Index row = 0; row < matrix.rows(); ++row)
    inverse_root[row] = 1.0 / std::sqrt(masses[movable[row / 3]]);
  matrix = inverse_root.asDiagonal() * matrix * inverse_root.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(matrix);
  Mode mode;
  mode.frequency_rad_s = std::sqrt(solver.eigenvalues()[0]);
  mode.shape.assign(block.lattice.vertexCount(), Vector3::Zero());
  const Eigen::VectorXd shape = inverse_root.cwiseProduct(solver.eigenvectors().col(0));
  for (std::size_t n = 0; n < movable.size(); ++n)
    mode.shape[movable[n]] = shape.segment<3>(static_cast<Eigen::Index>(3 * n));
  const double largest = largestNorm(mode.shape);
  for (Vector3& v : mode.shape)
    v /= largest;
  return mode;
}

struct Run {
  double period_s = 0.0;       ///< mean of all whole periods
  double energy_ratio = 0.0;   ///< mean of the last period over the mean of the first
  double periods_apart = 0.0;  ///< between those two
};

double energy(const Simulation& simulation) {
  const Mechanics mechanics = simulation.mechanics();
  return mechanics.kinetic_j + mechanics.elastic_j;
}

/// How far the motion is along the mode: 1 at the start.
double amplitude(const Simulation& simulation, const Mode& mode) {
  double along = 0.0;
  double whole = 0.0;
  for (std::uint32_t v = 0; v < mode.shape.size(); ++v) {
    const double mass = simulation.mass(v);
    along += mass * mode.shape[v].dot(simulation.state().displacements_m[v]);
    whole += mass * mode.shape[v].squaredNorm();
  }
  return along / whole;
}

/// Period by the zero crossings of the amplitude; energy by its mean over the first and the last period.
Run vibrate(Simulation& simulation, const Mode& mode, double amplitude_m, int periods) {
  std::vector<Vector3> start;
  for (const Vector3& v : mode.shape)
    start.push_back(amplitude_m * v);
  setMotion(simulation, start, std::vector<Vector3>(start.size(), Vector3::Zero()));
  const double dt_s = simulation.settings().dt_s;
  const double period_s = 2.0 * M_PI / mode.frequency_rad_s;
  const int steps_a_period = std::max(1, static_cast<int>(std::lround(period_s / dt_s)));
  std::vector<double> crossings_s;
  double first_j = 0.0;
  double last_j = 0.0;
  double before = amplitude(simulation, mode);
  for (int n = 1; n <= periods * steps_a_period; ++n) {
    simulation.step();
    const double now = amplitude(simulation, mode);
    if ((before > 0.0) != (now > 0.0))
      crossings_s.push_back(dt_s * (n - 1 + before / (before - now)));
    before = now;
    if (n <= steps_a_period)
      first_j += energy(simulation);
    if (n > (periods - 1) * steps_a_period)
      last_j += energy(simulation);
  }
  Run run;
  if (crossings_s.size() > 2)
    run.period_s = 2.0 * (crossings_s.back() - crossings_s.front()) / double(crossings_s.size() - 1);
  run.energy_ratio = last_j / first_j;
  run.periods_apart = (periods - 1) * steps_a_period * dt_s / period_s;
  return run;
}

struct Rule {
  Integrator integrator;
  double period_bound;
  double energy_bound;
};

/// What the theory of each rule allows at this step: (w dt)^2 / 24 for symplectic Euler, (w dt)^4 / 120 for
/// Runge-Kutta, (w dt)^2 / 3 for backward Euler, whose energy falls by 1 / (1 + (w dt)^2) a step as the dissertation's
/// does by 1 - (w dt)^2 / 2: those two have rows without bound against the exact energy, and backward Euler one against
/// theory.
constexpr std::array<Rule, 5> kRules{{{Integrator::kSymplecticEuler, 1e-4, 1e-4},
                                      {Integrator::kDissertation, 1e-4, kNoBound},
                                      {Integrator::kRungeKutta4, 1e-6, 1e-6},
                                      {Integrator::kBackwardEuler, 1e-3, kNoBound},
                                      {Integrator::kAdaptive, 1e-6, 1e-6}}};

SimulationSettings settingsFor(Integrator integrator, double dt_s) {
  SimulationSettings settings = exactSettings();
  settings.integrator = integrator;
  settings.dt_s = dt_s;
  settings.error_tolerance = 1e-9;  // the whole motion is 1e-4 of a cell edge
  return settings;
}

std::unique_ptr<Block> clampedBar() {
  auto block = std::make_unique<Block>(Vector3i(8, 2, 2), Vector3::Constant(kSpacingM), tissue());
  block->fixWhere([](const Vector3i& n) { return n.x() == 0; });
  return block;
}

double explicitLimit(const Block& block) {
  return Simulation(block.lattice, block.materials, exactSettings(), 1).stabilityLimit();
}

void reportRule(const Rule& rule, const Run& run, const Mode& mode, double dt_s, Report& report) {
  const std::string name = std::string("bar 8x2x2, ") + nameOf(rule.integrator);
  report.equal(name + ": period, s", run.period_s, 2.0 * M_PI / mode.frequency_rad_s, rule.period_bound);
  report.equal(name + ": energy left of the first period's", run.energy_ratio, 1.0, rule.energy_bound);
  if (rule.integrator != Integrator::kBackwardEuler)
    return;
  const double w_dt = mode.frequency_rad_s * dt_s;
  const double steps = run.periods_apart * 2.0 * M_PI / w_dt;
  report.equal(name + ": energy left, against 1/(1 + (w dt)^2) a step", run.energy_ratio,
               std::pow(1.0 + w_dt * w_dt, -steps), 1e-2);
}

void compareRules(const Options& options, Report& report) {
  const std::unique_ptr<Block> block = clampedBar();
  const Mode mode = slowestMode(*block);
  const double dt_s = kDtFraction * explicitLimit(*block);
  for (const Rule& rule : kRules) {
    Simulation simulation(block->lattice, block->materials, settingsFor(rule.integrator, dt_s), options.threads);
    const Run run = vibrate(simulation, mode, kAmplitude * kSpacingM, options.quick ? 3 : 10);
    reportRule(rule, run, mode, dt_s, report);
  }
}

std::string sweep(Integrator integrator, const Block& block, const Mode& mode, double limit_s, double farthest,
                  const Options& options) {
  std::ostringstream lines;
  for (double fraction = 0.02; fraction <= farthest; fraction *= 1.6) {
    Simulation simulation(block.lattice, block.materials, settingsFor(integrator, fraction * limit_s), options.threads);
    const Run run = vibrate(simulation, mode, kAmplitude * kSpacingM, 3);
    const double period_error = std::abs(run.period_s * mode.frequency_rad_s / (2.0 * M_PI) - 1.0);
    // Below this the measurement's own error shows.
    lines << fraction << " " << std::max(1e-10, period_error) << " "
          << std::max(1e-10, std::abs(1.0 - std::pow(run.energy_ratio, 1.0 / run.periods_apart))) << "\n";
  }
  return lines.str() + "\n\n";
}

void plotSweeps(const Options& options) {
  if (options.plots.empty())
    return;
  const std::unique_ptr<Block> block = clampedBar();
  const Mode mode = slowestMode(*block);
  const double limit_s = explicitLimit(*block);
  std::string data;
  std::array<std::string, 2> curves;
  const std::array<std::pair<Integrator, double>, 4> swept{{{Integrator::kSymplecticEuler, 0.95},
                                                            {Integrator::kDissertation, 0.65},
                                                            {Integrator::kRungeKutta4, 1.35},
                                                            {Integrator::kBackwardEuler, 20.0}}};
  for (std::size_t n = 0; n < swept.size(); ++n) {
    data += sweep(swept[n].first, *block, mode, limit_s, swept[n].second, options);
    for (std::size_t c = 0; c < 2; ++c)
      curves[c] += std::string(n == 0 ? "" : ", ") + "$data index " + std::to_string(n) +
                   " u 1:" + std::to_string(2 + c) + " w lp pt " + std::to_string(5 + n) + " lw 2 t '" +
                   nameOf(swept[n].first) + "'";
  }
  options.plot(
      "free_vibration",
      "$data << EOD\n" + data +
          "EOD\nset termoption noenhanced\nset logscale xy\nset format y '%.0e'\nset multiplot layout 1,2 title "
          "'First bending mode of a clamped bar, 8x2x2 cells'\n"
          "set xlabel 'dt / stability limit'\nset key bottom right\n"
          "set title 'error of the period'\nplot " +
          curves[0] + "\nset title 'energy lost or won in a period'\nplot " + curves[1] + "\nunset multiplot\n");
}

/// A free cell that breathes keeps its shape, so that its springs stay straight and the motion is a pure cosine of any
/// amplitude: w^2 = 12 K / (rho h^2), K the bulk modulus, by nu = 1/4 2/3 E.
void breathingCell(const Options& options, Report& report) {
  const Block block(Vector3i::Ones(), Vector3::Constant(kSpacingM), tissue());
  const double bulk_pa = kYoungPa / 1.5;
  Mode mode;
  mode.frequency_rad_s = std::sqrt(12.0 * bulk_pa / block.materials.front().density_kg_m3) / kSpacingM;
  for (const Vector3& rest : block.lattice.rest_positions)
    mode.shape.push_back((rest - Vector3::Constant(0.5 * kSpacingM)) / (0.5 * kSpacingM));
  const double limit_s = explicitLimit(block);
  for (const Integrator integrator : {Integrator::kSymplecticEuler, Integrator::kRungeKutta4}) {
    Simulation simulation(block.lattice, block.materials, settingsFor(integrator, 0.02 * limit_s), options.threads);
    const Run run = vibrate(simulation, mode, 0.1 * kSpacingM, 10);
    const std::string name = std::string("one cell breathing by 20 %, ") + nameOf(integrator);
    report.equal(name + ": period, s", run.period_s, 2.0 * M_PI / mode.frequency_rad_s, 1e-4);
    report.equal(name + ": energy left", run.energy_ratio, 1.0, 1e-3);
  }
}

}  // namespace

std::vector<Case> freeVibrationCases(const Options& options) {
  return {{"breathing cell", 0.5, [=](Report& report) { breathingCell(options, report); }},
          {"clamped bar", options.quick ? 2.0 : 10.0, [=](Report& report) { compareRules(options, report); }},
          {"plots", options.plots.empty() ? 0.0 : 20.0, [=](Report&) { plotSweeps(options); }}};
}

}  // namespace soft_volume::core::validate
