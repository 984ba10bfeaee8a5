#include "soft_volume/tool/cut_resistance.h"

namespace soft_volume::core {

Vector3 CutResistance::update(const Vector3& move_m, double dt_s, double resistance_n, double stiffness_n_m) {
  if (!(resistance_n > 0.0 && stiffness_n_m > 0.0)) {
    reset();
    return Vector3::Zero();
  }
  stretch_m_ += move_m;
  stretch_m_ /= 1.0 + dt_s * stiffness_n_m * kFullSpeed_m_s / resistance_n;
  const double longest_m = resistance_n / stiffness_n_m;
  const double length_m = stretch_m_.norm();
  if (length_m > longest_m)
    stretch_m_ *= longest_m / length_m;
  return -stiffness_n_m * stretch_m_;
}

}  // namespace soft_volume::core
