#pragma once

#include <cstdint>
#include <vector>

#include "kernel.h"
#include "lattice_index.h"
#include "spring_model.h"

namespace soft_volume::core {

/// The part of a lattice that is in the solve, packed for the kernels: everything is numbered by its place in here
/// ("local"), in the order of the lattice, so cost and memory follow what is active and not the lattice.
///
/// Beside the vertices that move it holds their frontier, whose rows tell with which force the rest of the lattice is
/// held back, and the neighbours of both, which only have a place.
template <typename Real>
class SolveSet {
 public:
  static constexpr std::uint32_t kAbsent = 0xffffffffU;

  SolveSet(const Lattice& lattice, const LatticeIndex& index) : lattice_(&lattice), index_(&index) {}

  /// Packs the movable vertices of `active_cells` (increasing). Displacements and velocities are zero afterwards.
  void build(const SpringModel& model, const std::vector<std::uint32_t>& active_cells, bool with_frontier);

  const KernelView<Real>& view() const { return view_; }
  KernelView<Real>& view() { return view_; }

  const std::vector<std::uint32_t>& moving() const { return moving_; }      ///< local vertices that move
  const std::vector<std::uint32_t>& frontier() const { return frontier_; }  ///< held back, with rows
  const std::vector<std::uint32_t>& movingBlocks() const { return moving_blocks_; }
  const std::vector<std::uint32_t>& frontierBlocks() const { return frontier_blocks_; }
  std::uint32_t globalVertex(std::uint32_t local) const { return vertices_[local]; }
  std::uint32_t localVertex(std::uint32_t global) const { return local_vertex_[global]; }
  std::size_t vertexCount() const { return vertices_.size(); }
  std::size_t paddedVertices() const { return displacement_[0].size(); }

  /// Cells with a moving vertex come first; only these can change their shape.
  std::size_t guardedCells() const { return guarded_cells_; }
  std::size_t guardedBlocks() const { return (guarded_cells_ + kLanes<Real> - 1) / kLanes<Real>; }
  std::size_t cellBlocks() const { return width_bound_.size() / kLanes<Real>; }
  std::uint32_t globalCell(std::uint32_t local) const { return cells_[local]; }
  std::uint32_t cornerVertex(std::uint32_t cell, int corner) const {
    return corners_[static_cast<std::size_t>(corner) * view_.cell_stride + cell];
  }
  /// Calls visit(local cell) for the guarded cells around a local vertex.
  template <typename Visit>
  void forEachCell(std::uint32_t local, const Visit& visit) const {
    index_->forEachCell(vertices_[local], [&](const CellCorner& at) {
      const std::uint32_t cell = local_cell_[at.cell];
      if (cell < guarded_cells_)
        visit(cell);
    });
  }
  /// A third of the summed stiffness of a local vertex with a row.
  double stiffness(std::uint32_t local) const { return vertex_stiffness_[local]; }
  bool moves(std::uint32_t local) const { return inverse_mass_[local] > Real(0); }

  std::size_t vertexBytes() const;
  std::size_t springBytes() const;
  std::size_t cellBytes() const;
  std::size_t volumeEnergyBytes() const;
  std::size_t stretchBytes() const { return stretched_.capacity() * sizeof(Real); }

 private:
  void numberVertices(const SpringModel& model, const std::vector<std::uint32_t>& active_cells, bool with_frontier);
  void numberCells(bool with_volume_energy);
  void resizeVertexArrays();
  void packRows(const SpringModel& model);
  void packBlock(const SpringModel& model, std::uint32_t block, const std::vector<VertexRow>& rows);
  void addEntry(const SpringModel& model, std::uint32_t block, std::uint8_t direction,
                const std::vector<const MergedSpring*>& springs);
  void addStiffness(const std::vector<const MergedSpring*>& springs, SpringEntry& entry);
  void packCells(const SpringModel& model);
  void packCellsOfVertices();
  void packMoreCells(std::uint32_t empty);
  void makeView(const SpringModel& model);

  const Lattice* lattice_;
  const LatticeIndex* index_;
  KernelView<Real> view_ = {};

  std::vector<std::uint32_t> local_vertex_;  ///< by lattice vertex, kAbsent outside
  std::vector<std::uint32_t> local_cell_;    ///< by lattice cell
  std::vector<std::uint32_t> vertices_;      ///< lattice vertex by local vertex, increasing
  std::vector<std::uint32_t> cells_;         ///< lattice cell by local cell
  std::size_t guarded_cells_ = 0;
  std::vector<std::uint32_t> moving_, frontier_, moving_blocks_, frontier_blocks_;

  std::vector<Real> displacement_[3], velocity_[3], force_[3], move_[3], external_[3];
  std::vector<Real> nearest_squared_, move_squared_, mass_, inverse_mass_, damping_rate_, vertex_stiffness_;

  std::vector<std::uint32_t> entry_begin_;
  std::vector<SpringEntry> entries_;
  std::vector<Real> stiffness_;
  std::vector<std::uint32_t> indices_;
  std::vector<Real> stretched_;

  std::vector<std::uint32_t> corners_;
  std::vector<std::uint8_t> cells_contiguous_;
  std::vector<Real> width_bound_;
  std::vector<Real> volume_modulus_, volume_stretch_, corner_force_;
  std::vector<std::uint32_t> cell_of_;
  std::vector<std::array<std::uint32_t, 2>> more_;  ///< vertex and place, where cell_of_ is taken
  std::vector<std::uint32_t> more_begin_, more_cells_;
};

}  // namespace soft_volume::core
