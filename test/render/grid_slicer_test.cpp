#include "soft_volume/render/grid_slicer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdio>
#include <limits>
#include <map>
#include <set>

#include "render/cell_grids.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 20240611;
constexpr PixelRect kEverywhere = {-1000000, -1000000, 1000000, 1000000};

using Point2 = std::array<double, 2>;

double cross(const Point2& a, const Point2& b) {
  return a[0] * b[1] - a[1] * b[0];
}

/// A camera at the origin that looks along z, so that camera frame and volume frame are the same.
Camera identityCamera(Projection projection) {
  Camera camera;
  camera.projection = projection;
  camera.width = 64;
  camera.height = 48;
  camera.fx = 100.0;
  camera.fy = 120.0;
  camera.cx = 31.5;
  camera.cy = 23.5;
  camera.far_m = 1000.0;
  return camera;
}

constexpr std::array<Projection, 2> kProjections = {Projection::kPerspective, Projection::kParallel};

/// Metres on the slice of a pixel position.
Point2 onSlice(const Camera& camera, const SliceVertex& vertex, double z_m) {
  const double scale = camera.projection == Projection::kPerspective ? z_m : 1.0;
  return {(vertex.u - camera.cx) / camera.fx * scale, (vertex.v - camera.cy) / camera.fy * scale};
}

double areaOf(const Camera& camera, const SliceMesh& mesh, const SlicePolygon& polygon, double z_m) {
  double twice = 0.0;
  for (std::uint32_t i = 0; i < polygon.size; ++i) {
    const std::uint32_t a = mesh.corners[polygon.first + i];
    const std::uint32_t b = mesh.corners[polygon.first + (i + 1) % polygon.size];
    twice += cross(onSlice(camera, mesh.vertices[a], z_m), onSlice(camera, mesh.vertices[b], z_m));
  }
  return 0.5 * twice;
}

double areaOf(const Camera& camera, const SliceMesh& mesh, const Slice& slice) {
  double area = 0.0;
  for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i)
    area += areaOf(camera, mesh, mesh.polygons[i], slice.z_m);
  return area;
}

/// Boundary faces as their vertices.
Faces outerFaces(const CellGrid& grid) {
  Faces faces;
  for (const GridFace& boundary : boundaryFaces(grid.types, grid.offsets, grid.connectivity)) {
    forEachFace(grid.types[boundary.cell], &grid.connectivity[grid.offsets[boundary.cell]],
                [&](std::size_t number, const std::uint32_t* vertices, std::size_t size) {
                  if (number == boundary.face)
                    faces.emplace_back(vertices, vertices + size);
                });
  }
  return faces;
}

/// Area inside the outline that the plane draws on the boundary faces alone, knowing nothing of cells: every face
/// contributes a line from each place where its border falls below the plane back to where it last rose above it.
double outlineArea(const Faces& faces, const std::vector<Vector3f>& positions, float z_m) {
  double twice = 0.0;
  for (const auto& face : faces) {
    Point2 risen{};
    bool is_known = false;
    for (std::size_t i = 0; i < 2 * face.size(); ++i) {
      const Vector3f& a = positions[face[i % face.size()]];
      const Vector3f& b = positions[face[(i + 1) % face.size()]];
      if ((a.z() >= z_m) == (b.z() >= z_m))
        continue;
      const double t = (double(z_m) - a.z()) / (double(b.z()) - a.z());
      const Point2 p = {a.x() + t * (b.x() - a.x()), a.y() + t * (b.y() - a.y())};
      if (b.z() >= z_m && i < face.size()) {
        risen = p;
        is_known = true;
      } else if (b.z() < z_m && is_known) {
        twice += cross(p, risen);
        is_known = false;
      }
    }
  }
  return 0.5 * twice;
}

/// How many segments the plane draws on the boundary.
std::size_t outlineSegments(const Faces& faces, const std::vector<Vector3f>& positions, float z_m) {
  std::size_t changes = 0;
  for (const auto& face : faces) {
    for (std::size_t i = 0; i < face.size(); ++i)
      changes += std::size_t((positions[face[i]].z() >= z_m) != (positions[face[(i + 1) % face.size()]].z() >= z_m));
  }
  return changes / 2;
}

/// Sides of a slice's polygons, as pairs of mesh vertices, by how often they occur.
std::map<std::pair<std::uint32_t, std::uint32_t>, int> sidesOf(const SliceMesh& mesh, const Slice& slice) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> sides;
  for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i) {
    const SlicePolygon& polygon = mesh.polygons[i];
    for (std::uint32_t k = 0; k < polygon.size; ++k)
      ++sides[{mesh.corners[polygon.first + k], mesh.corners[polygon.first + (k + 1) % polygon.size]}];
  }
  return sides;
}

/// Sides without an opposite: the outline. Fails where a side occurs twice in one direction.
std::size_t unmatchedSides(const SliceMesh& mesh, const Slice& slice) {
  const auto sides = sidesOf(mesh, slice);
  std::size_t unmatched = 0;
  for (const auto& [side, count] : sides) {
    EXPECT_EQ(count, 1) << "side " << side.first << " " << side.second;
    EXPECT_NE(side.first, side.second);
    unmatched += std::size_t(sides.count({side.second, side.first}) == 0);
  }
  return unmatched;
}

/// What every mesh must keep, whatever it was cut from.
void expectSound(const CellGrid& grid, const GridSlicer& slicer, const SliceMesh& mesh) {
  ASSERT_EQ(mesh.corners.size(), mesh.edges.size());
  std::uint32_t corner = 0;
  for (const SlicePolygon& polygon : mesh.polygons) {
    ASSERT_EQ(polygon.first, corner);
    ASSERT_GE(polygon.size, 3U);
    corner += polygon.size;
    const CellType type = grid.types[polygon.cell];
    for (std::uint32_t i = polygon.first; i < corner; ++i) {
      if (type == CellType::kPolyhedron) {
        ASSERT_EQ(mesh.edges[i], 255);
        continue;
      }
      const auto& ends = shapeOf(type).edges.at(mesh.edges[i]);
      const std::uint32_t* numbers = &grid.connectivity[grid.offsets[polygon.cell]];
      const auto [a, b] = std::minmax(numbers[ends[0]], numbers[ends[1]]);
      ASSERT_EQ(mesh.vertices.at(mesh.corners[i]).a, a);
      ASSERT_EQ(mesh.vertices[mesh.corners[i]].b, b);
    }
  }
  ASSERT_EQ(corner, mesh.corners.size());
  std::uint32_t polygon = 0;
  for (const Slice& slice : mesh.slices) {
    ASSERT_EQ(slice.first_polygon, polygon);
    polygon += slice.polygon_count;
  }
  ASSERT_EQ(polygon, mesh.polygons.size());
  for (const SliceVertex& vertex : mesh.vertices) {
    ASSERT_LT(vertex.a, vertex.b);
    ASSERT_TRUE(vertex.t >= 0.0F && vertex.t <= 1.0F);
    ASSERT_TRUE(std::isfinite(vertex.u) && std::isfinite(vertex.v));
  }
  ASSERT_EQ(int(mesh.slices.size()), slicer.planeCount());
}

SlicePlanes planesOver(const GridSlicer& slicer, const Camera& camera, int count) {
  const std::array<double, 2> range = slicer.depthRange(camera);
  return planesThrough(range, range[0], (range[1] - range[0]) / count, count);
}

GridSlicer slicerOf(const CellGrid& grid, const Camera& camera, const std::vector<Vector3f>& positions) {
  GridSlicer slicer;
  slicer.setCells(grid.types, grid.offsets, grid.connectivity, grid.points.size());
  slicer.transform(camera, positions, 1);
  return slicer;
}

SliceMesh sliceAll(const CellGrid& grid, const Camera& camera, const std::vector<Vector3f>& positions, int count,
                   bool extra = false) {
  GridSlicer slicer = slicerOf(grid, camera, positions);
  slicer.bucket(camera, planesOver(slicer, camera, count), {}, kEverywhere, extra);
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 1, mesh);
  expectSound(grid, slicer, mesh);
  return mesh;
}

const Vector3f kOrigin(-1.5F, -1.5F, 2.0F);
const Vector3i kThree(3, 3, 3);

/// 3^3 unit cubes of each type, and of all types.
std::map<std::string, CellGrid> allGrids(std::mt19937& random) {
  std::map<std::string, CellGrid> grids;
  const auto simple = [&](const std::string& name, auto add) {
    grids[name] = makeCells(kOrigin, kThree, [&](CellGrid& grid, int, int, int, const Corners& c) { add(grid, c); });
  };
  simple("hexahedra",
         [&](CellGrid& grid, const Corners& c) { addTurnedHexahedron(grid, c, int(grid.types.size() % 4)); });
  simple("voxels", addVoxel);
  simple("wedges", addWedges);
  simple("tetrahedra", addTetrahedra);
  simple("pyramids", [](CellGrid& grid, const Corners& c) { addFan(grid, c, false); });
  simple("polyhedra", [](CellGrid& grid, const Corners& c) { addCube(grid, c, false); });
  grids["mixed"] = makeMixedCells(kOrigin, kThree, random);
  return grids;
}

TEST(GridSlicer, PolygonsOfWarpedCellsTileTheCrossSection) {
  std::printf("seed %u\n", kSeed);
  std::mt19937 random(kSeed);
  for (const Projection projection : kProjections) {
    const Camera camera = identityCamera(projection);
    for (const auto& [name, grid] : allGrids(random)) {
      const Faces outline = outerFaces(grid);
      ASSERT_GE(outline.size(), 54U) << name;
      for (int i = 0; i < 30; ++i) {
        const auto positions = jittered(grid.points, 0.25F, random);
        const SliceMesh mesh = sliceAll(grid, camera, positions, 37);
        for (const Slice& slice : mesh.slices) {
          // Pixel coordinates are floats of some 100: 1e-5 pixel is 1e-6 of the area.
          ASSERT_NEAR(areaOf(camera, mesh, slice), outlineArea(outline, positions, slice.z_m), 3e-5) << name;
          ASSERT_EQ(unmatchedSides(mesh, slice), outlineSegments(outline, positions, slice.z_m)) << name;
        }
      }
    }
  }
}

TEST(GridSlicer, FoldedCellsStillMatchTheirNeighbours) {
  std::mt19937 random(kSeed + 1);
  const Camera camera = identityCamera(Projection::kPerspective);
  for (const auto& [name, grid] : allGrids(random)) {
    const Faces outline = outerFaces(grid);
    for (int i = 0; i < 10; ++i) {
      // Polygons may overlap or turn around, but the outline is still that of the boundary.
      const auto positions = jittered(grid.points, 0.9F, random);
      const SliceMesh mesh = sliceAll(grid, camera, positions, 37);
      for (const Slice& slice : mesh.slices) {
        ASSERT_NEAR(areaOf(camera, mesh, slice), outlineArea(outline, positions, slice.z_m), 5e-5) << name;
        ASSERT_EQ(unmatchedSides(mesh, slice), outlineSegments(outline, positions, slice.z_m)) << name;
      }
    }
  }
}

TEST(GridSlicer, BluntFinGivesTheDissertationsPolygonCounts) {
  CellGrid grid = makeCells(Vector3f::Zero(), {39, 31, 31},
                            [](CellGrid& g, int, int, int, const Corners& c) { addHexahedron(g, c); });
  grid.points = readBluntFin();
  if (grid.points.empty())
    GTEST_SKIP() << "blunt_fin/bluntfinxyz.bin is not under $SOFT_VOLUME_DATA";
  for (const Projection projection : kProjections) {
    Camera straight = identityCamera(projection);
    straight.T_volume_camera.position_m = {0, 0, -20};
    Camera turned = straight;
    turned.T_volume_camera.orientation = Quaternion(Eigen::AngleAxisd(-M_PI / 4, Vector3::UnitY()));
    turned.T_volume_camera.position_m = turned.T_volume_camera.orientation * Vector3(0, 0, -20);
    EXPECT_EQ(sliceAll(grid, straight, grid.points, 50).polygons.size(), 60450U);
    EXPECT_EQ(sliceAll(grid, straight, grid.points, 100).polygons.size(), 120900U);
    EXPECT_EQ(sliceAll(grid, turned, grid.points, 50).polygons.size(), 45463U);
    EXPECT_EQ(sliceAll(grid, turned, grid.points, 100).polygons.size(), 90980U);
  }
}

}  // namespace
}  // namespace soft_volume::core
