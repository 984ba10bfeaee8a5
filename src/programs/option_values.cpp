#include "option_values.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <sstream>

namespace soft_volume::core {

std::vector<double> parseNumbers(const std::string& text, const char* option) {
  std::vector<double> numbers;
  std::istringstream parts(text);
  for (std::string part; std::getline(parts, part, ',');) {
    char* end = nullptr;
    numbers.push_back(std::strtod(part.c_str(), &end));
    if (part.empty() || *end != '\0' || !std::isfinite(numbers.back()))
      throw CLI::ValidationError(option, "'" + text + "' must be finite numbers with commas between them");
  }
  return numbers;
}

std::vector<double> parseNumbers(const std::string& text, const char* option, std::size_t count) {
  const std::vector<double> numbers = parseNumbers(text, option);
  if (numbers.size() == count)
    return numbers;
  throw CLI::ValidationError(option,
                             "'" + text + "' must be " + std::to_string(count) + " numbers with commas between them");
}

ClipPlane parsePlane(const std::string& text, const char* option) {
  const std::vector<double> numbers = parseNumbers(text, option, 4);
  const Vector3 normal(numbers[0], numbers[1], numbers[2]);
  const double length = normal.norm();
  if (!(length > 1e-12 && std::isfinite(length)))
    throw CLI::ValidationError(option, "the plane's normal has no direction");
  return {normal / length, numbers[3]};
}

Vector3f parseColour(const std::string& text, const char* option) {
  const std::vector<double> rgb = parseNumbers(text, option, 3);
  if (*std::min_element(rgb.begin(), rgb.end()) < 0.0 || *std::max_element(rgb.begin(), rgb.end()) > 1.0)
    throw CLI::ValidationError(option, "red, green and blue must be from 0 to 1");
  return Vector3(rgb[0], rgb[1], rgb[2]).cast<float>();
}

PictureSize parseSize(const std::string& text, const char* option) {
  PictureSize size;
  char rest = '\0';
  if (std::sscanf(text.c_str(), "%dx%d%c", &size.width, &size.height, &rest) != 2)
    throw CLI::ValidationError(option, "'" + text + "' must be WIDTHxHEIGHT, such as 640x480");
  if (std::min(size.width, size.height) < 1 || std::max(size.width, size.height) > 8192)
    throw CLI::ValidationError(option, "'" + text + "' is out of range; use 1 to 8192 pixels");
  return size;
}

}  // namespace soft_volume::core
