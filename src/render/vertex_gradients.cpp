#include "vertex_gradients.h"

#include <algorithm>

#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

/// Determinant over the product of the edge lengths below which a cell has no usable directions.
constexpr float kMinFlatness = 0.02F;

/// Weights of a cell's vertices in three sums, each a mean edge along one direction of the cell. Every row adds up to
/// zero, so for a quantity that is linear in space the sums of the quantity follow from those of the positions.
using EdgeWeights = std::array<std::array<std::int8_t, 8>, 3>;

constexpr EdgeWeights kTetrahedronWeights = {{{-1, 1, 0, 0}, {-1, 0, 1, 0}, {-1, 0, 0, 1}}};
constexpr EdgeWeights kVoxelWeights = {
    {{-1, 1, -1, 1, -1, 1, -1, 1}, {-1, -1, 1, 1, -1, -1, 1, 1}, {-1, -1, -1, -1, 1, 1, 1, 1}}};
constexpr EdgeWeights kHexahedronWeights = {
    {{-1, 1, 1, -1, -1, 1, 1, -1}, {-1, -1, 1, 1, -1, -1, 1, 1}, {-1, -1, -1, -1, 1, 1, 1, 1}}};
constexpr EdgeWeights kWedgeWeights = {{{-1, 1, 0, -1, 1, 0}, {-1, 0, 1, -1, 0, 1}, {-1, -1, -1, 1, 1, 1}}};
constexpr EdgeWeights kPyramidWeights = {{{-1, 1, 1, -1, 0}, {-1, -1, 1, 1, 0}, {-1, -1, -1, -1, 4}}};

const EdgeWeights& weightsOf(CellType type) {
  switch (type) {
    case CellType::kTetrahedron:
      return kTetrahedronWeights;
    case CellType::kVoxel:
      return kVoxelWeights;
    case CellType::kWedge:
      return kWedgeWeights;
    case CellType::kPyramid:
      return kPyramidWeights;
    default:
      return kHexahedronWeights;
  }
}

/// Column j is the sum over the vertices of `weight(i, j)` times what `quantity` has there.
template <typename Sums, typename Weight, typename Quantity>
Sums weightedSums(const std::uint32_t* vertices, std::size_t count, const Weight& weight, const Quantity& quantity) {
  Sums sums = Sums::Zero();
  for (std::size_t i = 0; i < count; ++i) {
    const auto value = quantity(vertices[i]);
    for (int j = 0; j < 3; ++j)
      sums.col(j) += weight(i, j) * value;
  }
  return sums;
}

Vector3f meanOf(const std::uint32_t* vertices, std::size_t count, const std::vector<Vector3f>& points) {
  Vector3f sum = Vector3f::Zero();
  for (std::size_t i = 0; i < count; ++i)
    sum += points[vertices[i]];
  return sum / float(count);
}

/// The linear map from positions to the quantity, given the same sums of both. False for flat and, if asked for,
/// inside-out cells.
template <typename Map>
bool solveMap(const Eigen::Matrix3f& edges, const Map& sums, bool outward_only, Map& map) {
  Eigen::Matrix3f adjugate;
  adjugate.row(0) = edges.col(1).cross(edges.col(2));
  adjugate.row(1) = edges.col(2).cross(edges.col(0));
  adjugate.row(2) = edges.col(0).cross(edges.col(1));
  const float determinant = adjugate.row(0).dot(edges.col(0));
  const float flat = kMinFlatness * edges.col(0).norm() * edges.col(1).norm() * edges.col(2).norm();
  if (!(std::abs(determinant) > flat))
    return false;
  map = sums * adjugate / determinant;
  if constexpr (Map::RowsAtCompileTime == 3) {
    if (outward_only && !(map.determinant() > 0.0F))
      return false;
  }
  return map.allFinite();
}

}  // namespace

void VertexGradients::setGrid(const DrawnGrid& grid) {
  grid_ = &grid;
  polyhedron_begin_.assign(1, 0);
  polyhedron_vertices_.clear();
  for (std::size_t cell = 0; cell < grid.cellCount(); ++cell) {
    if (grid.cell_types[cell] == CellType::kPolyhedron) {
      const auto vertices = verticesOfPolyhedron(&grid.connectivity[grid.cell_offsets[cell]]);
      polyhedron_vertices_.insert(polyhedron_vertices_.end(), vertices.begin(), vertices.end());
    }
    polyhedron_begin_.push_back(std::uint32_t(polyhedron_vertices_.size()));
  }
  // A counting sort of the pairs (vertex, cell).
  cells_begin_.assign(grid.vertexCount() + 1, 0);
  const auto forEachPair = [&](const auto& visit) {
    for (std::size_t cell = 0; cell < grid.cellCount(); ++cell) {
      const bool polyhedron = grid.cell_types[cell] == CellType::kPolyhedron;
      const auto& offsets = polyhedron ? polyhedron_begin_ : grid.cell_offsets;
      const auto& vertices = polyhedron ? polyhedron_vertices_ : grid.connectivity;
      for (std::uint32_t i = offsets[cell]; i < offsets[cell + 1]; ++i)
        visit(vertices[i], std::uint32_t(cell));
    }
  };
  forEachPair([&](std::uint32_t vertex, std::uint32_t) { ++cells_begin_[vertex + 1]; });
  for (std::size_t i = 1; i < cells_begin_.size(); ++i)
    cells_begin_[i] += cells_begin_[i - 1];
  cells_at_vertex_.resize(cells_begin_.back());
  std::vector<std::uint32_t> next(cells_begin_.begin(), cells_begin_.end() - 1);
  forEachPair([&](std::uint32_t vertex, std::uint32_t cell) { cells_at_vertex_[next[vertex]++] = cell; });
}

template <typename Map, typename Quantity>
bool VertexGradients::cellMap(std::size_t cell, const std::vector<Vector3f>& positions, const Quantity& quantity,
                              bool outward_only, Map& map) const {
  const auto position = [&](std::uint32_t vertex) -> const Vector3f& { return positions[vertex]; };
  const CellType type = grid_->cell_types[cell];
  if (type == CellType::kPolyhedron) {
    const std::uint32_t* vertices = polyhedron_vertices_.data() + polyhedron_begin_[cell];
    const std::size_t count = polyhedron_begin_[cell + 1] - polyhedron_begin_[cell];
    const Vector3f centre = meanOf(vertices, count, positions);
    // Offsets from the centre as weights make it a least-squares fit.
    const auto weight = [&](std::size_t i, int j) { return positions[vertices[i]][j] - centre[j]; };
    const auto offset = [&](std::uint32_t vertex) -> Vector3f { return positions[vertex] - centre; };
    return solveMap(weightedSums<Eigen::Matrix3f>(vertices, count, weight, offset),
                    weightedSums<Map>(vertices, count, weight, quantity), outward_only, map);
  }
  const EdgeWeights& weights = weightsOf(type);
  const auto weight = [&](std::size_t i, int j) { return float(weights[std::size_t(j)][i]); };
  const std::uint32_t* vertices = &grid_->connectivity[grid_->cell_offsets[cell]];
  const std::size_t count = grid_->cell_offsets[cell + 1] - grid_->cell_offsets[cell];
  return solveMap(weightedSums<Eigen::Matrix3f>(vertices, count, weight, position),
                  weightedSums<Map>(vertices, count, weight, quantity), outward_only, map);
}

template <typename Map, typename Quantity>
std::vector<Map> VertexGradients::average(const std::vector<Vector3f>& positions, const Quantity& quantity,
                                          bool outward_only, int threads) const {
  std::vector<Map> cell_maps(grid_->cellCount());
  std::vector<std::uint8_t> usable(grid_->cellCount());
  parallelFor(std::ptrdiff_t(grid_->cellCount()), threads, [&](std::ptrdiff_t i) {
    const auto cell = std::size_t(i);
    usable[cell] = cellMap(cell, positions, quantity, outward_only, cell_maps[cell]);
  });
  std::vector<Map> maps(grid_->vertexCount());
  parallelFor(std::ptrdiff_t(grid_->vertexCount()), threads, [&](std::ptrdiff_t i) {
    const auto vertex = std::size_t(i);
    Map sum = Map::Zero();
    int count = 0;
    for (std::uint32_t k = cells_begin_[vertex]; k < cells_begin_[vertex + 1]; ++k) {
      if (usable[cells_at_vertex_[k]] == 0)
        continue;
      sum += cell_maps[cells_at_vertex_[k]];
      ++count;
    }
    maps[vertex] = sum / float(std::max(1, count));
  });
  return maps;
}

std::vector<Eigen::Matrix3f> VertexGradients::ofTexture(const std::vector<Vector3f>& positions, int threads) const {
  const auto texture = [&](std::uint32_t vertex) -> const Vector3f& { return grid_->texture[vertex]; };
  return average<Eigen::Matrix3f>(positions, texture, true, threads);
}

Matrix3 VertexGradients::meanOfTexture(int threads) const {
  Matrix3 sum = Matrix3::Zero();
  for (const Eigen::Matrix3f& map : ofTexture(grid_->rest_positions, threads))
    sum += map.cast<double>();
  return sum / std::max(1.0, double(grid_->vertexCount()));
}

std::vector<Vector3f> VertexGradients::ofScalar(const std::vector<Vector3f>& positions, int threads) const {
  using Row = Eigen::Matrix<float, 1, 3>;
  const auto scalar = [&](std::uint32_t vertex) { return Row::Scalar(grid_->point_scalars[vertex]); };
  const auto value = [&](std::uint32_t vertex) { return Eigen::Matrix<float, 1, 1>(scalar(vertex)); };
  const std::vector<Row> rows = average<Row>(positions, value, false, threads);
  std::vector<Vector3f> gradients(rows.size());
  std::transform(rows.begin(), rows.end(), gradients.begin(), [](const Row& row) { return row.transpose(); });
  return gradients;
}

}  // namespace soft_volume::core
