#pragma once

#include <array>
#include <cstdint>
#include <vector>

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

  /// The cells around a vertex, at most eight, by corner number; returns how many.
  int cellsOf(std::uint32_t vertex, std::array<CellCorner, 8>& cells) const;

  std::size_t bytes() const { return (node_begin_.capacity() + node_vertices_.capacity()) * sizeof(std::uint32_t); }

 private:
  const Lattice* lattice_;
  std::vector<std::uint32_t> node_begin_;
  std::vector<std::uint32_t> node_vertices_;
};

}  // namespace soft_volume::core
