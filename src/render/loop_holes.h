#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/render/slice_mesh.h"

namespace soft_volume::core {

/// Loops of one cell, each as its vertices in order.
using Loops = std::vector<std::vector<std::uint32_t>>;

/// A cell with a dent or a tunnel has loops that run around holes, the other way than those that run around it. Each
/// such loop and the one around it are cut apart along two straight bridges into two simple polygons, so that whoever
/// fills polygons need not know of holes. A loop stays as it is where no two bridges fit, which takes a cell whose
/// faces cross each other.
void splitAtHoles(const std::vector<SliceVertex>& vertices, Loops& loops);

}  // namespace soft_volume::core
