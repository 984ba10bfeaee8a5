#include "soft_volume/volume/transfer_function_file.h"

#include <limits.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <utility>

#include "soft_volume/common/error.h"
#include "transfer_function_formats.h"
#include "transfer_function_yaml.h"

namespace soft_volume::core {
namespace {

namespace fs = std::filesystem;

constexpr std::uintmax_t kMostBytes = std::uintmax_t(4) << 20;

// ------------------------------------------------------------------------------------------------------------- presets

fs::path programFolder() {
  char path[PATH_MAX];
  const ssize_t length = readlink("/proc/self/exe", path, sizeof path);
  return fs::path(std::string(path, length > 0 ? static_cast<std::size_t>(length) : 0)).parent_path();
}

fs::path presetFolder() {
  const char* chosen = std::getenv("SOFT_VOLUME_TRANSFER_FUNCTIONS");
  if (chosen != nullptr && *chosen != '\0') {
    if (fs::is_directory(chosen))
      return chosen;
    throw FileError(std::string(chosen) + ": the variable SOFT_VOLUME_TRANSFER_FUNCTIONS must name a folder");
  }
  const fs::path program = programFolder();
  const fs::path in_share = fs::path("share") / "soft_volume" / "config" / "transfer_functions";
  // Programs lie in bin, or, as catkin puts them, in lib/soft_volume.
  for (const fs::path& folder : {program.parent_path() / in_share, program.parent_path().parent_path() / in_share,
                                 fs::path(SOFT_VOLUME_PRESETS_SOURCE), fs::path(SOFT_VOLUME_PRESETS_INSTALLED)}) {
    std::error_code ignored;
    if (fs::is_directory(folder, ignored))
      return folder;
  }
  throw FileError(
      "the folder of the transfer functions' presets is missing; name it in the variable "
      "SOFT_VOLUME_TRANSFER_FUNCTIONS");
}

std::string listed(const std::vector<std::string>& names) {
  constexpr std::size_t kMost = 30;
  std::string list;
  for (std::size_t n = 0; n < std::min(kMost, names.size()); ++n)
    list += (n > 0 ? ", " : "") + names[n];
  return names.size() > kMost ? list + ", ..." : list;
}

/// Names of presets have no suffix and no folder.
bool looksLikePath(const std::string& source) {
  return source.find('/') != std::string::npos || source.find('.') != std::string::npos;
}

fs::path presetPath(const std::string& name) {
  const fs::path path = presetFolder() / (name + ".yaml");
  if (fs::is_regular_file(path))
    return path;
  throw FileError(name + ": is neither a file of a transfer function nor a preset; the presets are " +
                  listed(transferFunctionPresets()));
}

// --------------------------------------------------------------------------------------------------------------- files

std::string readText(const std::string& path) {
  std::error_code error;
  if (!fs::is_regular_file(path, error))
    throw FileError(path + ": is no file; give the path of a transfer function or a preset (" +
                    listed(transferFunctionPresets()) + ")");
  if (fs::file_size(path, error) > kMostBytes || error)
    throw FileError(path + ": is too large for a transfer function");
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  if (!(text << file.rdbuf()))
    throw FileError(path + ": cannot be read, or is empty");
  return text.str();
}

std::string lowerSuffix(const fs::path& path) {
  std::string suffix = path.extension().string();
  std::transform(suffix.begin(), suffix.end(), suffix.begin(), [](unsigned char c) { return char(std::tolower(c)); });
  return suffix;
}

TransferFunctionFile parse(const FunctionText& source) {
  const std::string suffix = lowerSuffix(source.path);
  if (suffix == ".yaml" || suffix == ".yml")
    return parseYamlFunction(source);
  if (suffix == ".json")
    return parseParaviewMap(source);
  if (suffix == ".vp")
    return parseSlicerProperty(source);
  if (suffix == ".mrml" || suffix == ".xml")
    return parseSlicerScene(source);
  throw FileError(source.path +
                  ": is of an unknown type; use .yaml, a colour map of ParaView (.json), or a volume "
                  "property of 3D Slicer (.vp, .mrml, .xml)");
}

TransferFunctionFile readFile(const std::string& path, const std::string& wanted) try {
  const std::string text = readText(path);
  TransferFunctionFile file = parse({path, text, wanted});
  if (file.name.empty())
    file.name = fs::path(path).stem().string();
  file.function.validate();
  return file;
} catch (const SceneError& error) {
  const std::string message = error.what();
  throw FileError(message.compare(0, path.size(), path) == 0 ? message : path + ": " + message);
}

YAML::Node parseYaml(const FunctionText& source) {
  try {
    return YAML::Load(source.text);
  } catch (const YAML::Exception& error) {
    throw FileError(source.path + ":" + std::to_string(error.mark.line + 1) + ": not valid YAML: " + error.msg);
  }
}

void requireRelative(const YamlMap& map, const std::vector<TransferFunction::Point>& points) {
  if (!points.empty() && (points.front().value < 0.0 || points.back().value > 1.0))
    map.fail("points", "must have values from 0 to 1, as it is relative to the data's range");
}

}  // namespace

void failChoice(const FunctionText& source, const std::vector<std::string>& names) {
  const std::string problem =
      source.wanted.empty() ? "holds several transfer functions" : "holds no '" + source.wanted + "'";
  throw FileError(source.path + ": " + problem + "; write " + source.path + "#NAME, with one of " + listed(names));
}

TransferFunctionFile parseYamlFunction(const FunctionText& source) {
  YamlMap map(parseYaml(source), "", source.path);
  TransferFunctionFile file;
  file.about = map.text("about", "");
  file.relative = map.flag("relative", false);
  file.states_distance = !file.relative || map.has("unit_distance_m");
  file.function.unit_distance_m = map.number("unit_distance_m", {1e-6, 1e6, "m"}, file.function.unit_distance_m);
  file.function.points = readPoints(map);
  finishTransferFunction(map, file.function);
  if (file.relative)
    requireRelative(map, file.function.points);
  return file;
}

TransferFunctionFile readTransferFunction(const std::string& source) {
  if (source.empty())
    throw FileError("the name of the transfer function is empty; the presets are " + listed(transferFunctionPresets()));
  if (fs::is_regular_file(source))
    return readFile(source, "");
  if (!looksLikePath(source))
    return readFile(presetPath(source).string(), "");
  const std::size_t hash = source.find_last_of('#');
  return readFile(source.substr(0, hash), hash == std::string::npos ? "" : source.substr(hash + 1));
}

TransferFunction stretched(const TransferFunction& function, const std::array<double, 2>& range) {
  TransferFunction result = function;
  for (TransferFunction::Point& point : result.points)
    point.value = range[0] + point.value * (range[1] - range[0]);
  return result;
}

TransferFunction fitTo(const TransferFunctionFile& file, const std::array<double, 2>& range, double diagonal_m) {
  if (!std::isfinite(range[0]) || !std::isfinite(range[1]) || range[0] > range[1])
    throw InputError("the range of the data must be finite and not decrease");
  if (!std::isfinite(diagonal_m) || diagonal_m < 0.0)
    throw InputError("the diagonal of the grid must be finite");
  TransferFunction function = file.function;
  if (file.relative) {
    const double spread = range[1] > range[0] ? 0.0 : std::max(1e-3 * std::abs(range[0]), 0.5);
    function = stretched(function, {range[0] - spread, range[1] + spread});
  }
  if (!file.states_distance)
    function.unit_distance_m = diagonal_m > 0.0 ? 0.01 * diagonal_m : function.unit_distance_m;
  return function;
}

std::vector<std::string> transferFunctionPresets() {
  std::vector<std::string> names;
  for (const fs::directory_entry& entry : fs::directory_iterator(presetFolder())) {
    if (entry.path().extension() == ".yaml")
      names.push_back(entry.path().stem().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace soft_volume::core
