#include "soft_volume/render/slicer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <map>
#include <string>

#include "render/render_scenes.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/slice_table.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 20240611;

using Point2 = std::array<double, 2>;

double cross(const Point2& a, const Point2& b) {
  return a[0] * b[1] - a[1] * b[0];
}

/// Metres on the slice of a pixel position.
Point2 onSlice(const Camera& camera, const LegacySliceVertex& vertex, double z_m) {
  return {(vertex.u - camera.cx) / camera.fx * z_m, (vertex.v - camera.cy) / camera.fy * z_m};
}

double areaOf(const Camera& camera, const LegacySliceMesh& mesh, const LegacySlice& slice) {
  double twice = 0.0;
  for (std::uint32_t i = slice.first_index; i < slice.first_index + slice.index_count; i += 3) {
    std::array<Point2, 3> p;
    for (std::size_t k = 0; k < 3; ++k)
      p[k] = onSlice(camera, mesh.vertices[mesh.indices[i + k]], slice.z_m);
    twice += cross(p[0], p[1]) + cross(p[1], p[2]) + cross(p[2], p[0]);
  }
  return 0.5 * twice;
}

/// Faces that only one cell has, as corners in outward order.
std::vector<std::array<std::uint32_t, 4>> boundaryFaces(const Topology& topology) {
  std::map<std::array<std::uint32_t, 4>, std::vector<std::array<std::uint32_t, 4>>> faces;
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    for (const auto& corners : kHexahedronFaces) {
      std::array<std::uint32_t, 4> face{};
      for (std::size_t i = 0; i < 4; ++i)
        face[i] = topology.connectivity[topology.cell_offsets[cell] + corners[i]];
      auto key = face;
      std::sort(key.begin(), key.end());
      faces[key].push_back(face);
    }
  }
  std::vector<std::array<std::uint32_t, 4>> boundary;
  for (const auto& face : faces) {
    if (face.second.size() == 1)
      boundary.push_back(face.second.front());
  }
  return boundary;
}

/// Area inside the outline that the plane draws on the boundary faces alone, knowing nothing of cells: every face with
/// a sign change contributes the line from each place where its border enters z < plane back to where it last left it.
double outlineArea(const std::vector<std::array<std::uint32_t, 4>>& faces, const std::vector<Vector3f>& positions,
                   float z_m) {
  double twice = 0.0;
  for (const auto& face : faces) {
    Point2 entered{};
    bool inside = false;
    for (std::size_t i = 0; i < 9; ++i) {
      const Vector3f& a = positions[face[i % 4]];
      const Vector3f& b = positions[face[(i + 1) % 4]];
      if ((a.z() >= z_m) == (b.z() >= z_m))
        continue;
      const double t = (double(z_m) - a.z()) / (double(b.z()) - a.z());
      const Point2 p = {a.x() + t * (b.x() - a.x()), a.y() + t * (b.y() - a.y())};
      if (b.z() >= z_m && i < 4) {
        entered = p;
        inside = true;
      } else if (b.z() < z_m && inside) {
        twice += cross(p, entered);
        inside = false;
      }
    }
  }
  return 0.5 * twice;
}

/// Directed edges of a slice's triangles whose opposite is missing: the outline.
std::size_t unmatchedEdges(const LegacySliceMesh& mesh, const LegacySlice& slice) {
  std::map<std::array<float, 4>, int> balance;
  for (std::uint32_t i = slice.first_index; i < slice.first_index + slice.index_count; i += 3) {
    for (std::uint32_t k = 0; k < 3; ++k) {
      const LegacySliceVertex& a = mesh.vertices[mesh.indices[i + k]];
      const LegacySliceVertex& b = mesh.vertices[mesh.indices[i + (k + 1) % 3]];
      ++balance[{a.u, a.v, b.u, b.v}];
      --balance[{b.u, b.v, a.u, a.v}];
    }
  }
  std::size_t unmatched = 0;
  for (const auto& edge : balance)
    unmatched += std::size_t(std::max(0, edge.second));
  return unmatched;
}

/// How many segments the plane draws on the boundary.
std::size_t outlineSegments(const std::vector<std::array<std::uint32_t, 4>>& faces,
                            const std::vector<Vector3f>& positions, float z_m) {
  std::size_t changes = 0;
  for (const auto& face : faces) {
    for (std::size_t i = 0; i < 4; ++i) {
      changes += std::size_t((positions[face[i]].z() >= z_m) != (positions[face[(i + 1) % 4]].z() >= z_m));
    }
  }
  return changes / 2;
}

/// A camera at the origin that looks along z, so that camera frame and volume frame are the same.
Camera identityCamera() {
  return straightCamera(Vector3::Zero());
}

std::vector<Vector3f> jittered(const std::vector<Vector3f>& positions, float distance, std::mt19937& random) {
  std::uniform_real_distribution<float> offset(-distance, distance);
  std::vector<Vector3f> moved = positions;
  for (Vector3f& p : moved)
    p += Vector3f(offset(random), offset(random), offset(random));
  return moved;
}

/// A block of 3^3 unit cells in front of the camera. Each cell numbers its corners from another start, so that
/// neighbours see their common edges in different directions.
Topology makeTurnedBlock() {
  Topology topology = makeBlock(Box3(Vector3(-1.5, -1.5, 2), Vector3(1.5, 1.5, 5)), Vector3i(3, 3, 3));
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    for (const std::size_t half : {8 * cell, 8 * cell + 4}) {
      const auto begin = topology.connectivity.begin() + std::ptrdiff_t(half);
      std::rotate(begin, begin + std::ptrdiff_t(cell % 4), begin + 4);
    }
  }
  return topology;
}

LegacySliceMesh sliceAll(const Camera& camera, const Topology& topology, const std::vector<Vector3f>& positions,
                         int count) {
  Slicer slicer;
  slicer.setTopology(topology);
  slicer.transform(camera, positions);
  const std::array<double, 2> range = slicer.depthRange(camera);
  return slicer.slice(camera, planesThrough(range, range[0], (range[1] - range[0]) / count, count), {});
}

TEST(Slicer, PolygonsOfWarpedCellsTileTheCrossSection) {
  std::printf("seed %u\n", kSeed);
  std::mt19937 random(kSeed);
  const Topology topology = makeTurnedBlock();
  const auto boundary = boundaryFaces(topology);
  ASSERT_EQ(boundary.size(), 54U);
  for (int grid = 0; grid < 40; ++grid) {
    const auto positions = jittered(topology.rest_positions, 0.25F, random);
    const LegacySliceMesh mesh = sliceAll(identityCamera(), topology, positions, 37);
    for (const LegacySlice& slice : mesh.slices) {
      // Pixel coordinates are floats of about 100: 1e-5 pixel is 1e-6 of the area.
      EXPECT_NEAR(areaOf(identityCamera(), mesh, slice), outlineArea(boundary, positions, slice.z_m), 2e-5);
      EXPECT_EQ(unmatchedEdges(mesh, slice), outlineSegments(boundary, positions, slice.z_m)) << "z " << slice.z_m;
    }
  }
}

TEST(Slicer, StronglyWarpedCellsStillMatchTheirNeighbours) {
  std::mt19937 random(kSeed + 1);
  const Topology topology = makeTurnedBlock();
  const auto boundary = boundaryFaces(topology);
  for (int grid = 0; grid < 20; ++grid) {
    // Folded cells: triangles may overlap or turn around, but the outline is still that of the boundary.
    const auto positions = jittered(topology.rest_positions, 0.45F, random);
    const LegacySliceMesh mesh = sliceAll(identityCamera(), topology, positions, 37);
    for (const LegacySlice& slice : mesh.slices) {
      EXPECT_NEAR(areaOf(identityCamera(), mesh, slice), outlineArea(boundary, positions, slice.z_m), 2e-5);
    }
  }
}

TEST(Slicer, AreaOfARotatedBoxIntegratesToItsVolume) {
  const Topology topology = makeBlock(Box3(Vector3(-0.5, -0.4, -0.3), Vector3(0.5, 0.4, 0.3)), Vector3i(5, 4, 3));
  const Camera camera = Camera::lookAt({2.0, 1.5, 2.5}, {0, 0, 0}, {0, 0, 1}, 0.5, 64, 48);
  const LegacySliceMesh mesh = sliceAll(camera, topology, topology.rest_positions, 400);
  double volume = 0.0;
  for (const LegacySlice& slice : mesh.slices)
    volume += areaOf(camera, mesh, slice);
  volume *= double(mesh.slices[1].z_m) - mesh.slices[0].z_m;
  EXPECT_NEAR(volume, 1.0 * 0.8 * 0.6, 2e-5);  // the midpoint rule errs by O(1 / 400^2)
}

TEST(Slicer, VerticesExactlyOnAPlaneCountAsBehindIt) {
  const Topology topology = makeBlock(Box3(Vector3(-1, -1, 1), Vector3(1, 1, 3)), Vector3i(2, 2, 2));
  Slicer slicer;
  slicer.setTopology(topology);
  slicer.transform(identityCamera(), topology.rest_positions);
  // Planes through all three vertex layers: the front layer lies on its plane and has nothing before it.
  const LegacySliceMesh& mesh = slicer.slice(identityCamera(), {1.0, 1.0, 3}, {});
  EXPECT_EQ(mesh.slices[0].index_count, 0U);
  EXPECT_NEAR(areaOf(identityCamera(), mesh, mesh.slices[1]), 4.0, 1e-5);
  EXPECT_NEAR(areaOf(identityCamera(), mesh, mesh.slices[2]), 4.0, 1e-5);
  EXPECT_EQ(mesh.polygon_count, 8U);
}

TEST(Slicer, SkippedCellsAreNotCut) {
  const Topology topology = makeBlock(Box3(Vector3(-1, -1, 1), Vector3(1, 1, 3)), Vector3i(2, 2, 2));
  Slicer slicer;
  slicer.setTopology(topology);
  slicer.transform(identityCamera(), topology.rest_positions);
  const LegacySliceMesh& mesh = slicer.slice(identityCamera(), {1.5, 1.0, 2}, {1, 0, 0, 0, 1, 1, 1, 1});
  EXPECT_NEAR(areaOf(identityCamera(), mesh, mesh.slices[0]), 3.0, 1e-5);
  EXPECT_EQ(mesh.slices[1].index_count, 0U);
}

TEST(Slicer, VerticesCarryTextureAndDirectionsOfTheDeformation) {
  const Topology topology = makeBlock(Box3(Vector3(-1, -1, 1), Vector3(1, 1, 3)), Vector3i(2, 2, 2));
  std::vector<Vector3f> positions = topology.rest_positions;
  for (Vector3f& p : positions)
    p.x() *= 2.0F;  // stretched: texture changes half as fast along x
  Slicer slicer;
  slicer.setTopology(topology);
  slicer.transform(identityCamera(), positions);
  const LegacySliceMesh& mesh = slicer.slice(identityCamera(), {1.25, 1.0, 1}, {});
  ASSERT_FALSE(mesh.vertices.empty());
  for (const LegacySliceVertex& vertex : mesh.vertices) {
    const double x_m = (vertex.u - 31.5) / 100.0 * 1.25;
    EXPECT_NEAR(vertex.texture[0], (x_m + 2.0) / 4.0, 1e-5);
    EXPECT_NEAR(vertex.texture[2], 0.125, 1e-6);
    EXPECT_NEAR(vertex.right[0], 0.25, 1e-6);
    EXPECT_NEAR(vertex.down[1], 0.5, 1e-6);
    EXPECT_NEAR(vertex.view[2], 0.5, 1e-6);
  }
}

TEST(Slicer, PlanesStayWhenTheGridMoves) {
  const SlicePlanes rest = planesThrough({1.0, 2.0}, 1.0, 0.1, 100);
  EXPECT_EQ(rest.count, 10);
  EXPECT_FLOAT_EQ(rest.z(0), 1.05F);
  const SlicePlanes deeper = planesThrough({0.83, 2.21}, 1.0, 0.1, 100);
  EXPECT_EQ(deeper.count, 14);
  EXPECT_FLOAT_EQ(deeper.z(0), 0.85F);
  EXPECT_FLOAT_EQ(deeper.z(2), rest.z(0));
  EXPECT_EQ(planesThrough({0.83, 1e6}, 1.0, 0.1, 40).count, 40);
  EXPECT_EQ(planesThrough({1.06, 1.07}, 1.0, 0.1, 40).count, 0);
}

TEST(Slicer, RefusesUnusableInput) {
  Topology topology = makeBlock(Box3(Vector3(-1, -1, 1), Vector3(1, 1, 3)), Vector3i(1, 1, 1));
  Slicer slicer;
  slicer.setTopology(topology);
  std::vector<Vector3f> positions = topology.rest_positions;
  positions.pop_back();
  EXPECT_THROW(slicer.transform(identityCamera(), positions), InputError);
  positions = topology.rest_positions;
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity(), 1e9F}) {
    positions[3].y() = bad;
    EXPECT_THROW(slicer.transform(identityCamera(), positions), InputError);
  }
  topology.cell_types[0] = CellType::kWedge;
  EXPECT_THROW(slicer.setTopology(topology), InputError);
}

double trianglesArea(const std::vector<LegacySliceVertex>& corners, const std::vector<std::uint32_t>& indices) {
  double area = 0.0;
  for (std::size_t i = 0; i < indices.size(); i += 3) {
    const auto point = [&](std::size_t k) { return Point2{corners[indices[i + k]].u, corners[indices[i + k]].v}; };
    area += 0.5 * std::abs(cross(point(0), point(1)) + cross(point(1), point(2)) + cross(point(2), point(0)));
  }
  return area;
}

TEST(Triangulate, ConcavePolygonsAreCoveredOnceInBothDirections) {
  // A quadrilateral that a fan from its first corner would overdraw, and an L of area 3.
  for (const auto& outline : {std::vector<Point2>{{0, 0}, {4, 0}, {1, 1}, {0, 4}},
                              std::vector<Point2>{{1, 1}, {1, 2}, {0, 2}, {0, 0}, {2, 0}, {2, 1}}}) {
    std::vector<LegacySliceVertex> corners;
    double twice = 0.0;
    for (std::size_t i = 0; i < outline.size(); ++i) {
      corners.push_back({float(outline[i][0]), float(outline[i][1]), {}, {}, {}, {}});
      twice += cross(outline[i], outline[(i + 1) % outline.size()]);
    }
    for (int turn = 0; turn < 2; ++turn) {
      for (std::size_t start = 0; start < corners.size(); ++start) {
        std::vector<std::uint32_t> indices;
        triangulate(corners.data(), int(corners.size()), 0, indices);
        EXPECT_EQ(indices.size(), 3 * (corners.size() - 2));
        EXPECT_NEAR(trianglesArea(corners, indices), std::abs(0.5 * twice), 1e-6);
        std::rotate(corners.begin(), corners.begin() + 1, corners.end());
      }
      std::reverse(corners.begin(), corners.end());
    }
  }
}

/// Vertices of the blunt fin (PLOT3D, big-endian): three dimensions, then all x, all y, all z. Empty when missing.
std::vector<Vector3f> readBluntFin() {
  const char* folder = std::getenv("SOFT_VOLUME_DATA");
  const std::string data = folder != nullptr ? folder : std::string(SOFT_VOLUME_SOURCE_DIR) + "/../shared/data";
  std::ifstream file(data + "/blunt_fin/bluntfinxyz.bin", std::ios::binary);
  std::vector<std::uint8_t> bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  const std::size_t count = 40 * 32 * 32;
  std::vector<Vector3f> points;
  if (bytes.size() < 12 + count * 12)
    return points;
  const auto valueAt = [&](std::size_t number) {
    std::uint32_t bits = 0;
    for (std::size_t i = 0; i < 4; ++i)
      bits = bits << 8 | bytes[12 + number * 4 + i];
    float value = 0.0F;
    std::memcpy(&value, &bits, 4);
    return value;
  };
  for (std::size_t i = 0; i < count; ++i)
    points.emplace_back(valueAt(i), valueAt(count + i), valueAt(2 * count + i));
  return points;
}

TEST(Slicer, BluntFinGivesTheDissertationsPolygonCounts) {
  Topology topology = makeBlock(Box3(Vector3::Zero(), Vector3::Ones()), Vector3i(39, 31, 31));
  topology.rest_positions = readBluntFin();
  if (topology.rest_positions.empty())
    GTEST_SKIP() << "blunt_fin/bluntfinxyz.bin is not under $SOFT_VOLUME_DATA";
  Camera straight = straightCamera({0, 0, -20});
  straight.far_m = 100.0;
  Camera turned = straight;
  turned.T_volume_camera.orientation = Quaternion(Eigen::AngleAxisd(-M_PI / 4, Vector3::UnitY()));
  turned.T_volume_camera.position_m = turned.T_volume_camera.orientation * Vector3(0, 0, -20);
  EXPECT_EQ(sliceAll(straight, topology, topology.rest_positions, 50).polygon_count, 60450U);
  EXPECT_EQ(sliceAll(straight, topology, topology.rest_positions, 100).polygon_count, 120900U);
  EXPECT_EQ(sliceAll(turned, topology, topology.rest_positions, 50).polygon_count, 45463U);
  EXPECT_EQ(sliceAll(turned, topology, topology.rest_positions, 100).polygon_count, 90980U);
}

}  // namespace
}  // namespace soft_volume::core
