#pragma once

#include <vector>

#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {

/// Points p with normal . p == offset_m.
struct Plane {
  Vector3 normal = Vector3::UnitX();
  double offset_m = 0.0;

  double distance(const Vector3& p) const { return normal.dot(p) - offset_m; }
};

/// A convex planar part of the surface that a blade swept.
struct BladePatch {
  std::vector<Vector3> corners;  ///< around it
  Plane plane;
  std::vector<Plane> sides;  ///< upright on the plane through each edge; positive inside
};

/// The patches of a quad: itself where it is convex and no corner is farther than `flat_m` from the plane through their
/// middle, two triangles otherwise. Those that are narrower than `narrow_m` are left out; a degenerate quad has none.
std::vector<BladePatch> patchesOf(const SweptQuad& quad, double flat_m, double narrow_m);

/// The part of a convex polygon where `plane` is at least `least_m`.
std::vector<Vector3> clipPolygon(const std::vector<Vector3>& polygon, const Plane& plane, double least_m);

}  // namespace soft_volume::core
