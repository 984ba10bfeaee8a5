#include "soft_volume/tool/contact_tracker.h"

#include <algorithm>
#include <cmath>

#include "directions.h"

namespace soft_volume::core {
namespace {

constexpr double kSurfaceTolerance = 1e-7;  // metres
constexpr double kClosedGap = 1e-5;         // metres
constexpr double kDrop = 0.05;  // of the radius; a surface that is deeper than expected by this is an opening
constexpr double kBesideOpening = 0.6;
constexpr double kBlend = 0.2;  // stable below a dent nine times sharper than the tip is deep
constexpr double kMaxTurn = 2.0 * M_PI / 180.0;

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
  return {true, inside_t, inside, outside_in_cells, false, 0.0};
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
    if (sample.tissue && field.hasCuts()) {
      const Hit gap = findGap(field, ray, t, next, last.at, sample.at);
      if (gap.found)
        return gap;
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

// Between two points in tissue: a gap between lips may be narrower than the steps. So look where the cells beside an
// incision end.
ContactTracker::Hit ContactTracker::findGap(const PatchContact& field, const Ray& ray, double t_start, double t_end,
                                            PatchContact::CellPoint start, const PatchContact::CellPoint& end) {
  while (start.cell != end.cell && (field.isCut(start.cell) || field.isCut(end.cell))) {
    double outside_t = t_end;
    while (outside_t - t_start > kSurfaceTolerance) {
      const double middle = 0.5 * (t_start + outside_t);
      const PatchContact::CellPoint at = field.locateIn(start.cell, ray.at(middle));
      if (at.found()) {
        t_start = middle;
        start = at;
      } else {
        outside_t = middle;
      }
    }
    if (ray.parts_lips && field.isAtCut(start))
      return {true, t_start, start, false, true, 0.0};
    if (outside_t + kClosedGap >= t_end)
      break;
    const PatchContact::Sample beyond = field.sample(ray.at(outside_t + kClosedGap), end.cell);
    if (!beyond.tissue)
      return {true, t_start, start, beyond.at.found(), false, 0.0};
    t_start = outside_t + kClosedGap;
    start = beyond.at;
  }
  return {};
}

// Where a sphere around the ray's origin is pressed in most, along the ray's direction.
ContactTracker::Hit ContactTracker::press(const PatchContact& field, const Ray& centre, double t_expected,
                                          double radius_m) {
  // Where lips lie on each other, the tissue on the surface is either one's: start below it.
  const double t_start = centre.parts_lips ? t_expected - field.marchStep() : t_expected;
  Hit deepest = findSurface(field, centre, t_start, -radius_m);
  deepest.reach_m = radius_m;
  if (!field.hasCuts() || (deepest.found && deepest.t > t_expected - kDrop * radius_m))
    return deepest;
  const Vector3 side = centre.direction.unitOrthogonal();
  const Vector3 other = centre.direction.cross(side);
  for (int n = 0; n < 8; ++n) {
    const double offset = (n % 2 == 0 ? 0.35 : 0.7) * radius_m;
    const double angle = n * M_PI / 4.0;
    const Ray ray{centre.origin + offset * (std::cos(angle) * side + std::sin(angle) * other), centre.direction,
                  centre.parts_lips};
    const double reach = std::sqrt(radius_m * radius_m - offset * offset);
    Hit hit = findSurface(field, ray, t_start, -reach);
    hit.reach_m = reach;
    if (hit.found && (!deepest.found || hit.depth() > deepest.depth()))
      deepest = hit;
  }
  return deepest;
}

// Height of the surface over the origin, at most `reach_m` either way.
double ContactTracker::heightAt(const PatchContact& field, const Ray& ray, double reach_m) {
  const Hit there = findSurface(field, ray, 0.0, -reach_m, reach_m);
  if (there.found)
    return there.t;
  return field.sample(ray.origin).tissue ? reach_m : -reach_m;
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
      const Vector3 beside = (s == 0 ? -reach : reach) * side;
      height[s] = heightAt(field, {centre + beside, outward}, reach);
      if (field.hasCuts() && height[s] < -0.5 * reach)  // a narrow opening, perhaps
        height[s] = heightAt(field, {centre + kBesideOpening * beside, outward}, reach) / kBesideOpening;
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
  surface_revision_ = field.revision();
  surface_cell_id_ = field.cellId(hit.inside.cell);
  surface_at_ = hit.inside;
  surface_is_lip_ = !hit.at_iso_surface && field.isAtCut(hit.inside);
  surface_point_m_ = field.position(hit.inside);
}

Contact ContactTracker::report(const PatchContact& field, const Hit& hit, const Vector3& tip_m) const {
  Contact contact;
  contact.touching = true;
  contact.proxy_m = tip_m + hit.depth() * normal_;
  contact.surface_point_m = surface_point_m_;
  contact.normal = normal_;
  contact.cell = surface_cell_id_;
  contact.surface_velocity_m_s = field.velocity(hit.inside);
  contact.penetration_m = hit.depth();
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
  Hit hit = press(field, {tip_m, normal_}, 0.0, radius_m);
  if (!hit.found)
    return {};
  const Vector3 normal =
      hit.at_iso_surface ? gradientNormal(field, hit, normal_) : surfaceNormal(field, hit, normal_, radius_m);
  if (normal.dot(normal_) > 0.0) {
    const Hit along_normal = press(field, {tip_m, normal}, hit.t, radius_m);
    if (along_normal.found) {
      normal_ = normal;
      hit = along_normal;
    }
  }
  touching_ = true;
  remember(field, hit);
  return report(field, hit, tip_m);
}

void ContactTracker::carrySurfacePoint(const PatchContact& field) {
  if (field.revision() != surface_revision_)
    return;  // the cell may have another shape; tissue hardly moves until the next query
  const std::uint32_t cell = field.cellOfId(surface_cell_id_);
  if (cell != PatchContact::kNoCell)
    surface_point_m_ = field.position({cell, surface_at_.local, surface_at_.cone});
}

Contact ContactTracker::follow(const PatchContact& field, const Vector3& tip_m, double radius_m) {
  carrySurfacePoint(field);
  const double expected = (surface_point_m_ - tip_m).dot(normal_);
  const Hit hit = press(field, {tip_m, normal_, surface_is_lip_}, expected, radius_m);
  if (!hit.found || hit.depth() <= 0.0)
    return release(tip_m);
  remember(field, hit);
  const Contact contact = report(field, hit, tip_m);
  // Beyond the patch's end nothing is known of the surface, and below another lip its slope is hard to tell.
  if (!contact.patch_too_small && !hit.at_closed_lips)
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
