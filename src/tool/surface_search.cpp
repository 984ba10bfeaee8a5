#include "surface_search.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "directions.h"

namespace soft_volume::core {
namespace {

constexpr double kSurfaceTolerance = 1e-7;  // metres
constexpr double kClosedGap = 1e-5;         // metres
constexpr double kDrop = 0.05;  // of the radius; a surface that is deeper than expected by this is an opening
constexpr double kBesideOpening = 0.6;
constexpr double kBeyond = 1e-3;
constexpr int kRimSteps = 5;
constexpr double kBumpOffset = 0.5;   // of the radius
constexpr double kSteepOffset = 0.2;  // of the radius

}  // namespace

// By intensities, which are nearly linear, unless two such steps do not halve the span, because they may jump.
SurfaceSearch::Hit SurfaceSearch::narrow(const Ray& ray, End inside, End outside) const {
  constexpr double kAny = std::numeric_limits<double>::infinity();
  std::array<double, 3> spans{kAny, kAny, std::abs(outside.t - inside.t)};  // newest last
  while (spans[2] > kSurfaceTolerance) {
    const bool by_intensity = outside.sample.at.found() && spans[2] <= 0.5 * spans[0];
    const double between = by_intensity ? share(inside.sample, outside.sample) : 0.5;
    const double t = inside.t + between * (outside.t - inside.t);
    const PatchContact::Sample sample = field_.sample(ray.at(t), inside.sample.at.cell);
    (sample.tissue ? inside : outside) = {t, sample};
    spans = {spans[1], spans[2], std::abs(outside.t - inside.t)};
  }
  return {true, inside.t, inside.sample.at, outside.sample.at.found(), false, 0.0};
}

// Of the way from inside to outside, where the threshold is passed by a linear intensity; a little beyond it, on the
// side where the span shrinks most.
double SurfaceSearch::share(const PatchContact::Sample& inside, const PatchContact::Sample& outside) const {
  const double above = inside.intensity - field_.threshold();
  const double share = above / (inside.intensity - outside.intensity);
  if (!std::isfinite(share))
    return 0.5;
  return std::clamp(share < 0.5 ? share + kBeyond : share - kBeyond, kBeyond, 1.0 - kBeyond);
}

SurfaceSearch::Hit SurfaceSearch::along(const Ray& ray, double start_m, const Span& span) const {
  End last{start_m, field_.sample(ray.at(start_m))};
  const double step = last.sample.tissue ? field_.marchStep() : -field_.marchStep();
  while (last.sample.tissue ? last.t < span.high_m : last.t > span.low_m) {
    End next{std::clamp(last.t + step, span.low_m, std::max(span.high_m, span.low_m)), {}};
    next.sample = field_.sample(ray.at(next.t), last.sample.at.cell);
    if (next.sample.tissue != last.sample.tissue)
      return last.sample.tissue ? narrow(ray, last, next) : narrow(ray, next, last);
    if (next.sample.tissue && field_.hasCuts()) {
      const Hit gap = findGap(ray, last.t, next.t, last.sample.at, next.sample.at);
      if (gap.found)
        return gap;
    }
    last = next;
  }
  return {};
}

Vector3 SurfaceSearch::gradientNormal(const Hit& hit, const Vector3& outward) const {
  const Vector3 gradient = field_.gradient(hit.inside);
  const double norm = gradient.norm();
  return std::isfinite(norm) && norm > 0.0 ? Vector3(-gradient / norm) : outward;
}

// Between two points in tissue: a gap between lips may be narrower than the steps. So look where the cells beside an
// incision end.
SurfaceSearch::Hit SurfaceSearch::findGap(const Ray& ray, double t_start, double t_end, PatchContact::CellPoint start,
                                          const PatchContact::CellPoint& end) const {
  while (start.cell != end.cell && (field_.isCut(start.cell) || field_.isCut(end.cell))) {
    double outside_t = t_end;
    while (outside_t - t_start > kSurfaceTolerance) {
      const double middle = 0.5 * (t_start + outside_t);
      const PatchContact::CellPoint at = field_.locateIn(start.cell, ray.at(middle));
      if (at.found()) {
        t_start = middle;
        start = at;
      } else {
        outside_t = middle;
      }
    }
    if (ray.parts_lips && field_.isAtCut(start))
      return {true, t_start, start, false, true, 0.0};
    if (outside_t + kClosedGap >= t_end)
      break;
    const PatchContact::Sample beyond = field_.sample(ray.at(outside_t + kClosedGap), end.cell);
    if (!beyond.tissue)
      return {true, t_start, start, beyond.at.found(), false, 0.0};
    t_start = outside_t + kClosedGap;
    start = beyond.at;
  }
  return {};
}

SurfaceSearch::Hit SurfaceSearch::Press::at(const SurfaceSearch& search, const Vector3& way, double offset_m) const {
  const double reach_m = reach(offset_m);
  Hit hit = search.along({centre.origin + offset_m * way, centre.direction, centre.parts_lips}, start_m,
                         {lowest_m - reach_m, highest_m - reach_m});
  hit.reach_m = reach_m;
  return hit;
}

SurfaceSearch::Hit SurfaceSearch::press(const Ray& centre, double expected_m, double radius_m, double lowest_m,
                                        double highest_m) const {
  // Where lips lie on each other, the tissue on the surface is either one's: start below it.
  const double start_m = centre.parts_lips ? expected_m - field_.marchStep() : expected_m;
  const Press press{centre, start_m, radius_m, lowest_m, highest_m};
  const Hit hit = press.at(*this, Vector3::Zero(), 0.0);
  const bool sinks = !hit.found || hit.t <= expected_m - kDrop * radius_m;
  const bool at_cut = hit.found && !hit.at_iso_surface && field_.isAtCut(hit.inside);
  if (field_.hasCuts() && (sinks || (at_cut && isSteep(press, hit))))
    return onRim(press, hit);
  return onBumps(press, hit);
}

// A sphere touches what is inclined or rough beside the line through its centre.
SurfaceSearch::Hit SurfaceSearch::onBumps(Press press, Hit deepest) const {
  const Vector3 side = press.centre.direction.unitOrthogonal();
  const Vector3 other = press.centre.direction.cross(side);
  const double offset_m = kBumpOffset * press.radius_m;
  for (const Vector3& way : {side, other, Vector3(-side), Vector3(-other)}) {
    if (deepest.found) {
      // Only what is above the sphere as it lies there now.
      press.start_m = deepest.depth() - press.reach(offset_m) + kSurfaceTolerance;
      if (!field_.sample(press.centre.at(press.start_m) + offset_m * way, deepest.inside.cell).tissue)
        continue;
    }
    const Hit hit = press.at(*this, way, offset_m);
    if (hit.found)
      deepest = hit;
  }
  return deepest;
}

// Whether the surface is nearly parallel to the line, as the wall of an opening is.
bool SurfaceSearch::isSteep(const Press& press, const Hit& hit) const {
  const double offset_m = kSteepOffset * press.radius_m;
  const Vector3 side = press.centre.direction.unitOrthogonal();
  for (const Vector3& way : {side, press.centre.direction.cross(side)}) {
    const Hit beside = press.at(*this, way, offset_m);
    if (!beside.found || std::abs(beside.t - hit.t) > offset_m)
      return true;
  }
  return false;
}

// The rim of an opening is sought on eight lines beside the middle and then, by bisection, on the way to the best one.
SurfaceSearch::Hit SurfaceSearch::onRim(const Press& press, const Hit& middle) const {
  Hit rim;
  Vector3 way = Vector3::Zero();
  double rim_m = 0.0;
  const auto take = [&](const Vector3& there, double offset_m) {
    const Hit hit = press.at(*this, there, offset_m);
    if (!hit.found || (rim.found && hit.depth() <= rim.depth()))
      return false;
    rim = hit;
    way = there;
    rim_m = offset_m;
    return true;
  };
  const Vector3 side = press.centre.direction.unitOrthogonal();
  const Vector3 other = press.centre.direction.cross(side);
  for (int n = 0; n < 8; ++n) {
    const double angle = n * M_PI / 4.0;
    take(std::cos(angle) * side + std::sin(angle) * other, (n % 2 == 0 ? 0.35 : 0.7) * press.radius_m);
  }
  double in_opening_m = 0.0;
  for (int n = 0; n < kRimSteps && rim_m > 0.0; ++n) {
    const double middle_m = 0.5 * (in_opening_m + rim_m);
    if (!take(way, middle_m))
      in_opening_m = middle_m;
  }
  return rim.found && !(middle.found && middle.depth() >= rim.depth()) ? rim : middle;
}

// Height of the surface over the origin, at most `reach_m` either way.
double SurfaceSearch::heightAt(const Ray& ray, double reach_m) const {
  const Hit there = along(ray, 0.0, {-reach_m, reach_m});
  if (there.found)
    return there.t;
  return field_.sample(ray.origin).tissue ? reach_m : -reach_m;
}

Vector3 SurfaceSearch::surfaceNormal(const Vector3& around_m, const Vector3& outward, double radius_m) const {
  const double reach = std::max(radius_m, 0.75 * field_.meanEdge());
  const Vector3 sides[2] = {outward.unitOrthogonal(), outward.cross(outward.unitOrthogonal())};
  Vector3 normal = outward;
  for (const Vector3& side : sides) {
    double height[2];
    for (int s = 0; s < 2; ++s) {
      const Vector3 beside = (s == 0 ? -reach : reach) * side;
      height[s] = heightAt({around_m + beside, outward}, reach);
      if (field_.hasCuts() && height[s] < -0.5 * reach)  // a narrow opening, perhaps
        height[s] = heightAt({around_m + kBesideOpening * beside, outward}, reach) / kBesideOpening;
    }
    normal -= (height[1] - height[0]) / (2.0 * reach) * side;
  }
  return normal.normalized();
}

Vector3 SurfaceSearch::shortestWayOut(const Vector3& from_m) const {
  Vector3 best = Vector3::Zero();
  double shortest = std::numeric_limits<double>::infinity();
  for (const Vector3& direction : directions()) {
    const Hit hit = along({from_m, direction}, 0.0, {0.0, shortest});
    if (!hit.found || (!hit.at_iso_surface && field_.gridGoesOn(hit.inside)) || hit.t >= shortest)
      continue;
    shortest = hit.t;
    best = direction;
  }
  return best;
}

}  // namespace soft_volume::core
