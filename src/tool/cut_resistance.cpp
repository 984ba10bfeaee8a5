#include "soft_volume/tool/cut_resistance.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {
namespace {

constexpr double kNothing = 1e-4;  // newtons that nobody feels

}  // namespace

void CutResistance::follow(double resistance_n, double dt_s) {
  const double kept = std::max(0.0, resistance_n_ - resistance_n) * std::exp(-dt_s / kFade_s);
  resistance_n_ = resistance_n + (kept > kNothing ? kept : 0.0);
}

Vector3 CutResistance::update(const Vector3& move_m, double dt_s, double resistance_n, double stiffness_n_m) {
  follow(resistance_n, dt_s);
  if (!(resistance_n_ > 0.0 && stiffness_n_m > 0.0)) {
    reset();
    return Vector3::Zero();
  }
  stretch_m_ += move_m;
  stretch_m_ /= 1.0 + dt_s * stiffness_n_m * kFullSpeed_m_s / resistance_n_;
  const double longest_m = resistance_n_ / stiffness_n_m;
  const double length_m = stretch_m_.norm();
  if (length_m > longest_m)
    stretch_m_ *= longest_m / length_m;
  return -stiffness_n_m * stretch_m_;
}

}  // namespace soft_volume::core
