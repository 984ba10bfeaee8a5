#include "report_text.h"

#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <fstream>

namespace soft_volume::core {

std::string format(const char* pattern, ...) {
  char buffer[1024];
  va_list arguments;
  va_start(arguments, pattern);
  std::vsnprintf(buffer, sizeof buffer, pattern, arguments);
  va_end(arguments);
  return buffer;
}

std::string number(double value) {
  return format(std::abs(value) >= 1000.0 ? "%.0f" : "%.3g", value);
}

std::string processorName() {
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);) {
    if (line.rfind("model name", 0) == 0)
      return line.substr(line.find(':') + 2);
  }
  return "an unknown processor";
}

}  // namespace soft_volume::core
