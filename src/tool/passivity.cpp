#include "soft_volume/tool/passivity.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {
namespace {

constexpr double kForgetLosses = 0.05;  // seconds
constexpr double kForgetMade = 2.0;     // seconds
constexpr double kTakeOut = 0.002;      // seconds in which the damper is to take out what was made
constexpr double kLongestGap = 0.02;    // seconds; over a longer one nothing is known of the way

/// What a spring gives back that is stretched to `stretch_m` and pulls with less than k x, because it was limited: as
/// it goes back it keeps that force until k x is as low.
double releasable(const PassivityControl::Tick& tick) {
  const double stretch = tick.stretch_m.norm();
  if (!(stretch > 0.0 && tick.stiffness_n_m > 0.0))
    return 0.0;
  const double along = tick.force_n.dot(tick.stretch_m) / stretch;
  const double force = std::clamp(along, 0.0, tick.stiffness_n_m * stretch);
  return force * stretch - 0.5 * force * force / tick.stiffness_n_m;
}

}  // namespace

void PassivityControl::remember(const Tick& tick) {
  newest_ = (newest_ + 1) % kKept;
  sent_[newest_] = {tick.time_s + delay_s_, tick.force_n};
  count_ = std::min(count_ + 1, kKept);
}

Vector3 PassivityControl::meanForce(double begin_s, double end_s) const {
  Vector3 impulse = Vector3::Zero();
  double until_s = end_s;
  for (std::size_t n = 0; n < count_ && until_s > begin_s; ++n) {
    const Sent& sent = sent_[(newest_ + kKept - n) % kKept];
    const double from_s = std::max(begin_s, sent.from_s);
    if (from_s >= until_s)
      continue;
    impulse += (until_s - from_s) * sent.force_n;
    until_s = from_s;
  }
  return impulse / (end_s - begin_s);
}

void PassivityControl::observe(const Tick& tick) {
  const double dt_s = tick.time_s - last_.time_s;
  const double way_s = tick.measured_s - last_.measured_s;
  if (!started_ || !(dt_s > 0.0 && dt_s < kLongestGap) || !(way_s >= 0.0 && way_s < kLongestGap)) {
    stored_j_ = releasable(tick);
    made_j_ = 0.0;
  } else {
    if (way_s > 0.0)
      made_j_ += meanForce(last_.measured_s, tick.measured_s).dot(tick.device_m - last_.device_m);
    if (tick.stiffness_n_m > 0.0 && last_.stiffness_n_m > 0.0)
      made_j_ -= 0.5 * dt_s * (last_.force_n + tick.force_n).dot(tick.surface_velocity_m_s);
    const double stored = releasable(tick);
    made_j_ += stored - stored_j_;
    stored_j_ = stored;
    made_j_ *= std::exp(-dt_s / (made_j_ < 0.0 ? kForgetLosses : kForgetMade));
  }
  started_ = true;
  last_ = tick;
  remember(tick);
}

double PassivityControl::damping(const Vector3& velocity_m_s, double most_n_s_m) const {
  const double squared = velocity_m_s.squaredNorm();
  if (!(made_j_ > 0.0 && squared > 0.0))
    return 0.0;
  return std::min(most_n_s_m, made_j_ / (squared * kTakeOut));
}

}  // namespace soft_volume::core
