#include "soft_volume/tool/contact_tracker.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace soft_volume::core {
namespace {

constexpr double kSurfaceTolerance = 1e-7;  // metres
constexpr double kBlend = 0.2;              // stable below a dent nine times sharper than the tip is deep
constexpr double kMaxTurn = 2.0 * M_PI / 180.0;
constexpr std::size_t kDirections = 26;

std::array<Vector3, kDirections> makeDirections() {
  std::array<Vector3, kDirections> directions;
  std::size_t n = 0;
  for (int k = -1; k <= 1; ++k) {
    for (int j = -1; j <= 1; ++j) {
      for (int i = -1; i <= 1; ++i) {
        if (i != 0 || j != 0 || k != 0)
          directions[n++] = Vector3(i, j, k).normalized();
      }
    }
  }
  return directions;
}

const std::array<Vector3, kDirections>& directions() {
  static const std::array<Vector3, kDirections> kAll = makeDirections();
  return kAll;
}

// Turns a unit vector towards another one, by a share of the difference and a largest angle; opposite ones are ignored.
Vector3 turnTowards(const Vector3& from, const Vector3& to) {
  const double cosine = from.dot(to);
  if (!(cosine > 0.0))
    return from;
  const Vector3 side = to - cosine * from;
  const double sine = side.norm();
  if (sine < 1e-12)
    return from;
  const double angle = std::min(kBlend * std::atan2(sine, cosine), kMaxTurn);
  return (std::cos(angle) * from + std::sin(angle) / sine * side).normalized();
}

}  // namespace

ContactTracker::Hit ContactTracker::bisect(const PatchContact& field, const Ray& ray, double inside_t, double outside_t,
                                           PatchContact::CellPoint inside) {
  bool outside_in_cells = field.locate(ray.at(outside_t), inside.cell).found();
  while (std::abs(outside_t - inside_t) > kSurfaceTolerance) {
    const double middle = 0.5 * (inside_t + outside_t);
    const PatchContact::Sample sample = field.sample(ray.at(middle), inside.cell);
    if (sample.tissue) {
      inside_t = middle;
      inside = sample.at;
    } else {
      outside_t = middle;
      outside_in_cells = sample.at.found();
    }
  }
  return {true, inside_t, inside, outside_in_cells};
}

// From t_start outwards when there is tissue, inwards when there is not, to the nearest change.
ContactTracker::Hit ContactTracker::findSurface(const PatchContact& field, const Ray& ray, double t_start, double t_min,
                                                double t_max) {
  PatchContact::Sample last = field.sample(ray.at(t_start));
  double t = t_start;
  const double step = last.tissue ? field.marchStep() : -field.marchStep();
  while (last.tissue ? t < t_max : t > t_min) {
    const double next = std::clamp(t + step, t_min, std::max(t_max, t_min));
    const PatchContact::Sample sample = field.sample(ray.at(next), last.at.cell);
    if (sample.tissue != last.tissue) {
      return last.tissue ? bisect(field, ray, t, next, last.at) : bisect(field, ray, next, t, sample.at);
    }
    t = next;
    last = sample;
  }
  return {};
}

Vector3 ContactTracker::gradientNormal(const PatchContact& field, const Hit& hit, const Vector3& outward) {
  const Vector3 gradient = field.gradient(hit.inside);
  const double norm = gradient.norm();
  return std::isfinite(norm) && norm > 0.0 ? Vector3(-gradient / norm) : outward;
}

// Slope of the surface between four lines beside the hit, parallel to the outward direction: exact for a plane. The
// gradient at the hit would do for a smooth surface, but that of a deformed lattice has a kink at every cell's face and
// a step where cells are left out, and a deep tip would swing about them for ever.
Vector3 ContactTracker::surfaceNormal(const PatchContact& field, const Hit& hit, const Vector3& outward,
                                      double radius_m) {
  const double reach = std::max(radius_m, 0.75 * field.meanEdge());
  const Vector3 centre = field.position(hit.inside);
  const Vector3 sides[2] = {outward.unitOrthogonal(), outward.cross(outward.unitOrthogonal())};
  Vector3 normal = outward;
  for (const Vector3& side : sides) {
    double height[2];
    for (int s = 0; s < 2; ++s) {
      const Ray ray{centre + (s == 0 ? -reach : reach) * side, outward};
      const Hit there = findSurface(field, ray, 0.0, -reach, reach);
      height[s] = there.found ? there.t : (field.sample(ray.origin).tissue ? reach : -reach);
    }
    normal -= (height[1] - height[0]) / (2.0 * reach) * side;
  }
  return normal.normalized();
}

Vector3 ContactTracker::shortestWayOut(const PatchContact& field, const Vector3& tip_m) {
  Vector3 best = Vector3::Zero();
  double shortest = std::numeric_limits<double>::infinity();
  for (const Vector3& direction : directions()) {
    const Hit hit = findSurface(field, {tip_m, direction}, 0.0, 0.0, shortest);
    if (!hit.found || (!hit.at_iso_surface && field.gridGoesOn(hit.inside)) || hit.t >= shortest)
      continue;
    shortest = hit.t;
    best = direction;
  }
  return best;
}

// Sets normal_ to a first guess; false when the sphere is free.
bool ContactTracker::touchDirection(const PatchContact& field, const Vector3& tip_m, double radius_m) {
  const bool centre = field.sample(tip_m).tissue;
  Vector3 inwards = Vector3::Zero();
  std::size_t hits = 0;
  for (const Vector3& direction : directions()) {
    if (!field.sample(tip_m + radius_m * direction).tissue)
      continue;
    inwards += direction;
    ++hits;
  }
  if (!centre && hits == 0)
    return false;
  const Vector3 back = free_tip_m_ - tip_m;
  if (centre && has_free_tip_ && back.norm() > kSurfaceTolerance) {
    normal_ = back.normalized();
  } else if (hits < kDirections && inwards.norm() > 0.1) {
    normal_ = -inwards.normalized();
  } else {
    normal_ = shortestWayOut(field, tip_m);
  }
  return normal_.squaredNorm() > 0.5;
}

void ContactTracker::remember(const PatchContact& field, const Hit& hit) {
  surface_cell_id_ = field.cellId(hit.inside.cell);
  surface_local_ = hit.inside.local;
  surface_point_m_ = field.position(hit.inside);
}

Contact ContactTracker::report(const PatchContact& field, const Hit& hit, double radius_m) const {
  Contact contact;
  contact.touching = true;
  contact.surface_point_m = surface_point_m_;
  contact.normal = normal_;
  contact.surface_velocity_m_s = field.velocity(hit.inside);
  contact.penetration_m = hit.t + radius_m;
  contact.patch_too_small = !hit.at_iso_surface && field.gridGoesOn(hit.inside);
  return contact;
}

Contact ContactTracker::release(const Vector3& tip_m) {
  touching_ = false;
  has_free_tip_ = true;
  free_tip_m_ = tip_m;
  return {};
}

Contact ContactTracker::touch(const PatchContact& field, const Vector3& tip_m, double radius_m) {
  if (!touchDirection(field, tip_m, radius_m))
    return release(tip_m);
  Hit hit = findSurface(field, {tip_m, normal_}, 0.0, -radius_m);
  if (!hit.found)
    return {};
  const Vector3 normal =
      hit.at_iso_surface ? gradientNormal(field, hit, normal_) : surfaceNormal(field, hit, normal_, radius_m);
  if (normal.dot(normal_) > 0.0) {
    const Hit along_normal = findSurface(field, {tip_m, normal}, hit.t, -radius_m);
    if (along_normal.found) {
      normal_ = normal;
      hit = along_normal;
    }
  }
  touching_ = true;
  remember(field, hit);
  return report(field, hit, radius_m);
}

void ContactTracker::carrySurfacePoint(const PatchContact& field) {
  const std::uint32_t cell = field.cellOfId(surface_cell_id_);
  if (cell != PatchContact::kNoCell)
    surface_point_m_ = field.position({cell, surface_local_});
}

Contact ContactTracker::follow(const PatchContact& field, const Vector3& tip_m, double radius_m) {
  carrySurfacePoint(field);
  const double expected = (surface_point_m_ - tip_m).dot(normal_);
  const Hit hit = findSurface(field, {tip_m, normal_}, expected, -radius_m);
  if (!hit.found || hit.t + radius_m <= 0.0)
    return release(tip_m);
  remember(field, hit);
  const Contact contact = report(field, hit, radius_m);
  // Beyond the patch's end nothing is known of the surface.
  if (!contact.patch_too_small)
    normal_ = turnTowards(normal_, surfaceNormal(field, hit, normal_, radius_m));
  return contact;
}

Contact ContactTracker::query(const PatchContact& field, const Vector3& tip_m, double tip_radius_m) {
  if (field.empty()) {
    reset();
    return {};
  }
  if (touching_)
    return follow(field, tip_m, tip_radius_m);
  // Far from the patch nothing is known to be free: the tissue may only not have been sent yet.
  if (field.bounds().squaredExteriorDistance(tip_m) > tip_radius_m * tip_radius_m)
    return {};
  return touch(field, tip_m, tip_radius_m);
}

}  // namespace soft_volume::core
