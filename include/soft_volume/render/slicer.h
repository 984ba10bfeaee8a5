#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/slice_planes.h"

namespace soft_volume::core {

/// One corner of a slice polygon.
struct LegacySliceVertex {
  float u, v;                    ///< pixels, with the convention of Camera
  std::array<float, 3> texture;  ///< texture coordinates; affine on a plane z = const: no perspective correction
  std::array<float, 3> view;     ///< change of the texture coordinates along the ray, per metre of depth
  std::array<float, 3> right;    ///< change of the texture coordinates per metre along the camera's x
  std::array<float, 3> down;     ///< the same along the camera's y
};

/// The triangles of one slice: `index_count` entries of LegacySliceMesh::indices from `first_index` on.
struct LegacySlice {
  float z_m;
  std::uint32_t first_index;
  std::uint32_t index_count;
};

struct LegacySliceMesh {
  std::vector<LegacySliceVertex> vertices;
  std::vector<std::uint32_t> indices;
  std::vector<LegacySlice> slices;  ///< front to back, one per plane
  std::size_t polygon_count = 0;
};

/// Cuts a deformed hexahedral grid into polygons by planes parallel to the view plane (dissertation, sections 3.2 to
/// 3.4).
///
/// Cells are put into one bucket per plane in O(n) by their smallest z; going from plane to plane the active list takes
/// in the next bucket and drops the cells that lie behind. Edges have no buckets of their own: each of the cells at an
/// edge interpolates it again, always from the lower to the higher vertex number, so neighbours get the same bits. That
/// is up to four times the interpolations of an active edge list but needs no look-up, and all of it is less than a
/// tenth of a frame, which the filling of polygons dominates.
///
/// Nothing is dropped at the border of the image: polygons reach beyond it and are clipped when drawn. Polygons that
/// are not convex (warped cells) are triangulated by ear clipping, all others as fans; a loop that crosses itself (a
/// folded cell) is drawn as a fan.
///
/// Not thread-safe; buffers are kept between calls. Use: setTopology once, then transform, planes and slice per image.
class Slicer {
 public:
  /// Takes over what it needs of a valid topology. Throws InputError when a cell is no hexahedron.
  void setTopology(const Topology& topology);
  using Corners = std::array<std::uint32_t, 8>;
  std::size_t cellCount() const { return cells_.size(); }
  const Corners& corners(std::size_t cell) const { return cells_[cell]; }
  std::size_t vertexCount() const { return texture_.size(); }

  /// Takes `positions` (volume frame, metres, one per vertex) to the camera frame. Throws InputError when their number
  /// is wrong or one is not finite or farther than 1000 km.
  void transform(const Camera& camera, const std::vector<Vector3f>& positions);
  /// Smallest and largest z of the transformed vertices, clipped to the camera's near and far; empty (first > second)
  /// when nothing lies between them.
  std::array<double, 2> depthRange(const Camera& camera) const;
  /// Cuts the transformed grid. `skip` has one entry per cell, nonzero where it is not drawn, or is empty.
  /// The directions at a vertex are mapped to texture coordinates through the inverse of each cell's deformation and
  /// averaged over the vertex's cells; cells flatter than a fiftieth of their edge box or inside out are left out of
  /// it, and vertices without any other get zero. The result is valid until the next call.
  const LegacySliceMesh& slice(const Camera& camera, const SlicePlanes& planes, const std::vector<std::uint8_t>& skip);

 private:
  struct BucketCell {
    std::uint32_t cell;
    float max_z_m;
  };

  void computeDirections(const Camera& camera);
  void fillBuckets(const SlicePlanes& planes, const std::vector<std::uint8_t>& skip);
  void updateActive(int plane, float z_m);
  void cutCell(const Camera& camera, const Corners& corners, float z_m);
  LegacySliceVertex cutEdge(const Camera& camera, std::uint32_t a, std::uint32_t b, float z_m) const;

  std::vector<Corners> cells_;
  std::vector<Vector3f> texture_;            ///< per vertex
  std::vector<Vector3f> positions_;          ///< per vertex, camera frame
  std::vector<Eigen::Matrix3f> to_texture_;  ///< per vertex: columns ray, camera x, camera y
  std::vector<std::uint32_t> usable_cells_;  ///< per vertex, cells in the sum
  std::vector<std::int32_t> first_plane_;    ///< per cell, one past the last where no plane cuts it
  std::vector<std::uint32_t> bucket_begin_;  ///< per plane, one for cells never cut, and the end
  std::vector<std::uint32_t> bucket_next_;   ///< where the next cell of a bucket goes
  std::vector<BucketCell> bucket_cells_;
  std::vector<BucketCell> active_;
  LegacySliceMesh mesh_;
};

/// Splits a simple polygon (pixel coordinates, either orientation, 3 to 12 corners) into triangles: a fan when it is
/// convex, by ear clipping otherwise. Appends index triples, `first` being the index of its first corner.
void triangulate(const LegacySliceVertex* corners, int size, std::uint32_t first, std::vector<std::uint32_t>& indices);

}  // namespace soft_volume::core
