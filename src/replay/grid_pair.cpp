#include "grid_pair.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <map>
#include <numeric>
#include <utility>

#include "soft_volume/grid/cell_shape.h"

namespace soft_volume {
namespace {

using core::CellType;
using core::Topology;
using core::Vector3;
using core::Vector3f;

bool sameBits(const Vector3f& a, const Vector3f& b) {
  return std::memcmp(a.data(), b.data(), 3 * sizeof(float)) == 0;
}

const std::uint32_t* cellBegin(const Topology& grid, std::size_t cell) {
  return grid.connectivity.data() + grid.cell_offsets[cell];
}

std::size_t cellSize(const Topology& grid, std::size_t cell) {
  return grid.cell_offsets[cell + 1] - grid.cell_offsets[cell];
}

bool sameCell(const Topology& a, const Topology& b, std::size_t cell) {
  return a.cell_types[cell] == b.cell_types[cell] && cellSize(a, cell) == cellSize(b, cell) &&
         std::equal(cellBegin(a, cell), cellBegin(a, cell) + cellSize(a, cell), cellBegin(b, cell));
}

bool sameGrid(const Topology& a, const Topology& b) {
  return a.vertexCount() == b.vertexCount() && a.cell_types == b.cell_types && a.connectivity == b.connectivity &&
         std::equal(a.rest_positions.begin(), a.rest_positions.end(), b.rest_positions.begin(), sameBits);
}

std::vector<std::uint32_t> verticesOf(const Topology& grid, std::size_t cell) {
  const std::uint32_t* begin = cellBegin(grid, cell);
  return grid.cell_types[cell] == CellType::kPolyhedron
             ? core::verticesOfPolyhedron(begin)
             : std::vector<std::uint32_t>(begin, begin + cellSize(grid, cell));
}

/// 1 for the vertices of `grid` that belong to a cell which `other` has not, or has otherwise.
std::vector<std::uint8_t> verticesOfChangedCells(const Topology& grid, const Topology& other) {
  std::vector<std::uint8_t> changed(grid.vertexCount(), 0);
  for (std::size_t cell = 0; cell < grid.cellCount(); ++cell) {
    if (cell < other.cellCount() && sameCell(grid, other, cell))
      continue;
    for (const std::uint32_t vertex : verticesOf(grid, cell))
      changed[vertex] = 1;
  }
  return changed;
}

/// The cells of an uncut lattice by their places.
class CellIndex {
 public:
  explicit CellIndex(const Topology& uncut) : edges_(cellEdges(uncut)) {
    if (uncut.cellCount() > 0)
      origin_ = lowestCorner(uncut, 0);
    for (std::size_t cell = 0; cell < uncut.cellCount(); ++cell) {
      if (uncut.cell_types[cell] == CellType::kEmpty)
        continue;
      const Vector3 place = (lowestCorner(uncut, cell) - origin_).cwiseQuotient(edges_);
      cells_[key(place.array().round())] = static_cast<std::uint32_t>(cell);
    }
  }

  /// The cells that hold a point; several when it lies on a face, edge or corner.
  std::vector<std::uint32_t> around(const Vector3& point_m) const {
    constexpr double kOnFace = 1e-4;  // of an edge; places at rest are floats
    const Vector3 place = (point_m - origin_).cwiseQuotient(edges_);
    std::vector<std::uint32_t> found;
    for (int corner = 0; corner < 8; ++corner) {
      const Vector3 side(corner & 1 ? kOnFace : -kOnFace, corner & 2 ? kOnFace : -kOnFace,
                         corner & 4 ? kOnFace : -kOnFace);
      const auto cell = cells_.find(key((place + side).array().floor()));
      if (cell != cells_.end() && std::find(found.begin(), found.end(), cell->second) == found.end())
        found.push_back(cell->second);
    }
    return found;
  }

  const Vector3& edges() const { return edges_; }

 private:
  static Vector3 lowestCorner(const Topology& grid, std::size_t cell) {
    Vector3 lowest = Vector3::Constant(INFINITY);
    for (const std::uint32_t vertex : verticesOf(grid, cell))
      lowest = lowest.cwiseMin(grid.rest_positions[vertex].cast<double>());
    return lowest;
  }
  using Key = std::array<std::int64_t, 3>;
  static Key key(const Eigen::Array3d& place) {
    return {static_cast<std::int64_t>(place.x()), static_cast<std::int64_t>(place.y()),
            static_cast<std::int64_t>(place.z())};
  }

  Vector3 edges_;
  Vector3 origin_ = Vector3::Zero();
  std::map<Key, std::uint32_t> cells_;
};

double cross(const Vector3& a, const Vector3& b, const Vector3& c) {
  return (b - a).cross(c - a).norm() / 2.0;
}

}  // namespace

GridPair::GridPair(Grid first, Grid second, const Grid& first_uncut, const Grid& second_uncut)
    : first_(std::move(first)), second_(std::move(second)), same_lattice_(sameGrid(*first_uncut, *second_uncut)) {
  if (same_lattice_) {
    pairVertices();
    return;
  }
  looks_in_second_ = cellEdges(*first_uncut).minCoeff() >= cellEdges(*second_uncut).minCoeff();
  if (looks_in_second_) {
    lookUpVertices(*first_, *first_uncut, *second_, *second_uncut);
  } else {
    lookUpVertices(*second_, *second_uncut, *first_, *first_uncut);
  }
}

void GridPair::pairVertices() {
  const std::vector<std::uint8_t> first = verticesOfChangedCells(*first_, *second_);
  const std::vector<std::uint8_t> second = verticesOfChangedCells(*second_, *first_);
  const std::size_t common = std::min(first.size(), second.size());
  for (std::size_t v = 0; v < common; ++v) {
    if (first[v] != 0 || second[v] != 0 || !sameBits(first_->rest_positions[v], second_->rest_positions[v]))
      continue;
    SharedPoint point;
    point.vertex = point.other.vertices[0] = static_cast<std::uint32_t>(v);
    point.other.weights[0] = 1.0;
    point.other.count = 1;
    points_.push_back(point);
  }
  left_out_ = std::max(first.size(), second.size()) - points_.size();
}

void GridPair::lookUpVertices(const Topology& coarse, const Topology& coarse_uncut, const Topology& fine,
                              const Topology& fine_uncut) {
  const CellIndex index(fine_uncut);
  const std::vector<std::uint8_t> cut = verticesOfChangedCells(coarse, coarse_uncut);
  for (std::size_t v = 0; v < coarse.vertexCount(); ++v) {
    const Vector3 rest = coarse.rest_positions[v].cast<double>();
    const std::vector<std::uint32_t> cells = index.around(rest);
    const bool usable = cut[v] == 0 && !cells.empty() && std::all_of(cells.begin(), cells.end(), [&](auto cell) {
                          return sameCell(fine, fine_uncut, cell);
                        });
    if (!usable) {
      ++left_out_;
      continue;
    }
    SharedPoint point;
    point.vertex = static_cast<std::uint32_t>(v);
    for (const std::uint32_t corner : verticesOf(fine, cells.front())) {
      const Vector3 apart = (fine.rest_positions[corner].cast<double>() - rest).cwiseAbs().cwiseQuotient(index.edges());
      point.other.vertices[point.other.count] = corner;
      point.other.weights[point.other.count++] = (Vector3::Ones() - apart.cwiseMin(1.0)).prod();
    }
    points_.push_back(point);
  }
}

void GridPair::compare(double time_s, const Positions& first, const Positions& second, double moved_m,
                       ComparedQuantity& quantity) const {
  ComparedSample sample;
  sample.time_s = time_s;
  sample.first = largestDisplacement(*first_, first);
  sample.second = largestDisplacement(*second_, second);
  const Positions& vertices = looks_in_second_ ? first : second;
  const Positions& others = looks_in_second_ ? second : first;
  const Topology& grid = looks_in_second_ ? *first_ : *second_;
  ComparedQuantity::Squares squares;
  for (const SharedPoint& point : points_) {
    // Equal vertices are not interpolated: rounding would make them differ.
    Vector3 place = others[point.other.vertices[0]].cast<double>();
    if (point.other.count > 1) {
      place.setZero();
      for (std::uint32_t n = 0; n < point.other.count; ++n)
        place += point.other.weights[n] * others[point.other.vertices[n]].cast<double>();
    }
    const Vector3 vertex = vertices[point.vertex].cast<double>();
    const Vector3 rest = grid.rest_positions[point.vertex].cast<double>();
    const double apart = (vertex - place).norm();
    sample.largest = std::max(sample.largest, apart);
    if (std::max((vertex - rest).norm(), (place - rest).norm()) > moved_m) {
      squares.sum += apart * apart;
      ++squares.count;
    }
  }
  sample.rms = squares.count > 0 ? std::sqrt(squares.sum / static_cast<double>(squares.count)) : 0.0;
  quantity.left_out += left_out_;
  quantity.add(sample, points_.size(), squares);
}

core::Vector3 cellEdges(const Topology& uncut) {
  for (std::size_t cell = 0; cell < uncut.cellCount(); ++cell) {
    if (uncut.cell_types[cell] == CellType::kEmpty)
      continue;
    Eigen::AlignedBox3d box;
    for (const std::uint32_t vertex : verticesOf(uncut, cell))
      box.extend(uncut.rest_positions[vertex].cast<double>());
    return box.sizes();
  }
  return Vector3::Zero();
}

double cutArea(const Topology& topology) {
  double area_m2 = 0.0;
  std::size_t face_of_grid = 0;
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    core::forEachFace(topology.cell_types[cell], cellBegin(topology, cell),
                      [&](std::size_t, const std::uint32_t* vertices, std::size_t size) {
                        if (topology.cut_faces[face_of_grid++] == 0)
                          return;
                        const auto rest = [&](std::size_t n) {
                          return Vector3(topology.rest_positions[vertices[n]].cast<double>());
                        };
                        for (std::size_t n = 2; n < size; ++n)
                          area_m2 += cross(rest(0), rest(n - 1), rest(n));
                      });
  }
  return area_m2 / 2.0;
}

std::uint64_t partCount(const Topology& topology) {
  std::vector<std::uint32_t> parent(topology.cellCount());
  std::iota(parent.begin(), parent.end(), 0U);
  const auto root = [&parent](std::uint32_t cell) {
    while (parent[cell] != cell)
      cell = parent[cell] = parent[parent[cell]];
    return cell;
  };
  std::size_t face_of_grid = 0;
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    const std::size_t faces = core::faceCount(topology.cell_types[cell], cellBegin(topology, cell));
    for (std::size_t face = 0; face < faces; ++face) {
      const std::int32_t neighbour = topology.face_neighbours[face_of_grid++];
      if (neighbour >= 0)
        parent[root(static_cast<std::uint32_t>(cell))] = root(static_cast<std::uint32_t>(neighbour));
    }
  }
  std::uint64_t parts = 0;
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell)
    parts += topology.cell_types[cell] != CellType::kEmpty && parent[cell] == cell ? 1 : 0;
  return parts;
}

double largestDisplacement(const Topology& topology, const std::vector<Vector3f>& positions) {
  double largest = 0.0;
  for (std::size_t v = 0; v < positions.size(); ++v)
    largest = std::max(largest, (positions[v].cast<double>() - topology.rest_positions[v].cast<double>()).norm());
  return largest;
}

}  // namespace soft_volume
