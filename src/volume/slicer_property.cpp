#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <sstream>
#include <string>
#include <vector>

#include "curve.h"
#include "soft_volume/common/error.h"
#include "transfer_function_formats.h"

namespace soft_volume::core {
namespace {

/// The three curves as 3D Slicer writes them: how many numbers follow (old files: how many points), then the points.
struct PropertyTexts {
  std::string scalar_opacity;
  std::string gradient_opacity;  ///< may be empty
  std::string colour;
};

bool parseNumber(const std::string& word, double& number) {
  char* end = nullptr;
  number = std::strtod(word.c_str(), &end);
  return end != word.c_str() && *end == '\0' && std::isfinite(number);
}

std::vector<double> rowsOf(const std::string& text, std::size_t width, const std::string& place) {
  std::vector<double> numbers;
  std::istringstream words(text);
  for (std::string word; words >> word;) {
    numbers.emplace_back();
    if (!parseNumber(word, numbers.back()))
      throw FileError(place + " holds '" + word + "', which is not a finite number");
  }
  if (numbers.size() < 1 + width || (numbers.size() - 1) % width != 0)
    throw FileError(place + " must hold a count and then " + std::to_string(width) + " numbers for each point");
  const double claimed = numbers.front();
  const auto follow = double(numbers.size() - 1);
  if (claimed != follow && claimed * double(width) != follow) {
    throw FileError(place + " claims " + std::to_string(static_cast<long long>(claimed)) + " numbers, but " +
                    std::to_string(numbers.size() - 1) + " follow; the file is cut off or damaged");
  }
  numbers.erase(numbers.begin());
  return numbers;
}

OpacityCurve opacityCurve(const std::string& text, const std::string& place) {
  const std::vector<double> rows = rowsOf(text, 2, place);
  OpacityCurve curve;
  for (std::size_t n = 0; n < rows.size(); n += 2)
    curve.push_back({rows[n], rows[n + 1]});
  checkCurve(curve, place);
  return curve;
}

ColourCurve colourCurve(const std::string& text, const std::string& place) {
  const std::vector<double> rows = rowsOf(text, 4, place);
  ColourCurve curve;
  for (std::size_t n = 0; n < rows.size(); n += 4)
    curve.push_back({rows[n], {rows[n + 1], rows[n + 2], rows[n + 3]}});
  checkCurve(curve, place);
  return curve;
}

bool isConstantOne(const OpacityCurve& curve) {
  return std::all_of(curve.begin(), curve.end(), [](const CurveNode<double>& node) { return node.y == 1.0; });
}

TransferFunctionFile makeFunction(const PropertyTexts& texts, const std::string& path) {
  TransferFunctionFile file;
  const ColourCurve colours = colourCurve(texts.colour, path + ": the colours");
  const OpacityCurve opacities = opacityCurve(texts.scalar_opacity, path + ": the scalar opacity");
  file.function.points = joinCurves(colours, opacities);
  file.function.unit_distance_m = 0.001;
  file.states_distance = true;
  const std::string place = path + ": the gradient opacity";
  if (!texts.gradient_opacity.empty() && !isConstantOne(opacityCurve(texts.gradient_opacity, place)))
    file.notes.push_back("its opacity depends on the gradient too, which is ignored");
  return file;
}

/// Lines without what follows "=>", without empty ones.
std::vector<std::string> meaningfulLines(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) {
    line.erase(std::min(line.find("=>"), line.size()));
    line.erase(line.find_last_not_of(" \t\r") + 1);
    if (!line.empty() && line.front() != '#')
      lines.push_back(line);
  }
  return lines;
}

std::string attributeOf(const std::string& element, const std::string& name) {
  const std::string start = " " + name + "=\"";
  const std::size_t from = element.find(start);
  const std::size_t begin = from + start.size();
  return from == std::string::npos ? "" : element.substr(begin, element.find('"', begin) - begin);
}

/// The starts of the elements <VolumeProperty ...>, on one line each.
std::vector<std::string> propertyElements(std::string text) {
  std::replace_if(
      text.begin(), text.end(), [](char c) { return c == '\n' || c == '\r' || c == '\t'; }, ' ');
  std::vector<std::string> elements;
  const std::string start = "<VolumeProperty ";
  for (std::size_t at = text.find(start); at != std::string::npos; at = text.find(start, at + 1))
    elements.push_back(text.substr(at, text.find('>', at) - at));
  return elements;
}

}  // namespace

TransferFunctionFile parseSlicerProperty(const FunctionText& source) {
  // Six numbers for interpolation and light come first; versions differ in their order, and none of them is used.
  constexpr std::size_t kLight = 6;
  const std::vector<std::string> lines = meaningfulLines(source.text);
  for (std::size_t n = 0; n < std::min(kLight, lines.size()); ++n) {
    double ignored = 0.0;
    if (!parseNumber(lines[n], ignored))
      throw FileError(source.path + ": line " + std::to_string(n + 1) +
                      " must be one number; this is no volume property of 3D Slicer");
  }
  if (lines.size() < kLight + 2) {
    throw FileError(source.path + ": has " + std::to_string(lines.size()) +
                    " lines; a volume property of 3D Slicer has 9, so the file is cut off");
  }
  const bool has_gradient = lines.size() > kLight + 2;
  return makeFunction(
      {lines[kLight], has_gradient ? lines[kLight + 1] : "", lines[has_gradient ? kLight + 2 : kLight + 1]},
      source.path);
}

TransferFunctionFile parseSlicerScene(const FunctionText& source) {
  const std::vector<std::string> elements = propertyElements(source.text);
  if (elements.empty())
    throw FileError(source.path + ": has no element <VolumeProperty ...> of 3D Slicer");
  std::vector<std::string> names;
  for (const std::string& element : elements) {
    names.push_back(attributeOf(element, "name"));
    if (source.wanted.empty() ? elements.size() > 1 : names.back() != source.wanted)
      continue;
    const PropertyTexts texts{attributeOf(element, "scalarOpacity"), attributeOf(element, "gradientOpacity"),
                              attributeOf(element, "colorTransfer")};
    TransferFunctionFile file = makeFunction(texts, source.path + " (" + names.back() + ")");
    file.name = names.back();
    return file;
  }
  failChoice(source, names);
}

}  // namespace soft_volume::core
