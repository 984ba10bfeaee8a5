#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/volume/transfer_function.h"

namespace soft_volume::core {

/// A transfer function sampled for look-up on the GPU, equally spaced from its first to its last point, and its
/// integral over the value (Engel, Kraus and Ertl 2001, without self-attenuation inside a slab): the difference of two
/// integrals over the difference of their entries is the mean over a slab in which the value changes linearly.
class TransferTable {
 public:
  static constexpr int kSize = 4096;
  /// Red, green, blue and the absorption of one metre in halvings: a way of d metres lets 2^(-absorption d) through.
  using Entry = std::array<float, 4>;

  /// Throws SceneError when the function is not valid.
  explicit TransferTable(const TransferFunction& function);

  const std::vector<Entry>& entries() const { return entries_; }
  /// For each entry the sum up to it, by the trapezoid rule in steps of one entry; colours weighted by absorption.
  const std::vector<Entry>& integrals() const { return integrals_; }
  double firstValue() const { return first_value_; }
  /// Entries per unit of value: value v is entry round((v - firstValue()) * entriesPerValue()), clamped.
  double entriesPerValue() const { return entries_per_value_; }
  /// True when no value in [low, high] has any opacity.
  bool isTransparent(double low, double high) const;

 private:
  void integrate();

  std::vector<Entry> entries_;
  std::vector<Entry> integrals_;
  std::vector<std::uint32_t> opaque_before_;  ///< how many entries before this one have opacity
  double first_value_ = 0.0;
  double entries_per_value_ = 1.0;
};

}  // namespace soft_volume::core
