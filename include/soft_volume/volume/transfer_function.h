#pragma once

#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// Maps a scalar to colour and opacity: piecewise linear between its points (emission-absorption model).
///
/// Opacity is that of a slab of `unit_distance_m` of the material, so that the image does not depend on the distance of
/// the slices: a slab of thickness d has 1 - (1 - opacity)^(d / unit_distance_m).
struct TransferFunction {
  struct Point {
    double value = 0.0;                  ///< scalar in the volume's own units
    Vector3f colour = Vector3f::Zero();  ///< RGB in [0, 1] as displayed, not premultiplied
    float opacity = 0.0F;                ///< in [0, 1] per unit distance
  };
  struct Sample {
    Vector3f colour;
    float opacity;
  };

  std::vector<Point> points;       ///< at least two, strictly increasing values
  double unit_distance_m = 0.001;  ///< distance that `opacity` refers to

  /// Value outside the points clamps to the first or last one; NaN gives opacity 0. Needs valid points.
  Sample evaluate(double value) const;
  /// Throws SceneError when there are fewer than two points, values do not increase, or anything is out of range.
  void validate() const;
};

}  // namespace soft_volume::core
