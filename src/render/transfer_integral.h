#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/volume/transfer_function.h"

namespace soft_volume::core {

/// A transfer function and its integral over the value, without the sampling of TransferTable: every interval between
/// two points of the function has nodes of its own, so that peaks keep their place however narrow they are.
class TransferIntegral {
 public:
  /// Red, green and blue, each times absorption, and the absorption per metre (natural logarithm). Opacity per unit
  /// distance o absorbs -ln(1 - o) / unit distance, with the bound of TransferTable.
  using Density = Eigen::Vector4d;

  /// Throws SceneError when the function is not valid.
  explicit TransferIntegral(const TransferFunction& function);

  Density at(double value) const;
  /// Red, green and blue as they are, and the absorption per metre.
  Eigen::Vector4d colourAt(double value) const;
  /// Integral of the density from the function's first point to the value; zero where that is not finite.
  Density upTo(double value) const;
  /// Mean density while the value goes evenly from one to the other, given upTo() of both. Zero where one is not
  /// finite.
  Density mean(double from, const Density& up_to_from, double to, const Density& up_to_to) const;
  /// How fast any part of the density changes at most, per unit of the value, somewhere between these; at least that.
  double steepest(double low, double high) const;
  /// From the first point to the last.
  double range() const { return function_.points.back().value - function_.points.front().value; }

 private:
  struct Node {
    double value;
    Density sum;
    Density density;
  };
  void addNode(double value);
  void addSteepness();
  std::size_t partOf(double value) const;
  std::size_t nodeBefore(double value) const;

  TransferFunction function_;
  std::vector<Node> nodes_;
  std::size_t nodes_per_interval_ = 1;
  std::vector<std::uint32_t> first_interval_;  ///< by equal parts of the range, the interval that it begins in
  /// Level l: by parts, the steepest change from this part to the one 2^l - 1 behind it.
  std::vector<std::vector<double>> steepest_;
};

}  // namespace soft_volume::core
