#include "soft_volume/tool/tool.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

#include "range_check.h"

namespace soft_volume::core {
namespace {

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
    : config_((config.validate(), config)),
      stiffness_n_m_(config.coupling.renderedStiffness(config.device)),
      probe_(config.tip_radius_m, stiffness_n_m_, config.coupling.damping_n_s_m),
      scalpel_(config.blade_length_m, config.blade_min_move_m),
      resistance_(stiffness_n_m_),
      limiter_(config.device, config.safety),
      force_sequence_(first_sequence),
      cut_sequence_(first_sequence) {
  header_.tool_id = config.id;
}

void Tool::forgetPatch() {
  if (field_)
    field_->clear();
  reset();  // a stroke ends with its session: nobody has to be told
  header_ = {};
  header_.tool_id = config_.id;
  blade_resistance_n_ = 0.0;
  push_cell_.reset();
  pushing_ = false;
}

void Tool::setVolume(std::shared_ptr<const Volume> volume) {
  field_.emplace(std::move(volume), config_.tissue_threshold);
  topology_.reset();
  forgetPatch();
}

void Tool::setTopology(std::shared_ptr<const Topology> topology) {
  assert(topology);
  const bool new_session = !topology_ || topology_->session != topology->session;
  topology_ = std::move(topology);
  if (new_session)
    forgetPatch();
}

void Tool::setPatch(const GridPatch& patch) {
  if (!field_ || !topology_)
    throw InputError("grid patch: it came before the volume and the grid; wait for them");
  if (patch.tool_id != config_.id)
    throw InputError("grid patch: made for tool '" + patch.tool_id + "'");
  if (!(std::isfinite(patch.blade_resistance_n) && patch.blade_resistance_n >= 0.0))
    throw InputError("grid patch: the blade's resistance is not a number from 0 on; wait for the next patch");
  field_->update(*topology_, patch);
  blade_resistance_n_ = patch.blade_resistance_n;
  header_.session = patch.session;
  header_.revision = patch.revision;
  header_.step = patch.step;
}

std::optional<ToolCutCommand> Tool::reset() {
  limiter_.reset();
  probe_.reset();
  contact_ = {};
  in_incision_ = false;
  has_pose_ = false;
  return lift();
}

std::optional<ToolCutCommand> Tool::lift() {
  resistance_.reset();
  cut_pose_.reset();
  if (!scalpel_.lift())
    return std::nullopt;
  ToolCutCommand command;
  command.header = nextHeader(cut_sequence_);
  command.lifted = true;
  return command;
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
  ToolCutCommand command;
  command.lifted = scalpel_.cut(*field_, pose, command.quads);
  if (!command.quads.empty() || command.lifted) {
    command.header = nextHeader(cut_sequence_);
    output.cut = std::move(command);
  }
  output.cutting = scalpel_.inTissue();
  in_incision_ |= output.cutting;
  contact_ = {};
  probe_.reset();
  push_point_m_ = input.pose.position_m;
  push_cell_.reset();
  if (output.cutting)
    return cuttingForce(input.pose.position_m, input.pose_time_s);
  resistance_.reset();
  cut_pose_.reset();
  return Vector3::Zero();
}

Vector3 Tool::cuttingForce(const Vector3& position_m, double time_s) {
  const CutPose before = cut_pose_.value_or(CutPose{position_m, time_s});
  const double dt_s = std::max(0.0, time_s - before.time_s);
  cut_pose_ = CutPose{position_m, time_s};
  return resistance_.update(position_m - before.position_m, dt_s, blade_resistance_n_) -
         config_.cutting_drag_n_s_m * velocity_m_s_;
}

void Tool::press(const ToolInput& input, Vector3& wish_n) {
  const Probe::Result result = probe_.update(*field_, input.pose.position_m, velocity_m_s_);
  if (in_incision_) {
    in_incision_ = result.contact.touching;
    if (in_incision_)
      return;
  }
  contact_ = result.contact;
  if (!contact_.touching)
    return;
  push_point_m_ = contact_.surface_point_m;
  push_cell_ = contact_.cell;
  wish_n = result.device_force_n;
}

Vector3 Tool::wishedForce(const ToolInput& input, ToolOutput& output) {
  if (!field_ || field_->empty()) {
    contact_ = {};
    output.cut = lift();
    return Vector3::Zero();
  }
  if (config_.kind == ToolKind::kScalpel && input.buttons.test(config_.cut_button))
    return cut(input, output);
  output.cut = lift();
  Vector3 wish = Vector3::Zero();
  press(input, wish);
  return wish;
}

ToolCommandHeader Tool::nextHeader(std::uint64_t& sequence) const {
  ToolCommandHeader header = header_;
  header.sequence = sequence++;
  return header;
}

void Tool::commandForce(ToolOutput& output) {
  const bool push = output.device_force_n.squaredNorm() > 0.0;
  if (!push && !pushing_)
    return;
  pushing_ = push;
  ToolForceCommand command;
  command.header = nextHeader(force_sequence_);
  command.hold_steps = config_.hold_steps;
  command.force_n = -output.device_force_n;
  command.point_m = push_point_m_;
  command.footprint_radius_m = config_.footprint_radius_m;
  if (push && push_cell_)
    command.cells.push_back(*push_cell_);
  output.force = std::move(command);
}

ToolOutput Tool::update(const ToolInput& input) {
  ToolOutput output;
  Vector3 wish = Vector3::Zero();
  if (limiter_.check(input.time_s, input.pose_time_s, input.pose, input.velocity_m_s) == ForceFault::kNone) {
    estimateVelocity(input);
    wish = wishedForce(input, output);
  } else {
    output.cut = lift();
    has_pose_ = false;
    velocity_m_s_.setZero();
  }
  const ForceLimiter::Output limited = limiter_.limit(input.time_s, wish);
  output.device_force_n = limited.force_n;
  output.saturated = limited.saturated;
  output.slew_limited = limited.slew_limited;
  output.fault = limiter_.fault();
  output.pose_stale = output.fault == ForceFault::kStalePose || output.fault == ForceFault::kUnusablePose;
  output.tripped = limiter_.tripped();
  if (output.fault == ForceFault::kNone)
    output.contact = contact_;
  output.velocity_m_s = velocity_m_s_;
  output.coupling_stiffness_n_m = stiffness_n_m_;
  commandForce(output);
  return output;
}

}  // namespace soft_volume::core
