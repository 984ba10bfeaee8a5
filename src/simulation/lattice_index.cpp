#include "lattice_index.h"

#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {

void LatticeIndex::refresh() {
  const Vector3i& dims = lattice_->dims;
  const std::size_t nodes = lattice_->latticeNode(dims.x(), dims.y(), dims.z()) + 1;
  node_begin_.assign(nodes + 1, 0);
  for (const std::uint32_t node : lattice_->lattice_nodes)
    ++node_begin_[node + 1];
  for (std::size_t n = 0; n < nodes; ++n)
    node_begin_[n + 1] += node_begin_[n];
  node_vertices_.resize(lattice_->vertexCount());
  std::vector<std::uint32_t> next(node_begin_.begin(), node_begin_.end() - 1);
  for (std::uint32_t v = 0; v < lattice_->vertexCount(); ++v)
    node_vertices_[next[lattice_->lattice_nodes[v]]++] = v;
}

int LatticeIndex::cellsOf(std::uint32_t vertex, std::array<CellCorner, 8>& cells) const {
  const Vector3i& dims = lattice_->dims;
  const int node = static_cast<int>(lattice_->lattice_nodes[vertex]);
  const Vector3i place(node % (dims.x() + 1), (node / (dims.x() + 1)) % (dims.y() + 1),
                       node / ((dims.x() + 1) * (dims.y() + 1)));
  int count = 0;
  for (std::uint8_t c = 0; c < 8; ++c) {
    const Vector3i at = place - Vector3i(kHexahedronCorners[c][0], kHexahedronCorners[c][1], kHexahedronCorners[c][2]);
    if ((at.array() < 0).any() || (at.array() >= dims.array()).any())
      continue;
    const std::int32_t cell = lattice_->cell_at[lattice_->latticeCell(at.x(), at.y(), at.z())];
    if (cell != Lattice::kNone && lattice_->cells[static_cast<std::size_t>(cell)][c] == vertex)
      cells[static_cast<std::size_t>(count++)] = {static_cast<std::uint32_t>(cell), c};
  }
  return count;
}

}  // namespace soft_volume::core
