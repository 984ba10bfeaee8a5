#include "soft_volume/render/slicer.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "soft_volume/common/error.h"
#include "soft_volume/render/slice_table.h"

namespace soft_volume::core {
namespace {

/// Farther away than this a position is an error; it also keeps float arithmetic far from overflow.
constexpr float kMaxCoordinate = 1e6F;
/// Determinant over the product of the edge lengths below which a cell has no usable light direction.
constexpr float kMinFlatness = 0.02F;

bool isUsable(const Vector3f& p) {
  return p.array().isFinite().all() && p.cwiseAbs().maxCoeff() <= kMaxCoordinate;
}

/// Sums of a hexahedron's four edges along each of its three directions.
Eigen::Matrix3f edgeSums(const std::array<std::uint32_t, 8>& corners, const std::vector<Vector3f>& points) {
  const auto p = [&](std::size_t corner) -> const Vector3f& { return points[corners[corner]]; };
  Eigen::Matrix3f sums;
  sums.col(0) = p(1) + p(2) + p(5) + p(6) - p(0) - p(3) - p(4) - p(7);
  sums.col(1) = p(2) + p(3) + p(6) + p(7) - p(0) - p(1) - p(4) - p(5);
  sums.col(2) = p(4) + p(5) + p(6) + p(7) - p(0) - p(1) - p(2) - p(3);
  return sums;
}

/// The matrix that takes directions in the deformed cell to texture coordinates. False for cells too flat or inside
/// out.
bool directionMap(const Eigen::Matrix3f& edges, const Eigen::Matrix3f& texture, Eigen::Matrix3f& map) {
  Eigen::Matrix3f adjugate;
  adjugate.row(0) = edges.col(1).cross(edges.col(2));
  adjugate.row(1) = edges.col(2).cross(edges.col(0));
  adjugate.row(2) = edges.col(0).cross(edges.col(1));
  const float determinant = adjugate.row(0).dot(edges.col(0));
  if (!(determinant > kMinFlatness * edges.col(0).norm() * edges.col(1).norm() * edges.col(2).norm()))
    return false;
  map = texture * adjugate / determinant;
  return true;
}

/// Index of the first plane behind z, which may be one past the last.
int firstPlaneBehind(const SlicePlanes& planes, float z_m) {
  const double estimate = std::floor((z_m - planes.depth(0)) / planes.distance_m) - 1.0;
  int plane = int(std::clamp(estimate, 0.0, double(planes.count)));
  while (plane < planes.count && planes.z(plane) <= z_m)
    ++plane;
  return plane;
}

}  // namespace

void Slicer::setTopology(const Topology& topology) {
  for (const CellType type : topology.cell_types) {
    if (type == CellType::kHexahedron)
      continue;
    throw InputError("cannot draw cells of VTK type " + std::to_string(int(type)) + ", only hexahedra (12)");
  }
  texture_ = topology.texture_coordinates;
  cells_.resize(topology.cellCount());
  for (std::size_t cell = 0; cell < cells_.size(); ++cell) {
    std::copy_n(topology.connectivity.begin() + topology.cell_offsets[cell], 8, cells_[cell].begin());
  }
}

void Slicer::transform(const Camera& camera, const std::vector<Vector3f>& positions) {
  if (positions.size() != vertexCount()) {
    throw InputError("got " + std::to_string(positions.size()) + " positions for a grid of " +
                     std::to_string(vertexCount()) + " vertices");
  }
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  const Matrix3 rotation = T_camera_volume.orientation.toRotationMatrix();
  positions_.resize(positions.size());
  for (std::size_t i = 0; i < positions.size(); ++i) {
    if (!isUsable(positions[i])) {
      throw InputError("the position of vertex " + std::to_string(i) + " is not finite or farther than 1000 km");
    }
    positions_[i] = (rotation * positions[i].cast<double>() + T_camera_volume.position_m).cast<float>();
  }
}

std::array<double, 2> Slicer::depthRange(const Camera& camera) const {
  float low = std::numeric_limits<float>::max();
  float high = std::numeric_limits<float>::lowest();
  for (const Vector3f& p : positions_) {
    low = std::min(low, p.z());
    high = std::max(high, p.z());
  }
  return {std::max(double(low), camera.near_m), std::min(double(high), camera.far_m)};
}

void Slicer::computeDirections(const Camera& camera) {
  to_texture_.assign(vertexCount(), Eigen::Matrix3f::Zero());
  usable_cells_.assign(vertexCount(), 0);
  for (const Corners& corners : cells_) {
    Eigen::Matrix3f map;
    if (!directionMap(edgeSums(corners, positions_), edgeSums(corners, texture_), map))
      continue;
    for (const std::uint32_t corner : corners) {
      to_texture_[corner] += map;
      ++usable_cells_[corner];
    }
  }
  for (std::size_t i = 0; i < vertexCount(); ++i) {
    const Eigen::Matrix3f map = to_texture_[i] / float(std::max(1U, usable_cells_[i]));
    const Vector3f& p = positions_[i];
    const float z_m = std::max(p.z(), float(camera.near_m));
    to_texture_[i].col(0) = map * Vector3f(p.x() / z_m, p.y() / z_m, 1.0F);
    to_texture_[i].col(1) = map.col(0);
    to_texture_[i].col(2) = map.col(1);
  }
}

/// A counting sort: cells are counted per plane, then written behind their predecessors.
void Slicer::fillBuckets(const SlicePlanes& planes, const std::vector<std::uint8_t>& skip) {
  bucket_begin_.assign(std::size_t(planes.count) + 2, 0);
  first_plane_.resize(cells_.size());
  for (std::size_t cell = 0; cell < cells_.size(); ++cell) {
    float low = std::numeric_limits<float>::max();
    for (const std::uint32_t corner : cells_[cell])
      low = std::min(low, positions_[corner].z());
    const bool drawn = skip.empty() || skip[cell] == 0;
    first_plane_[cell] = drawn ? firstPlaneBehind(planes, low) : planes.count;
    ++bucket_begin_[std::size_t(first_plane_[cell]) + 1];
  }
  for (std::size_t plane = 1; plane < bucket_begin_.size(); ++plane)
    bucket_begin_[plane] += bucket_begin_[plane - 1];
  bucket_cells_.resize(cells_.size());
  bucket_next_ = bucket_begin_;
  for (std::size_t cell = 0; cell < cells_.size(); ++cell) {
    float high = std::numeric_limits<float>::lowest();
    for (const std::uint32_t corner : cells_[cell])
      high = std::max(high, positions_[corner].z());
    bucket_cells_[bucket_next_[std::size_t(first_plane_[cell])]++] = {std::uint32_t(cell), high};
  }
}

void Slicer::updateActive(int plane, float z_m) {
  const auto isBehind = [z_m](const BucketCell& cell) { return cell.max_z_m < z_m; };
  active_.erase(std::remove_if(active_.begin(), active_.end(), isBehind), active_.end());
  const auto begin = bucket_cells_.begin() + bucket_begin_[std::size_t(plane)];
  const auto end = bucket_cells_.begin() + bucket_begin_[std::size_t(plane) + 1];
  std::remove_copy_if(begin, end, std::back_inserter(active_), isBehind);
}

LegacySliceVertex Slicer::cutEdge(const Camera& camera, std::uint32_t a, std::uint32_t b, float z_m) const {
  if (a > b)
    std::swap(a, b);
  const Vector3f& from = positions_[a];
  const Vector3f& to = positions_[b];
  const float t = (z_m - from.z()) / (to.z() - from.z());
  const Vector3f p = from + t * (to - from);
  const Vector3f texture = texture_[a] + t * (texture_[b] - texture_[a]);
  const Eigen::Matrix3f steps = to_texture_[a] + t * (to_texture_[b] - to_texture_[a]);
  const auto toArray = [](const Vector3f& v) -> std::array<float, 3> { return {v.x(), v.y(), v.z()}; };
  return {float(camera.fx) * p.x() / z_m + float(camera.cx),
          float(camera.fy) * p.y() / z_m + float(camera.cy),
          toArray(texture),
          toArray(steps.col(0)),
          toArray(steps.col(1)),
          toArray(steps.col(2))};
}

void Slicer::cutCell(const Camera& camera, const Corners& corners, float z_m) {
  unsigned signs = 0;
  for (std::size_t i = 0; i < 8; ++i)
    signs |= unsigned(positions_[corners[i]].z() >= z_m) << i;
  const SliceLoops& loops = hexahedronSliceTable()[signs];
  const std::uint8_t* edge = loops.edges.data();
  for (std::size_t loop = 0; loop < loops.loop_count; ++loop) {
    const auto first = std::uint32_t(mesh_.vertices.size());
    const int size = loops.loop_sizes[loop];
    for (int i = 0; i < size; ++i, ++edge) {
      const auto& ends = kHexahedronEdges[*edge];
      mesh_.vertices.push_back(cutEdge(camera, corners[ends[0]], corners[ends[1]], z_m));
    }
    triangulate(&mesh_.vertices[first], size, first, mesh_.indices);
    ++mesh_.polygon_count;
  }
}

const LegacySliceMesh& Slicer::slice(const Camera& camera, const SlicePlanes& planes,
                                     const std::vector<std::uint8_t>& skip) {
  computeDirections(camera);
  fillBuckets(planes, skip);
  active_.clear();
  mesh_.vertices.clear();
  mesh_.indices.clear();
  mesh_.slices.clear();
  mesh_.polygon_count = 0;
  for (int plane = 0; plane < planes.count; ++plane) {
    const float z_m = planes.z(plane);
    const auto first_index = std::uint32_t(mesh_.indices.size());
    updateActive(plane, z_m);
    for (const BucketCell& cell : active_)
      cutCell(camera, cells_[cell.cell], z_m);
    mesh_.slices.push_back({z_m, first_index, std::uint32_t(mesh_.indices.size()) - first_index});
  }
  return mesh_;
}

}  // namespace soft_volume::core
