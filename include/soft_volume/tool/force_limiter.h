#pragma once

#include <array>
#include <optional>
#include <string>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// What a driver may render on a haptic device; not the device's own inertia and friction.
struct DeviceLimits {
  double max_force_n = 3.3;           ///< (0, 100]
  double max_stiffness_n_m = 400;     ///< (0, 20000]
  double max_damping_n_s_m = 4;       ///< [0, 100]
  double workspace_radius_m = 0.075;  ///< (0, 2]

  /// Throws SceneError with the field and its range; `owner` starts the message.
  void validate(const std::string& owner) const;
};

/// The limits of a known device: touch, omni, desktop, premium_1_5, premium_3_0, omega_7 or falcon (the limits that an
/// open haptics library ships). Throws SceneError with the known names for another name.
DeviceLimits deviceLimits(const std::string& name);

/// Rules between the wished force and the motor. The defaults are the loosest values that are allowed.
struct SafetyConfig {
  double max_growth_n_s = 100.0;  ///< fastest growth of the force, 0.1 N/ms; (0, 100]
  double ramp_in_s = 0.2;         ///< after start, reconnect and reset; [0.2, 10]
  double stale_after_s = 0.02;    ///< age of a pose from which on it is not used; (0, 0.02]
  double drop_s = 0.025;          ///< time in which a fault takes the force to zero; (0, 0.025]
  double max_speed_m_s = 1.0;     ///< faster than a hand: a jump of the pose; (0, 1]

  void validate(const std::string& owner) const;
};

/// Why the force is being taken to zero.
enum class ForceFault {
  kNone,
  kStalePose,      ///< no pose within stale_after_s
  kDisabled,       ///< the device is not enabled, or the hand holds the clutch
  kStalePatch,     ///< the simulation has stopped sending the tissue's state
  kUnusablePose,   ///< not finite, or the quaternion is not a rotation
  kUnusableForce,  ///< the wished force is not finite
  kTripped,        ///< the pose jumped; stays until reset()
};

inline constexpr std::array<ForceFault, 6> kForceFaults{ForceFault::kStalePose,     ForceFault::kDisabled,
                                                        ForceFault::kStalePatch,    ForceFault::kUnusablePose,
                                                        ForceFault::kUnusableForce, ForceFault::kTripped};

/// A sentence for people; empty for kNone.
std::string describe(ForceFault fault);

/// Takes a wished force to what may be sent to a motor.
///
/// - saturation at the device's maximum;
/// - growth of the force, in any direction, limited; decreases are free;
/// - the force starts at zero and ramps in after the start, after every fault (a reconnect) and after reset();
/// - a stale or unusable pose, a fault that was reported, or an unusable force, takes the force linearly to zero within
/// drop_s;
/// - a pose that moves faster than max_speed_m_s does the same and latches until reset().
///
/// Times are seconds of any one clock of the caller, which the limiter never reads itself; a clock that jumps back
/// restarts it. Per cycle: check(), then limit(). No allocation; one thread at a time.
class ForceLimiter {
 public:
  struct Output {
    Vector3 force_n = Vector3::Zero();
    bool saturated = false;
    bool slew_limited = false;
  };

  /// Needs valid configurations.
  ForceLimiter(const DeviceLimits& limits, const SafetyConfig& safety) : limits_(limits), safety_(safety) {}

  /// Judges the newest pose, received or stamped at `pose_time_s`. `velocity_m_s` is the device's own, where it has
  /// one; otherwise speed is judged from the poses: at once beyond max_speed_m_s plus 5 mm (a late message is no jump),
  /// and as a mean over 20 ms. `stamp_s` is when the device measured the pose by its own clock, which need not agree
  /// with the other times: messages that were held up come in one burst, and their stamps say that nothing jumped. They
  /// are believed for up to 0.1 s between two poses; stamps that do not increase say nothing.
  ForceFault check(double time_s, double pose_time_s, const Pose& pose, const std::optional<Vector3>& velocity_m_s,
                   const std::optional<double>& stamp_s = std::nullopt);
  /// Another fault that the caller found since the last check(); the pose's go first.
  void report(ForceFault fault);
  /// The force to send, by the result of the last check().
  Output limit(double time_s, const Vector3& wish_n);

  bool tripped() const { return tripped_; }
  /// The device is one that tripped elsewhere.
  void trip() { tripped_ = true; }
  ForceFault fault() const { return fault_; }
  /// Starts over with zero force and the ramp; a trip stays.
  void restart();
  /// The same, and ends a trip.
  void reset();

 private:
  struct TimedPosition {
    double time_s;
    std::optional<double> stamp_s;
    Vector3 position_m;
  };
  bool jumped(const TimedPosition& now);
  static double between(const TimedPosition& before, const TimedPosition& now);
  Vector3 falling(double time_s);
  Vector3 slewed(const Vector3& wish_n, double dt_s, bool& limited) const;

  DeviceLimits limits_;
  SafetyConfig safety_;

  ForceFault fault_ = ForceFault::kNone;
  bool tripped_ = false;
  Vector3 force_n_ = Vector3::Zero();  // sent last
  std::optional<double> time_s_;       // of the last check
  std::optional<double> limit_time_s_;
  std::optional<double> ramp_start_s_;  // set while forces flow
  std::optional<double> fall_start_s_;  // set while a fault takes the force down
  Vector3 fall_from_n_ = Vector3::Zero();

  std::optional<TimedPosition> last_;       // newest pose
  std::optional<TimedPosition> reference_;  // start of the window for the mean speed
};

}  // namespace soft_volume::core
