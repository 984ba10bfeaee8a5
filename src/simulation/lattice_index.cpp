#include "lattice_index.h"

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

}  // namespace soft_volume::core
