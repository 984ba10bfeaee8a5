#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// The hexahedral simulation grid (dissertation section 4.2): equal box-shaped cells on a regular lattice, present only
/// where there is tissue, incisions included. Cells are numbered in lattice order and never renumbered; incisions
/// replicate vertices, and cells that they part (embedding.h): these follow at the end, share the place of the cell
/// that they are a copy of and divide its stiffness and mass with it.
struct Lattice {
  static constexpr std::int32_t kNone = -1;
  static constexpr std::uint8_t kRemoved = 2;

  Vector3i dims = Vector3i::Zero();     ///< cells along each axis of the surrounding lattice
  Vector3 spacing_m = Vector3::Ones();  ///< edge lengths of a cell
  Vector3 origin_m = Vector3::Zero();   ///< lowest corner of lattice cell (0, 0, 0), volume frame
  std::uint32_t revision = 1;           ///< grows by one with every incision

  // Per cell.
  std::vector<std::array<std::uint32_t, 8>> cells;           ///< vertices in VTK's hexahedron order
  std::vector<std::uint32_t> parent_cells;                   ///< lattice cell, i + nx*(j + ny*k)
  std::vector<std::uint16_t> materials;                      ///< index into the scene's materials
  std::vector<Vector3> rest_stretch;                         ///< factor of the rest lengths along the cell's axes
  std::vector<std::array<std::int32_t, 6>> face_neighbours;  ///< cell behind each face, kNone at surfaces and cuts
  std::vector<std::array<std::uint8_t, 6>> cut_faces;        ///< 1 where an incision opened the face
  std::vector<double> shares;  ///< of an uncut cell's stiffness and mass; those of a place sum to 1
  /// Part of each face's area that an incision left to the cell, where the face is surface of the lattice.
  std::vector<std::array<double, 6>> surface_shares;
  std::vector<std::int32_t> next_cells;  ///< the next cell at the same place, kNone behind the last

  // Per vertex.
  std::vector<Vector3> rest_positions;         ///< volume frame, metres
  std::vector<std::uint8_t> fixed;             ///< 1: never moves; kRemoved: nor does it, its tissue was taken away
  std::vector<std::uint32_t> origin_vertices;  ///< vertex that it was replicated from; itself where it was not
  std::vector<std::uint32_t> lattice_nodes;    ///< lattice node, i + (nx+1)*(j + (ny+1)*k); replicas share it

  // Per lattice place.
  std::vector<std::int32_t> cell_at;  ///< per lattice cell: the first cell there or kNone

  std::size_t cellCount() const { return cells.size(); }
  /// The cell at the same place that the lattice was built with.
  std::uint32_t firstCell(std::uint32_t cell) const { return static_cast<std::uint32_t>(cell_at[parent_cells[cell]]); }
  std::size_t vertexCount() const { return rest_positions.size(); }
  std::size_t latticeCell(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(dims.x()) * (std::size_t(j) + std::size_t(dims.y()) * std::size_t(k));
  }
  std::size_t latticeNode(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(dims.x() + 1) * (std::size_t(j) + std::size_t(dims.y() + 1) * std::size_t(k));
  }
  Vector3i cellIndex(std::uint32_t parent_cell) const {
    const int nx = dims.x();
    const int ny = dims.y();
    const int p = static_cast<int>(parent_cell);
    return {p % nx, (p / nx) % ny, p / (nx * ny)};
  }
};

/// Half-open box of lattice cell indices.
struct LatticeBox {
  Vector3i begin;
  Vector3i end;
};

/// The lattice cells that a box of the volume frame touches, cut to the lattice; empty boxes have begin == end.
LatticeBox latticeBox(const Lattice& lattice, const Box3& box_m);

/// Calls `visit(cell)` for every present cell of a box, in lattice order; for those at one place by number.
template <typename Visit>
void forEachCell(const Lattice& lattice, const LatticeBox& box, const Visit& visit) {
  for (int k = box.begin.z(); k < box.end.z(); ++k) {
    for (int j = box.begin.y(); j < box.end.y(); ++j) {
      for (int i = box.begin.x(); i < box.end.x(); ++i) {
        for (std::int32_t cell = lattice.cell_at[lattice.latticeCell(i, j, k)]; cell != Lattice::kNone;
             cell = lattice.next_cells[static_cast<std::size_t>(cell)])
          visit(static_cast<std::uint32_t>(cell));
      }
    }
  }
}

/// Appends a copy of a cell at the same place, with its vertices and no share; returns its number.
std::uint32_t copyCell(Lattice& lattice, std::uint32_t cell);

/// Appends a replica of a vertex and returns its number.
std::uint32_t replicateVertex(Lattice& lattice, std::uint32_t vertex);

/// Connects the present cells of a regular lattice. `cell_materials` has one entry per lattice cell: a material index
/// or Lattice::kNone where there is no cell. Vertices exist only at corners of present cells, in lattice order; none is
/// fixed yet. Throws InputError when dims are below 1, spacing is not positive or sizes do not match.
Lattice makeLattice(const Vector3i& dims, const Vector3& spacing_m, const Vector3& origin_m,
                    const std::vector<std::int32_t>& cell_materials);

/// What receivers see of a lattice that lies in a volume.
Topology makeTopology(const Lattice& lattice, const VolumeGeometry& volume, std::uint64_t session);

}  // namespace soft_volume::core
