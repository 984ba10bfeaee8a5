#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "soft_volume/grid/topology.h"
#include "soft_volume/replay/compared_quantity.h"

namespace soft_volume {

/// Points that moved less are at rest, for the RMS: part of a cell's edge.
constexpr double kMovedPart = 0.01;

/// Which material points two grids of the same tissue share, and how far their places are apart.
///
/// Grids of one lattice share the vertices that both have at the same place at rest and in the same cells: not those of
/// cells that only one of the grids has cut, or cut otherwise. Of grids with other spacings the vertices of the coarser
/// one are looked up in the cell of the finer one that they lie in, by its trilinear interpolation: not those in cells
/// that either of them has cut, nor outside of the other grid.
class GridPair {
 public:
  using Positions = std::vector<core::Vector3f>;
  using Grid = std::shared_ptr<const core::Topology>;

  /// `first_uncut` and `second_uncut`: the grids before any cut.
  GridPair(Grid first, Grid second, const Grid& first_uncut, const Grid& second_uncut);

  /// Adds one state to `quantity`; its positions belong to the grids. RMS counts the points that are farther than
  /// `moved_m` from rest in either grid.
  void compare(double time_s, const Positions& first, const Positions& second, double moved_m,
               ComparedQuantity& quantity) const;

  bool sameLattice() const { return same_lattice_; }
  std::uint64_t leftOut() const { return left_out_; }
  /// Whether this pair is of these grids.
  bool isOf(const Grid& first, const Grid& second) const { return first == first_ && second == second_; }

 private:
  /// A point as a mean of up to 8 vertices.
  struct Place {
    std::array<std::uint32_t, 8> vertices{};
    std::array<double, 8> weights{};
    std::uint32_t count = 0;
  };
  struct SharedPoint {
    std::uint32_t vertex = 0;  ///< of the grid whose vertices are looked at
    Place other;               ///< in the other one
  };

  void pairVertices();
  void lookUpVertices(const core::Topology& coarse, const core::Topology& coarse_uncut, const core::Topology& fine,
                      const core::Topology& fine_uncut);

  Grid first_;
  Grid second_;
  bool same_lattice_ = false;
  bool looks_in_second_ = true;  ///< the points are vertices of the first grid
  std::vector<SharedPoint> points_;
  std::uint64_t left_out_ = 0;
};

/// Edges of the cells of an uncut lattice, metres; zero without cells.
core::Vector3 cellEdges(const core::Topology& uncut);
/// Area at rest of the faces that incisions opened, one of the two sides, square metres.
double cutArea(const core::Topology& topology);
/// Groups of cells that hang together by faces.
std::uint64_t partCount(const core::Topology& topology);
/// Largest distance of a vertex from rest, metres.
double largestDisplacement(const core::Topology& topology, const std::vector<core::Vector3f>& positions);

}  // namespace soft_volume
