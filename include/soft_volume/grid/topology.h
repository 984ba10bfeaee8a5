#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// VTK's cell types, as far as they are drawn. The numbers are VTK's.
enum class CellType : std::uint8_t {
  kEmpty = 0,  ///< nothing: a cell that was taken away, so that the others keep their numbers
  kTetrahedron = 10,
  kVoxel = 11,
  kHexahedron = 12,
  kWedge = 13,
  kPyramid = 14,
  kPolyhedron = 42,
};

/// What a receiver of a grid knows: the cells, how they hang together and where they belong in the volume. Positions
/// change with every state, this only with a revision. The renderer and the tool work on it; it mirrors the message
/// GridTopology, whose comments define each field.
struct Topology {
  std::uint64_t session = 0;
  std::uint32_t revision = 0;

  std::vector<Vector3f> rest_positions;        ///< per vertex, volume frame, metres
  std::vector<Vector3f> texture_coordinates;   ///< per vertex, [0, 1]^3 of the volume
  std::vector<std::uint8_t> fixed;             ///< per vertex, 1 where it never moves
  std::vector<std::uint32_t> origin_vertices;  ///< per vertex, the one that it was parted from, or itself; or empty

  std::vector<CellType> cell_types;         ///< per cell
  std::vector<std::uint32_t> cell_offsets;  ///< cells + 1 entries into `connectivity`
  /// Vertex numbers in VTK's order for the cell's type; for a polyhedron VTK's face stream: the number of faces, then
  /// for each face the number of its vertices and these, in outward counter-clockwise order.
  std::vector<std::uint32_t> connectivity;
  std::vector<std::uint32_t> parent_cells;    ///< per cell, the lattice cell that it is a part of; or empty
  std::vector<std::uint16_t> materials;       ///< per cell, index into the scene's materials
  std::vector<std::int32_t> face_neighbours;  ///< per cell and face in VTK's order: neighbour cell or -1
  std::vector<std::uint8_t> cut_faces;        ///< per cell and face, 1 where an incision opened it

  std::size_t vertexCount() const { return rest_positions.size(); }
  std::size_t cellCount() const { return cell_types.size(); }

  /// Throws InputError when sizes do not fit together, an index is out of range, or a rest position is not finite.
  void validate() const;
};

}  // namespace soft_volume::core
