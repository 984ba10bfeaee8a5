#pragma once

#include <cstdint>
#include <optional>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/contact.h"
#include "soft_volume/tool/patch_contact.h"

namespace soft_volume::core {

class SurfaceSearch;

/// The god object of a spherical tip (Zilles and Salisbury, 1995; on an implicit surface as in Salisbury and Tarr,
/// 1997): a sphere that stays outside of the tissue while the tip is inside. A spring from the tip to it is what the
/// hand feels.
///
/// - In the air the sphere goes straight to the tip and stops at the first tissue on its way, however thin.
/// - On the tissue it is carried by the point of the tissue that it rests on, and slides along the surface to where the
///   spring pulls straight against it. The surface is searched from where it was, never from the tip: a tip may be
///   arbitrarily deep, below a fold or beyond thin tissue, and a closed cavity below the surface is not noticed. A
///   slide stops where the sphere's centre would enter other tissue (an overhanging fold, the other lip), or goes along
///   it.
/// - With the coefficient mu it sticks while the force is inside the friction cone, and slides to the cone's border
///   otherwise (Harwin and Melder, 2002).
/// - Slides follow the smooth normal below (force shading, Ruspini et al., 1997): the place that is nearest to a deep
/// tip
///   would jump from cell to cell, whose faces are kinks of a deformed surface. So the sphere also rounds the corner
///   between a floor and a wall. Walls that rise more steeply than that are not climbed.
/// - The surface is the threshold's iso-surface, cut faces and the end of the lattice (SurfaceSearch): over a narrow
///   opening the sphere rests on the rims, between wide lips it touches the one beside it. On rough tissue it lies on
///   the bumps.
/// - Its normal is the surface's slope over the tip's radius, or three quarters of a cell, whichever is more; it turns
///   by a fifth of the difference per tick, by at most 2 degrees.
///
/// A tip that starts inside tissue, with no history, leaves along the shortest of 26 ways, which may end in a cavity.
/// Queries allocate nothing and take no lock. Not thread safe: one proxy belongs to one tip.
class Proxy {
 public:
  /// `tip_m` is the centre of the device's sphere, volume frame; `friction` the coefficient of Coulomb's friction
  /// between it and the tissue, 0 for none. Call once per tick; `field` may have moved or got a new patch in between.
  Contact update(const PatchContact& field, const Vector3& tip_m, double tip_radius_m, double friction);
  /// Forgets the contact and the last free place: new session, device reconnected.
  void reset() { *this = Proxy(); }

 private:
  struct Tip {
    Vector3 position_m;
    double radius_m;
    double friction;
  };
  struct Rest;

  void take(const PatchContact& field, const Rest& rest);
  void carry(const PatchContact& field);
  std::optional<Rest> restAt(const SurfaceSearch& search, const Vector3& near_m, double radius_m, double rise_m) const;
  void slide(const SurfaceSearch& search, const PatchContact& field, const Tip& tip, Rest rest);
  std::optional<Rest> slid(const SurfaceSearch& search, const PatchContact& field, const Tip& tip);
  bool isBlocked(const PatchContact& field, const Vector3& to_m) const;
  Vector3 along(const SurfaceSearch& search, const Vector3& inside_m, const Vector3& way) const;
  std::optional<Rest> approach(const SurfaceSearch& search, const PatchContact& field, const Tip& tip);
  std::optional<Rest> touched(const SurfaceSearch& search, const PatchContact& field, const Vector3& centre_m,
                              double radius_m);
  bool guessNormal(const SurfaceSearch& search, const PatchContact& field, const Vector3& centre_m, double radius_m);
  Contact report(const PatchContact& field, const Tip& tip) const;

  bool touching_ = false;
  bool has_centre_ = false;
  Vector3 centre_m_ = Vector3::Zero();  // of the sphere, in the air or on the surface
  Vector3 normal_ = Vector3::Zero();
  double gain_ = 1.0;  // share of a slide that is tried first
  // The tissue that it rests on, by the topology's cell number, so that it survives a new patch.
  std::uint32_t revision_ = 0;
  std::uint32_t cell_id_ = 0;
  PatchContact::CellPoint at_;
  Vector3 point_m_ = Vector3::Zero();
  bool is_lip_ = false;
  bool patch_too_small_ = false;
};

}  // namespace soft_volume::core
