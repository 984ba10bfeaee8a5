#include "blade_patch.h"

#include <algorithm>
#include <limits>

namespace soft_volume::core {
namespace {

BladePatch makePatch(const std::vector<Vector3>& corners, const Vector3& normal) {
  Vector3 middle = Vector3::Zero();
  for (const Vector3& p : corners)
    middle += p / static_cast<double>(corners.size());
  BladePatch patch{corners, {normal, normal.dot(middle)}, {}};
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vector3 inward = normal.cross(corners[(i + 1) % corners.size()] - corners[i]).normalized();
    patch.sides.push_back({inward, inward.dot(corners[i])});
  }
  return patch;
}

/// Least distance between a side and the corner farthest from it; not positive where the patch is not convex.
double widthOf(const BladePatch& patch) {
  double width = std::numeric_limits<double>::infinity();
  for (const Plane& side : patch.sides) {
    double farthest = 0.0;
    for (const Vector3& p : patch.corners)
      farthest = std::max(farthest, side.distance(p));
    width = std::min(width, farthest);
  }
  return width;
}

bool isFlatAndConvex(const BladePatch& patch, double flat_m) {
  const auto count = patch.corners.size();
  for (std::size_t i = 0; i < count; ++i) {
    const bool convex = patch.sides[i].distance(patch.corners[(i + 2) % count]) > 0.0 &&
                        patch.sides[i].distance(patch.corners[(i + count - 1) % count]) > 0.0;
    if (!convex || std::abs(patch.plane.distance(patch.corners[i])) > flat_m)
      return false;
  }
  return true;
}

}  // namespace

std::vector<BladePatch> patchesOf(const SweptQuad& quad, double flat_m, double narrow_m) {
  std::vector<BladePatch> patches;
  const auto addWide = [&](const BladePatch& patch) {
    if (widthOf(patch) >= narrow_m)
      patches.push_back(patch);
  };
  const Vector3 normal = (quad[2] - quad[0]).cross(quad[3] - quad[1]);
  const BladePatch whole = makePatch({quad.begin(), quad.end()}, normal.normalized());
  if (normal.norm() > 0.0 && isFlatAndConvex(whole, flat_m)) {
    addWide(whole);
    return patches;
  }
  for (const auto& t : {std::array<std::size_t, 3>{0, 1, 2}, {0, 2, 3}}) {
    const std::vector<Vector3> corners = {quad[t[0]], quad[t[1]], quad[t[2]]};
    const Vector3 cross = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    if (cross.norm() > 0.0)
      addWide(makePatch(corners, cross.normalized()));
  }
  return patches;
}

std::vector<Vector3> clipPolygon(const std::vector<Vector3>& polygon, const Plane& plane, double least_m) {
  std::vector<Vector3> kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector3& p = polygon[i];
    const Vector3& q = polygon[(i + 1) % polygon.size()];
    const double at_p = plane.distance(p) - least_m;
    const double at_q = plane.distance(q) - least_m;
    if (at_p >= 0.0)
      kept.push_back(p);
    if ((at_p >= 0.0) != (at_q >= 0.0))
      kept.push_back(p + at_p / (at_p - at_q) * (q - p));
  }
  return kept;
}

}  // namespace soft_volume::core
