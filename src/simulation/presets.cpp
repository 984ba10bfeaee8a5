#include "soft_volume/simulation/presets.h"

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

SimulationSettings reed1997() {
  SimulationSettings settings;
  settings.integrator = Integrator::kDissertation;
  settings.safe_move = SafeMove::kDissertation;
  settings.active_set = ActiveSet::kNeighbourhood;
  settings.spring_rule = SpringRule::kDissertation;
  settings.precision = Precision::kDouble;
  return settings;
}

SimulationSettings fast() {
  SimulationSettings settings;
  settings.dt_fraction = 0.9;
  settings.activation_threshold = 1e-2;
  return settings;
}

SimulationSettings exact() {
  SimulationSettings settings;
  settings.integrator = Integrator::kAdaptive;
  settings.active_set = ActiveSet::kAll;
  settings.precision = Precision::kDouble;
  return settings;
}

}  // namespace

SimulationSettings simulationPreset(const std::string& name) {
  if (name == "reed1997")
    return reed1997();
  if (name == "fast")
    return fast();
  if (name == "balanced")
    return {};
  if (name == "exact")
    return exact();
  std::string list;
  for (const std::string& preset : simulationPresetNames())
    list += (list.empty() ? "" : ", ") + preset;
  throw SceneError("there is no simulation preset '" + name + "'; it must be one of: " + list);
}

std::vector<std::string> simulationPresetNames() {
  return {"reed1997", "fast", "balanced", "exact"};
}

}  // namespace soft_volume::core
