#include "transfer_integral.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace soft_volume::core {
namespace {

constexpr double kMinTransparency = 1e-12;
constexpr std::size_t kNodes = 4096;
constexpr std::size_t kMinNodesPerInterval = 64;
constexpr std::size_t kParts = 1024;
/// Values closer than this part of the range give their difference no digits; the density between them is constant.
constexpr double kEqual = 1e-7;

/// Gauss and Legendre's rule for [0, 1].
constexpr std::array<double, 4> kPlaces = {0.069431844202973712, 0.33000947820757187, 0.66999052179242813,
                                           0.93056815579702629};
constexpr std::array<double, 4> kWeights = {0.17392742256872693, 0.32607257743127307, 0.32607257743127307,
                                            0.17392742256872693};

}  // namespace

TransferIntegral::TransferIntegral(const TransferFunction& function) : function_(function) {
  function.validate();
  const std::vector<TransferFunction::Point>& points = function_.points;
  const std::size_t intervals = points.size() - 1;
  nodes_per_interval_ = std::max(kMinNodesPerInterval, kNodes / intervals);
  nodes_.push_back({points[0].value, Density::Zero(), at(points[0].value)});
  for (std::size_t i = 0; i < intervals; ++i) {
    const double width = (points[i + 1].value - points[i].value) / double(nodes_per_interval_);
    for (std::size_t node = 1; node < nodes_per_interval_; ++node)
      addNode(points[i].value + double(node) * width);
    addNode(points[i + 1].value);
  }
  std::uint32_t interval = 0;
  for (std::size_t part = 0; part < kParts; ++part) {
    const double begin = points[0].value + range() * double(part) / double(kParts);
    while (interval + 1 < intervals && points[interval + 1].value < begin)
      ++interval;
    first_interval_.push_back(interval);
  }
  addSteepness();
}

std::size_t TransferIntegral::partOf(double value) const {
  const double part = (value - function_.points.front().value) / range() * double(kParts);
  return part > 0.0 ? std::min(kParts - 1, std::size_t(std::min(part, double(kParts)))) : 0;
}

void TransferIntegral::addSteepness() {
  steepest_.assign(1, std::vector<double>(kParts, 0.0));
  for (std::size_t i = 1; i < nodes_.size(); ++i) {
    const double change = (nodes_[i].density - nodes_[i - 1].density).cwiseAbs().maxCoeff();
    const double slope = change / (nodes_[i].value - nodes_[i - 1].value);
    for (std::size_t part = partOf(nodes_[i - 1].value); part <= partOf(nodes_[i].value); ++part)
      steepest_[0][part] = std::max(steepest_[0][part], slope);
  }
  for (std::size_t width = 1; 2 * width <= kParts; width *= 2) {
    const std::vector<double>& half = steepest_.back();
    std::vector<double> whole = half;
    for (std::size_t part = 0; part + width < kParts; ++part)
      whole[part] = std::max(half[part], half[part + width]);
    steepest_.push_back(std::move(whole));
  }
}

double TransferIntegral::steepest(double low, double high) const {
  const std::size_t first = partOf(low);
  const std::size_t last = std::max(first, partOf(high));
  std::size_t level = 0;
  while ((std::size_t(2) << level) <= last - first + 1)
    ++level;
  const std::vector<double>& steepest = steepest_[level];
  return std::max(steepest[first], steepest[last + 1 - (std::size_t(1) << level)]);
}

void TransferIntegral::addNode(double value) {
  const Node& last = nodes_.back();
  const double width = value - last.value;
  Density sum = last.sum;
  for (std::size_t i = 0; i < kPlaces.size(); ++i)
    sum += width * kWeights[i] * at(last.value + kPlaces[i] * width);
  nodes_.push_back({value, sum, at(value)});
}

Eigen::Vector4d TransferIntegral::colourAt(double value) const {
  const TransferFunction::Sample sample = function_.evaluate(value);
  if (!(sample.opacity > 0.0F))
    return {sample.colour.x(), sample.colour.y(), sample.colour.z(), 0.0};
  const double transparency = std::max(kMinTransparency, 1.0 - double(sample.opacity));
  return {sample.colour.x(), sample.colour.y(), sample.colour.z(), -std::log(transparency) / function_.unit_distance_m};
}

TransferIntegral::Density TransferIntegral::at(double value) const {
  Density density = colourAt(value);
  density.head<3>() *= density[3];
  return density;
}

/// Of a value within the range.
std::size_t TransferIntegral::nodeBefore(double value) const {
  const std::vector<TransferFunction::Point>& points = function_.points;
  std::size_t interval = first_interval_[partOf(value)];
  while (interval > 0 && points[interval].value > value)
    --interval;
  while (interval + 2 < points.size() && points[interval + 1].value <= value)
    ++interval;
  const double width = points[interval + 1].value - points[interval].value;
  const double place = (value - points[interval].value) / width * double(nodes_per_interval_);
  return interval * nodes_per_interval_ + std::min(nodes_per_interval_ - 1, std::size_t(std::max(0.0, place)));
}

TransferIntegral::Density TransferIntegral::upTo(double value) const {
  if (!std::isfinite(value))
    return Density::Zero();
  if (value <= nodes_.front().value)
    return (value - nodes_.front().value) * nodes_.front().density;
  if (value >= nodes_.back().value)
    return nodes_.back().sum + (value - nodes_.back().value) * nodes_.back().density;
  const Node* node = &nodes_[nodeBefore(value)];
  // The cubic that has both ends' integrals and densities.
  const double width = node[1].value - node[0].value;
  const double t = (value - node[0].value) / width;
  const double s = 1.0 - t;
  return node[0].sum + (t * t * (3.0 - 2.0 * t)) * (node[1].sum - node[0].sum) +
         (width * t * s) * (s * node[0].density - t * node[1].density);
}

TransferIntegral::Density TransferIntegral::mean(double from, const Density& up_to_from, double to,
                                                 const Density& up_to_to) const {
  const double difference = to - from;
  if (std::abs(difference) > kEqual * range())
    return (up_to_to - up_to_from) / difference;
  return at(0.5 * (from + to));
}

}  // namespace soft_volume::core
