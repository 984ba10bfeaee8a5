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

/// A camera that looks from the side onto allGrids().
Camera obliqueCamera(Projection projection) {
  const Vector3 eye(6.0, 4.5, -3.0);
  const Vector3 target(0.0, 0.0, 3.5);
  Camera camera = projection == Projection::kPerspective
                      ? Camera::lookAt(eye, target, Vector3::UnitZ(), 0.6, 320, 240)
                      : Camera::lookAtParallel(eye, target, Vector3::UnitZ(), 6.0, 320, 240);
  camera.far_m = 100.0;
  return camera;
}

TEST(GridSlicer, AreasIntegrateToTheVolume) {
  std::mt19937 random(kSeed + 2);
  for (const Projection projection : kProjections) {
    const Camera camera = obliqueCamera(projection);
    for (const auto& [name, grid] : allGrids(random)) {
      const SliceMesh mesh = sliceAll(grid, camera, grid.points, 300);
      double volume = 0.0;
      for (const Slice& slice : mesh.slices) {
        volume += areaOf(camera, mesh, slice) * double(slice.back_m - slice.front_m);
        for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i)
          ASSERT_GE(areaOf(camera, mesh, mesh.polygons[i], slice.z_m), -1e-6) << name << ": right-handed cells";
      }
      EXPECT_NEAR(volume, 27.0, 2e-3) << name;  // the midpoint rule errs by O(1 / 300^2)
    }
  }
}

/// Signed volume before the plane of warped tetrahedra, whose faces are plane: no face rule plays a part.
double volumeBefore(const CellGrid& grid, const std::vector<Vector3f>& positions, double z_m) {
  double volume = 0.0;
  for (std::size_t cell = 0; cell < grid.types.size(); ++cell) {
    std::array<Eigen::Vector3d, 4> p;
    for (std::size_t i = 0; i < 4; ++i)
      p[i] = positions[grid.connectivity[grid.offsets[cell] + i]].cast<double>();
    const double whole = (p[1] - p[0]).dot((p[2] - p[0]).cross(p[3] - p[0])) / 6.0;
    // The part of a tetrahedron below z as a divided difference of ((z - z_i)_+)^3.
    double part = 0.0;
    for (std::size_t i = 0; i < 4; ++i) {
      double denominator = 1.0;
      for (std::size_t k = 0; k < 4; ++k)
        denominator *= k == i ? 1.0 : p[k].z() - p[i].z();
      part += std::pow(std::max(0.0, z_m - p[i].z()), 3) / denominator;
    }
    volume += whole * part;
  }
  return volume;
}

TEST(GridSlicer, AreaIsTheSlopeOfTheVolumeBeforeThePlane) {
  std::mt19937 random(kSeed + 3);
  const Camera camera = identityCamera(Projection::kParallel);
  const CellGrid grid = allGrids(random)["tetrahedra"];
  const auto positions = jittered(grid.points, 0.2F, random);
  constexpr double kStep_m = 1e-4;
  const SliceMesh mesh = sliceAll(grid, camera, positions, 37);
  for (const Slice& slice : mesh.slices) {
    const double slope =
        (volumeBefore(grid, positions, slice.z_m + kStep_m) - volumeBefore(grid, positions, slice.z_m - kStep_m)) /
        (2.0 * kStep_m);
    EXPECT_NEAR(areaOf(camera, mesh, slice), slope, 2e-3) << "z " << slice.z_m;
  }
}

TEST(GridSlicer, VerticesInterpolateTheirEdges) {
  std::mt19937 random(kSeed + 4);
  for (const Projection projection : kProjections) {
    const Camera camera = obliqueCamera(projection);
    const CellGrid grid = makeMixedCells(kOrigin, kThree, random);
    const GridSlicer slicer = slicerOf(grid, camera, grid.points);
    const SliceMesh mesh = sliceAll(grid, camera, grid.points, 20);
    for (const Slice& slice : mesh.slices) {
      for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i) {
        for (std::uint32_t k = 0; k < mesh.polygons[i].size; ++k) {
          const SliceVertex& vertex = mesh.vertices[mesh.corners[mesh.polygons[i].first + k]];
          const Vector3 a = slicer.positions()[vertex.a].cast<double>();
          const Vector3 b = slicer.positions()[vertex.b].cast<double>();
          const Vector3 p = a + double(vertex.t) * (b - a);
          ASSERT_NEAR(p.z(), slice.z_m, 1e-5);
          ASSERT_LT((camera.project(p) - Eigen::Vector2d(vertex.u, vertex.v)).norm(), 2e-3);
        }
      }
    }
  }
}

TEST(GridSlicer, VerticesExactlyOnAPlaneCountAsBehindIt) {
  const Camera camera = identityCamera(Projection::kParallel);
  const CellGrid grid = makeCells(Vector3f(-1, -1, 1), {2, 2, 2},
                                  [](CellGrid& g, int, int, int, const Corners& c) { addHexahedron(g, c); });
  GridSlicer slicer = slicerOf(grid, camera, grid.points);
  // Planes through all three layers of vertices: the front layer lies on its plane and has nothing before it.
  slicer.bucket(camera, planesThrough({1.0, 3.0}, 0.5, 1.0, 3), {}, kEverywhere, false);
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 1, mesh);
  ASSERT_EQ(mesh.slices.size(), 3U);
  EXPECT_FLOAT_EQ(mesh.slices[0].z_m, 1.0F);
  EXPECT_EQ(mesh.slices[0].polygon_count, 0U);
  EXPECT_EQ(mesh.slices[1].polygon_count, 4U);
  EXPECT_EQ(mesh.slices[2].polygon_count, 4U);
  EXPECT_NEAR(areaOf(camera, mesh, mesh.slices[1]), 4.0, 1e-5);
  EXPECT_NEAR(areaOf(camera, mesh, mesh.slices[2]), 4.0, 1e-5);
}

/// Positions on a lattice of a quarter, where every plane goes through vertices.
TEST(GridSlicer, GridsWithManyVerticesOnPlanesTileToo) {
  std::mt19937 random(kSeed + 5);
  const Camera camera = identityCamera(Projection::kParallel);
  for (const auto& [name, grid] : allGrids(random)) {
    const Faces outline = outerFaces(grid);
    auto positions = jittered(grid.points, 0.3F, random);
    for (Vector3f& p : positions)
      p = (p * 4.0F).array().round() * 0.25F;
    GridSlicer slicer = slicerOf(grid, camera, positions);
    slicer.bucket(camera, planesThrough(slicer.depthRange(camera), 0.125, 0.25, 100), {}, kEverywhere, false);
    SliceMesh mesh;
    slicer.slice(0, slicer.planeCount(), 1, mesh);
    expectSound(grid, slicer, mesh);
    for (const Slice& slice : mesh.slices) {
      EXPECT_NEAR(areaOf(camera, mesh, slice), outlineArea(outline, positions, slice.z_m), 3e-5) << name;
      EXPECT_EQ(unmatchedSides(mesh, slice), outlineSegments(outline, positions, slice.z_m)) << name;
    }
  }
}

/// As addWedges, of hexahedra that name vertices twice.
void addCollapsedHexahedra(CellGrid& grid, const Corners& c) {
  addHexahedron(grid, {c[0], c[1], c[2], c[2], c[4], c[5], c[6], c[6]});
  addHexahedron(grid, {c[0], c[2], c[3], c[0], c[4], c[6], c[7], c[4]});
}

TEST(GridSlicer, CollapsedCellsFitTheirNeighbours) {
  std::mt19937 random(kSeed + 6);
  const Camera camera = identityCamera(Projection::kPerspective);
  const CellGrid grid = makeCells(kOrigin, kThree, [&](CellGrid& g, int i, int j, int k, const Corners& c) {
    if ((i + j + k) % 2 == 0)
      addCollapsedHexahedra(g, c);
    else
      addWedges(g, c);
    addHexahedron(g, {c[0], c[0], c[0], c[0], c[6], c[6], c[6], c[6]});  // a line
    addHexahedron(g, {c[0], c[2], c[0], c[2], c[2], c[0], c[0], c[2]});
    addHexahedron(g, {c[3], c[3], c[3], c[3], c[3], c[3], c[3], c[3]});
  });
  const Faces outline = outerFaces(grid);
  ASSERT_EQ(outline.size(), 4U * 9U + 2U * 2U * 9U);
  for (int i = 0; i < 20; ++i) {
    const auto positions = jittered(grid.points, 0.25F, random);
    const SliceMesh mesh = sliceAll(grid, camera, positions, 37, true);
    for (const Slice& slice : mesh.slices) {
      if (slice.extra)
        continue;
      ASSERT_NEAR(areaOf(camera, mesh, slice), outlineArea(outline, positions, slice.z_m), 3e-5);
      ASSERT_EQ(unmatchedSides(mesh, slice), outlineSegments(outline, positions, slice.z_m));
    }
  }
}

TEST(GridSlicer, AnyCellsAtAllGiveASoundMesh) {
  std::mt19937 random(kSeed + 7);
  for (int round = 0; round < 60; ++round) {
    CellGrid grid;
    for (int i = 0; i < 12; ++i) {
      const auto lattice = [&] { return float(random() % 5); };
      grid.addPoint({lattice(), lattice(), 1.0F + lattice()});
    }
    const auto numbers = [&](std::size_t count) {
      std::vector<std::uint32_t> result;
      for (std::size_t i = 0; i < count; ++i)
        result.push_back(std::uint32_t(random() % grid.points.size()));
      return result;
    };
    for (int cell = 0; cell < 30; ++cell) {
      for (const CellType type :
           {CellType::kTetrahedron, CellType::kVoxel, CellType::kHexahedron, CellType::kWedge, CellType::kPyramid}) {
        grid.add(type, numbers(shapeOf(type).vertex_count));
      }
      Faces faces;  // not even closed
      for (std::size_t f = 0; f < 1 + random() % 6; ++f)
        faces.push_back(numbers(3 + random() % 5));
      addPolyhedron(grid, faces);
    }
    for (const Projection projection : kProjections)
      sliceAll(grid, identityCamera(projection), grid.points, 1 + int(random() % 20), round % 2 == 0);
  }
}

/// A slice without the numbers that depend on what was cut before it.
struct PlanePolygons {
  std::array<float, 3> depths{};
  bool extra = false;
  std::vector<std::uint32_t> numbers;  ///< per polygon its cell and size, per corner its edge and the ends' vertices
  std::vector<float> places;           ///< per corner u, v, t

  bool operator==(const PlanePolygons& other) const {
    return depths == other.depths && extra == other.extra && numbers == other.numbers && places == other.places;
  }
};

void addPolygon(const SliceMesh& mesh, const SlicePolygon& polygon, PlanePolygons& plane) {
  plane.numbers.insert(plane.numbers.end(), {polygon.cell, polygon.size});
  for (std::uint32_t i = polygon.first; i < polygon.first + polygon.size; ++i) {
    const SliceVertex& vertex = mesh.vertices[mesh.corners[i]];
    plane.numbers.insert(plane.numbers.end(), {mesh.edges[i], vertex.a, vertex.b});
    plane.places.insert(plane.places.end(), {vertex.u, vertex.v, vertex.t});
  }
}

template <typename Keep>
PlanePolygons planeOf(const SliceMesh& mesh, std::size_t number, const Keep& keep) {
  const Slice& slice = mesh.slices[number];
  PlanePolygons plane{{slice.z_m, slice.front_m, slice.back_m}, slice.extra, {}, {}};
  for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i) {
    if (keep(mesh.polygons[i]))
      addPolygon(mesh, mesh.polygons[i], plane);
  }
  return plane;
}

bool keepAll(const SlicePolygon&) {
  return true;
}

TEST(GridSlicer, PlanesDoNotDependOnRunsAndThreads) {
  std::mt19937 random(kSeed + 8);
  const CellGrid grid = makeMixedCells(kOrigin, {6, 6, 6}, random);
  const auto positions = jittered(grid.points, 0.3F, random);
  const Camera camera = obliqueCamera(Projection::kPerspective);
  for (const bool extra : {false, true}) {
    for (const int count : {3, 61}) {
      const SliceMesh whole = sliceAll(grid, camera, positions, count, extra);
      GridSlicer slicer;
      slicer.setCells(grid.types, grid.offsets, grid.connectivity, grid.points.size());
      for (int threads = 1; threads <= 5; ++threads) {
        slicer.transform(camera, positions, threads);
        slicer.bucket(camera, planesOver(slicer, camera, count), {}, kEverywhere, extra, threads);
        SliceMesh mesh;
        slicer.slice(0, slicer.planeCount(), threads, mesh);
        expectSound(grid, slicer, mesh);
        EXPECT_EQ(mesh.corners, whole.corners);
        EXPECT_EQ(mesh.edges, whole.edges);
        ASSERT_EQ(mesh.vertices.size(), whole.vertices.size());
        for (std::size_t i = 0; i < whole.slices.size(); ++i)
          ASSERT_TRUE(planeOf(mesh, i, keepAll) == planeOf(whole, i, keepAll));
        for (int run = 0; run < 40; ++run) {
          const int begin = int(random() % whole.slices.size());
          const int end = begin + int(random() % (whole.slices.size() + 1 - std::size_t(begin)));
          slicer.slice(begin, end, threads, mesh);
          ASSERT_EQ(int(mesh.slices.size()), end - begin);
          for (int i = begin; i < end; ++i) {
            ASSERT_TRUE(planeOf(mesh, std::size_t(i - begin), keepAll) == planeOf(whole, std::size_t(i), keepAll));
          }
        }
      }
    }
  }
}

TEST(GridSlicer, SkippedCellsAreLeftOutAndChangeNoOther) {
  std::mt19937 random(kSeed + 9);
  const CellGrid grid = makeMixedCells(kOrigin, {5, 5, 5}, random);
  const auto positions = jittered(grid.points, 0.3F, random);
  const Camera camera = obliqueCamera(Projection::kPerspective);
  const SliceMesh whole = sliceAll(grid, camera, positions, 40);
  GridSlicer slicer = slicerOf(grid, camera, positions);
  for (const unsigned one_in : {2U, 10U}) {
    std::vector<std::uint8_t> skip;
    for (std::size_t cell = 0; cell < grid.types.size(); ++cell)
      skip.push_back(std::uint8_t(random() % one_in != 0));
    slicer.bucket(camera, planesOver(slicer, camera, 40), skip, kEverywhere, false);
    SliceMesh mesh;
    slicer.slice(0, slicer.planeCount(), 1, mesh);
    expectSound(grid, slicer, mesh);
    for (std::size_t i = 0; i < whole.slices.size(); ++i) {
      EXPECT_TRUE(planeOf(mesh, i, keepAll) ==
                  planeOf(whole, i, [&](const SlicePolygon& polygon) { return skip[polygon.cell] == 0; }));
    }
    EXPECT_LT(mesh.vertices.size(), whole.vertices.size()) << "edges of skipped cells alone are not cut";
  }
}

/// Whether a polygon's image lies wholly outside the rectangle's pixels.
bool isBeyond(const SliceMesh& mesh, const SlicePolygon& polygon, const PixelRect& rect) {
  float low_u = 1e30F, high_u = -1e30F, low_v = 1e30F, high_v = -1e30F;
  for (std::uint32_t i = polygon.first; i < polygon.first + polygon.size; ++i) {
    const SliceVertex& vertex = mesh.vertices[mesh.corners[i]];
    low_u = std::min(low_u, vertex.u);
    high_u = std::max(high_u, vertex.u);
    low_v = std::min(low_v, vertex.v);
    high_v = std::max(high_v, vertex.v);
  }
  return high_u < float(rect.begin_x) - 0.5F || low_u > float(rect.end_x) - 0.5F ||
         high_v < float(rect.begin_y) - 0.5F || low_v > float(rect.end_y) - 0.5F;
}

/// The last camera is inside the grid, with cells all around it.
TEST(GridSlicer, CellsOutsideTheRectangleAreLeftOutAndNoOther) {
  std::mt19937 random(kSeed + 10);
  const CellGrid grid = makeMixedCells(Vector3f(-3, -3, -3), {6, 6, 6}, random);
  const auto positions = jittered(grid.points, 0.3F, random);
  Camera inside = Camera::lookAt({0.3, 0.2, 0.1}, {1, 2, 3}, {0, 0, 1}, 1.5, 320, 240);
  inside.near_m = 0.001;
  for (const Camera& camera : {Camera::lookAt({6, 5, 4}, {0, 0, 0}, {0, 0, 1}, 0.6, 320, 240),
                               Camera::lookAtParallel({6, 5, 4}, {0, 0, 0}, {0, 0, 1}, 8.0, 320, 240), inside}) {
    const SliceMesh whole = sliceAll(grid, camera, positions, 40, true);
    GridSlicer slicer = slicerOf(grid, camera, positions);
    for (const PixelRect& rect : {PixelRect{0, 0, 320, 240}, {100, 50, 200, 100}, {10, 200, 11, 201}, {5, 5, 5, 5}}) {
      slicer.bucket(camera, planesOver(slicer, camera, 40), {}, rect, true);
      SliceMesh mesh;
      slicer.slice(0, slicer.planeCount(), 1, mesh);
      expectSound(grid, slicer, mesh);
      ASSERT_EQ(mesh.slices.size(), whole.slices.size()) << "the rectangle must not change extra planes";
      std::set<std::uint32_t> kept;
      for (const SlicePolygon& polygon : mesh.polygons)
        kept.insert(polygon.cell);
      for (std::size_t i = 0; i < whole.slices.size(); ++i) {
        EXPECT_TRUE(planeOf(mesh, i, keepAll) ==
                    planeOf(whole, i, [&](const SlicePolygon& polygon) { return kept.count(polygon.cell) != 0; }));
      }
      for (const SlicePolygon& polygon : whole.polygons)
        EXPECT_TRUE(kept.count(polygon.cell) != 0 || isBeyond(whole, polygon, rect));
      if (rect.pixels() < 20000 && &camera != &inside) {
        EXPECT_LT(mesh.polygons.size(), whole.polygons.size() / 2);
      }
    }
  }
}

/// How often each cell occurs on planes of either kind.
std::vector<std::array<int, 2>> cutsOf(const CellGrid& grid, const SliceMesh& mesh) {
  std::vector<std::array<int, 2>> cuts(grid.types.size());
  for (const Slice& slice : mesh.slices) {
    std::set<std::uint32_t> cells;
    for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i)
      cells.insert(mesh.polygons[i].cell);
    for (const std::uint32_t cell : cells)
      ++cuts[cell][slice.extra ? 1 : 0];
  }
  return cuts;
}

TEST(GridSlicer, ExtraPlanesCutWhatNoOtherPlaneCuts) {
  std::mt19937 random(kSeed + 11);
  const Camera camera = obliqueCamera(Projection::kPerspective);
  const CellGrid grid = makeMixedCells(Vector3f(-1.5F, -1.5F, 2.0F), {4, 4, 4}, random);
  const auto positions = jittered(grid.points, 0.3F, random);
  for (const int count : {1, 2, 5, 30}) {
    const SliceMesh plain = sliceAll(grid, camera, positions, count);
    const SliceMesh mesh = sliceAll(grid, camera, positions, count, true);
    const auto plain_cuts = cutsOf(grid, plain);
    const auto cuts = cutsOf(grid, mesh);
    for (std::size_t cell = 0; cell < grid.types.size(); ++cell) {
      EXPECT_EQ(cuts[cell][0], plain_cuts[cell][0]);
      EXPECT_EQ(cuts[cell][1], cuts[cell][0] == 0 ? 1 : 0) << "cell " << cell;
    }
    std::size_t normal = 0;
    for (std::size_t i = 0; i < mesh.slices.size(); ++i) {
      const Slice& slice = mesh.slices[i];
      EXPECT_LE(slice.front_m, slice.z_m);
      EXPECT_LE(slice.z_m, slice.back_m);
      EXPECT_LT(slice.front_m, slice.back_m);
      if (i > 0) {
        EXPECT_LT(mesh.slices[i - 1].z_m, slice.z_m);
      }
      if (!slice.extra) {
        EXPECT_TRUE(planeOf(mesh, i, keepAll) == planeOf(plain, normal, keepAll));
        ++normal;
        continue;
      }
      EXPECT_GT(slice.polygon_count, 0U);
      if (i > 0) {
        EXPECT_FLOAT_EQ(slice.front_m, 0.5F * (mesh.slices[i - 1].z_m + slice.z_m));
      }
      if (i + 1 < mesh.slices.size()) {
        EXPECT_FLOAT_EQ(slice.back_m, 0.5F * (mesh.slices[i + 1].z_m + slice.z_m));
      }
    }
    EXPECT_EQ(normal, plain.slices.size());
    EXPECT_LT(mesh.slices.size(), plain.slices.size() + 64 * (plain.slices.size() + 1));
  }
}

/// A stack of layers that get thinner and thinner, one flat, between two planes.
TEST(GridSlicer, CellsTooThinForAnExtraPlaneAreCutAtTheNearest) {
  const Camera camera = identityCamera(Projection::kParallel);
  CellGrid grid = makeCells(Vector3f(-1, -1, 0), {1, 1, 24},
                            [](CellGrid& g, int, int, int, const Corners& c) { addHexahedron(g, c); });
  float z_m = 2.03F;
  for (int layer = 0; layer < 25; ++layer) {
    for (std::size_t i = 0; i < 4; ++i)
      grid.points[std::size_t(layer) * 4 + i].z() = z_m;
    z_m += layer == 20 ? 0.0F : 0.5F * std::pow(0.5F, float(layer));
  }
  GridSlicer slicer = slicerOf(grid, camera, grid.points);
  slicer.bucket(camera, planesThrough({1.5, 4.6}, 1.5, 1.0, 100), {}, kEverywhere, true);
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 1, mesh);
  expectSound(grid, slicer, mesh);
  const auto cuts = cutsOf(grid, mesh);
  int thin = 0;
  for (std::size_t cell = 0; cell < grid.types.size(); ++cell) {
    const float low_m = grid.points[cell * 4].z();
    const float high_m = grid.points[cell * 4 + 4].z();
    EXPECT_EQ(cuts[cell][0] + cuts[cell][1], low_m < high_m ? 1 : 0) << "cell " << cell;
    thin += high_m - low_m > 0.0F && high_m - low_m < 1.0F / 64.0F ? 1 : 0;
  }
  EXPECT_GT(thin, 8);
  for (const Slice& slice : mesh.slices) {
    for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i) {
      EXPECT_NEAR(areaOf(camera, mesh, mesh.polygons[i], slice.z_m), 1.0, 1e-5);
      EXPECT_NEAR(grid.points[mesh.vertices[mesh.corners[mesh.polygons[i].first]].a].z(), slice.z_m, 0.5F);
    }
  }
}

TEST(GridSlicer, PlanesStandForTheSlabAroundThem) {
  const Camera camera = identityCamera(Projection::kParallel);
  const CellGrid grid =
      makeCells(kOrigin, kThree, [](CellGrid& g, int, int, int, const Corners& c) { addVoxel(g, c); });
  GridSlicer slicer = slicerOf(grid, camera, grid.points);
  const std::array<double, 2> range = slicer.depthRange(camera);
  EXPECT_EQ(range[0], 2.0);
  EXPECT_EQ(range[1], 5.0);
  slicer.bucket(camera, planesThrough(range, 2.0, 0.5, 100), {}, kEverywhere, true);
  EXPECT_TRUE(slicer.extraPlanes().empty());
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 1, mesh);
  ASSERT_EQ(mesh.slices.size(), 6U);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_FLOAT_EQ(mesh.slices[i].front_m, 2.0F + 0.5F * float(i));
    EXPECT_FLOAT_EQ(mesh.slices[i].z_m, 2.25F + 0.5F * float(i));
    EXPECT_FLOAT_EQ(mesh.slices[i].back_m, 2.5F + 0.5F * float(i));
  }
}

TEST(GridSlicer, NothingIsCutBeforeNearAndBehindFar) {
  const CellGrid grid = makeCells(Vector3f(-3, -3, -3), {6, 6, 6},
                                  [](CellGrid& g, int, int, int, const Corners& c) { addHexahedron(g, c); });
  Camera camera = identityCamera(Projection::kPerspective);
  camera.near_m = 0.5;
  camera.far_m = 1.25;
  const SliceMesh mesh = sliceAll(grid, camera, grid.points, 2, true);
  EXPECT_FALSE(mesh.slices.empty());
  for (const Slice& slice : mesh.slices) {
    EXPECT_GE(slice.z_m, 0.5F);
    EXPECT_LE(slice.z_m, 1.25F);
  }
  GridSlicer slicer = slicerOf(grid, camera, grid.points);
  camera.near_m = 5.0;
  camera.far_m = 6.0;
  EXPECT_GT(slicer.depthRange(camera)[0], slicer.depthRange(camera)[1]);
  slicer.bucket(camera, planesThrough(slicer.depthRange(camera), 0.0, 0.7, 100), {}, kEverywhere, true);
  EXPECT_EQ(slicer.planeCount(), 0);
}

TEST(GridSlicer, ExtraPlanesAtTheEndsStayWithinTheSlabsOfTheOthers) {
  const Camera camera = identityCamera(Projection::kParallel);
  CellGrid grid =
      makeCells(kOrigin, {1, 1, 12}, [](CellGrid& g, int, int, int, const Corners& c) { addHexahedron(g, c); });
  for (Vector3f& p : grid.points)
    p.z() = 2.0F + 0.1F * (p.z() - kOrigin.z());
  GridSlicer slicer = slicerOf(grid, camera, grid.points);
  const auto range = slicer.depthRange(camera);
  slicer.bucket(camera, planesThrough(range, range[0], (range[1] - range[0]) / 3.0, 100), {}, kEverywhere, true);
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 1, mesh);
  EXPECT_TRUE(mesh.slices.front().extra);
  EXPECT_TRUE(mesh.slices.back().extra);
  EXPECT_FLOAT_EQ(mesh.slices.front().front_m, float(range[0]));
  EXPECT_FLOAT_EQ(mesh.slices.back().back_m, float(range[1]));
}

TEST(GridSlicer, GridBetweenTwoPlanesIsCutByExtraOnes) {
  const Camera camera = identityCamera(Projection::kPerspective);
  const CellGrid grid =
      makeCells(kOrigin, kThree, [](CellGrid& g, int, int, int, const Corners& c) { addVoxel(g, c); });
  GridSlicer slicer = slicerOf(grid, camera, grid.points);
  const SlicePlanes planes = planesThrough(slicer.depthRange(camera), 0.0, 20.0, 100);
  EXPECT_EQ(planes.count, 0);
  slicer.bucket(camera, planes, {}, kEverywhere, true);
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 2, mesh);
  EXPECT_EQ(mesh.polygons.size(), 27U);
  EXPECT_EQ(int(slicer.extraPlanes().size()), slicer.planeCount());
  slicer.bucket(camera, planes, {}, kEverywhere, false);
  EXPECT_EQ(slicer.planeCount(), 0);
  slicer.slice(0, 0, 2, mesh);
  EXPECT_TRUE(mesh.polygons.empty());
}

TEST(GridSlicer, EmptyGridGivesNothing) {
  GridSlicer slicer;
  slicer.setCells({}, {0}, {}, 0);
  const Camera camera = identityCamera(Projection::kPerspective);
  slicer.transform(camera, {}, 2);
  const auto range = slicer.depthRange(camera);
  EXPECT_GT(range[0], range[1]);
  slicer.bucket(camera, planesThrough({1.0, 2.0}, 0.0, 0.1, 100), {}, kEverywhere, true, 2);
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 2, mesh);
  EXPECT_EQ(mesh.slices.size(), 10U);
  EXPECT_TRUE(mesh.polygons.empty());
}

TEST(GridSlicer, RefusesUnusablePositions) {
  const CellGrid grid =
      makeCells(kOrigin, kThree, [](CellGrid& g, int, int, int, const Corners& c) { addVoxel(g, c); });
  const Camera camera = identityCamera(Projection::kPerspective);
  GridSlicer slicer = slicerOf(grid, camera, grid.points);
  std::vector<Vector3f> positions = grid.points;
  positions.pop_back();
  EXPECT_THROW(slicer.transform(camera, positions, 1), InputError);
  positions = grid.points;
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e9F}) {
    positions[7].y() = bad;
    positions[3].y() = bad;
    try {
      slicer.transform(camera, positions, 2);
      ADD_FAILURE() << "accepted " << bad;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find("vertex 3 "), std::string::npos) << error.what();
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
