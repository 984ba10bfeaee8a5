#pragma once

#include <array>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

constexpr std::size_t kDirections = 26;

/// Unit vectors to the faces, edges and corners of a cube around the origin: no place on the sphere is farther than 28
/// degrees from the nearest one.
inline const std::array<Vector3, kDirections>& directions() {
  static const std::array<Vector3, kDirections> kAll = [] {
    std::array<Vector3, kDirections> all;
    std::size_t n = 0;
    for (int k = -1; k <= 1; ++k) {
      for (int j = -1; j <= 1; ++j) {
        for (int i = -1; i <= 1; ++i) {
          if (i != 0 || j != 0 || k != 0)
            all[n++] = Vector3(i, j, k).normalized();
        }
      }
    }
    return all;
  }();
  return kAll;
}

}  // namespace soft_volume::core
