#include "extra_planes.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {

/// From 1 to kPlaces, which stands for none.
int ExtraPlanes::firstPlaceBehind(float z_m) const {
  int place = int(std::clamp((double(z_m) - front_m_) / part_m_, 1.0, double(kPlaces)));
  while (place > 1 && z(place - 1) > z_m)
    --place;
  while (place < kPlaces && z(place) <= z_m)
    ++place;
  return place;
}

ExtraPlace ExtraPlanes::placeFor(float low_m, float high_m) const {
  const int first = firstPlaceBehind(low_m);
  int last = firstPlaceBehind(high_m) - 1;
  if (first > last) {
    const float middle_m = low_m + 0.5F * (high_m - low_m);
    const float z_m = middle_m > low_m ? middle_m : high_m;
    return {std::clamp(int(std::lround((double(z_m) - front_m_) / part_m_)), 1, kPlaces - 1), z_m};
  }
  // Without its lowest bit a place is on a coarser level.
  while ((last & (last - 1)) >= first)
    last &= last - 1;
  return {last, z(last)};
}

}  // namespace soft_volume::core
