#pragma once

#include <cstdint>
#include <optional>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/force_limiter.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume::core {

/// Where a scene wants a device's workspace.
struct WorkspacePlace {
  Vector3 centre_m = Vector3::Zero();  ///< volume frame; the middle of the device's workspace comes to lie here
  /// Of the user's frame (x to the right, y away from the user, z up) in the volume frame.
  Quaternion orientation = Quaternion::Identity();
};

/// In which frame a driver wants the force.
enum class ForceFrame {
  kBase,  ///< that of the poses
  kBody,  ///< the handle's, as it is oriented now
};

/// How a device's workspace lies in the volume. The base frame B is the one that the driver's poses are in.
struct WorkspaceMappingConfig {
  double scale = 1.0;                                      ///< metres of the tip per metre of the device; [0.01, 100]
  double force_scale = 1.0;                                ///< newtons on the device per newton at the tip; [0.01, 100]
  Vector3 device_centre_m = Vector3::Zero();               ///< B; comes to lie at the scene's workspace centre
  Vector3 offset_m = Vector3::Zero();                      ///< user's frame, metres of the tip; added to that centre
  Quaternion orientation = Quaternion::Identity();         ///< of B in the user's frame
  Quaternion handle_orientation = Quaternion::Identity();  ///< of the tool (+z up its shaft) in the handle's frame
  ForceFrame force_frame = ForceFrame::kBase;
  std::optional<std::uint32_t> clutch_button;  ///< while it is held the tip stays and the device feels nothing; [0, 31]

  /// Throws SceneError with the field and its range; `owner` starts the message.
  void validate(const std::string& owner) const;
};

/// Takes poses of a device to the tip of the tool in the volume frame, and forces back.
///
/// p_V = centre + R_V_B scale (p_B - device_centre) + what the clutch has shifted. While the clutch is held the tip's
/// position stays and the device moves under it without a force (a force that is held while the device moves would put
/// out energy); when it is let go the tip goes on from where it is, without a jump. The tip's orientation follows the
/// device at all times, so it has nothing to jump.
///
/// What limits a device limits the tip, scaled: a stiffness of K at the tip is felt as K scale force_scale. The atTip()
/// functions give the limits that the tip must keep, so that the device keeps its own.
///
/// No allocation; one thread at a time.
class WorkspaceMapping {
 public:
  /// Everything of the device equals the volume's: what a driver sends that is in the volume frame already.
  WorkspaceMapping() = default;
  /// Needs a valid configuration.
  WorkspaceMapping(const WorkspaceMappingConfig& config, const WorkspacePlace& place);

  struct Tip {
    Pose pose;                            ///< volume frame; not usable when the device's is not
    std::optional<Vector3> velocity_m_s;  ///< volume frame, where the device measures it; zero while disengaged
    bool engaged = true;                  ///< false while the clutch is held: there must be no force
  };
  /// Of the newest pose (B, metres) and velocity. Every pose must pass here, in order.
  Tip toVolume(const Pose& device, const std::optional<Vector3>& velocity_m_s, const Buttons& buttons);

  /// A force at the tip (volume frame) as the driver wants it for the newest pose; the force scale is in it.
  Vector3 forceToDevice(const Vector3& force_n) const;
  /// The opposite: what a driver was given as a force at the tip, for a handle oriented like `device` (B).
  Vector3 forceToVolume(const Vector3& driver_force_n, const Quaternion& device) const;
  /// The device's pose (B) that has the tip there, with what the clutch has shifted so far.
  Pose toDevice(const Pose& tip) const;

  /// Stiffness or damping as the device feels it for one at the tip, and back.
  double atDevice(double stiffness_or_damping) const {
    return stiffness_or_damping * config_.scale * config_.force_scale;
  }
  double atTip(double stiffness_or_damping) const {
    return stiffness_or_damping / (config_.scale * config_.force_scale);
  }
  DeviceLimits atTip(const DeviceLimits& device) const;
  SafetyConfig atTip(const SafetyConfig& device) const;

  const WorkspaceMappingConfig& config() const { return config_; }

 private:
  Vector3 mapped(const Vector3& p_B) const;

  WorkspaceMappingConfig config_;
  Quaternion R_V_B_ = Quaternion::Identity();
  Vector3 centre_m_ = Vector3::Zero();  // volume frame
  Vector3 shift_m_ = Vector3::Zero();   // of the clutch, volume frame
  std::optional<Vector3> held_m_;       // where the clutch holds the tip
  Vector3 tip_m_ = Vector3::Zero();
  bool has_tip_ = false;
  Quaternion device_orientation_ = Quaternion::Identity();
};

}  // namespace soft_volume::core
