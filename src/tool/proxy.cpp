#include "soft_volume/tool/proxy.h"

#include <algorithm>
#include <cmath>

#include "directions.h"
#include "surface_search.h"

namespace soft_volume::core {
namespace {

constexpr double kStill = 1e-8;     // metres that are not worth a slide
constexpr double kRough = 2e-5;     // metres that a surface may rise or fall anywhere
constexpr double kSteep = 3.0;      // rise of a slope that is still the same surface
constexpr double kEnough = 0.45;    // of what a slide on a plane would take out of the spring; 0.5 would be all of it
constexpr double kShade = 1.2;      // slope of the surface against its smooth plane that a slide climbs
constexpr double kLeastGain = 0.1;  // of a slide
constexpr int kSlides = 2;          // per tick
constexpr int kTries = 3;           // per slide
constexpr int kMaxSweep = 16;
constexpr double kFeel = 1.14;  // of the radius; a plane that touches the sphere holds one of 26 points out there
constexpr double kBlend = 0.2;
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

/// The sphere at rest on the surface.
struct Proxy::Rest {
  SurfaceSearch::Hit hit;
  Vector3 centre_m;
};

void Proxy::take(const PatchContact& field, const Rest& rest) {
  const SurfaceSearch::Hit& hit = rest.hit;
  centre_m_ = rest.centre_m;
  revision_ = field.revision();
  cell_id_ = field.cellId(hit.inside.cell);
  at_ = hit.inside;
  point_m_ = field.position(hit.inside);
  is_lip_ = !hit.at_iso_surface && field.isAtCut(hit.inside);
  patch_too_small_ = !hit.at_iso_surface && field.gridGoesOn(hit.inside);
}

// With the tissue that it rests on. After a cut the cell may have another shape; the tissue is where it was.
void Proxy::carry(const PatchContact& field) {
  if (field.revision() != revision_)
    return;
  const std::uint32_t cell = field.cellOfId(cell_id_);
  if (cell == PatchContact::kNoCell)
    return;
  at_.cell = cell;
  const Vector3 now_m = field.position(at_);
  centre_m_ += now_m - point_m_;
  point_m_ = now_m;
}

std::optional<Proxy::Rest> Proxy::restAt(const SurfaceSearch& search, const Vector3& near_m, double radius_m,
                                         double rise_m) const {
  const SurfaceSearch::Hit hit = search.press({near_m, normal_, is_lip_}, -radius_m, radius_m, -rise_m, rise_m);
  if (!hit.found)
    return std::nullopt;
  return Rest{hit, near_m + hit.depth() * normal_};
}

// One slide towards where the spring pulls straight, or to the border of the friction cone; nothing when it is there.
// It takes out of the spring what it would on a plane, but for the slope that the smooth normal hides.
std::optional<Proxy::Rest> Proxy::slid(const SurfaceSearch& search, const PatchContact& field, const Tip& tip) {
  const Vector3 to_tip = tip.position_m - centre_m_;
  const double depth_m = std::max(0.0, -to_tip.dot(normal_));
  const double friction_m = tip.friction * depth_m;
  Vector3 way = to_tip - to_tip.dot(normal_) * normal_;
  const double length_m = way.norm();
  if (length_m - friction_m <= kStill)
    return std::nullopt;
  way /= length_m;
  for (int n = 0; n < kTries; ++n) {
    const double drive_m = way.dot(to_tip) - friction_m;
    if (drive_m <= kStill)
      break;
    const double step_m = gain_ * std::min(drive_m, 0.5 * tip.radius_m);
    const auto rest = restAt(search, centre_m_ + step_m * way, tip.radius_m, kSteep * step_m + kRough);
    const bool blocked = rest && isBlocked(field, rest->centre_m);
    const double taken = rest ? 0.5 * (to_tip.squaredNorm() - (tip.position_m - rest->centre_m).squaredNorm()) : 0.0;
    if (rest && !blocked && taken >= step_m * (friction_m + kEnough * drive_m - kShade * depth_m)) {
      gain_ = n == 0 ? std::min(1.0, 2.0 * gain_) : gain_;
      return rest;
    }
    if (blocked)
      way = along(search, rest->centre_m, way);
    else
      gain_ = std::max(kLeastGain, 0.5 * gain_);
  }
  return std::nullopt;
}

// Into tissue from the air. A centre in tissue is that of a sphere between lips.
bool Proxy::isBlocked(const PatchContact& field, const Vector3& to_m) const {
  return field.sample(to_m).tissue && !field.sample(centre_m_).tissue;
}

// The part of a way along the surface that does not enter the tissue which begins before `inside_m`.
Vector3 Proxy::along(const SurfaceSearch& search, const Vector3& inside_m, const Vector3& way) const {
  const Vector3 back = centre_m_ - inside_m;
  const double distance_m = back.norm();
  if (!(distance_m > 0.0))
    return Vector3::Zero();
  const SurfaceSearch::Hit hit = search.along({inside_m, back / distance_m}, 0.0, {0.0, distance_m});
  Vector3 wall = hit.found ? search.gradientNormal(hit, back / distance_m) : Vector3(back / distance_m);
  wall -= wall.dot(normal_) * normal_;
  const Vector3 left = way - way.dot(wall) / std::max(wall.squaredNorm(), 1e-12) * wall;
  const double length = left.norm();
  return length > 1e-6 ? Vector3(left / length) : Vector3(Vector3::Zero());
}

void Proxy::slide(const SurfaceSearch& search, const PatchContact& field, const Tip& tip, Rest rest) {
  for (int n = 0; n < kSlides; ++n) {
    const auto there = slid(search, field, tip);
    if (!there)
      break;
    rest = *there;
    take(field, rest);
  }
  // Beyond the patch's end nothing is known of the surface, and below another lip its slope is hard to tell.
  if (!patch_too_small_ && !rest.hit.at_closed_lips)
    normal_ = turnTowards(normal_, search.surfaceNormal(rest.centre_m - tip.radius_m * normal_, normal_, tip.radius_m));
}

// Sets normal_ to a first guess; false when the sphere at `centre_m` is free.
bool Proxy::guessNormal(const SurfaceSearch& search, const PatchContact& field, const Vector3& centre_m,
                        double radius_m) {
  const bool in_tissue = field.sample(centre_m).tissue;
  Vector3 inwards = Vector3::Zero();
  std::size_t hits = 0;
  for (const Vector3& direction : directions()) {
    if (!field.sample(centre_m + kFeel * radius_m * direction).tissue)
      continue;
    inwards += direction;
    ++hits;
  }
  if (!in_tissue && hits == 0)
    return false;
  const Vector3 back = centre_m_ - centre_m;
  if (in_tissue && has_centre_ && back.norm() > kStill) {
    normal_ = back.normalized();
  } else if (hits < kDirections && inwards.norm() > 0.1) {
    normal_ = -inwards.normalized();
  } else {
    normal_ = search.shortestWayOut(centre_m);
  }
  return normal_.squaredNorm() > 0.5;
}

// The rest of a sphere in the air that has come to `centre_m`, with the normal there; nothing when it is free.
std::optional<Proxy::Rest> Proxy::touched(const SurfaceSearch& search, const PatchContact& field,
                                          const Vector3& centre_m, double radius_m) {
  if (!guessNormal(search, field, centre_m, radius_m))
    return std::nullopt;
  is_lip_ = false;
  SurfaceSearch::Hit hit = search.press({centre_m, normal_}, 0.0, radius_m, -radius_m);
  if (!hit.found)
    return std::nullopt;
  const Vector3 normal = search.surfaceNormal(centre_m + (hit.depth() - radius_m) * normal_, normal_, radius_m);
  if (normal.dot(normal_) > 0.0) {
    const SurfaceSearch::Hit along_normal = search.press({centre_m, normal}, hit.t, radius_m, -radius_m);
    if (along_normal.found) {
      normal_ = normal;
      hit = along_normal;
    }
  }
  if (hit.depth() <= 0.0)
    return std::nullopt;
  return Rest{hit, centre_m + hit.depth() * normal_};
}

// Through the air to the tip, or to the first tissue on the way.
std::optional<Proxy::Rest> Proxy::approach(const SurfaceSearch& search, const PatchContact& field, const Tip& tip) {
  // Far from the patch nothing is known to be free: the tissue may only not have been sent yet.
  if (field.bounds().squaredExteriorDistance(tip.position_m) > tip.radius_m * tip.radius_m) {
    has_centre_ = false;
    return std::nullopt;
  }
  const Vector3 from_m = has_centre_ ? centre_m_ : tip.position_m;
  const Vector3 way = tip.position_m - from_m;
  const double step_m = std::min(0.5 * tip.radius_m, field.marchStep());
  const int steps = int(std::clamp(std::ceil(way.norm() / step_m), 1.0, double(kMaxSweep)));
  for (int n = 1; n <= steps; ++n) {
    const Vector3 there_m = from_m + double(n) / steps * way;
    if (const auto rest = touched(search, field, there_m, tip.radius_m))
      return rest;
    centre_m_ = there_m;
    has_centre_ = true;
  }
  return std::nullopt;
}

Contact Proxy::report(const PatchContact& field, const Tip& tip) const {
  Contact contact;
  contact.penetration_m = (centre_m_ - tip.position_m).dot(normal_);
  if (contact.penetration_m <= 0.0)
    return {};
  contact.touching = true;
  contact.proxy_m = centre_m_;
  contact.surface_point_m = centre_m_ - tip.radius_m * normal_;
  contact.normal = normal_;
  contact.cell = cell_id_;
  contact.surface_velocity_m_s = field.velocity(at_);
  contact.patch_too_small = patch_too_small_;
  return contact;
}

Contact Proxy::update(const PatchContact& field, const Vector3& tip_m, double tip_radius_m, double friction) {
  if (field.empty()) {
    reset();
    return {};
  }
  const SurfaceSearch search(field);
  const Tip tip{tip_m, tip_radius_m, friction};
  std::optional<Rest> rest;
  if (touching_) {
    carry(field);
    rest = restAt(search, centre_m_, tip_radius_m, tip_radius_m);
    if (rest && (tip_m - rest->centre_m).dot(normal_) >= 0.0)
      rest.reset();
  }
  if (!rest)
    rest = approach(search, field, tip);
  touching_ = rest.has_value();
  if (!touching_)
    return {};
  has_centre_ = true;
  take(field, *rest);
  slide(search, field, tip, *rest);
  return report(field, tip);
}

}  // namespace soft_volume::core
