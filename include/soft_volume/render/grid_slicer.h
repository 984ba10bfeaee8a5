#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/slice_mesh.h"
#include "soft_volume/render/slice_planes.h"

namespace soft_volume::core {

struct PixelRect;

/// Cuts a grid of any cells into polygons by planes parallel to the view plane (dissertation, sections 3.2 to 3.5 and
/// 3.7.1).
///
/// Vertices go to image space; edges and cells go into one bucket per plane in O(n) by the first plane that cuts them.
/// From plane to plane, active lists of both take in the next bucket and drop what lies before the plane. Each cut edge
/// is one vertex of the mesh, shared by all polygons at it; the polygons come from tables (slice_table.h), those of
/// polyhedra from the same rule on each of their faces. Whether a vertex lies behind a plane (z >= plane) has one
/// answer everywhere, so neighbours always fit, whatever the shapes of the cells; a degenerate cell gives fewer or
/// flatter polygons.
///
/// Nothing is dropped at the border of the image: polygons reach beyond it and are clipped when drawn.
///
/// Use: setCells once, then transform, bucket and slice per image. From one thread at a time; buffers are kept between
/// calls.
class GridSlicer {
 public:
  GridSlicer();
  ~GridSlicer();
  GridSlicer(GridSlicer&&) noexcept;
  GridSlicer& operator=(GridSlicer&&) noexcept;

  /// Cells as in Topology and IrregularGrid, already validated.
  void setCells(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                const std::vector<std::uint32_t>& connectivity, std::size_t vertex_count);
  std::size_t cellCount() const;
  std::size_t vertexCount() const;

  /// Takes `positions` (volume frame, metres, one per vertex) to the camera frame. Throws InputError when their number
  /// is wrong or one is not finite or farther than 1000 km.
  void transform(const Camera& camera, const std::vector<Vector3f>& positions, int threads);
  const std::vector<Vector3f>& positions() const;  ///< camera frame
  /// Smallest and largest z of the transformed vertices, clipped to the camera's near and far; empty (first > second)
  /// when nothing lies between them.
  std::array<double, 2> depthRange(const Camera& camera) const;

  /// Puts edges and cells into buckets; `camera` is that of transform(). At most 65,534 planes, all at depths of more
  /// than 0. `skip`: per cell, nonzero where it is not drawn, or empty. Cells whose image lies outside `rect` are left
  /// out, which changes nothing in `rect`.
  ///
  /// With `extra`, planes are added for the cells that are not skipped and lie between two planes, up to 63 between two
  /// planes, and as many in one distance before the first and behind the last: each such cell with a depth
  /// of more than zero is cut on one of them. A cell that is too thin for that is cut through its middle, and this
  /// polygon belongs to the nearest of them. Which planes are added does not depend on `rect`.
  void bucket(const Camera& camera, const SlicePlanes& planes, const std::vector<std::uint8_t>& skip,
              const PixelRect& rect, bool extra, int threads = 1);
  /// Planes after bucket(), extra ones included.
  int planeCount() const;
  bool isExtra(int plane) const;
  /// Depths of the extra planes, front to back: while they and the planes stay, polygons far from a change stay.
  const std::vector<float>& extraPlanes() const;
  /// Cuts planes [begin, end). What was in `mesh` is replaced. The result of a plane does not depend on the run that it
  /// belongs to, nor on the number of threads.
  void slice(int begin, int end, int threads, SliceMesh& mesh);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soft_volume::core
