#include "output.h"

#include <sys/resource.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <limits>

#include "soft_volume/common/error.h"
#include "soft_volume/render/image_io.h"

namespace soft_volume::core::render_program {
namespace {

/// 16-bit grey: 65535 is nearest, 1 farthest, 0 nothing.
std::vector<std::uint16_t> depthGreys(const Frame& frame) {
  const DepthRange range = depthRange(frame);
  const float width = std::max(range.farthest - range.nearest, std::numeric_limits<float>::min());
  std::vector<std::uint16_t> greys;
  greys.reserve(frame.depth_m.size());
  for (const float z : frame.depth_m)
    greys.push_back(std::isfinite(z) ? static_cast<std::uint16_t>(1.5F + 65534.0F * ((range.farthest - z) / width))
                                     : 0);
  return greys;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  if (values.size() % 2 == 1)
    return *middle;
  return 0.5 * (*middle + *std::max_element(values.begin(), middle));
}

}  // namespace

void checkWritable(const std::string& path) {
  if (path.empty())
    return;
  const bool existed = std::filesystem::exists(path);
  if (!std::ofstream(path, std::ios::app))
    throw FileError(path + ": cannot be written");
  if (!existed)
    std::filesystem::remove(path);
}

void writeFloats(const std::string& path, const std::vector<float>& values) {
  std::ofstream file(path, std::ios::binary);
  file.write(reinterpret_cast<const char*>(values.data()), std::streamsize(values.size() * sizeof(float)));
  file.close();
  if (!file)
    throw FileError(path + ": cannot be written");
}

void writeDepth(const std::string& path, const Frame& frame) {
  if (std::filesystem::path(path).extension() == ".png")
    writePng16(path, frame.width, frame.height, depthGreys(frame));
  else
    writeFloats(path, frame.depth_m);
}

DepthRange depthRange(const Frame& frame) {
  constexpr float kNothing = std::numeric_limits<float>::quiet_NaN();
  DepthRange range{kNothing, kNothing};
  for (const float z : frame.depth_m) {
    range.nearest = std::fmin(range.nearest, z);
    range.farthest = std::fmax(range.farthest, z);
  }
  return range;
}

std::string numbered(const std::string& path, int number) {
  char digits[16];
  std::snprintf(digits, sizeof digits, "_%03d", number);
  const std::size_t suffix = path.find_last_of('.');
  return path.substr(0, suffix) + digits + path.substr(suffix);
}

bool isTransparent(const Frame& frame) {
  for (std::size_t i = 3; i < frame.rgba.size(); i += 4) {
    if (frame.rgba[i] > 0.0F)
      return false;
  }
  return true;
}

void StageTimes::add(const Frame& frame) {
  frames_.push_back({frame.transform_ms, frame.bucket_ms, frame.slice_ms, frame.render_ms, frame.totalMs()});
}

StageTimes::Medians StageTimes::medians() const {
  const auto medianOf = [this](double Medians::*stage) {
    std::vector<double> values;
    for (const Medians& frame : frames_)
      values.push_back(frame.*stage);
    return median(values);
  };
  return {medianOf(&Medians::transform_ms), medianOf(&Medians::bucket_ms), medianOf(&Medians::slice_ms),
          medianOf(&Medians::render_ms), medianOf(&Medians::total_ms)};
}

std::size_t peakRssBytes() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return std::size_t(usage.ru_maxrss) * 1024;
}

}  // namespace soft_volume::core::render_program
