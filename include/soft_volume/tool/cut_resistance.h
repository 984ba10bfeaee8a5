#pragma once

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// The force that tissue puts up against a blade which cuts it. Energy balance of steady cutting: what the blade does
/// to the tissue beyond deforming it goes into new surface, so the force along the travel is F = G_c dA/ds, fracture
/// toughness times area opened per travel (Atkins, "The Science and Engineering of Cutting", 2009). The simulation
/// measures it as R (GridPatch::blade_resistance_n).
///
/// Rendered, as a device can stand it, by a spring that trails behind the blade: its end stays in the tissue, creeps
/// towards the blade at v0 |F| / R and is dragged along where the force would get beyond R. So
/// - a steady blade feels R min(1, |v| / v0) against its velocity, v0 = 5 mm/s;
/// - a blade at rest feels nothing once the spring has relaxed, with the time constant R / (k v0);
/// - where R falls, or the blade is out (R = 0), the force follows within some 25 ms: no motor is let go in one tick;
/// - a damper of R / v0, which no sampled loop could hold, is never rendered: the loop sees the coupling's stiffness k;
/// - more energy never comes back than went in; a stroke along a line at v0 or faster costs R s less R^2 / (2 k), the
///   spring's share at its start.
/// Allocates nothing; one thread at a time.
class CutResistance {
 public:
  static constexpr double kFullSpeed_m_s = 0.005;  ///< v0
  static constexpr double kFade_s = 0.008;         ///< time constant of the force when the resistance falls

  /// Force on the blade [N] after it moved and `dt_s` passed, volume frame; needs dt_s >= 0 and resistance_n >= 0. The
  /// stiffness is the coupling's; it may fall from one call to the next.
  Vector3 update(const Vector3& move_m, double dt_s, double resistance_n, double stiffness_n_m);
  /// The blade is free: the spring is gone.
  void reset() { *this = CutResistance(); }
  bool loaded() const { return stretch_m_.squaredNorm() > 0.0; }

 private:
  void follow(double resistance_n, double dt_s);

  double resistance_n_ = 0.0;            // that is rendered
  Vector3 stretch_m_ = Vector3::Zero();  // from the spring's end in the tissue to the blade
};

}  // namespace soft_volume::core
