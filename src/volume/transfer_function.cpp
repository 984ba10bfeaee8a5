#include "soft_volume/volume/transfer_function.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

bool inUnitInterval(float x) {
  return x >= 0.0F && x <= 1.0F;
}

void validatePoint(const TransferFunction::Point& point, std::size_t index) {
  const std::string name = "transfer function, point " + std::to_string(index + 1) + ": ";
  if (!std::isfinite(point.value)) {
    throw SceneError(name + "the value must be a finite number");
  }
  if (!inUnitInterval(point.opacity)) {
    throw SceneError(name + "opacity must be in [0, 1], got " + std::to_string(point.opacity));
  }
  for (int channel = 0; channel < 3; ++channel) {
    if (!inUnitInterval(point.colour[channel])) {
      throw SceneError(name + "colour components must be in [0, 1], got " + std::to_string(point.colour[channel]));
    }
  }
}

}  // namespace

TransferFunction::Sample TransferFunction::evaluate(double value) const {
  assert(!points.empty());
  if (std::isnan(value)) {
    return {Vector3f::Zero(), 0.0F};
  }
  const auto above = std::upper_bound(points.begin(), points.end(), value,
                                      [](double v, const Point& point) { return v < point.value; });
  if (above == points.begin()) {
    return {points.front().colour, points.front().opacity};
  }
  if (above == points.end()) {
    return {points.back().colour, points.back().opacity};
  }
  const Point& a = *(above - 1);
  const Point& b = *above;
  const auto t = static_cast<float>((value - a.value) / (b.value - a.value));
  return {a.colour + t * (b.colour - a.colour), a.opacity + t * (b.opacity - a.opacity)};
}

void TransferFunction::validate() const {
  if (points.size() < 2) {
    throw SceneError("a transfer function needs at least two points, got " + std::to_string(points.size()));
  }
  if (!(unit_distance_m > 0.0) || !std::isfinite(unit_distance_m)) {
    throw SceneError("transfer function: unit_distance_m must be positive, got " + std::to_string(unit_distance_m));
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    validatePoint(points[i], i);
    if (i > 0 && !(points[i].value > points[i - 1].value)) {
      throw SceneError("transfer function, point " + std::to_string(i + 1) + ": values must increase, but " +
                       std::to_string(points[i].value) + " follows " + std::to_string(points[i - 1].value));
    }
  }
}

}  // namespace soft_volume::core
