#include "soft_volume/tool/tool.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <utility>

#include "range_check.h"

namespace soft_volume::core {
namespace {

/// Tissue under a footprint, as under a flat punch on a half space, is 2 E a / (1 - nu^2) stiff. A coupling that is not
/// a good deal softer swings with it, because it pushes from where the surface was some time ago. The share is one that
/// was stable with 30, 100 and 250 patches a second for tissue damped by half of the critical damping.
constexpr double kTissueShare = 0.3;
constexpr double kPoisson = 0.45;
constexpr double kVelocityFilter = 0.005;  // seconds; smooths velocities estimated from poses

}  // namespace

void ToolConfig::validate() const {
  const std::string owner = "tool '" + id + "'";
  if (id.empty())
    throw SceneError("a tool has an empty id; give every tool a name of its own");
  checkRange(owner + ": tissue_threshold", tissue_threshold, -1e30, 1e30);
  checkRange(owner + ": tip_radius_m", tip_radius_m, 0.0005, 0.05);
  checkRange(owner + ": footprint_radius_m", footprint_radius_m, 0.001, 0.1);
  checkRange(owner + ": patch_radius_m", patch_radius_m, 0.005, 0.2);
  checkRange(owner + ": friction_coefficient", friction_coefficient, 0.0, 2.0);
  checkRange(owner + ": hold_steps", hold_steps, 1, 10000);
  device.validate(owner + ": device");
  coupling.validate(owner, device);
  safety.validate(owner);
  if (kind == ToolKind::kGrasper) {
    checkRange(owner + ": grasp_reach_m", grasp_reach_m, 0.0005, 0.05);
    checkRange(owner + ": slip_force_n", slip_force_n, 1e-6, 100.0);
    checkRange(owner + ": grasp_button", grasp_button, 0, 31);
  }
  if (kind != ToolKind::kScalpel)
    return;
  checkRange(owner + ": blade_length_m", blade_length_m, 0.001, 0.1);
  checkRange(owner + ": blade_min_move_m", blade_min_move_m, 0.00005, 0.01);
  checkRange(owner + ": cutting_drag_n_s_m", cutting_drag_n_s_m, 0.0, coupling.device_damping_n_s_m);
  checkRange(owner + ": cut_button", cut_button, 0, 31);
}

Tool::Tool(const ToolConfig& config, std::uint64_t first_sequence)
    : config_(config),
      intake_(config.id, config.tissue_threshold),
      grasp_(config.grasp_reach_m, config.slip_force_n),
      scalpel_(config.blade_length_m, config.blade_min_move_m),
      coupling_(config.coupling, config.device),
      passivity_(config.coupling.delay_s),
      limiter_(config.device, config.safety),
      force_sequence_(first_sequence),
      cut_sequence_(first_sequence) {}

void Tool::forgetSession() {
  limiter_.restart();
  forgetContact();
  lift();  // a stroke ends with its session: nobody has to be told
  header_ = {};
  patches_.reset();
  push_cell_.reset();
  pushing_ = false;
}

void Tool::setVolume(std::shared_ptr<const Volume> volume) {
  intake_.setVolume(std::move(volume));
  patch_ = intake_.makeEmpty();
  spare_ = intake_.makeEmpty();
  forgetSession();
}

void Tool::setTopology(std::shared_ptr<const Topology> topology) {
  if (!intake_.setTopology(std::move(topology)) || !patch_)
    return;
  patch_ = intake_.makeEmpty();
  forgetSession();
}

void Tool::setPatch(const GridPatch& patch) {
  intake_.fill(patch, spare_.get());
  spare_ = takePatch(std::move(spare_));
}

std::unique_ptr<ReadyPatch> Tool::takePatch(std::unique_ptr<ReadyPatch> patch) {
  if (header_.session != 0 && patch->session != header_.session)
    forgetSession();
  header_.session = patch->session;
  header_.revision = patch->revision;
  header_.step = patch->step;
  patch_is_new_ = true;
  if (patch_ && patches_.interval() > 0.0)
    patch->field.beginFrom(patch_->field, patches_.interval());
  std::swap(patch_, patch);
  return patch;
}

std::optional<TissueCut> Tool::reset() {
  limiter_.reset();
  meter_.pause();  // it may have been out of the hand
  forgetContact();
  return lift();
}

void Tool::forgetContact() {
  proxy_.reset();
  grasp_.reset();
  resistance_.reset();
  cut_pose_.reset();
  contact_ = {};
  in_incision_ = false;
  has_pose_ = false;
}

std::optional<TissueCut> Tool::lift() {
  if (!scalpel_.lift())
    return std::nullopt;
  return TissueCut{nextHeader(cut_sequence_), std::nullopt, true};
}

void Tool::estimateVelocity(const ToolInput& input) {
  const double dt = input.pose_time_s - pose_time_s_;
  if (input.velocity_m_s) {
    velocity_m_s_ = *input.velocity_m_s;
  } else if (!has_pose_ || dt > config_.safety.stale_after_s) {
    velocity_m_s_.setZero();
  } else if (dt > 0.0) {
    const Vector3 newest = (input.pose.position_m - position_m_) / dt;
    velocity_m_s_ += dt / (dt + kVelocityFilter) * (newest - velocity_m_s_);
  }
  if (has_pose_ && dt == 0.0)
    return;
  has_pose_ = true;
  pose_time_s_ = input.pose_time_s;
  position_m_ = input.pose.position_m;
}

Vector3 Tool::cut(const ToolInput& input, ToolOutput& output) {
  Pose pose = input.pose;
  pose.orientation.normalize();
  const Scalpel::Sweep sweep = scalpel_.cut(patch_->field, pose);
  if (sweep.quad || sweep.ended)
    output.cut = TissueCut{nextHeader(cut_sequence_), sweep.quad, sweep.ended};
  output.cutting = scalpel_.inTissue();
  in_incision_ |= output.cutting;
  contact_ = {};
  proxy_.reset();
  push_point_m_ = input.pose.position_m;
  push_cell_.reset();
  const double resistance_n = output.cutting ? patch_->blade_resistance_n : 0.0;
  const double drag_n_s_m = output.cutting ? config_.cutting_drag_n_s_m : 0.0;
  return resistance(input, resistance_n) - drag_n_s_m * velocity_m_s_;
}

/// Also after the cut, until the force has faded.
Vector3 Tool::resistance(const ToolInput& input, double resistance_n) {
  const CutPose now{input.pose.position_m, input.pose_time_s};
  const CutPose before = cut_pose_.value_or(now);
  cut_pose_ = now;
  return resistance_.update(now.position_m - before.position_m, std::max(0.0, now.time_s - before.time_s), resistance_n,
                            coupling_.stiffness_n_m());
}

/// Twice what sampling and delay make of energy per speed at this stiffness, but no more than is passive.
double Tool::dampingBound() const {
  const CouplingConfig& coupling = config_.coupling;
  const LoopTiming& timing = coupling_.timing();
  const double made = coupling_.stiffness_n_m() * (0.5 * timing.period_s + timing.delay_s);
  return std::min(
      {2.0 * made, config_.device.max_damping_n_s_m, coupling.device_damping_n_s_m - coupling.damping_n_s_m});
}

Vector3 Tool::springForce(ToolOutput& output) const {
  const double stretch = spring_.stretch_m.norm();
  if (!spring_.loaded || stretch == 0.0)
    return Vector3::Zero();
  const Vector3 axis = spring_.stretch_m / stretch;
  const Vector3 speed = (velocity_m_s_ - spring_.surface_velocity_m_s).dot(axis) * axis;
  output.passivity_damping_n_s_m = passivity_.damping(speed, dampingBound());
  const double damping = config_.coupling.damping_n_s_m + output.passivity_damping_n_s_m;
  const Vector3 force = coupling_.stiffness_n_m() * spring_.stretch_m - damping * speed;
  return force.dot(axis) > 0.0 ? force : Vector3::Zero();  // it never pushes the tip into the tissue
}

void Tool::press(const ToolInput& input) {
  const Contact contact =
      proxy_.update(patch_->field, input.pose.position_m, config_.tip_radius_m, config_.friction_coefficient);
  if (in_incision_) {
    in_incision_ = contact.touching;
    if (in_incision_)
      return;
  }
  contact_ = contact;
  if (!contact_.touching)
    return;
  push_point_m_ = contact_.surface_point_m;
  push_cell_ = contact_.cell;
  spring_ = {true, contact.proxy_m - input.pose.position_m, contact.surface_velocity_m_s};
}

/// Jaws that hold tissue feel nothing else.
bool Tool::grip(const ToolInput& input, ToolOutput& output) {
  const bool closed = input.buttons.test(config_.grasp_button);
  const bool held = grasp_.holding();
  const Grasp::Hold hold = grasp_.update(patch_->field, input.pose.position_m, closed, coupling_.stiffness_n_m());
  in_incision_ |= held && !hold.holding;  // what was held may lie around the tip: as after a cut
  if (!hold.holding)
    return false;
  output.gripping = true;
  output.grip_point_m = hold.point_m;
  contact_ = {};
  proxy_.reset();
  push_point_m_ = hold.point_m;
  push_cell_ = hold.cell;
  spring_ = {true, hold.anchor_m - input.pose.position_m, hold.velocity_m_s};
  return true;
}

Vector3 Tool::wishedForce(const ToolInput& input, ToolOutput& output) {
  if (!patch_ || patch_->field.empty()) {
    contact_ = {};
    output.cut = lift();
    return resistance(input, 0.0);
  }
  if (config_.kind == ToolKind::kScalpel && input.buttons.test(config_.cut_button))
    return cut(input, output);
  output.cut = lift();
  if (config_.kind != ToolKind::kGrasper || !grip(input, output))
    press(input);
  return springForce(output) + resistance(input, 0.0);
}

TickHeader Tool::nextHeader(std::uint64_t& sequence) const {
  TickHeader header = header_;
  header.sequence = sequence++;
  return header;
}

void Tool::commandForce(ToolOutput& output) {
  const bool push = output.device_force_n.squaredNorm() > 0.0;
  if (!push && !pushing_)
    return;
  pushing_ = push;
  output.force = TissueForce{nextHeader(force_sequence_), config_.hold_steps,
                             -output.device_force_n,      push_point_m_,
                             config_.footprint_radius_m,  push ? push_cell_ : std::nullopt};
}

/// Patches, poses and ticks by the clock, and what follows for the coupling.
void Tool::watchTime(const ToolInput& input) {
  if (patch_is_new_)
    patches_.take(input.time_s);
  patch_is_new_ = false;
  if (patch_)
    patch_->field.advance(clock_s_ ? std::max(0.0, input.time_s - *clock_s_) : 0.0);
  clock_s_ = input.time_s;
  if (poseFault())
    meter_.pause();
  else
    meter_.tick(input.time_s, input.pose_time_s, input.pose_delay_s);
  const bool touching = contact_.touching || grasp_.holding() || resistance_.loaded();
  const bool loaded = pushing_ || (touching && limiter_.fault() == ForceFault::kNone);
  coupling_.update(meter_.timing(), tissueBound(), loaded);
}

double Tool::tissueBound() const {
  const double footprint_m = config_.footprint_radius_m;
  const double modulus_pa = patch_ && has_pose_ ? patch_->field.youngsModulus(position_m_, footprint_m) : 0.0;
  if (modulus_pa == 0.0)  // no tissue
    return std::numeric_limits<double>::infinity();
  return kTissueShare * 2.0 * modulus_pa * footprint_m / (1.0 - kPoisson * kPoisson);
}

bool Tool::poseFault() const {
  return limiter_.fault() == ForceFault::kStalePose || limiter_.fault() == ForceFault::kUnusablePose;
}

void Tool::observe(const ToolInput& input, const Vector3& force_n) {
  if (poseFault()) {
    passivity_.reset();
    return;
  }
  PassivityControl::Tick tick;
  tick.time_s = input.time_s;
  tick.measured_s = input.pose_time_s - input.pose_delay_s;
  tick.device_m = input.pose.position_m;
  tick.stretch_m = spring_.stretch_m;
  tick.surface_velocity_m_s = spring_.surface_velocity_m_s;
  tick.stiffness_n_m = spring_.loaded ? coupling_.stiffness_n_m() : 0.0;
  tick.force_n = force_n;
  passivity_.observe(tick);
}

void Tool::report(ToolOutput& output) const {
  output.fault = limiter_.fault();
  output.pose_stale = poseFault();
  output.patch_stale = output.fault == ForceFault::kStalePatch;
  output.tripped = limiter_.tripped();
  if (output.fault == ForceFault::kNone)
    output.contact = contact_;
  output.velocity_m_s = velocity_m_s_;
  output.patch = header_;
  output.coupling_stiffness_n_m = coupling_.stiffness_n_m();
  output.stiffness_bound = coupling_.bound();
  output.timing = coupling_.timing();
  output.patch_interval_s = patches_.interval();
  output.made_energy_j = passivity_.energy();
}

ToolOutput Tool::update(const ToolInput& input) {
  ToolOutput output;
  Vector3 wish = Vector3::Zero();
  spring_ = {};
  limiter_.check(input.time_s, input.pose_time_s, input.pose, input.velocity_m_s, input.pose_stamp_s);
  watchTime(input);
  if (!input.forces_allowed)
    limiter_.report(ForceFault::kDisabled);
  if (patches_.stopped(input.time_s))
    limiter_.report(ForceFault::kStalePatch);
  if (limiter_.fault() == ForceFault::kNone) {
    estimateVelocity(input);
    wish = wishedForce(input, output);
  } else {
    output.cut = lift();
    resistance_.reset();
    cut_pose_.reset();
    has_pose_ = false;
    velocity_m_s_.setZero();
  }
  const ForceLimiter::Output limited = limiter_.limit(input.time_s, wish);
  output.device_force_n = limited.force_n;
  output.saturated = limited.saturated;
  output.slew_limited = limited.slew_limited;
  observe(input, limited.force_n);
  report(output);
  commandForce(output);
  return output;
}

}  // namespace soft_volume::core
