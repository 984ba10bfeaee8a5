#include "soft_volume/scene/tool_rig.h"

#include <algorithm>

namespace soft_volume::core {
namespace {

ToolConfig forDevice(ToolConfig config, const DeviceProfile& profile, const WorkspaceMapping& mapping, double rate_hz) {
  config.device = mapping.atTip(profile.limits);
  config.safety = mapping.atTip(profile.safety);
  CouplingConfig& coupling = config.coupling;
  const double damping = mapping.atTip(profile.device_damping_n_s_m);
  coupling.device_damping_n_s_m = damping;
  coupling.damping_n_s_m = std::min({coupling.damping_n_s_m, 0.5 * damping, config.device.max_damping_n_s_m});
  coupling.sample_period_s = 1.0 / rate_hz;
  // A force waits for the driver's next cycle, which no message tells.
  coupling.delay_s = profile.output_delay_s + 1.0 / profile.rate_hz;
  config.cutting_drag_n_s_m = std::min(config.cutting_drag_n_s_m, damping);
  return config;
}

}  // namespace

ToolRig makeToolRig(const Scene& scene, const DeviceProfile* profile, double rate_hz, std::uint64_t first_sequence) {
  ToolRig rig;
  rig.swap_button = scene.swap_button;
  if (profile != nullptr)
    rig.mapping = WorkspaceMapping(profile->mapping, profile->placeIn(scene));
  for (const ToolConfig& config : scene.tools) {
    rig.tools.push_back(std::make_unique<Tool>(
        profile != nullptr ? forDevice(config, *profile, rig.mapping, rate_hz) : config, first_sequence));
  }
  return rig;
}

}  // namespace soft_volume::core
