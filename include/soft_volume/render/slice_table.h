#pragma once

#include <array>
#include <cstdint>

namespace soft_volume::core {

/// The closed loops that a plane cuts out of one cell, each a list of edge numbers (dissertation, section 3.5). Loops
/// are not triangulated.
struct SliceLoops {
  std::uint8_t loop_count = 0;               ///< 0 to 4
  std::array<std::uint8_t, 4> loop_sizes{};  ///< edges of each loop, at least 3
  std::array<std::uint8_t, 12> edges{};      ///< the loops one after the other
};

/// Edges of a hexahedron as pairs of its vertices, and its faces as vertices in outward counter-clockwise order; both
/// in VTK's order of vertices and faces.
inline constexpr std::array<std::array<std::uint8_t, 2>, 12> kHexahedronEdges = {
    {{0, 1}, {1, 2}, {3, 2}, {0, 3}, {4, 5}, {5, 6}, {7, 6}, {4, 7}, {0, 4}, {1, 5}, {2, 6}, {3, 7}}};
inline constexpr std::array<std::array<std::uint8_t, 4>, 6> kHexahedronFaces = {
    {{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4}, {3, 7, 6, 2}, {0, 3, 2, 1}, {4, 5, 6, 7}}};

/// Loops for each of the 256 ways in which a plane parts the vertices of a hexahedron; bit v of the index is set where
/// vertex v is on the positive side (z >= plane).
///
/// One rule decides every face, from its four signs alone: each run of positive corners is cut off on its own, so a
/// face with positive corners on one diagonal keeps the two negative ones together. Both cells at the face therefore
/// draw the same segments on it, in opposite directions, and the slices of neighbours fit without gap or overlap
/// (figures 3.8 to 3.11), whatever the cell's shape. Seen from the positive side all loops of a right-handed cell run
/// counter-clockwise.
///
/// Other cell types get a table of their own beside this one, from their own edges and faces.
const std::array<SliceLoops, 256>& hexahedronSliceTable();

}  // namespace soft_volume::core
