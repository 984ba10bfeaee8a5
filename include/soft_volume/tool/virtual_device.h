#pragma once

#include <optional>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/force_limiter.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume::core {

/// Where the scripted hand wants the device, and when.
struct WayPoint {
  double time_s = 0.0;                    ///< since the script's start; [0, 86400], increasing from one to the next
  Vector3 position_m = Vector3::Zero();   ///< volume frame, within the workspace
  std::optional<Quaternion> orientation;  ///< of the tool in the volume frame; that of the way-point before by default
  Buttons buttons;                        ///< held from this way-point's time until the next one's
  /// The hand goes on through this way-point instead of resting there: a run of these is one smooth curve from the rest
  /// before to the rest after it. Of no effect for the first and the last way-point.
  bool pass = false;
};

/// A device's own mechanics, which its limits (what a driver may render) do not tell.
struct DeviceMechanics {
  double mass_kg = 0.045;                   ///< apparent mass at the tip
  double friction_n = 0.26;                 ///< Coulomb friction at the tip
  double position_resolution_m = 0.000055;  ///< of the encoders, at the tip
  double rate_hz = 1000.0;                  ///< of its servo loop
  const char* source = "";                  ///< whose numbers these are
};

/// The mechanics of a device that deviceLimits() knows. Throws SceneError with the known names for another name.
DeviceMechanics deviceMechanics(const std::string& name);

/// A haptic device and the hand that holds it. The defaults are a Touch without friction: apparent mass 45 g at the tip
/// as its maker states. Its damping and the hand's stiffness and damping are assumptions, in the range that papers on
/// grasps of a stylus report (hundreds of N/m, a few N·s/m).
struct VirtualDeviceConfig {
  DeviceLimits limits;
  double mass_kg = 0.045;                        ///< apparent mass at the tip; [0.005, 5]
  double damping_n_s_m = 0.2;                    ///< physical damping; [0, 100]
  double friction_n = 0.0;                       ///< Coulomb friction, sticks too; [0, 10]
  double step_s = 0.001;                         ///< that step() advances; [0.00001, 0.001]
  double hand_stiffness_n_m = 300.0;             ///< [1, mass / step^2], beyond which a step is not stable
  double hand_damping_n_s_m = 5.0;               ///< [0, 100]
  double position_resolution_m = 0.0;            ///< of the encoders, 0 for none; [0, 0.001]
  Vector3 workspace_centre_m = Vector3::Zero();  ///< volume frame
  std::vector<WayPoint> way_points;              ///< at least one

  /// Throws SceneError with the field, or the way-point's number, and its range.
  void validate() const;
};

/// Work through one of the device's ports so far, joule; what went in and out by turns adds to both.
struct PortWork {
  double into_device_j = 0.0;
  double out_of_device_j = 0.0;
};

/// A haptic device in software that behaves like a driver of a real one: mass and damping, a hand that pulls it along a
/// script (minimum jerk between way-points where it rests; where it passes, a cubic in time with a continuous velocity,
/// which at a way-point is that of the parabola through it and its neighbours; spring and damper between hand and
/// device), a servo force that is saturated and held until it is replaced or 20 ms old, a workspace with hard ends. The
/// orientation follows the script; nothing turns it. Fixed steps of 1 ms, semi-implicit (symplectic for the springs,
/// implicit in the damping): deterministic, and no clock is read. One thread at a time.
class VirtualDevice {
 public:
  static constexpr double kStep_s = 0.001;  ///< of a configuration that does not say otherwise
  static constexpr double kServoTimeout_s = 0.02;

  /// Starts at rest at the first way-point. Throws SceneError when the configuration is not valid.
  explicit VirtualDevice(const VirtualDeviceConfig& config);

  /// The force that the motors shall render from now on, volume frame. Not finite is taken as zero.
  void setServoForce(const Vector3& force_n);
  /// The hand holds the device by another spring and damper from now on; zeros let it go.
  void setGrip(double stiffness_n_m, double damping_n_s_m);
  void step();

  /// Seconds simulated.
  double time_s() const { return double(steps_) * config_.step_s; }
  /// True after the last way-point's time; the hand stays there.
  bool scriptEnded() const { return time_s() >= config_.way_points.back().time_s; }
  /// Tip, volume frame, as the encoders see it.
  Pose pose() const;
  Vector3 velocity_m_s() const { return velocity_m_s_; }
  Buttons buttons() const;
  /// What the motors render now: saturated, zero when timed out.
  Vector3 renderedForce_n() const;
  /// What the hand feels: spring and damper between hand and device, on the hand [N].
  Vector3 handForce_n() const;
  /// Of the tip, exactly.
  const Vector3& position_m() const { return position_m_; }
  /// Exact works of hand and motors in the steps that were done.
  const PortWork& handWork() const { return hand_work_; }
  const PortWork& motorWork() const { return motor_work_; }
  double kineticEnergy_j() const { return 0.5 * config_.mass_kg * velocity_m_s_.squaredNorm(); }
  const VirtualDeviceConfig& config() const { return config_; }

 private:
  struct Wanted {
    Vector3 position_m;
    Vector3 velocity_m_s;
    Quaternion orientation;
  };
  std::size_t wayPointAt(double time_s) const;
  Wanted wantedAt(double time_s) const;
  Wanted passingBetween(std::size_t way_point, double u) const;
  bool passes(std::size_t way_point) const;
  Vector3 velocityAt(std::size_t way_point) const;
  Vector3 velocityAfter(const Vector3& force_n) const;
  void stayInWorkspace();

  VirtualDeviceConfig config_;
  std::uint64_t steps_ = 0;
  Vector3 position_m_;
  Vector3 velocity_m_s_ = Vector3::Zero();
  Vector3 servo_force_n_ = Vector3::Zero();
  std::uint64_t servo_step_ = 0;
  PortWork hand_work_;
  PortWork motor_work_;
};

}  // namespace soft_volume::core
