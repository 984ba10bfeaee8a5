#pragma once

#include <string>

namespace soft_volume::core {

/// As printf, up to 1023 characters.
std::string format(const char* pattern, ...) __attribute__((format(printf, 1, 2)));

/// Three digits, or all before the point where there are more.
std::string number(double value);

/// What this machine calls its processor.
std::string processorName();

}  // namespace soft_volume::core
