#pragma once

#include <array>
#include <cstdint>

namespace soft_volume::core {

/// Tables of a hexahedron in VTK's vertex and face order.

/// Lattice offset of each corner.
constexpr int kHexahedronCorners[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                          {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};

/// Corners of each face, counter-clockwise seen from outside: -x, +x, -y, +y, -z, +z. Face f lies on axis f / 2.
constexpr int kHexahedronFaces[6][4] = {{0, 4, 7, 3}, {1, 2, 6, 5}, {0, 1, 5, 4},
                                        {3, 7, 6, 2}, {0, 3, 2, 1}, {4, 5, 6, 7}};

/// The face of the neighbour that touches face f.
constexpr int oppositeFace(int face) {
  return face ^ 1;
}

/// A pair of corners, of which a hexahedron has 28: 12 edges, 12 face diagonals, 4 body diagonals.
struct CornerPair {
  std::uint8_t a;
  std::uint8_t b;
  std::uint8_t axes;  ///< along how many axes the corners differ: 1 edge, 2 face diagonal, 3 body diagonal
};

constexpr std::array<CornerPair, 28> makeCornerPairs() {
  std::array<CornerPair, 28> pairs{};
  int n = 0;
  for (int a = 0; a < 8; ++a) {
    for (int b = a + 1; b < 8; ++b) {
      int axes = 0;
      for (int d = 0; d < 3; ++d)
        axes += kHexahedronCorners[a][d] != kHexahedronCorners[b][d] ? 1 : 0;
      pairs[n++] = {static_cast<std::uint8_t>(a), static_cast<std::uint8_t>(b), static_cast<std::uint8_t>(axes)};
    }
  }
  return pairs;
}

constexpr std::array<CornerPair, 28> kCornerPairs = makeCornerPairs();

}  // namespace soft_volume::core
