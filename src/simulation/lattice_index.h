#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/grid/lattice.h"

namespace soft_volume::core {

/// A cell and which of its corners a vertex is.
struct CellCorner {
  std::uint32_t cell;
  std::uint8_t corner;
};

/// Finds vertices by lattice node and cells by vertex. Refers to the lattice; refresh() after an incision.
class LatticeIndex {
 public:
  explicit LatticeIndex(const Lattice& lattice) : lattice_(&lattice) { refresh(); }
  void refresh();

  /// Calls visit(vertex) for the vertices at a lattice node, replicas included.
  template <typename Visit>
  void forEachVertex(std::size_t node, const Visit& visit) const {
    for (std::uint32_t n = node_begin_[node]; n < node_begin_[node + 1]; ++n)
      visit(node_vertices_[n]);
  }

  /// Calls visit(CellCorner) for the cells around a vertex, by corner number. At the end of an incision several copies
  /// of one cell may meet in a vertex, as the same corner.
  template <typename Visit>
  void forEachCell(std::uint32_t vertex, const Visit& visit) const {
    const Vector3i& dims = lattice_->dims;
    const int node = static_cast<int>(lattice_->lattice_nodes[vertex]);
    const Vector3i place(node % (dims.x() + 1), (node / (dims.x() + 1)) % (dims.y() + 1),
                         node / ((dims.x() + 1) * (dims.y() + 1)));
    for (std::uint8_t c = 0; c < 8; ++c) {
      const Vector3i at =
          place - Vector3i(kHexahedronCorners[c][0], kHexahedronCorners[c][1], kHexahedronCorners[c][2]);
      if ((at.array() < 0).any() || (at.array() >= dims.array()).any())
        continue;
      for (std::int32_t cell = lattice_->cell_at[lattice_->latticeCell(at.x(), at.y(), at.z())]; cell != Lattice::kNone;
           cell = lattice_->next_cells[static_cast<std::size_t>(cell)]) {
        if (lattice_->cells[static_cast<std::size_t>(cell)][c] == vertex)
          visit(CellCorner{static_cast<std::uint32_t>(cell), c});
      }
    }
  }

  std::size_t bytes() const { return (node_begin_.capacity() + node_vertices_.capacity()) * sizeof(std::uint32_t); }

 private:
  const Lattice* lattice_;
  std::vector<std::uint32_t> node_begin_;
  std::vector<std::uint32_t> node_vertices_;
};

}  // namespace soft_volume::core
