#pragma once

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/contact.h"
#include "soft_volume/tool/contact_tracker.h"
#include "soft_volume/tool/patch_contact.h"

namespace soft_volume::core {

/// The god object of a spherical tip: a sphere that stays outside of the tissue while the tip is inside. A spring from
/// the tip to it is what the hand feels. Queries allocate nothing and take no lock. Not thread safe: one proxy belongs
/// to one tip.
class Proxy {
 public:
  /// `tip_m` is the centre of the device's sphere, volume frame; `friction` the coefficient of Coulomb's friction
  /// between it and the tissue, 0 for none. Call once per tick; `field` may have moved or got a new patch in between.
  Contact update(const PatchContact& field, const Vector3& tip_m, double tip_radius_m, double friction);
  /// Forgets the contact and the last free place: new session, device reconnected.
  void reset() { tracker_.reset(); }

 private:
  ContactTracker tracker_;
};

}  // namespace soft_volume::core
