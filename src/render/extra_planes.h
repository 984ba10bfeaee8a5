#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// Where a cell that lies between two planes is cut (dissertation, section 3.7.1).
struct ExtraPlace {
  int place;  ///< 1 to ExtraPlanes::kPlaces - 1: how many parts of the slab lie before it
  float z_m;  ///< where the cell itself is cut; not the place's depth when the cell is too thin to hold a place
};

/// Places between two neighbouring planes: the slab is halved until a place lies in the cell, up to kPlaces parts.
class ExtraPlanes {
 public:
  static constexpr int kPlaces = 64;

  ExtraPlanes(double front_m, double back_m) : front_m_(front_m), part_m_((back_m - front_m) / kPlaces) {}
  float z(int place) const { return float(front_m_ + place * part_m_); }
  /// For a cell that spans depths low_m < high_m within the slab: a place z with low_m < z <= high_m, the one on the
  /// coarsest level. A thinner cell gets the place nearest to it.
  ExtraPlace placeFor(float low_m, float high_m) const;

 private:
  int firstPlaceBehind(float z_m) const;

  double front_m_;
  double part_m_;
};

}  // namespace soft_volume::core
