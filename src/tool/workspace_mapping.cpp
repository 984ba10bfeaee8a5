#include "soft_volume/tool/workspace_mapping.h"

#include "range_check.h"

namespace soft_volume::core {

void WorkspaceMappingConfig::validate(const std::string& owner) const {
  checkRange(owner + ": scale", scale, 0.01, 100.0);
  checkRange(owner + ": force_scale", force_scale, 0.01, 100.0);
  for (int d = 0; d < 3; ++d) {
    checkRange(owner + ": device_centre_m", device_centre_m[d], -10.0, 10.0);
    checkRange(owner + ": offset_m", offset_m[d], -10.0, 10.0);
  }
  checkRange(owner + ": norm of orientation_xyzw", orientation.norm(), 0.99, 1.01);
  checkRange(owner + ": norm of handle_orientation_xyzw", handle_orientation.norm(), 0.99, 1.01);
  if (clutch_button)
    checkRange(owner + ": clutch_button", *clutch_button, 0.0, 31.0);
}

WorkspaceMapping::WorkspaceMapping(const WorkspaceMappingConfig& config, const WorkspacePlace& place)
    : config_(config),
      R_V_B_((place.orientation * config.orientation).normalized()),
      centre_m_(place.centre_m + place.orientation * config.offset_m) {}

Vector3 WorkspaceMapping::mapped(const Vector3& p_B) const {
  return centre_m_ + R_V_B_ * (config_.scale * (p_B - config_.device_centre_m)) + shift_m_;
}

WorkspaceMapping::Tip WorkspaceMapping::toVolume(const Pose& device, const std::optional<Vector3>& velocity_m_s,
                                                 const Buttons& buttons) {
  Tip tip;
  tip.engaged = !(config_.clutch_button && buttons[*config_.clutch_button]);
  tip.pose.orientation = R_V_B_ * device.orientation * config_.handle_orientation;
  if (velocity_m_s)
    tip.velocity_m_s = tip.engaged ? Vector3(R_V_B_ * (config_.scale * *velocity_m_s)) : Vector3::Zero();
  if (!isUsable(device)) {  // passed on as it is, and nothing is remembered of it
    tip.pose.position_m = mapped(device.position_m);
    return tip;
  }
  device_orientation_ = device.orientation.normalized();
  if (!tip.engaged && !held_m_)
    held_m_ = has_tip_ ? tip_m_ : mapped(device.position_m);
  if (held_m_) {  // also on the pose at which it is let go
    shift_m_ += *held_m_ - mapped(device.position_m);
    if (tip.engaged)
      held_m_.reset();
  }
  tip_m_ = mapped(device.position_m);
  has_tip_ = true;
  tip.pose.position_m = tip_m_;
  return tip;
}

Vector3 WorkspaceMapping::forceToDevice(const Vector3& force_n) const {
  const Vector3 force_B = R_V_B_.conjugate() * (config_.force_scale * force_n);
  return config_.force_frame == ForceFrame::kBody ? device_orientation_.conjugate() * force_B : force_B;
}

Vector3 WorkspaceMapping::forceToVolume(const Vector3& driver_force_n, const Quaternion& device) const {
  const Vector3 force_B = config_.force_frame == ForceFrame::kBody ? device * driver_force_n : driver_force_n;
  return R_V_B_ * force_B / config_.force_scale;
}

Pose WorkspaceMapping::toDevice(const Pose& tip) const {
  Pose device;
  device.position_m =
      R_V_B_.conjugate() * (tip.position_m - centre_m_ - shift_m_) / config_.scale + config_.device_centre_m;
  device.orientation = R_V_B_.conjugate() * tip.orientation * config_.handle_orientation.conjugate();
  return device;
}

DeviceLimits WorkspaceMapping::atTip(const DeviceLimits& device) const {
  DeviceLimits tip;
  tip.max_force_n = device.max_force_n / config_.force_scale;
  tip.max_stiffness_n_m = atTip(device.max_stiffness_n_m);
  tip.max_damping_n_s_m = atTip(device.max_damping_n_s_m);
  tip.workspace_radius_m = device.workspace_radius_m * config_.scale;
  return tip;
}

SafetyConfig WorkspaceMapping::atTip(const SafetyConfig& device) const {
  SafetyConfig tip = device;
  tip.max_growth_n_s = device.max_growth_n_s / config_.force_scale;
  tip.max_speed_m_s = device.max_speed_m_s * config_.scale;
  return tip;
}

}  // namespace soft_volume::core
