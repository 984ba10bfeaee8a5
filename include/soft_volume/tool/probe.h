#pragma once

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/contact_tracker.h"
#include "soft_volume/tool/patch_contact.h"

namespace soft_volume::core {

/// A sphere that presses on tissue through a spring and a damper. Allocates nothing; one thread at a time.
class Probe {
 public:
  struct Result {
    Contact contact;
    Vector3 device_force_n = Vector3::Zero();  ///< wished force on the device, before any limit
  };

  Probe(double tip_radius_m, double stiffness_n_m, double damping_n_s_m)
      : tip_radius_m_(tip_radius_m), stiffness_n_m_(stiffness_n_m), damping_n_s_m_(damping_n_s_m) {}

  /// Force = stiffness * penetration - damping * approach speed relative to the tissue, along the outward normal; it
  /// never pulls. `tip_m` is the sphere's centre.
  Result update(const PatchContact& field, const Vector3& tip_m, const Vector3& tip_velocity_m_s);
  void reset() { tracker_.reset(); }

 private:
  double tip_radius_m_;
  double stiffness_n_m_;
  double damping_n_s_m_;
  ContactTracker tracker_;
};

}  // namespace soft_volume::core
