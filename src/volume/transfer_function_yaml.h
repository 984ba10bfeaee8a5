#pragma once

#include <vector>

#include "common/yaml_map.h"
#include "soft_volume/volume/transfer_function.h"

namespace soft_volume::core {

// What a scene's `transfer_function` and a file of one share. All throw SceneError with the place in the file.

/// The rows of `points`: value, red, green, blue, opacity.
std::vector<TransferFunction::Point> readPoints(YamlMap& map);
/// Refuses a function that cannot be used, with the place of its points, and keys that nobody read.
void finishTransferFunction(const YamlMap& map, const TransferFunction& function);

}  // namespace soft_volume::core
