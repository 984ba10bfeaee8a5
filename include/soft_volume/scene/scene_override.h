#pragma once

#include <string>
#include <vector>

namespace soft_volume::core {

/// A key of a scene and its new value, as KEY=VALUE: `simulation.integrator=backward_euler`.
struct SceneOverride {
  std::string key;    ///< path; an item of a list by its name, id or place from 0: `materials.tissue.poisson_ratio`
  std::string value;  ///< YAML
};

/// Parts `KEY=VALUE,KEY=VALUE` at the commas that are outside of brackets and braces. Throws InputError.
std::vector<SceneOverride> parseOverrides(const std::string& text);

/// The scene's text with other values. `simulation.preset` takes the place of all keys of the method; other keys of
/// `simulation` go before it. The time step is found anew (`auto`) when the method or the lattice's spacing changes and
/// no simulation.dt_s is given, because what a resolved scene holds is that of the old one.
/// Throws SceneError when a key's parent does not exist; parseScene() of the result checks the rest.
std::string overrideScene(const std::string& yaml, const std::vector<SceneOverride>& overrides);

}  // namespace soft_volume::core
