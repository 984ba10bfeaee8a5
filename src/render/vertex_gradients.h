#pragma once

#include <cstdint>
#include <vector>

#include "drawn_grid.h"

namespace soft_volume::core {

/// How quantities that are given at a grid's vertices (texture coordinates, a scalar) change per metre in the deformed
/// grid: through the inverse of each cell's deformation, averaged over the cells of a vertex. Exact where the quantity
/// is linear in space.
///
/// Cells flatter than a fiftieth of the box of their edges are left out, as are cells where the quantity is not finite
/// and, for texture coordinates, cells that are inside out. Vertices without any other cell get zero.
class VertexGradients {
 public:
  /// The grid stays alive until the next call.
  void setGrid(const DrawnGrid& grid);

  /// Per vertex, how the texture coordinates change along x, y and z (columns) of the positions' frame.
  std::vector<Eigen::Matrix3f> ofTexture(const std::vector<Vector3f>& positions, int threads) const;
  /// Mean over the vertices of the grid at rest.
  Matrix3 meanOfTexture(int threads) const;
  /// Per vertex, the gradient of the grid's scalar at points.
  std::vector<Vector3f> ofScalar(const std::vector<Vector3f>& positions, int threads) const;

 private:
  template <typename Map, typename Quantity>
  std::vector<Map> average(const std::vector<Vector3f>& positions, const Quantity& quantity, bool outward_only,
                           int threads) const;
  template <typename Map, typename Quantity>
  bool cellMap(std::size_t cell, const std::vector<Vector3f>& positions, const Quantity& quantity, bool outward_only,
               Map& map) const;

  const DrawnGrid* grid_ = nullptr;
  std::vector<std::uint32_t> polyhedron_begin_;     ///< per cell, into polyhedron_vertices_, and the end
  std::vector<std::uint32_t> polyhedron_vertices_;  ///< each once; nothing for the other types
  std::vector<std::uint32_t> cells_begin_;          ///< per vertex, into cells_at_vertex_, and the end
  std::vector<std::uint32_t> cells_at_vertex_;
};

}  // namespace soft_volume::core
