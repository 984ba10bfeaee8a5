#include "soft_volume/tool/force_limiter.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <utility>

#include "range_check.h"

namespace soft_volume::core {
namespace {

constexpr double kJumpSlack = 0.005;   // metres that a burst of late messages may seem to jump
constexpr double kBelievedGap = 0.1;   // seconds between two poses, by the device's own clock
constexpr double kSpeedWindow = 0.02;  // seconds; short windows confuse jitter of the messages with speed

constexpr std::array<std::pair<const char*, DeviceLimits>, 7> kDevices{{
    {"touch", {3.3, 400, 4, 0.075}},
    {"omni", {3.3, 700, 5, 0.1}},
    {"desktop", {7.9, 1000, 5, 0.1}},
    {"premium_1_5", {8.5, 800, 5, 0.12}},
    {"premium_3_0", {22, 1000, 5, 0.25}},
    {"omega_7", {12, 5000, 30, 0.075}},
    {"falcon", {8, 3000, 20, 0.04}},
}};

constexpr double kRounding = 1e-9;
constexpr double kTiny = 1e-9;  // stands for an open end of a range

}  // namespace

void DeviceLimits::validate(const std::string& owner) const {
  checkRange(owner + ": max_force_n", max_force_n, kTiny, 100.0);
  checkRange(owner + ": max_stiffness_n_m", max_stiffness_n_m, kTiny, 20000.0);
  checkRange(owner + ": max_damping_n_s_m", max_damping_n_s_m, 0.0, 100.0);
  checkRange(owner + ": workspace_radius_m", workspace_radius_m, kTiny, 2.0);
}

DeviceLimits deviceLimits(const std::string& name) {
  std::string known;
  for (const auto& [known_name, limits] : kDevices) {
    if (name == known_name)
      return limits;
    known += (known.empty() ? "" : ", ") + std::string(known_name);
  }
  throw SceneError("device '" + name + "' is not known; use one of " + known + ", or state its limits");
}

void SafetyConfig::validate(const std::string& owner) const {
  checkRange(owner + ": max_growth_n_s", max_growth_n_s, kTiny, 100.0);
  checkRange(owner + ": ramp_in_s", ramp_in_s, 0.2, 10.0);
  checkRange(owner + ": stale_after_s", stale_after_s, kTiny, 0.02);
  checkRange(owner + ": drop_s", drop_s, kTiny, 0.025);
  checkRange(owner + ": max_speed_m_s", max_speed_m_s, kTiny, 1.0);
}

std::string describe(ForceFault fault) {
  switch (fault) {
    case ForceFault::kNone:
      return "";
    case ForceFault::kStalePose:
      return "no pose from the device within the time limit";
    case ForceFault::kDisabled:
      return "the device does not take forces now: it is not enabled, or its clutch is held";
    case ForceFault::kStalePatch:
      return "the simulation no longer sends the tissue near the tool";
    case ForceFault::kUnusablePose:
      return "the device's pose is not finite or its quaternion is not a rotation";
    case ForceFault::kUnusableForce:
      return "the wished force is not finite";
    case ForceFault::kTripped:
      return "the device's pose moved faster than the speed limit; check the device, then call the reset service";
  }
  return "unknown fault";
}

void ForceLimiter::reset() {
  *this = ForceLimiter(limits_, safety_);
}

void ForceLimiter::restart() {
  const bool tripped = tripped_;
  reset();
  tripped_ = tripped;
}

/// Time that the device had for its way, by the clock that gives it more.
double ForceLimiter::between(const TimedPosition& before, const TimedPosition& now) {
  const double received_s = std::max(0.0, now.time_s - before.time_s);
  if (!before.stamp_s || !now.stamp_s)
    return received_s;
  const double stamped_s = *now.stamp_s - *before.stamp_s;
  return stamped_s > 0.0 ? std::max(received_s, std::min(stamped_s, kBelievedGap)) : received_s;
}

bool ForceLimiter::jumped(const TimedPosition& now) {
  if (!last_ || now.time_s - last_->time_s > safety_.stale_after_s) {  // a reconnect: nothing to compare with
    last_ = reference_ = now;
    return false;
  }
  const double dt = between(*last_, now);
  bool jumped = (now.position_m - last_->position_m).norm() > safety_.max_speed_m_s * dt + kJumpSlack;
  last_ = now;
  const double window = between(*reference_, now);
  if (window >= kSpeedWindow) {
    jumped |= (now.position_m - reference_->position_m).norm() > safety_.max_speed_m_s * window;
    reference_ = now;
  }
  return jumped;
}

ForceFault ForceLimiter::check(double time_s, double pose_time_s, const Pose& pose,
                               const std::optional<Vector3>& velocity_m_s, const std::optional<double>& stamp_s) {
  assert(std::isfinite(time_s));
  if (time_s_ && time_s < *time_s_ && !tripped_)
    reset();
  time_s_ = time_s;
  fault_ = ForceFault::kNone;
  if (!isUsable(pose) || (velocity_m_s && !isFinite(*velocity_m_s))) {
    last_.reset();
    fault_ = ForceFault::kUnusablePose;
  } else if (!(std::abs(time_s - pose_time_s) <= safety_.stale_after_s)) {
    fault_ = ForceFault::kStalePose;
  } else if (jumped({pose_time_s, stamp_s, pose.position_m}) ||
             (velocity_m_s && velocity_m_s->norm() > safety_.max_speed_m_s)) {
    tripped_ = true;
  }
  if (tripped_)
    fault_ = ForceFault::kTripped;
  return fault_;
}

void ForceLimiter::report(ForceFault fault) {
  if (fault_ == ForceFault::kNone)
    fault_ = fault;
}

Vector3 ForceLimiter::falling(double time_s) {
  ramp_start_s_.reset();
  if (!fall_start_s_) {
    fall_start_s_ = time_s;
    fall_from_n_ = force_n_;
  }
  const double share = 1.0 - (time_s - *fall_start_s_) / safety_.drop_s;
  return (share < kRounding ? 0.0 : std::min(share, 1.0)) * fall_from_n_;
}

// Whatever lies between zero and the force sent last is a decrease and free; the rest is growth, also sideways.
Vector3 ForceLimiter::slewed(const Vector3& wish_n, double dt_s, bool& limited) const {
  const double squared = force_n_.squaredNorm();
  const double share = squared > 0.0 ? std::clamp(wish_n.dot(force_n_) / squared, 0.0, 1.0) : 0.0;
  const Vector3 free = share * force_n_;
  const Vector3 growth = wish_n - free;
  const double most = safety_.max_growth_n_s * dt_s;
  limited = growth.norm() > most;
  return limited ? Vector3(free + most / growth.norm() * growth) : wish_n;
}

ForceLimiter::Output ForceLimiter::limit(double time_s, const Vector3& wish_n) {
  Output output;
  if (fault_ == ForceFault::kNone && !isFinite(wish_n))
    fault_ = ForceFault::kUnusableForce;
  // A cycle that comes late must not be allowed a large growth.
  const double dt = limit_time_s_ ? std::clamp(time_s - *limit_time_s_, 0.0, safety_.stale_after_s) : 0.0;
  limit_time_s_ = time_s;
  if (fault_ != ForceFault::kNone) {
    output.force_n = force_n_ = falling(time_s);
    return output;
  }
  fall_start_s_.reset();
  if (!ramp_start_s_) {
    ramp_start_s_ = time_s;
    force_n_.setZero();
  }
  const double norm = wish_n.norm();
  output.saturated = norm > limits_.max_force_n;
  const double scale = output.saturated ? limits_.max_force_n / norm : 1.0;
  const double ramp = std::clamp((time_s - *ramp_start_s_) / safety_.ramp_in_s, 0.0, 1.0);
  output.force_n = force_n_ = slewed(ramp * scale * wish_n, dt, output.slew_limited);
  return output;
}

}  // namespace soft_volume::core
