#include "soft_volume/render/slice_planes.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {

SlicePlanes planesThrough(const std::array<double, 2>& range_m, double anchor_m, double distance_m, int max_count) {
  SlicePlanes planes;
  planes.distance_m = distance_m;
  const double first = std::ceil((range_m[0] - anchor_m) / distance_m - 0.5);
  const double last = std::floor((range_m[1] - anchor_m) / distance_m - 0.5);
  planes.anchor_m = anchor_m;
  planes.first_number = int(std::clamp(first, -1e9, 1e9));
  planes.count = int(std::clamp(last - first + 1.0, 0.0, double(max_count)));
  return planes;
}

}  // namespace soft_volume::core
