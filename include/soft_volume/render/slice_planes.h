#pragma once

#include <array>

namespace soft_volume::core {

/// Equally spaced planes z = const in the camera frame; each stands for a slab of `distance_m` around it. They belong
/// to a ladder of planes that does not move with the grid: rung n lies at anchor_m + (n + 0.5) distance_m.
struct SlicePlanes {
  double anchor_m = 0.0;
  double distance_m = 1.0;
  int first_number = 0;  ///< rung of the first plane
  int count = 0;

  /// Depth of plane i; with i - 0.5 and i + 0.5 the bounds of its slab. Computed from the rung's number, so that a rung
  /// has the same depth to the last bit whichever plane is the first.
  double depth(double i) const { return anchor_m + (first_number + i + 0.5) * distance_m; }
  /// The planes are float numbers, as the vertices are, so that "z >= plane" has one answer everywhere.
  float z(int i) const { return float(depth(i)); }
};

/// The planes that cut depths `range_m`, on the ladder anchor_m + (i + 0.5) distance_m, at most `max_count` from the
/// front. With an anchor and distance that do not depend on the deformation, a camera keeps its planes while the grid
/// moves, so the image changes only where the grid does.
SlicePlanes planesThrough(const std::array<double, 2>& range_m, double anchor_m, double distance_m, int max_count);

}  // namespace soft_volume::core
