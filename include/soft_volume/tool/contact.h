#pragma once

#include <cstdint>

#include "soft_volume/common/geometry.h"
#include "soft_volume/tool/patch_contact.h"

namespace soft_volume::core {

/// Where a spherical tip touches the deformed tissue; volume frame.
struct Contact {
  bool touching = false;
  Vector3 proxy_m = Vector3::Zero();          ///< centre of the sphere as it rests on the surface
  Vector3 surface_point_m = Vector3::Zero();  ///< the sphere's lowest point: on the surface, but for bumps and openings
  Vector3 normal = Vector3::Zero();           ///< outward unit vector of the surface there
  Vector3 surface_velocity_m_s = Vector3::Zero();  ///< of the tissue at the surface point, as it is shown
  std::uint32_t cell = PatchContact::kNoCell;      ///< the topology's number of the cell that it lies on
  double penetration_m = 0.0;    ///< from the proxy to the tip, along the normal: how deep the sphere is pressed in
  bool patch_too_small = false;  ///< the surface lies beyond the patch: the penetration is a lower bound
};

}  // namespace soft_volume::core
