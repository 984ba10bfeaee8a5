#pragma once

#include <string>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume::core {

/// How far a 6-axis mouse is deflected, or what keys are held: each component in [-1, 1].
struct Deflection {
  Vector3 linear = Vector3::Zero();
  Vector3 angular = Vector3::Zero();
};

/// How fast a mouse or a keyboard moves the tool.
struct TeleopConfig {
  std::string joy;              ///< topic of the mouse, 6 axes in [-1, 1]: x, y, z and about x, y, z
  double max_speed_m_s = 0.05;  ///< at full deflection, or while a key is held; (0, 0.5]
  double max_turn_rad_s = 1.0;  ///< the same for turning; (0, 10]
  double dead_zone = 0.05;      ///< deflection up to which nothing moves; [0, 0.9]
};

/// Turns deflections into a device's pose: a speed in proportion to the deflection, smoothed so that a key does not
/// kick, inside of a sphere. One thread at a time; no clock is read.
class Teleoperation {
 public:
  /// Starts at rest at the centre. Needs a valid configuration.
  Teleoperation(const TeleopConfig& config, const Vector3& centre_m, double radius_m);

  /// Components that are not finite count as none.
  void step(const Deflection& deflection, double dt_s);

  const Pose& pose() const { return pose_; }
  const Vector3& velocity_m_s() const { return velocity_m_s_; }
  const Vector3& turn_rad_s() const { return turn_rad_s_; }

 private:
  Vector3 shaped(const Vector3& deflection) const;
  void stayInside(double dt_s);

  TeleopConfig config_;
  Vector3 centre_m_;
  double radius_m_;
  Pose pose_;
  Vector3 velocity_m_s_ = Vector3::Zero();
  Vector3 turn_rad_s_ = Vector3::Zero();
};

/// The keys of a terminal as a deflection and as buttons. A terminal tells when a key is pressed or repeats, but not
/// when it is let go: a key counts as held for a moment after that.
class Keyboard {
 public:
  static constexpr double kHold_s = 0.12;  ///< longer than the pause between repeats
  static constexpr double kTap_s = 0.1;    ///< for which the swap key presses its button
  static constexpr const char* kHelp =
      "a d  left, right      j l  turn left, right\n"
      "w s  up, down         i k  tip up, down\n"
      "e q  away, towards    u o  roll left, right\n"
      "space  press or release button 0 (cut, grip)\n"
      "tab    tap button 1 (next tool)\n";

  /// A key at a time of the caller's clock; unknown ones are ignored.
  void press(char key, double time_s);
  /// In the user's frame: x right, y away, z up.
  Deflection deflection(double time_s) const;
  Buttons buttons(double time_s) const;

 private:
  char held_ = 0;
  double held_since_s_ = 0.0;
  bool toggled_ = false;
  bool tapped_ = false;
  double tapped_at_s_ = 0.0;
};

}  // namespace soft_volume::core
