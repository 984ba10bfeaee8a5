#include "soft_volume/replay/compared_quantity.h"

#include <algorithm>
#include <cmath>

namespace soft_volume {

void ComparedQuantity::add(const ComparedSample& sample, std::uint64_t things, const Squares& squares) {
  if (samples.empty() || sample.largest > largest) {
    largest = sample.largest;
    largest_at_s = sample.time_s;
  }
  scale = std::max({scale, std::abs(sample.first), std::abs(sample.second)});
  identical = identical && sample.largest == 0.0;
  compared += things;
  squares_.sum += squares.sum;
  squares_.count += squares.count;
  rms = squares_.count > 0 ? std::sqrt(squares_.sum / static_cast<double>(squares_.count)) : 0.0;
  samples.push_back(sample);
}

void ComparedQuantity::addValues(double time_s, double first, double second, double apart) {
  add({time_s, first, second, apart, apart}, 1, {apart * apart, 1});
}

void ComparedQuantity::addIndex(double time_s, double index) {
  if (samples.empty() || index < largest) {
    largest = index;
    largest_at_s = time_s;
  }
  scale = 1.0;
  identical = identical && index == 1.0;
  rms = (rms * static_cast<double>(compared) + index) / static_cast<double>(compared + 1);
  ++compared;
  samples.push_back({time_s, 0.0, 0.0, index, index});
}

}  // namespace soft_volume
