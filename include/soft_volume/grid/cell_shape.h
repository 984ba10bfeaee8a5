#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "soft_volume/grid/topology.h"

namespace soft_volume::core {

/// Vertices, edges and faces of a cell type, by the cell's own vertex numbers. Edges and faces are in VTK's order, save
/// for the last two edges of a hexahedron. Faces run counter-clockwise seen from outside a cell that has the
/// orientation of VTK's documentation; files also hold cells of the other one, which then run clockwise everywhere.
struct CellShape {
  std::size_t vertex_count = 0;
  std::size_t edge_count = 0;
  std::size_t face_count = 0;
  std::array<std::array<std::uint8_t, 2>, 12> edges{};
  std::array<std::uint8_t, 6> face_sizes{};  ///< 3 or 4
  std::array<std::array<std::uint8_t, 4>, 6> faces{};
};

/// Of any type but the polyhedron; an empty cell has none of all, whose shape is in its face stream. Throws InputError
/// on that and on unknown numbers.
const CellShape& shapeOf(CellType type);

/// Calls `visit(face number, vertices, size)` for the faces of a cell in their order; `vertices` points to the grid's
/// vertex numbers, outward counter-clockwise as in CellShape, and is valid during the call. `cell` is the begin of the
/// cell's numbers in a valid connectivity.
template <typename Visit>
void forEachFace(CellType type, const std::uint32_t* cell, const Visit& visit) {
  if (type == CellType::kPolyhedron) {
    const std::uint32_t* face = cell + 1;
    for (std::size_t i = 0; i < cell[0]; ++i, face += 1 + face[0])
      visit(i, face + 1, std::size_t(face[0]));
    return;
  }
  const CellShape& shape = shapeOf(type);
  for (std::size_t i = 0; i < shape.face_count; ++i) {
    std::array<std::uint32_t, 4> vertices{};
    for (std::size_t k = 0; k < shape.face_sizes[i]; ++k)
      vertices[k] = cell[shape.faces[i][k]];
    visit(i, vertices.data(), std::size_t(shape.face_sizes[i]));
  }
}

/// How many faces a cell has.
std::size_t faceCount(CellType type, const std::uint32_t* cell);

/// The vertices of a cell's faces, each once, in increasing order: what a polyhedron's face stream does not say.
std::vector<std::uint32_t> verticesOfPolyhedron(const std::uint32_t* face_stream);

struct GridFace {
  std::uint32_t cell;
  std::uint32_t face;  ///< its number in the cell
};

/// The faces without a neighbour, by cell and face: the grid's boundary. Two faces are neighbours when they have the
/// same set of vertices, in whatever order; a quadrilateral with two equal corners thus fits a triangle. Faces with
/// fewer than three different vertices have no area and are left out. The grid is a valid one as in Topology.
/// Takes time in proportion to the grid.
std::vector<GridFace> boundaryFaces(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                                    const std::vector<std::uint32_t>& connectivity);

}  // namespace soft_volume::core
