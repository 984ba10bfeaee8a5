#pragma once

#include <string>
#include <vector>

#include "soft_volume/render/renderer.h"

namespace soft_volume::core {

// Values of options that several programs have. All throw CLI::ValidationError, which names the option.

/// Finite numbers between commas.
std::vector<double> parseNumbers(const std::string& text, const char* option);
std::vector<double> parseNumbers(const std::string& text, const char* option, std::size_t count);

/// NX,NY,NZ,OFFSET: a normal of any length; the offset counts along its direction.
ClipPlane parsePlane(const std::string& text, const char* option);

/// R,G,B from 0 to 1.
Vector3f parseColour(const std::string& text, const char* option);

struct PictureSize {
  int width = 0;
  int height = 0;
};
/// WIDTHxHEIGHT, 1 to 8192.
PictureSize parseSize(const std::string& text, const char* option);

}  // namespace soft_volume::core
