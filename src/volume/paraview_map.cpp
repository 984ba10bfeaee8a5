#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "colour_space.h"
#include "curve.h"
#include "soft_volume/common/error.h"
#include "transfer_function_formats.h"

namespace soft_volume::core {
namespace {

using Json = nlohmann::json;

/// Between two nodes that are not mixed linearly so many samples are taken.
constexpr int kSamples = 16;

Json parseJson(const FunctionText& source) {
  try {
    return Json::parse(source.text);
  } catch (const Json::exception& error) {
    throw FileError(source.path + ": not valid JSON: " + error.what());
  }
}

std::string nameOf(const Json& map) {
  const auto name = map.find("Name");
  return name != map.end() && name->is_string() ? name->get<std::string>() : "";
}

/// The array's only map, or the one that is wanted.
const Json& chosenMap(const Json& file, const FunctionText& source) {
  const Json& first = file.is_array() && !file.empty() ? file.front() : file;
  if (!first.is_object())
    throw FileError(source.path + ": holds no colour map of ParaView, which is an object with RGBPoints");
  if (!file.is_array() || (file.size() == 1 && source.wanted.empty()))
    return first;
  std::vector<std::string> names;
  for (const Json& map : file) {
    names.push_back(map.is_object() ? nameOf(map) : "");
    if (!source.wanted.empty() && names.back() == source.wanted)
      return map;
  }
  failChoice(source, names);
}

/// The numbers of a key in rows of `width`.
std::vector<double> numbersOf(const Json& map, const char* key, std::size_t width, const std::string& place) {
  const Json& list = map.at(key);
  if (!list.is_array() || list.empty() || list.size() % width != 0) {
    throw FileError(place + ": " + key + " must be a list of numbers, " + std::to_string(width) + " for each point");
  }
  std::vector<double> numbers;
  for (const Json& item : list) {
    if (!item.is_number() || !std::isfinite(item.get<double>()))
      throw FileError(place + ": " + key + " holds " + item.dump() + ", which is not a finite number");
    numbers.push_back(item.get<double>());
  }
  return numbers;
}

ColourSpace spaceOf(const Json& map, const std::string& place, std::vector<std::string>& notes) {
  const auto space = map.find("ColorSpace");
  const std::string name = space != map.end() && space->is_string() ? space->get<std::string>() : "RGB";
  const bool no_wrap = map.contains("HSVWrap") && (map["HSVWrap"] == 0 || map["HSVWrap"] == false);
  static const std::map<std::string, ColourSpace> kSpaces = {{"RGB", ColourSpace::kRgb},
                                                             {"HSV", ColourSpace::kHsv},
                                                             {"HSVNoWrap", ColourSpace::kHsvNoWrap},
                                                             {"Lab", ColourSpace::kLab},
                                                             {"CIELAB", ColourSpace::kLab},
                                                             {"Lab/CIEDE2000", ColourSpace::kLab},
                                                             {"CIEDE2000", ColourSpace::kLab},
                                                             {"Diverging", ColourSpace::kDiverging},
                                                             {"Step", ColourSpace::kStep}};
  const auto found = kSpaces.find(name);
  if (found == kSpaces.end())
    throw FileError(place + ": ColorSpace '" + name + "' is not known; use RGB, HSV, Lab, Diverging or Step");
  if (name.find("CIEDE2000") != std::string::npos)
    notes.push_back("ColorSpace CIEDE2000 is mixed as Lab");
  return found->second == ColourSpace::kHsv && no_wrap ? ColourSpace::kHsvNoWrap : found->second;
}

/// Nodes with samples between them where the space does not mix linearly.
ColourCurve coloursOf(const std::vector<double>& rows, ColourSpace space) {
  ColourCurve curve;
  for (std::size_t n = 0; n < rows.size(); n += 4) {
    const CurveNode<Vector3> node{rows[n], {rows[n + 1], rows[n + 2], rows[n + 3]}};
    if (n > 0 && space == ColourSpace::kStep) {
      curve.push_back({curve.back().value, node.y});
    } else if (n > 0 && space != ColourSpace::kRgb) {
      const CurveNode<Vector3> from = curve.back();
      for (int s = 1; s < kSamples; ++s) {
        const double t = double(s) / kSamples;
        curve.push_back({from.value + t * (node.value - from.value), mixColours(from.y, node.y, t, space)});
      }
    }
    curve.push_back(node);
  }
  return curve;
}

struct OpacityNode {
  double value;
  double opacity;
  double midpoint;   ///< where half of the way to the next node's opacity is reached
  double sharpness;  ///< 0 linear, 1 a step
};

/// The curve of vtkPiecewiseFunction between two nodes: a cubic whose ends flatten with the sharpness.
double opacityBetween(const OpacityNode& a, const OpacityNode& b, double t) {
  double s = t < a.midpoint ? 0.5 * t / a.midpoint : 0.5 + 0.5 * (t - a.midpoint) / (1.0 - a.midpoint);
  if (a.sharpness < 0.01)
    return a.opacity + s * (b.opacity - a.opacity);
  if (a.sharpness > 0.99)
    return s < 0.5 ? a.opacity : b.opacity;
  const double power = 1.0 + 10.0 * a.sharpness;
  s = s < 0.5 ? 0.5 * std::pow(2.0 * s, power) : 1.0 - 0.5 * std::pow(2.0 * (1.0 - s), power);
  const double rise = s * s * (3.0 - 2.0 * s);
  const double slope = (1.0 - a.sharpness) * (s * (1.0 - s) * (1.0 - 2.0 * s));
  const double opacity = a.opacity + (rise + slope) * (b.opacity - a.opacity);
  return std::clamp(opacity, std::min(a.opacity, b.opacity), std::max(a.opacity, b.opacity));
}

OpacityCurve opacitiesOf(const std::vector<double>& rows) {
  OpacityCurve curve;
  OpacityNode from{};
  for (std::size_t n = 0; n < rows.size(); n += 4) {
    const OpacityNode node{rows[n], rows[n + 1], std::clamp(rows[n + 2], 1e-5, 1.0 - 1e-5), rows[n + 3]};
    const bool linear = from.sharpness < 0.01 && std::abs(from.midpoint - 0.5) < 1e-6;
    for (int s = 1; n > 0 && !linear && s < kSamples; ++s) {
      const double t = double(s) / kSamples;
      curve.push_back({from.value + t * (node.value - from.value), opacityBetween(from, node, t)});
    }
    curve.push_back({node.value, node.opacity});
    from = node;
  }
  return curve;
}

OpacityCurve readOpacities(const Json& map, const ColourCurve& colours, const std::string& place,
                           std::vector<std::string>& notes) {
  if (map.contains("Points")) {
    const OpacityCurve curve = opacitiesOf(numbersOf(map, "Points", 4, place));
    checkCurve(curve, place + ": Points");
    return curve;
  }
  notes.push_back("states no opacity (Points), so it rises from 0 to 1");
  return {{colours.front().value, 0.0}, {colours.back().value, 1.0}};
}

/// ParaView's own maps go from 0 to 1 or from -1 to 1 and are meant for any data.
bool makeRelative(std::vector<TransferFunction::Point>& points) {
  const double first = points.front().value;
  const double width = points.back().value - first;
  constexpr double kStepWidth = 1e-5;
  if ((first != 0.0 || std::abs(width - 1.0) > kStepWidth) && (first != -1.0 || std::abs(width - 2.0) > kStepWidth))
    return false;
  for (TransferFunction::Point& point : points)
    point.value = (point.value - first) / std::round(width);
  return true;
}

}  // namespace

TransferFunctionFile parseParaviewMap(const FunctionText& source) {
  const Json json = parseJson(source);
  const Json& map = chosenMap(json, source);
  TransferFunctionFile file;
  file.name = nameOf(map);
  const std::string place = source.path + (file.name.empty() ? "" : ": colour map '" + file.name + "'");
  if (!map.contains("RGBPoints")) {
    throw FileError(place + (map.contains("IndexedColors")
                                 ? ": has colours for categories (IndexedColors), not for a range of values"
                                 : ": has no RGBPoints"));
  }
  const std::vector<double> rows = numbersOf(map, "RGBPoints", 4, place);
  const ColourCurve colours = coloursOf(rows, spaceOf(map, place, file.notes));
  checkCurve(colours, place + ": RGBPoints");
  file.function.points = joinCurves(colours, readOpacities(map, colours, place, file.notes));
  file.relative = makeRelative(file.function.points);
  return file;
}

}  // namespace soft_volume::core
