#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// The cells near a tool with what contact needs of them; mirrors the message GridPatch. Vertex and cell numbers are
/// those of the topology with the same session and revision.
struct GridPatch {
  std::uint64_t session = 0;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;
  std::string tool_id;

  std::vector<std::uint32_t> vertex_ids;   ///< increasing
  std::vector<Vector3f> positions;         ///< per vertex_ids, volume frame, metres
  std::vector<Vector3f> velocities;        ///< per vertex_ids, metres per second
  std::vector<std::uint32_t> cell_ids;     ///< increasing; all their vertices are in vertex_ids
  std::vector<float> stiffness_pa;         ///< per cell: Young's modulus
  std::vector<float> cut_resistance_j_m2;  ///< per cell: energy to part a unit area, 0 where not modelled
  double blade_resistance_n = 0.0;         ///< of the tool's stroke under way, energy per travel; 0 without one
};

}  // namespace soft_volume::core
