#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "soft_volume/scene/device_profile.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/tool/tool.h"
#include "soft_volume/tool/workspace_mapping.h"

namespace soft_volume::core {

/// The tools of a scene as one hand holds them, one at a time, with what a device needs.
struct ToolRig {
  std::uint64_t generation = 0;  ///< for the owner, who may tell rigs apart by it
  std::vector<std::unique_ptr<Tool>> tools;
  WorkspaceMapping mapping;
  std::uint32_t swap_button = 0;
};

/// The scene's tools on a device that is served `rate_hz` times a second. What the device's file says of the device
/// goes before what the scene says; without a file (null) the scene's own device is there, in the volume frame.
/// `first_sequence` as in Tool.
ToolRig makeToolRig(const Scene& scene, const DeviceProfile* profile, double rate_hz, std::uint64_t first_sequence);

}  // namespace soft_volume::core
