#include "solver.h"

#include <algorithm>
#include <cmath>

#include "implicit_step.h"
#include "lip_set.h"
#include "safe_move.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/simulation/corner_width.h"
#include "solve_set.h"

namespace soft_volume::core {
namespace {

/// Blocks that one thread takes at a time: enough work to be worth a thread's while.
constexpr std::size_t kChunk = 32;
/// Fewer are done sooner by one thread than several have met.
constexpr std::size_t kParallelVertices = 4096;
/// The guard corrects moves in every so many steps.
constexpr std::uint64_t kCorrectEvery = 4;
/// Two neighbours may not come closer than this fraction of the shortest edge in the dissertation's rule.
constexpr double kEpsilon = 1e-3;
/// A vertex takes at most this force, in units of its springs' summed stiffness times the shortest edge: 1.8 E h^2
/// inside a cubic lattice. More only folds the cells beneath it.
constexpr double kLargestForce = 0.25;
/// An adaptive step is not divided further than into this many parts.
constexpr double kMostParts = 1024.0;
/// Into how many explicit steps one of backward Euler is divided at most.
constexpr int kUnfoldingParts = 100;
/// Reserve of the mass floor for the volume energy, which stiffens as faces grow.
constexpr double kVolumeReserve = 1.5;

template <typename Real>
class PackedSolver final : public Solver {
 public:
  PackedSolver(const Lattice& lattice, const LatticeIndex& index, int threads)
      : lattice_(&lattice),
        set_(lattice, index),
        kernel_(&bestKernel<Real>()),
        guard_(set_, *kernel_, threads),
        threads_(threads) {}

  void build(const SpringModel& model, const std::vector<std::uint32_t>& active_cells, bool with_frontier,
             const SimulationState& state, const std::vector<LipContact>& lips) override;
  void readState(SimulationState& state, std::vector<Vector3>& positions_m) const override;
  void step(const SimulationSettings& settings, double dt_s, const OuterActions& actions,
            SimulationStats& stats) override;
  void readFrontier(std::vector<FrontierVertex>& frontier) override;
  void readMotion(std::vector<VertexMotion>& motion) const override;
  std::vector<std::uint32_t> movingVertices() const override;
  void addMemory(std::vector<MemoryUse>& table) const override;

 private:
  using Arrays = std::vector<Real>[3];
  struct LocalTarget {
    std::uint32_t vertex;
    Vector3 displacement_m;
  };

  template <typename Pass>
  void overBlocks(std::size_t blocks, const Pass& pass) const {
    const int threads = blocks * kLanes<Real> < kParallelVertices ? 1 : threads_;
    parallelFor(static_cast<std::ptrdiff_t>((blocks + kChunk - 1) / kChunk), threads, [&](std::ptrdiff_t n) {
      const std::size_t begin = static_cast<std::size_t>(n) * kChunk;
      pass(begin, std::min(blocks, begin + kChunk));
    });
  }

  void takeActions(const SimulationSettings& settings, const OuterActions& actions, SimulationStats& stats);
  void takeTargets(const OuterActions& actions);
  void setMasses(bool with_floor, double dt_s);
  void findMassBounds();
  void findStressedCells();
  void writeExternals(const OuterActions& actions, SimulationStats& stats);
  void addAltitudeForces();
  void keepExternal(std::uint32_t vertex);
  void clearAltitudeForces();
  void evaluateInnerForces();
  void evaluateForces(const AdvanceRule<Real>& rule);
  AdvanceRule<Real> rule(const SimulationSettings& settings, double dt_s) const;
  void advance(const AdvanceRule<Real>& rule, SimulationStats& stats);
  void leadTargets(const AdvanceRule<Real>& rule);
  void finishMove(const SimulationSettings& settings, double dt_s, SimulationStats& stats);
  void readLag(SimulationStats& stats) const;
  void dampQuasiStatic(const AdvanceRule<Real>& rule);
  void eulerStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats);
  void rungeKutta(const AdvanceRule<Real>& lips_rule, double dt_s);
  void moveFrom(const Arrays& from, const SimulationSettings& settings, double dt_s, SimulationStats& stats);
  void adaptiveStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats);
  void backwardEulerStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats);
  void unfoldStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats);
  void findRankOnes();
  void stiffnessProduct(const Eigen::VectorXd& x, Eigen::VectorXd& y);
  void keepMomentum(const Eigen::VectorXd& inertia, const Eigen::VectorXd& residual);
  void findPreconditioner(LinearProblem& problem);
  double implicitResidual(const Eigen::VectorXd& inertia, Eigen::VectorXd& residual);
  void save(Arrays& to, Real* const from[3]) const;
  void restore(const Arrays& from, Real* const to[3]) const;

  const Lattice* lattice_;
  SolveSet<Real> set_;
  const Kernel<Real>* kernel_;
  SafeMoveGuard<Real> guard_;
  LipSet<Real> lips_;
  int threads_;
  const SpringModel* model_ = nullptr;

  std::vector<std::uint32_t> loaded_;       ///< local vertices with an external force
  std::vector<std::uint32_t> altitude_on_;  ///< local vertices that altitude springs push, besides
  std::vector<Real> unaltered_[3];          ///< external forces without theirs; empty until it is needed
  std::vector<std::uint8_t> altitude_mark_;
  std::vector<std::uint32_t> stressed_;  ///< local cells with altitude springs at work
  std::vector<LocalTarget> targets_;
  std::vector<Real> true_inverse_mass_;  ///< without grips and mass floor
  std::vector<double> mass_bound_;       ///< quasi-static: stiffness that the mass floor answers
  Arrays start_, start_velocity_, sum_, velocity_sum_, coarse_, adaptive_start_, adaptive_velocity_;
  std::vector<std::uint64_t> limited_;  ///< per chunk of blocks
  std::uint64_t step_ = 0;
  bool masses_changed_ = true;
  double mass_dt_s_ = 0.0;
  bool mass_floor_ = false;
  std::vector<RankOneStiffness> rank_ones_;
  Arrays direction_, product_;
};

template <typename Real>
void PackedSolver<Real>::build(const SpringModel& model, const std::vector<std::uint32_t>& active_cells,
                               bool with_frontier, const SimulationState& state, const std::vector<LipContact>& lips) {
  model_ = &model;
  set_.build(model, active_cells, with_frontier);
  lips_.build(*lattice_, lips, set_);
  KernelView<Real>& view = set_.view();
  for (std::uint32_t v = 0; v < set_.vertexCount(); ++v) {
    for (int d = 0; d < 3; ++d)
      view.displacement[d][v] = static_cast<Real>(state.displacements_m[set_.globalVertex(v)][d]);
  }
  for (const std::uint32_t v : set_.moving()) {
    for (int d = 0; d < 3; ++d)
      view.velocity[d][v] = static_cast<Real>(state.velocities_m_s[set_.globalVertex(v)][d]);
  }
  guard_.reset();
  loaded_.clear();
  altitude_on_.clear();
  altitude_mark_.clear();
  stressed_.clear();
  targets_.clear();
  true_inverse_mass_.assign(view.inverse_mass, view.inverse_mass + set_.vertexCount());
  mass_bound_.clear();
  masses_changed_ = true;
  limited_.assign(set_.movingBlocks().size() / kChunk + 1, 0);
}

template <typename Real>
void PackedSolver<Real>::readState(SimulationState& state, std::vector<Vector3>& positions_m) const {
  const KernelView<Real>& view = set_.view();
  for (const std::uint32_t v : set_.moving()) {
    const std::uint32_t global = set_.globalVertex(v);
    for (int d = 0; d < 3; ++d) {
      state.displacements_m[global][d] = double(view.displacement[d][v]);
      state.velocities_m_s[global][d] = double(view.velocity[d][v]);
    }
    positions_m[global] = lattice_->rest_positions[global] + state.displacements_m[global];
  }
}

// --- what acts from outside

template <typename Real>
void PackedSolver<Real>::writeExternals(const OuterActions& actions, SimulationStats& stats) {
  clearAltitudeForces();
  KernelView<Real>& view = set_.view();
  for (const std::uint32_t v : loaded_) {
    for (int d = 0; d < 3; ++d)
      view.external[d][v] = Real(0);
  }
  loaded_.clear();
  for (const VertexLoad& load : actions.loads) {
    const std::uint32_t v = set_.localVertex(load.vertex);
    if (v == SolveSet<Real>::kAbsent)
      continue;
    for (int d = 0; d < 3; ++d)
      view.external[d][v] += static_cast<Real>(load.force_n[d]);
    loaded_.push_back(v);
  }
  std::sort(loaded_.begin(), loaded_.end());
  loaded_.erase(std::unique(loaded_.begin(), loaded_.end()), loaded_.end());
  for (const std::uint32_t v : loaded_) {
    const Vector3 force(view.external[0][v], view.external[1][v], view.external[2][v]);
    const double bound = kLargestForce * 3.0 * set_.stiffness(v) * model_->shortest_edge_m;
    if (force.norm() <= bound || true_inverse_mass_[v] <= Real(0))
      continue;
    ++stats.saturated_forces;
    for (int d = 0; d < 3; ++d)
      view.external[d][v] = static_cast<Real>(force[d] * (bound / force.norm()));
  }
}

template <typename Real>
void PackedSolver<Real>::takeTargets(const OuterActions& actions) {
  targets_.clear();
  for (const Target& target : actions.targets) {
    const std::uint32_t v = set_.localVertex(target.vertex);
    if (v != SolveSet<Real>::kAbsent && true_inverse_mass_[v] > Real(0))
      targets_.push_back({v, target.displacement_m});
  }
}

template <typename Real>
void PackedSolver<Real>::takeActions(const SimulationSettings& settings, const OuterActions& actions,
                                     SimulationStats& stats) {
  for (int d = 0; d < 3; ++d)
    set_.view().gravity[d] = static_cast<Real>(settings.gravity_m_s2[d]);
  set_.view().nearest_of_all = settings.safe_move == SafeMove::kDissertation;
  if (actions.loads_changed || masses_changed_)
    writeExternals(actions, stats);
  masses_changed_ = masses_changed_ || !targets_.empty() || !actions.targets.empty();
  takeTargets(actions);
}

/// Stiffness bounds for the mass floor: x K x <= sum over vertices of bound |x|^2, the absolute row sum of springs
/// (twice their stiffness, whatever their direction) and of the volume energy kappa V g g^T.
template <typename Real>
void PackedSolver<Real>::findMassBounds() {
  mass_bound_.assign(set_.vertexCount(), 0.0);
  for (const std::uint32_t v : set_.moving())
    mass_bound_[v] = 6.0 * set_.stiffness(v);
  const KernelView<Real>& view = set_.view();
  if (view.volume_modulus == nullptr)
    return;
  const Vector3 h(view.spacing[0], view.spacing[1], view.spacing[2]);
  const double gradient = 0.25 * Vector3(1.0 / h.x(), 1.0 / h.y(), 1.0 / h.z()).norm();
  for (std::uint32_t cell = 0; cell < set_.guardedCells(); ++cell) {
    const double bound = kVolumeReserve * double(view.volume_modulus[cell]) * h.prod() * 8.0 * gradient * gradient;
    for (int c = 0; c < 8; ++c)
      mass_bound_[set_.cornerVertex(cell, c)] += bound;
  }
}

/// Gripped vertices do not answer to forces; quasi-static masses make any step stable.
template <typename Real>
void PackedSolver<Real>::setMasses(bool with_floor, double dt_s) {
  if (!masses_changed_ && dt_s == mass_dt_s_ && with_floor == mass_floor_ && !(with_floor && !stressed_.empty()))
    return;
  Real* inverse_mass = set_.view().inverse_mass;
  if (with_floor && mass_bound_.empty())
    findMassBounds();
  for (const std::uint32_t v : set_.moving()) {
    inverse_mass[v] = true_inverse_mass_[v];
    if (with_floor) {
      const double floor = dt_s * dt_s * mass_bound_[v];
      inverse_mass[v] = static_cast<Real>(1.0 / std::max(1.0 / double(true_inverse_mass_[v]), floor));
    }
  }
  for (const std::uint32_t cell : stressed_) {
    if (!with_floor)
      break;
    const std::uint32_t global = set_.globalCell(cell);
    // |dw| <= 2 |dx|, and up to four tetrahedra of the cell share the vertex.
    const double floor = dt_s * dt_s * 16.0 * altitudeStiffness(*lattice_, *model_, global);
    for (int c = 0; c < 8; ++c) {
      const std::uint32_t v = set_.cornerVertex(cell, c);
      if (inverse_mass[v] > Real(0))
        inverse_mass[v] = static_cast<Real>(1.0 / (1.0 / double(inverse_mass[v]) + floor));
    }
  }
  for (const LocalTarget& target : targets_)
    inverse_mass[target.vertex] = Real(0);
  masses_changed_ = false;
  mass_dt_s_ = dt_s;
  mass_floor_ = with_floor;
}

// --- altitude springs

template <typename Real>
void PackedSolver<Real>::findStressedCells() {
  const Real limit = static_cast<Real>(kAltitudeWidth * model_->shortest_edge_m);
  const KernelView<Real>& view = set_.view();
  overBlocks(set_.guardedBlocks(),
             [&](std::size_t begin, std::size_t end) { kernel_->refreshWidths(view, limit, begin, end); });
  const bool before = !stressed_.empty();
  stressed_.clear();
  for (std::uint32_t cell = 0; cell < set_.guardedCells(); ++cell) {
    if (view.width_bound[cell] < limit)
      stressed_.push_back(cell);
  }
  masses_changed_ = masses_changed_ || before;
}

template <typename Real>
void PackedSolver<Real>::clearAltitudeForces() {
  for (const std::uint32_t v : altitude_on_) {
    altitude_mark_[v] = 0;
    for (int d = 0; d < 3; ++d)
      set_.view().external[d][v] = unaltered_[d][v];
  }
  altitude_on_.clear();
}

template <typename Real>
void PackedSolver<Real>::keepExternal(std::uint32_t vertex) {
  if (altitude_mark_[vertex])
    return;
  altitude_mark_[vertex] = 1;
  altitude_on_.push_back(vertex);
  for (int d = 0; d < 3; ++d)
    unaltered_[d][vertex] = set_.view().external[d][vertex];
}

/// Adds them to the external forces; `unaltered_` keeps what was there before.
template <typename Real>
void PackedSolver<Real>::addAltitudeForces() {
  if (stressed_.empty())
    return;
  KernelView<Real>& view = set_.view();
  if (altitude_mark_.empty()) {
    for (std::vector<Real>& values : unaltered_)
      values.assign(set_.vertexCount(), Real(0));
    altitude_mark_.assign(set_.vertexCount(), 0);
  }
  const double limit = kAltitudeWidth * model_->shortest_edge_m;
  for (const std::uint32_t cell : stressed_) {
    const AltitudeSpring spring{altitudeStiffness(*lattice_, *model_, set_.globalCell(cell)), limit};
    const CellCorners corners = guard_.corners(cell, false);
    for (int t = 0; t < 8; ++t) {
      const CornerWidth width = cornerWidthGradient(cornerEdges(corners, t));
      const double force = spring.force(width.width_m);
      if (force <= 0.0)
        continue;
      for (int n = 0; n < 4; ++n) {
        const std::uint32_t v = set_.cornerVertex(cell, kCornerTetrahedra[t][n]);
        keepExternal(v);
        for (int d = 0; d < 3; ++d)
          view.external[d][v] += static_cast<Real>(force * width.gradient[static_cast<std::size_t>(n)][d]);
      }
    }
  }
}

// --- steps

/// All but those of the lips.
template <typename Real>
void PackedSolver<Real>::evaluateInnerForces() {
  clearAltitudeForces();
  addAltitudeForces();
  const KernelView<Real>& view = set_.view();
  if (view.corner_force != nullptr) {
    overBlocks(set_.cellBlocks(), [&](std::size_t begin, std::size_t end) { kernel_->volumeForces(view, begin, end); });
  }
  overBlocks(set_.movingBlocks().size(), [&](std::size_t begin, std::size_t end) {
    kernel_->forces(view, set_.movingBlocks().data(), begin, end);
  });
}

/// For a step by the rule.
template <typename Real>
void PackedSolver<Real>::evaluateForces(const AdvanceRule<Real>& rule) {
  evaluateInnerForces();
  lips_.addForces(set_.view(), rule, threads_);
}

template <typename Real>
AdvanceRule<Real> PackedSolver<Real>::rule(const SimulationSettings& settings, double dt_s) const {
  const double h = model_->shortest_edge_m;
  AdvanceRule<Real> rule;
  rule.dt = static_cast<Real>(dt_s);
  rule.half_dt_squared =
      settings.integrator == Integrator::kDissertation ? static_cast<Real>(0.5 * dt_s * dt_s) : Real(0);
  const bool width = settings.safe_move == SafeMove::kWidth;
  rule.nearest_fraction = static_cast<Real>(kEdgeFraction);
  rule.largest_move = width ? static_cast<Real>(kLongestMove * h) : Real(1e30);
  rule.epsilon = width ? Real(-1e15) : static_cast<Real>(kEpsilon * h);
  rule.damped = settings.integrator != Integrator::kQuasiStatic;  // it has its own
  rule.limits = settings.safe_move != SafeMove::kNone;
  rule.consistent = width;
  return rule;
}

template <typename Real>
void PackedSolver<Real>::advance(const AdvanceRule<Real>& rule, SimulationStats& stats) {
  const std::vector<std::uint32_t>& blocks = set_.movingBlocks();
  overBlocks(blocks.size(), [&](std::size_t begin, std::size_t end) {
    limited_[begin / kChunk] = 0;
    kernel_->advance(set_.view(), rule, blocks.data(), begin, end, &limited_[begin / kChunk]);
  });
  for (std::size_t n = 0; n * kChunk < blocks.size(); ++n)
    stats.limited_moves += limited_[n];
}

/// Leads gripped vertices towards their targets, as far as one safe move goes.
template <typename Real>
void PackedSolver<Real>::leadTargets(const AdvanceRule<Real>& rule) {
  KernelView<Real>& view = set_.view();
  for (const LocalTarget& target : targets_) {
    const std::uint32_t v = target.vertex;
    Vector3 move;
    for (int d = 0; d < 3; ++d)
      move[d] = target.displacement_m[d] - double(view.displacement[d][v]);
    const double nearest = std::sqrt(double(view.nearest_squared[v]));
    const double longest = std::min(double(rule.nearest_fraction) * nearest, double(rule.largest_move));
    const double length = move.norm();
    if (rule.limits && length > longest)
      move *= longest / length;
    view.move_squared[v] = static_cast<Real>(move.squaredNorm());
    for (int d = 0; d < 3; ++d) {
      view.move[d][v] = static_cast<Real>(move[d]);
      view.velocity[d][v] = static_cast<Real>(move[d] / double(rule.dt));
    }
  }
}

/// Guards the moves and makes them.
template <typename Real>
void PackedSolver<Real>::finishMove(const SimulationSettings& settings, double dt_s, SimulationStats& stats) {
  if (settings.safe_move == SafeMove::kWidth)
    guard_.guard(dt_s, targets_.empty() && step_ % kCorrectEvery == 0, stats);
  overBlocks(set_.movingBlocks().size(), [&](std::size_t begin, std::size_t end) {
    kernel_->apply(set_.view(), set_.movingBlocks().data(), begin, end);
  });
  readLag(stats);
}

template <typename Real>
void PackedSolver<Real>::readLag(SimulationStats& stats) const {
  const KernelView<Real>& view = set_.view();
  stats.grip_lag_m = 0.0;
  for (const LocalTarget& target : targets_) {
    const std::uint32_t v = target.vertex;
    const Vector3 now(view.displacement[0][v], view.displacement[1][v], view.displacement[2][v]);
    stats.grip_lag_m = std::max(stats.grip_lag_m, (target.displacement_m - now).norm());
  }
}

/// Kinetic damping: where the forces have begun to take energy out of the motion, a minimum was passed; start again
/// from there.
template <typename Real>
void PackedSolver<Real>::dampQuasiStatic(const AdvanceRule<Real>& rule) {
  KernelView<Real>& view = set_.view();
  double power = 0.0;
  for (const std::uint32_t v : set_.moving()) {
    for (int d = 0; d < 3; ++d)
      power += double(view.force[d][v]) * double(view.velocity[d][v]);
  }
  if (power >= 0.0)
    return;
  for (const std::uint32_t v : set_.moving()) {
    for (int d = 0; d < 3; ++d)
      view.velocity[d][v] = Real(0);
  }
  if (!lips_.empty())
    evaluateForces(rule);  // lips answer to velocities
}

template <typename Real>
void PackedSolver<Real>::eulerStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats) {
  const AdvanceRule<Real> limits = rule(settings, dt_s);
  evaluateForces(limits);
  if (settings.integrator == Integrator::kQuasiStatic)
    dampQuasiStatic(limits);
  advance(limits, stats);
  leadTargets(limits);
  finishMove(settings, dt_s, stats);
}

template <typename Real>
void PackedSolver<Real>::save(Arrays& to, Real* const from[3]) const {
  for (int d = 0; d < 3; ++d)
    to[d].assign(from[d], from[d] + set_.vertexCount());
}

template <typename Real>
void PackedSolver<Real>::restore(const Arrays& from, Real* const to[3]) const {
  for (int d = 0; d < 3; ++d)
    std::copy(from[d].begin(), from[d].end(), to[d]);
}

/// One classical Runge-Kutta step of displacements and velocities, without limits. The forces of lips are those for a
/// step by `lips_rule`, whatever part of it this is, so that halved steps find the same motion.
template <typename Real>
void PackedSolver<Real>::rungeKutta(const AdvanceRule<Real>& lips_rule, double dt_s) {
  constexpr double kNodes[4] = {0.0, 0.5, 0.5, 1.0};
  constexpr double kWeights[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
  KernelView<Real>& view = set_.view();
  save(start_, view.displacement);
  save(start_velocity_, view.velocity);
  for (int d = 0; d < 3; ++d) {
    sum_[d].assign(set_.vertexCount(), Real(0));
    velocity_sum_[d].assign(set_.vertexCount(), Real(0));
  }
  for (int stage = 0; stage < 4; ++stage) {
    evaluateForces(lips_rule);
    const Real next = static_cast<Real>(stage < 3 ? kNodes[stage + 1] * dt_s : 0.0);
    const Real weight = static_cast<Real>(kWeights[stage] * dt_s);
    for (const std::uint32_t v : set_.moving()) {
      for (int d = 0; d < 3; ++d) {
        const Real velocity = view.velocity[d][v];
        const Real acceleration = view.inverse_mass[v] * view.force[d][v] - view.damping_rate[v] * velocity;
        const bool free = view.inverse_mass[v] > Real(0);
        sum_[d][v] += free ? weight * velocity : Real(0);
        velocity_sum_[d][v] += free ? weight * acceleration : Real(0);
        view.displacement[d][v] = start_[d][v] + (free ? next * velocity : Real(0));
        view.velocity[d][v] = start_velocity_[d][v] + (free ? next * acceleration : Real(0));
      }
    }
  }
  for (const std::uint32_t v : set_.moving()) {
    for (int d = 0; d < 3; ++d) {
      view.displacement[d][v] = start_[d][v] + sum_[d][v];
      view.velocity[d][v] = start_velocity_[d][v] + velocity_sum_[d][v];
    }
  }
}

/// Turns the way from `from` to the present displacements into a limited move from there.
template <typename Real>
void PackedSolver<Real>::moveFrom(const Arrays& from, const SimulationSettings& settings, double dt_s,
                                  SimulationStats& stats) {
  KernelView<Real>& view = set_.view();
  const AdvanceRule<Real> limits = rule(settings, dt_s);
  for (const std::uint32_t v : set_.moving()) {
    Real squared = Real(0);
    for (int d = 0; d < 3; ++d) {
      view.move[d][v] = view.displacement[d][v] - from[d][v];
      squared += view.move[d][v] * view.move[d][v];
    }
    const double nearest = std::sqrt(double(view.nearest_squared[v]));
    const double longest = std::min(double(limits.nearest_fraction) * nearest, double(limits.largest_move));
    const double length = std::sqrt(double(squared));
    if (limits.limits && length > longest) {
      ++stats.limited_moves;
      for (int d = 0; d < 3; ++d) {
        view.move[d][v] *= static_cast<Real>(longest / length);
        view.velocity[d][v] = static_cast<Real>(double(view.move[d][v]) / dt_s);
      }
      squared = static_cast<Real>(longest * longest);
    }
    view.move_squared[v] = squared;
  }
  restore(from, view.displacement);
  leadTargets(limits);
  finishMove(settings, dt_s, stats);
}

/// Tries a step whole and in two halves, whose difference is the error (Richardson); backs up and halves it until that
/// is small enough (section 4.3).
template <typename Real>
void PackedSolver<Real>::adaptiveStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats) {
  KernelView<Real>& view = set_.view();
  const double allowed_m = settings.error_tolerance * model_->shortest_edge_m;
  const AdvanceRule<Real> lips_rule = rule(settings, dt_s);
  double done_s = 0.0;
  double part_s = dt_s;
  while (done_s < dt_s) {
    part_s = std::min(part_s, dt_s - done_s);
    findStressedCells();
    setMasses(false, dt_s);
    save(adaptive_start_, view.displacement);
    save(adaptive_velocity_, view.velocity);
    rungeKutta(lips_rule, part_s);
    save(coarse_, view.displacement);
    restore(adaptive_start_, view.displacement);
    restore(adaptive_velocity_, view.velocity);
    rungeKutta(lips_rule, 0.5 * part_s);
    rungeKutta(lips_rule, 0.5 * part_s);
    double squared = 0.0;
    for (const std::uint32_t v : set_.moving()) {
      double of_vertex = 0.0;
      for (int d = 0; d < 3; ++d) {
        const double difference = double(view.displacement[d][v]) - double(coarse_[d][v]);
        of_vertex += difference * difference;
      }
      squared = std::isfinite(of_vertex) ? std::max(squared, of_vertex) : 1e30;
    }
    const double error_m = std::sqrt(squared) / 15.0;
    if (error_m > allowed_m && part_s > dt_s / kMostParts) {
      restore(adaptive_start_, view.displacement);
      restore(adaptive_velocity_, view.velocity);
      part_s *= 0.5;
      ++stats.rejected_steps;
      continue;
    }
    moveFrom(adaptive_start_, settings, part_s, stats);
    done_s += part_s;
    // Doubling multiplies the error by 32.
    part_s *= error_m < allowed_m / 32.0 ? 2.0 : 1.0;
  }
}

// --- backward Euler

/// The volume energies and altitude springs at the present displacements, without their geometric part, which could
/// make the matrix indefinite.
template <typename Real>
void PackedSolver<Real>::findRankOnes() {
  rank_ones_.clear();
  const KernelView<Real>& view = set_.view();
  const double rest_m3 = lattice_->spacing_m.prod();
  for (std::uint32_t cell = 0; view.volume_modulus != nullptr && cell < set_.guardedCells(); ++cell) {
    if (view.volume_modulus[cell] <= Real(0))
      continue;
    RankOneStiffness term;
    term.count = 8;
    term.gradient.fill(Vector3::Zero());
    const double stretch = double(view.volume_stretch[cell]);
    term.stiffness = double(view.volume_modulus[cell]) / (64.0 * rest_m3 * stretch);
    const CellCorners corners = guard_.corners(cell, false);
    for (int c = 0; c < 8; ++c) {
      term.vertices[static_cast<std::size_t>(c)] = set_.cornerVertex(cell, c);
      const CornerEdges e = cornerEdges(corners, c);
      const Vector3 normals[3] = {e.b.cross(e.c), e.c.cross(e.a), e.a.cross(e.b)};
      for (int n = 0; n < 3; ++n) {
        term.gradient[kCornerTetrahedra[c][n + 1]] += normals[n];
        term.gradient[kCornerTetrahedra[c][0]] -= normals[n];
      }
    }
    rank_ones_.push_back(term);
  }
  const double limit = kAltitudeWidth * model_->shortest_edge_m;
  for (const std::uint32_t cell : stressed_) {
    const CellCorners corners = guard_.corners(cell, false);
    for (int t = 0; t < 8; ++t) {
      const CornerWidth width = cornerWidthGradient(cornerEdges(corners, t));
      if (width.width_m >= limit)
        continue;
      RankOneStiffness term;
      term.gradient.fill(Vector3::Zero());
      term.count = 4;
      term.stiffness = altitudeStiffness(*lattice_, *model_, set_.globalCell(cell));
      for (std::size_t n = 0; n < 4; ++n) {
        term.vertices[n] = set_.cornerVertex(cell, kCornerTetrahedra[t][n]);
        term.gradient[n] = width.gradient[n];
      }
      rank_ones_.push_back(term);
    }
  }
}

/// Unknowns are the vertices of moving(), three each; the rest of the lattice stays.
template <typename Real>
void PackedSolver<Real>::stiffnessProduct(const Eigen::VectorXd& x, Eigen::VectorXd& y) {
  const std::vector<std::uint32_t>& moving = set_.moving();
  for (std::size_t n = 0; n < moving.size(); ++n) {
    for (int d = 0; d < 3; ++d)
      direction_[d][moving[n]] = static_cast<Real>(x[Eigen::Index(3 * n) + d]);
  }
  const Real* const direction[3] = {direction_[0].data(), direction_[1].data(), direction_[2].data()};
  Real* const product[3] = {product_[0].data(), product_[1].data(), product_[2].data()};
  overBlocks(set_.movingBlocks().size(), [&](std::size_t begin, std::size_t end) {
    kernel_->stiffnessProduct(set_.view(), direction, product, set_.movingBlocks().data(), begin, end);
  });
  for (const RankOneStiffness& term : rank_ones_) {
    double along = 0.0;
    for (std::size_t n = 0; n < std::size_t(term.count); ++n) {
      for (int d = 0; d < 3; ++d)
        along += term.gradient[n][d] * double(direction_[d][term.vertices[n]]);
    }
    for (std::size_t n = 0; n < std::size_t(term.count); ++n) {
      for (int d = 0; d < 3; ++d)
        product_[d][term.vertices[n]] += static_cast<Real>(term.stiffness * along * term.gradient[n][d]);
    }
  }
  lips_.addProduct(direction_, product_);
  for (std::size_t n = 0; n < moving.size(); ++n) {
    const bool free = set_.view().inverse_mass[moving[n]] > Real(0);
    for (int d = 0; d < 3; ++d)
      y[Eigen::Index(3 * n) + d] = free ? double(product_[d][moving[n]]) : 0.0;
  }
}

/// Of M ((1/dt^2 + alpha/dt) y - v / dt) = f(start + y), y the move so far; `inertia` is the diagonal of the left side.
/// Returns its norm.
template <typename Real>
double PackedSolver<Real>::implicitResidual(const Eigen::VectorXd& inertia, Eigen::VectorXd& residual) {
  evaluateInnerForces();
  lips_.addPresentForces(set_.view(), threads_);
  const KernelView<Real>& view = set_.view();
  const std::vector<std::uint32_t>& moving = set_.moving();
  for (std::size_t n = 0; n < moving.size(); ++n) {
    const std::uint32_t v = moving[n];
    const bool free = view.inverse_mass[v] > Real(0);
    for (int d = 0; d < 3; ++d) {
      const Eigen::Index at = Eigen::Index(3 * n) + d;
      const double y = double(view.displacement[d][v]) - double(start_[d][v]);
      const double momentum = double(start_velocity_[d][v]) / (double(true_inverse_mass_[v]) * mass_dt_s_);
      residual[at] = free ? momentum + double(view.force[d][v]) - inertia[at] * y : 0.0;
    }
  }
  return residual.norm();
}

/// The inverse of the diagonal, springs taken as averaged over directions.
template <typename Real>
void PackedSolver<Real>::findPreconditioner(LinearProblem& problem) {
  const std::vector<std::uint32_t>& moving = set_.moving();
  for (std::vector<Real>& values : product_)
    std::fill(values.begin(), values.end(), Real(0));
  for (const RankOneStiffness& term : rank_ones_) {
    for (std::size_t n = 0; n < std::size_t(term.count); ++n) {
      for (int d = 0; d < 3; ++d)
        product_[d][term.vertices[n]] += static_cast<Real>(term.stiffness * term.gradient[n][d] * term.gradient[n][d]);
    }
  }
  lips_.addDiagonal(product_);
  problem.preconditioner = problem.diagonal;
  for (std::size_t n = 0; n < moving.size(); ++n) {
    for (int d = 0; d < 3; ++d)
      problem.preconditioner[Eigen::Index(3 * n) + d] += set_.stiffness(moving[n]) + double(product_[d][moving[n]]);
  }
  problem.preconditioner = problem.preconditioner.cwiseInverse().eval();
}

/// Inner forces cancel, so what is left unsolved in their sum is wrong momentum of a free body: moves it as a whole.
template <typename Real>
void PackedSolver<Real>::keepMomentum(const Eigen::VectorXd& inertia, const Eigen::VectorXd& residual) {
  Vector3 left = Vector3::Zero();
  double total = 0.0;
  for (Eigen::Index n = 0; n < residual.size(); n += 3) {
    left += residual.segment<3>(n);
    total += inertia[n];
  }
  for (const std::uint32_t v : set_.moving()) {
    for (int d = 0; d < 3; ++d)
      set_.view().displacement[d][v] += static_cast<Real>(left[d] / total);
  }
}

/// Newton's method with backtracking on the norm of the residual.
template <typename Real>
void PackedSolver<Real>::backwardEulerStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats) {
  constexpr int kMostIterations = 12;
  constexpr int kMostHalvings = 6;
  constexpr double kTolerance = sizeof(Real) == 4 ? 1e-4 : 1e-8;
  constexpr double kLinearTolerance = 1e-2;
  KernelView<Real>& view = set_.view();
  const std::vector<std::uint32_t>& moving = set_.moving();
  const Eigen::Index size = Eigen::Index(3 * moving.size());
  save(start_, view.displacement);
  save(start_velocity_, view.velocity);
  for (int d = 0; d < 3; ++d) {
    direction_[d].assign(set_.paddedVertices(), Real(0));
    product_[d].assign(set_.paddedVertices(), Real(0));
  }
  LinearProblem problem;
  problem.stiffness_product = [this](const Eigen::VectorXd& x, Eigen::VectorXd& y) { stiffnessProduct(x, y); };
  problem.diagonal.resize(size);
  for (std::size_t n = 0; n < moving.size(); ++n) {
    const std::uint32_t v = moving[n];
    const double inertia = (1.0 / dt_s + double(view.damping_rate[v])) / (dt_s * double(true_inverse_mass_[v]));
    problem.diagonal.segment<3>(Eigen::Index(3 * n)).setConstant(inertia);
  }
  Eigen::VectorXd residual(size), step;
  double norm = implicitResidual(problem.diagonal, residual);
  const double first = norm;
  for (int iteration = 0; iteration < kMostIterations && norm > kTolerance * first; ++iteration) {
    findRankOnes();
    findPreconditioner(problem);
    // Newton corrects what a loose solution leaves.
    stats.solver_iterations += solveConjugateGradient(problem, residual, kLinearTolerance, step);
    save(coarse_, view.displacement);
    const double before = norm;
    double share = 1.0;
    for (int halving = 0; halving <= kMostHalvings; ++halving, share *= 0.5) {
      for (std::size_t n = 0; n < moving.size(); ++n) {
        for (int d = 0; d < 3; ++d)
          view.displacement[d][moving[n]] =
              static_cast<Real>(double(coarse_[d][moving[n]]) + share * step[Eigen::Index(3 * n) + d]);
      }
      norm = implicitResidual(problem.diagonal, residual);
      if (norm < before)
        break;
    }
    if (!(norm < before)) {
      restore(coarse_, view.displacement);
      break;
    }
  }
  if (targets_.empty() && moving.size() == set_.vertexCount())
    keepMomentum(problem.diagonal, residual);
  const Real inverse_dt = static_cast<Real>(1.0 / dt_s);
  for (const std::uint32_t v : moving) {
    for (int d = 0; d < 3; ++d)
      view.velocity[d][v] = (view.displacement[d][v] - start_[d][v]) * inverse_dt;
  }
  moveFrom(start_, settings, dt_s, stats);
}

/// In place of a step of backward Euler while cells are nearly folded: long moves would all be rejected there and lock
/// the fold. Short explicit ones find the way out; where their number is bounded, the mass floor keeps them stable.
template <typename Real>
void PackedSolver<Real>::unfoldStep(const SimulationSettings& settings, double dt_s, SimulationStats& stats) {
  const double parts = std::ceil(dt_s / (0.5 * model_->certain_step_s));
  const int count = parts < kUnfoldingParts ? static_cast<int>(parts) : kUnfoldingParts;
  for (int n = 0; n < count; ++n) {
    findStressedCells();
    setMasses(true, dt_s / count);
    eulerStep(settings, dt_s / count, stats);
  }
  masses_changed_ = true;
}

template <typename Real>
void PackedSolver<Real>::step(const SimulationSettings& settings, double dt_s, const OuterActions& actions,
                              SimulationStats& stats) {
  step_ = actions.step;
  takeActions(settings, actions, stats);
  if (settings.safe_move == SafeMove::kWidth)
    findStressedCells();
  setMasses(settings.integrator == Integrator::kQuasiStatic, dt_s);
  switch (settings.integrator) {
    case Integrator::kAdaptive:
      adaptiveStep(settings, dt_s, stats);
      break;
    case Integrator::kRungeKutta4:
      rungeKutta(rule(settings, dt_s), dt_s);
      moveFrom(start_, settings, dt_s, stats);
      break;
    case Integrator::kBackwardEuler:
      if (stressed_.empty())
        backwardEulerStep(settings, dt_s, stats);
      else
        unfoldStep(settings, dt_s, stats);
      break;
    default:
      eulerStep(settings, dt_s, stats);
  }
}

// --- what others read

template <typename Real>
void PackedSolver<Real>::readFrontier(std::vector<FrontierVertex>& frontier) {
  frontier.clear();
  const KernelView<Real>& view = set_.view();
  if (view.corner_force != nullptr) {
    overBlocks(set_.cellBlocks(), [&](std::size_t begin, std::size_t end) { kernel_->volumeForces(view, begin, end); });
  }
  overBlocks(set_.frontierBlocks().size(), [&](std::size_t begin, std::size_t end) {
    kernel_->forces(view, set_.frontierBlocks().data(), begin, end);
  });
  for (const std::uint32_t v : set_.frontier()) {
    frontier.push_back(
        {set_.globalVertex(v), Vector3(view.force[0][v], view.force[1][v], view.force[2][v]), set_.stiffness(v)});
  }
}

template <typename Real>
std::vector<std::uint32_t> PackedSolver<Real>::movingVertices() const {
  std::vector<std::uint32_t> vertices;
  for (const std::uint32_t v : set_.moving())
    vertices.push_back(set_.globalVertex(v));
  return vertices;
}

template <typename Real>
void PackedSolver<Real>::readMotion(std::vector<VertexMotion>& motion) const {
  motion.clear();
  const KernelView<Real>& view = set_.view();
  for (const std::uint32_t v : set_.moving()) {
    const Vector3 velocity(view.velocity[0][v], view.velocity[1][v], view.velocity[2][v]);
    const Vector3 force(view.force[0][v], view.force[1][v], view.force[2][v]);
    const bool free = view.inverse_mass[v] > Real(0);
    motion.push_back({set_.globalVertex(v), velocity.norm(), free ? force.norm() / set_.stiffness(v) : 0.0});
  }
}

template <typename Real>
void PackedSolver<Real>::addMemory(std::vector<MemoryUse>& table) const {
  const auto bytesOf = [](const auto& arrays) {
    std::size_t bytes = 0;
    for (const auto& values : arrays)
      bytes += values.capacity() * sizeof(Real);
    return bytes;
  };
  table.push_back({"solve: vertices", set_.vertexBytes() + true_inverse_mass_.capacity() * sizeof(Real)});
  table.push_back({"solve: springs", set_.springBytes()});
  table.push_back({"solve: stretched springs of incisions", set_.stretchBytes()});
  table.push_back({"solve: cells", set_.cellBytes()});
  table.push_back({"solve: volume energy", set_.volumeEnergyBytes()});
  table.push_back({"solve: safe move", guard_.bytes()});
  table.push_back({"solve: lips", lips_.bytes()});
  table.push_back({"solve: altitude springs", bytesOf(unaltered_)});
  table.push_back({"solve: mass floor", mass_bound_.capacity() * sizeof(double)});
  table.push_back({"solve: other integrators",
                   bytesOf(start_) + bytesOf(start_velocity_) + bytesOf(sum_) + bytesOf(velocity_sum_) +
                       bytesOf(coarse_) + bytesOf(adaptive_start_) + bytesOf(adaptive_velocity_) + bytesOf(direction_) +
                       bytesOf(product_) + rank_ones_.capacity() * sizeof(RankOneStiffness)});
}

}  // namespace

std::unique_ptr<Solver> makeSolver(Precision precision, const Lattice& lattice, const LatticeIndex& index,
                                   int threads) {
  if (precision == Precision::kFloat)
    return std::make_unique<PackedSolver<float>>(lattice, index, threads);
  return std::make_unique<PackedSolver<double>>(lattice, index, threads);
}

}  // namespace soft_volume::core
