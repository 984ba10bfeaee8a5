#pragma once

#include <array>
#include <cstdint>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// Where the two lips of an incision may press on each other: a point that at rest both have in common, with the part
/// of their area around it. Each lip moves with a cell of the lattice.
struct LipContact {
  std::array<std::uint32_t, 2> cells = {};  ///< that carry lip 0 and lip 1, different ones
  std::array<Vector3, 2> places = {
      Vector3::Zero(), Vector3::Zero()};  ///< of the point at rest in either cell, 0 to 1 along each of its axes
  Vector3 normal = Vector3::Zero();       ///< at rest, volume frame, from lip 0 to lip 1, of length 1
  double area_m2 = 0.0;                   ///< at rest
  double stiffness_n_m = 0.0;             ///< force for a depth to which the lips are pressed into each other
  double opening_n = 0.0;                 ///< force that pulls each lip away from the other, however far apart they are
};

}  // namespace soft_volume::core
