#include "transfer_table.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {
namespace {

/// Opacity 1 would absorb without end; this lets 6 % through a tenth of the unit distance, and leaves the integrals
/// precise.
constexpr double kMinTransparency = 1e-12;

TransferTable::Entry makeEntry(const TransferFunction& function, double value) {
  const TransferFunction::Sample sample = function.evaluate(value);
  const double transparency = std::max(kMinTransparency, 1.0 - double(sample.opacity));
  const float absorption = sample.opacity > 0.0F ? float(-std::log2(transparency) / function.unit_distance_m) : 0.0F;
  return {sample.colour.x(), sample.colour.y(), sample.colour.z(), absorption};
}

}  // namespace

TransferTable::TransferTable(const TransferFunction& function) {
  function.validate();
  first_value_ = function.points.front().value;
  entries_per_value_ = (kSize - 1) / (function.points.back().value - first_value_);
  entries_.reserve(kSize);
  opaque_before_.assign(1, 0);
  for (int i = 0; i < kSize; ++i) {
    entries_.push_back(makeEntry(function, first_value_ + i / entries_per_value_));
    opaque_before_.push_back(opaque_before_.back() + std::uint32_t(entries_.back()[3] > 0.0F));
  }
  integrate();
}

void TransferTable::integrate() {
  std::array<double, 4> sum{};
  integrals_.assign(1, Entry{});
  for (std::size_t i = 1; i < entries_.size(); ++i) {
    const Entry& a = entries_[i - 1];
    const Entry& b = entries_[i];
    for (std::size_t channel = 0; channel < 3; ++channel) {
      sum[channel] += 0.5 * (double(a[channel]) * a[3] + double(b[channel]) * b[3]);
    }
    sum[3] += 0.5 * (double(a[3]) + b[3]);
    integrals_.push_back({float(sum[0]), float(sum[1]), float(sum[2]), float(sum[3])});
  }
}

bool TransferTable::isTransparent(double low, double high) const {
  const auto place = [this](double value) { return (value - first_value_) * entries_per_value_; };
  // One entry more on both sides covers the rounding of the look-up. A scalar that is further out than that gets the
  // first or the last entry and none beside it.
  const auto begin = std::size_t(std::clamp(place(low) - 1.0, 0.0, double(kSize - 1)));
  const auto end = std::size_t(std::clamp(place(high) + 3.0, 1.0, double(kSize)));
  const bool below = place(high) < -1.0;
  const bool above = place(low) > double(kSize);
  return opaque_before_[above ? std::size_t(kSize - 1) : begin] == opaque_before_[below ? std::size_t(1) : end];
}

}  // namespace soft_volume::core
