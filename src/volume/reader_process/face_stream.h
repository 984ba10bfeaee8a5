#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core::reader {

/// Faces of a polyhedron as lists of vertices.
using Faces = std::vector<std::vector<std::uint32_t>>;

/// Makes the faces fit for slicing: vertices that follow themselves go, faces of fewer than three vertices go, and all
/// faces are turned counter-clockwise seen from outside, which many writers neglect. `point` gives a vertex's place.
/// Returns false when an edge belongs to an odd number of faces: such a cell is not closed.
bool closeFaces(Faces& faces, const std::function<Vector3(std::uint32_t)>& point);

/// VTK's face stream: the number of faces, then for each the number of its vertices and these.
void appendFaceStream(const Faces& faces, std::vector<std::uint32_t>& stream);

}  // namespace soft_volume::core::reader
