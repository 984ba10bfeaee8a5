#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/render/slice_mesh.h"

namespace soft_volume::core {

/// Splits a simple polygon of a slice (either orientation) into size - 2 triangles: a fan when it is convex, by ear
/// clipping otherwise; a loop that crosses itself (a folded cell) becomes some fan. `tip` (less than size): the corner
/// of a convex polygon that all its triangles share. Writes 3 (size - 2) places in the polygon, 0 to size - 1, to
/// `triangles`.
void triangulate(const SliceMesh& mesh, const SlicePolygon& polygon, std::uint32_t tip, std::uint32_t* triangles);

}  // namespace soft_volume::core
