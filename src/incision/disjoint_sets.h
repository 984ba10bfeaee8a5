#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

namespace soft_volume::core {

// Disjoint sets of numbers: each number has a parent, roots are their own.

inline std::uint32_t rootOf(std::vector<std::uint32_t>& parents, std::uint32_t n) {
  while (parents[n] != n)
    n = parents[n] = parents[parents[n]];
  return n;
}

/// Joins two sets; the lower number stays the root.
inline void join(std::vector<std::uint32_t>& parents, std::uint32_t a, std::uint32_t b) {
  a = rootOf(parents, a);
  b = rootOf(parents, b);
  parents[std::max(a, b)] = std::min(a, b);
}

}  // namespace soft_volume::core
