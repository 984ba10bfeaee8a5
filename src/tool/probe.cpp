#include "soft_volume/tool/probe.h"

#include <algorithm>

namespace soft_volume::core {

Probe::Result Probe::update(const PatchContact& field, const Vector3& tip_m, const Vector3& tip_velocity_m_s) {
  Result result;
  result.contact = tracker_.query(field, tip_m, tip_radius_m_);
  if (!result.contact.touching)
    return result;
  const double leaving = (tip_velocity_m_s - result.contact.surface_velocity_m_s).dot(result.contact.normal);
  const double force = stiffness_n_m_ * result.contact.penetration_m - damping_n_s_m_ * leaving;
  result.device_force_n = std::max(0.0, force) * result.contact.normal;
  return result;
}

}  // namespace soft_volume::core
