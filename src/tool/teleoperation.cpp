#include "soft_volume/tool/teleoperation.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {
namespace {

/// In which the speed follows a deflection: a hand's reaction is slower, a step of the speed would be a kick.
constexpr double kSmoothing_s = 0.05;

struct KeyMotion {
  char key;
  int axis;  // 0 to 2: along; 3 to 5: about
  double sign;
};
constexpr KeyMotion kMotions[] = {{'d', 0, 1.0}, {'a', 0, -1.0}, {'e', 1, 1.0}, {'q', 1, -1.0},
                                  {'w', 2, 1.0}, {'s', 2, -1.0}, {'i', 3, 1.0}, {'k', 3, -1.0},
                                  {'o', 4, 1.0}, {'u', 4, -1.0}, {'j', 5, 1.0}, {'l', 5, -1.0}};

const KeyMotion* findMotion(char key) {
  const auto* found = std::find_if(std::begin(kMotions), std::end(kMotions), [key](auto& m) { return m.key == key; });
  return found == std::end(kMotions) ? nullptr : found;
}

}  // namespace

Teleoperation::Teleoperation(const TeleopConfig& config, const Vector3& centre_m, double radius_m)
    : config_(config), centre_m_(centre_m), radius_m_(radius_m) {
  pose_.position_m = centre_m;
}

/// The dead zone taken out, and at most 1 long.
Vector3 Teleoperation::shaped(const Vector3& deflection) const {
  Vector3 shaped;
  for (int d = 0; d < 3; ++d) {
    const double beyond = std::isfinite(deflection[d]) ? std::abs(deflection[d]) - config_.dead_zone : 0.0;
    shaped[d] = std::copysign(std::clamp(beyond / (1.0 - config_.dead_zone), 0.0, 1.0), deflection[d]);
  }
  return shaped / std::max(1.0, shaped.norm());
}

void Teleoperation::step(const Deflection& deflection, double dt_s) {
  const double follow = 1.0 - std::exp(-dt_s / kSmoothing_s);
  velocity_m_s_ += follow * (config_.max_speed_m_s * shaped(deflection.linear) - velocity_m_s_);
  turn_rad_s_ += follow * (config_.max_turn_rad_s * shaped(deflection.angular) - turn_rad_s_);
  stayInside(dt_s);
  const double angle_rad = turn_rad_s_.norm() * dt_s;
  if (angle_rad > 0.0) {
    pose_.orientation = Quaternion(Eigen::AngleAxisd(angle_rad, turn_rad_s_.normalized())) * pose_.orientation;
    pose_.orientation.normalize();
  }
}

/// Moves; what would lead out of the sphere is stopped, so that the velocity is that of the motion.
void Teleoperation::stayInside(double dt_s) {
  Vector3 to = pose_.position_m + dt_s * velocity_m_s_;
  const Vector3 out = to - centre_m_;
  if (out.norm() > radius_m_)
    to = centre_m_ + out * (radius_m_ / out.norm());
  if (dt_s > 0.0)
    velocity_m_s_ = (to - pose_.position_m) / dt_s;
  pose_.position_m = to;
}

void Keyboard::press(char key, double time_s) {
  if (findMotion(key) != nullptr) {
    held_ = key;
    held_since_s_ = time_s;
  } else if (key == ' ') {
    toggled_ = !toggled_;
  } else if (key == '\t') {
    tapped_ = true;
    tapped_at_s_ = time_s;
  }
}

Deflection Keyboard::deflection(double time_s) const {
  Deflection deflection;
  const KeyMotion* motion = time_s - held_since_s_ <= kHold_s ? findMotion(held_) : nullptr;
  if (motion != nullptr)
    (motion->axis < 3 ? deflection.linear : deflection.angular)[motion->axis % 3] = motion->sign;
  return deflection;
}

Buttons Keyboard::buttons(double time_s) const {
  Buttons buttons;
  buttons[0] = toggled_;
  buttons[1] = tapped_ && time_s - tapped_at_s_ <= kTap_s;
  return buttons;
}

}  // namespace soft_volume::core
