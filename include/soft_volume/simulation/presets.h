#pragma once

#include <string>
#include <vector>

#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

/// Settings for a purpose, by name:
/// - `reed1997`: chapter 4 of the dissertation as written (Figure 4.4, 40 % rule, lifetimes, uniform springs without
///   damping); the baseline of every comparison;
/// - `fast`: the longest step and the smallest active set that are still useful at interactive rates;
/// - `balanced`: the defaults of SimulationSettings;
/// - `exact`: the whole lattice in double precision with an error bound per step; far from real time.
/// The time step of each is automatic. doc/simulation.md has the error and the cost of each.
/// Throws SceneError when there is no such preset.
SimulationSettings simulationPreset(const std::string& name);

std::vector<std::string> simulationPresetNames();

}  // namespace soft_volume::core
