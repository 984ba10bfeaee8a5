#pragma once

#include <cstdint>
#include <vector>

namespace soft_volume::core {

/// A cut edge of the grid: one corner of as many polygons as cells meet at the edge. Whatever the grid has at its
/// vertices is x[a] + t (x[b] - x[a]) here.
struct SliceVertex {
  float u, v;          ///< pixels, with the convention of Camera
  float t;             ///< place on the edge: 0 at vertex a, 1 at vertex b
  std::uint32_t a, b;  ///< vertices of the grid, a < b
};

/// One loop of a plane through one cell, counter-clockwise seen from behind the plane (positive side) where the cell is
/// right-handed. Not necessarily convex.
struct SlicePolygon {
  std::uint32_t cell;
  std::uint32_t first;  ///< its corners are SliceMesh::corners[first .. first + size) and as many `edges`
  std::uint32_t size;   ///< at least 3
};

/// One plane z = z_m of the camera frame. It stands for the slab from front_m to back_m.
struct Slice {
  float z_m;
  float front_m;
  float back_m;
  bool extra;  ///< adaptive slicing: cuts only those cells that no other plane cuts
  std::uint32_t first_polygon;
  std::uint32_t polygon_count;
};

/// What planes parallel to the view plane cut out of a grid.
struct SliceMesh {
  std::vector<SliceVertex> vertices;
  std::vector<std::uint32_t> corners;  ///< indices into `vertices`
  std::vector<std::uint8_t> edges;  ///< parallel to `corners`: the cut edge's number in its cell (slice_table.h), 255
                                    ///< in polyhedra
  std::vector<SlicePolygon> polygons;  ///< by plane
  std::vector<Slice> slices;           ///< front to back
};

}  // namespace soft_volume::core
