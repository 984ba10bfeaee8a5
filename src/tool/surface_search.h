#pragma once

#include <cmath>
#include <limits>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/patch_contact.h"

namespace soft_volume::core {

/// Finds the tissue's surface in a patch of cells along lines and around spheres. The surface is where the intensity
/// passes the threshold, and where the cells end inside tissue (some were left out, a cut opened). Lips that are less
/// than 10 micrometres apart are as one, save for lines that part them. Pure and without allocation.
class SurfaceSearch {
 public:
  struct Ray {
    Vector3 origin;
    Vector3 direction;        // outwards, of length 1
    bool parts_lips = false;  // a lip ends the tissue, too, where the other one lies on it
    Vector3 at(double t) const { return origin + t * direction; }
  };
  struct Hit {
    bool found = false;
    double t = 0.0;                  // along the line, metres
    PatchContact::CellPoint inside;  // the last point in the tissue
    bool at_iso_surface = false;     // otherwise the cells end there
    bool at_closed_lips = false;     // the other lip lies on the surface
    double reach_m = 0.0;            // of the sphere along the line, beyond the plane through its centre
    /// How far the sphere must go along the line so that it only touches there.
    double depth() const { return t + reach_m; }
  };
  /// Where along a line the surface may be.
  struct Span {
    double low_m;
    double high_m = std::numeric_limits<double>::infinity();
  };

  explicit SurfaceSearch(const PatchContact& field) : field_(field) {}

  /// The nearest change between tissue and air: from `start_m` outwards when there is tissue, inwards otherwise.
  Hit along(const Ray& ray, double start_m, const Span& span) const;
  /// Where a sphere around the line's origin is pressed in most, along the line. The surface is expected at
  /// `expected_m`; its depth is at least `lowest_m` and at most `highest_m`. Four lines beside the middle say what the
  /// sphere meets of an incline or of bumps. Over an opening it rests on the rims as far as it does not fit in: where
  /// the line through its centre meets the surface deeper than expected, or the wall of a cut, eight more lines, at
  /// 0.35 and 0.7 radii, find the rim.
  Hit press(const Ray& centre, double expected_m, double radius_m, double lowest_m,
            double highest_m = std::numeric_limits<double>::infinity()) const;
  /// Outward unit vector by the gradient of the intensity; `outward` where there is none.
  Vector3 gradientNormal(const Hit& hit, const Vector3& outward) const;
  /// Slope of the surface between four lines around a point near it, at the sphere's radius or three quarters of a
  /// cell, whichever is more, parallel to the outward direction: exact for a plane. The gradient at the point would do
  /// for a smooth surface, but that of a deformed lattice has a kink at every cell's face and a step where cells are
  /// left out.
  Vector3 surfaceNormal(const Vector3& around_m, const Vector3& outward, double radius_m) const;
  /// Of 26 directions the one in which the tissue ends first; zero when it ends nowhere.
  Vector3 shortestWayOut(const Vector3& from_m) const;

 private:
  /// A sphere that is pressed on the surface along a line.
  struct Press {
    Ray centre;
    double start_m;
    double radius_m;
    double lowest_m;
    double highest_m;
    double reach(double offset_m) const { return std::sqrt(radius_m * radius_m - offset_m * offset_m); }
    /// Where it meets the surface on a parallel line, that far off on this way.
    Hit at(const SurfaceSearch& search, const Vector3& way, double offset_m) const;
  };
  /// A point of a line.
  struct End {
    double t;
    PatchContact::Sample sample;
  };
  Hit narrow(const Ray& ray, End inside, End outside) const;
  double share(const PatchContact::Sample& inside, const PatchContact::Sample& outside) const;
  Hit findGap(const Ray& ray, double t_start, double t_end, PatchContact::CellPoint start,
              const PatchContact::CellPoint& end) const;
  Hit onBumps(Press press, Hit deepest) const;
  bool isSteep(const Press& press, const Hit& hit) const;
  Hit onRim(const Press& press, const Hit& middle) const;
  double heightAt(const Ray& ray, double reach_m) const;

  const PatchContact& field_;
};

}  // namespace soft_volume::core
