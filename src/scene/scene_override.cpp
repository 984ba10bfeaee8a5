#include "soft_volume/scene/scene_override.h"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <array>
#include <sstream>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr char kPreset[] = "simulation.preset";
constexpr char kTimeStep[] = "simulation.dt_s";
/// What a preset decides.
constexpr std::array<const char*, 12> kMethodKeys = {
    "integrator",  "safe_move", "active_set",          "spring_rule",          "precision",  "dt_s",
    "dt_fraction", "substeps",  "activation_radius_m", "activation_threshold", "lifetime_s", "error_tolerance"};
/// What the automatic time step follows from, besides the materials.
constexpr std::array<const char*, 6> kTimeStepKeys = {kPreset,
                                                      "simulation.integrator",
                                                      "simulation.spring_rule",
                                                      "simulation.dt_fraction",
                                                      "simulation.substeps",
                                                      "lattice.spacing_m"};

std::vector<std::string> split(const std::string& path) {
  std::vector<std::string> parts;
  std::istringstream text(path);
  for (std::string part; std::getline(text, part, '.');)
    parts.push_back(part);
  return parts;
}

bool isNamed(const YAML::Node& item, const std::string& name) {
  for (const char* key : {"name", "id"}) {
    if (item.IsMap() && item[key] && item[key].IsScalar() && item[key].Scalar() == name)
      return true;
  }
  return false;
}

YAML::Node itemOf(const YAML::Node& list, const std::string& part) {
  for (std::size_t n = 0; n < list.size(); ++n) {
    if (isNamed(list[n], part) || part == std::to_string(n))
      return list[n];
  }
  return YAML::Node(YAML::NodeType::Undefined);
}

YAML::Node parentOf(const YAML::Node& top, const std::string& key) {
  const std::vector<std::string> parts = split(key);
  YAML::Node node = top;
  for (std::size_t n = 0; n + 1 < parts.size(); ++n) {
    const YAML::Node& here = node;
    const YAML::Node next = here.IsSequence() ? itemOf(here, parts[n]) : here[parts[n]];
    if (!next.IsDefined() || next.IsScalar())
      throw SceneError(key + ": the scene has no '" + parts[n] + "' there; doc/scene.md lists its keys");
    node.reset(next);
  }
  return node;
}

void set(YAML::Node& top, const SceneOverride& override) {
  YAML::Node parent = parentOf(top, override.key);
  const std::string last = split(override.key).back();
  YAML::Node value;
  try {
    value = YAML::Load(override.value);
  } catch (const YAML::Exception&) {
    throw SceneError(override.key + ": '" + override.value + "' is no value; quote it or close its brackets");
  }
  if (!parent.IsSequence()) {
    parent[last] = value;
    return;
  }
  YAML::Node item = itemOf(parent, last);
  if (!item.IsDefined())
    throw SceneError(override.key + ": the list has no item '" + last + "'");
  item = value;
}

bool changesTimeStep(const SceneOverride& override) {
  return std::find(kTimeStepKeys.begin(), kTimeStepKeys.end(), override.key) != kTimeStepKeys.end();
}

}  // namespace

std::vector<SceneOverride> parseOverrides(const std::string& text) {
  std::vector<std::string> items(1);
  int depth = 0;
  for (const char c : text) {
    depth += c == '[' || c == '{' ? 1 : c == ']' || c == '}' ? -1 : 0;
    if (c == ',' && depth == 0)
      items.emplace_back();
    else
      items.back() += c;
  }
  std::vector<SceneOverride> overrides;
  for (const std::string& item : items) {
    const std::size_t equals = item.find('=');
    if (equals == 0 || equals == std::string::npos || equals + 1 == item.size())
      throw InputError("'" + item + "' is not KEY=VALUE, as in simulation.integrator=backward_euler");
    overrides.push_back({item.substr(0, equals), item.substr(equals + 1)});
  }
  return overrides;
}

std::string overrideScene(const std::string& yaml, const std::vector<SceneOverride>& overrides) {
  YAML::Node top = YAML::Load(yaml);
  const auto has = [&](const char* key) {
    return std::any_of(overrides.begin(), overrides.end(), [&](const SceneOverride& o) { return o.key == key; });
  };
  if (has(kPreset)) {
    for (const char* key : kMethodKeys)
      top["simulation"].remove(key);
  } else if (!has(kTimeStep) && std::any_of(overrides.begin(), overrides.end(), changesTimeStep)) {
    top["simulation"]["dt_s"] = "auto";
  }
  for (const SceneOverride& override : overrides)
    set(top, override);
  YAML::Emitter out;
  out << top;
  return out.c_str();
}

}  // namespace soft_volume::core
