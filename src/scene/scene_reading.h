#pragma once

#include <limits>
#include <string>
#include <vector>

#include "common/yaml_map.h"
#include "soft_volume/common/named_choice.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume::core {

// What the parts of the scene's reader share. Everything throws SceneError with the place in the file.

constexpr double kBig = std::numeric_limits<double>::max();
constexpr Range kFinite{-kBig, kBig};
constexpr Range kMetres{-10.0, 10.0, "m"};
constexpr Range kFraction{0.0, 1.0};

template <typename Choice>
void readChoice(YamlMap& map, const char* key, Choice& choice) {
  choice = *choiceNamed<Choice>(map.choice(key, choiceNames<Choice>(), nameOf(choice)));
}

/// Replaces ${NAME} by the environment variable and resolves a relative path against `folder`; empty stays empty.
std::string resolvePath(const YamlMap& map, const std::string& key, const std::string& text, const std::string& folder);
YAML::Node parseYaml(const std::string& yaml, const std::string& origin);
/// A unit quaternion [x, y, z, w].
Quaternion readOrientation(YamlMap& map, const std::string& key);

/// The whole of `rendering`.
RenderSettings readRendering(YamlMap map, const std::vector<Material>& materials, const std::string& folder);

}  // namespace soft_volume::core
