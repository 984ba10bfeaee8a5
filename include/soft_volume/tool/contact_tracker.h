#pragma once

#include <cstdint>
#include <limits>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/contact.h"
#include "soft_volume/tool/patch_contact.h"

namespace soft_volume::core {

/// Single-point contact along the gradient: follows one point of the tissue's surface from touch to release and
/// measures the penetration of a sphere along the surface normal there.
///
/// - First touch: looks into 26 directions on the sphere. The gradient of the intensity where the surface is crossed
///   gives the normal, mapped to the deformed frame by the inverse transpose of the deformation gradient.
/// - Then: the surface point moves with the tissue that it lies on. From there the surface is searched along the line
///   through the tip, never from the tip outwards: a tip may be arbitrarily deep, and a closed cavity between tip and
///   surface is not noticed. The normal is the slope of the surface over the tip's radius or three quarters of a cell,
///   whichever is more. The force turns towards it by a fifth of the difference per query and by at most 2 degrees, and
///   never to the other side, so noise cannot flip it.
/// - Where the lattice ends inside tissue (cells are left out, a cut opened), its boundary is the surface. Lips that
/// are
///   less than 10 micrometres apart are as one, save for a tip that presses one of them already. Over an opening the
///   sphere rests on the rims as far as it does not fit in: where the line through its centre meets the surface deeper
///   than expected, eight more lines, at 0.35 and 0.7 radii, say where it is pressed in most. Between lips that are
///   wider apart it touches the lip beside it.
///
/// What it is not: it does not resist sliding (no friction) and does not prevent that a tip travels below the surface
/// from one fold to the next; that needs a proxy (god object). A tip that starts inside tissue, with no history, leaves
/// along the shortest of 26 ways, which may end in a cavity.
///
/// Queries allocate nothing. Not thread safe: one tracker belongs to one tip.
class ContactTracker {
 public:
  /// `tip_m` is the centre of the sphere. Call once per pose; `field` may have got a new patch in between.
  Contact query(const PatchContact& field, const Vector3& tip_m, double tip_radius_m);
  /// Forgets the contact and the last free place: new session, device reconnected.
  void reset() { *this = ContactTracker(); }

 private:
  struct Ray {
    Vector3 origin;
    Vector3 direction;
    bool parts_lips = false;  // a lip ends the tissue, too, where the other one lies on it
    Vector3 at(double t) const { return origin + t * direction; }
  };
  struct Hit {
    bool found = false;
    double t = 0.0;
    PatchContact::CellPoint inside;  // the last point in the tissue
    bool at_iso_surface = false;     // otherwise the cells end there
    bool at_closed_lips = false;     // the other lip lies on the surface
    double reach_m = 0.0;            // of the sphere along the line, beyond the plane through its centre
    double depth() const { return t + reach_m; }
  };

  static Hit findSurface(const PatchContact& field, const Ray& ray, double t_start, double t_min,
                         double t_max = std::numeric_limits<double>::infinity());
  static Hit bisect(const PatchContact& field, const Ray& ray, double inside_t, double outside_t,
                    PatchContact::CellPoint inside);
  static Hit findGap(const PatchContact& field, const Ray& ray, double t_start, double t_end,
                     PatchContact::CellPoint start, const PatchContact::CellPoint& end);
  static Hit press(const PatchContact& field, const Ray& centre, double t_expected, double radius_m);
  static Vector3 gradientNormal(const PatchContact& field, const Hit& hit, const Vector3& outward);
  static double heightAt(const PatchContact& field, const Ray& ray, double reach_m);
  static Vector3 surfaceNormal(const PatchContact& field, const Hit& hit, const Vector3& outward, double radius_m);
  static Vector3 shortestWayOut(const PatchContact& field, const Vector3& tip_m);

  Contact touch(const PatchContact& field, const Vector3& tip_m, double radius_m);
  Contact follow(const PatchContact& field, const Vector3& tip_m, double radius_m);
  bool touchDirection(const PatchContact& field, const Vector3& tip_m, double radius_m);
  void carrySurfacePoint(const PatchContact& field);
  void remember(const PatchContact& field, const Hit& hit);
  Contact report(const PatchContact& field, const Hit& hit, const Vector3& tip_m) const;
  Contact release(const Vector3& tip_m);

  bool touching_ = false;
  bool has_free_tip_ = false;
  Vector3 free_tip_m_ = Vector3::Zero();  // last place of the tip without contact
  Vector3 normal_ = Vector3::Zero();
  Vector3 surface_point_m_ = Vector3::Zero();
  // The tissue that the surface point lies on, by the topology's cell number, so that it survives a new patch.
  std::uint32_t surface_revision_ = 0;
  std::uint32_t surface_cell_id_ = 0;
  PatchContact::CellPoint surface_at_;
  bool surface_is_lip_ = false;
};

}  // namespace soft_volume::core
