#pragma once

#include <array>

namespace soft_volume::core {

/// Equally spaced planes z = const in the camera frame; each stands for a slab of `distance_m` around it.
struct SlicePlanes {
  double first_z_m = 0.0;
  double distance_m = 1.0;
  int count = 0;
  int first_number = 0;  ///< of the first plane on the ladder that it belongs to

  /// The planes are float numbers, as the vertices are, so that "z >= plane" has one answer everywhere.
  float z(int i) const { return float(first_z_m + i * distance_m); }
};

/// The planes that cut depths `range_m`, on the ladder anchor_m + (i + 0.5) distance_m, at most `max_count` from the
/// front. With an anchor and distance that do not depend on the deformation, a camera keeps its planes while the grid
/// moves, so the image changes only where the grid does.
SlicePlanes planesThrough(const std::array<double, 2>& range_m, double anchor_m, double distance_m, int max_count);

}  // namespace soft_volume::core
