#pragma once

#include <string>

#include "soft_volume/volume/transfer_function_file.h"

namespace soft_volume::core {

/// The contents of a file. `wanted` names one of several functions, empty where there is one. Throw FileError, or
/// SceneError with a place, and leave the validation of the function to the caller.
struct FunctionText {
  const std::string& path;
  const std::string& text;
  const std::string& wanted;
};

TransferFunctionFile parseYamlFunction(const FunctionText& source);
TransferFunctionFile parseParaviewMap(const FunctionText& source);
/// The lines of a .vp file.
TransferFunctionFile parseSlicerProperty(const FunctionText& source);
/// The attributes of <VolumeProperty ...> elements.
TransferFunctionFile parseSlicerScene(const FunctionText& source);

/// Throws that `names` holds several, or no `wanted`.
[[noreturn]] void failChoice(const FunctionText& source, const std::vector<std::string>& names);

}  // namespace soft_volume::core
