#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <type_traits>
#include <vector>

namespace soft_volume::core {

/// 64-bit XXH3 of a block of memory. Used for identity (did these bytes change?), never for security. The value is the
/// same on every machine of the same byte order.
std::uint64_t hashBytes(const void* data, std::size_t size, std::uint64_t seed = 0);

template <typename T>
std::uint64_t hashVector(const std::vector<T>& values, std::uint64_t seed = 0) {
  static_assert(std::is_standard_layout<T>::value, "only plain values can be hashed by their bytes");
  return hashBytes(values.data(), values.size() * sizeof(T), seed);
}

/// Sixteen lower-case hexadecimal digits.
std::string hashToString(std::uint64_t hash);

}  // namespace soft_volume::core
