#include <gtest/gtest.h>

#include <cstdio>
#include <map>
#include <numeric>

#include "incision/embedded_block.h"
#include "render/cell_grids.h"
#include "soft_volume/render/grid_slicer.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 19970602;
constexpr int kBlocks = caseCount(50);
constexpr int kCutsOfBlock = 20;
constexpr int kCells = 8;

/// Quads that are bad for a mesh: through vertices, edges and faces exactly, at 1 % and 99 % of edges, oblique and
/// along axes, much smaller and much larger than the block, and warped.
class RandomQuads {
 public:
  explicit RandomQuads(unsigned seed) : random_(seed) {}

  SweptQuad next() {
    const double half_m = kH * (random_() % 4 == 0 ? 20.0 : range(0.3, 2.5));
    SweptQuad quad = squareQuad(middle(), normal(), half_m, range(0.0, 3.0));
    if (random_() % 4 == 0) {
      for (Vector3& p : quad)
        p += range(0.0, 0.2) * half_m * Vector3(range(-1, 1), range(-1, 1), range(-1, 1));
    }
    return quad;
  }

 private:
  double range(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_); }
  Vector3 middle() {
    Vector3 p(range(0, kCells), range(0, kCells), range(0, kCells));
    const double share = std::array<double, 4>{0.0, 0.01, 0.99, 0.5}[random_() % 4];
    if (random_() % 2 == 0)
      p = p.array().floor() + share;
    return p * kH;
  }
  Vector3 normal() {
    switch (random_() % 4) {
      case 0:
        return Vector3::Unit(int(random_() % 3));
      case 1:
        return {double(random_() % 2), double(random_() % 2), 1.0};
      default:
        return {range(-1, 1), range(-1, 1), range(-1, 1) + 0.01};
    }
  }

  std::mt19937 random_;
};

/// The number of parts, by flooding from piece to piece over faces with the same corners: knows nothing of the mesh's
/// own pairing. Lips whose corners all lie on the incision's front have the same corners, too.
std::size_t countIslands(const CutMesh& mesh) {
  std::map<std::vector<std::uint32_t>, std::vector<std::uint32_t>> owners;
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p) {
    for (auto loop : mesh.loopsOf(p)) {
      std::sort(loop.begin(), loop.end());
      owners[loop].push_back(p);
    }
  }
  std::vector<std::uint32_t> part(mesh.pieces().size());
  std::iota(part.begin(), part.end(), 0U);
  for (bool changed = true; changed;) {
    changed = false;
    for (const auto& entry : owners) {
      for (const std::uint32_t p : entry.second) {
        const std::uint32_t low = std::min(part[p], part[entry.second[0]]);
        changed |= part[p] != low || part[entry.second[0]] != low;
        part[p] = part[entry.second[0]] = low;
      }
    }
  }
  std::set<std::uint32_t> parts(part.begin(), part.end());
  return parts.size();
}

/// Closed faces: both pieces run along the same corners in opposite directions.
void expectPairsFit(const CutMesh& mesh) {
  for (std::uint32_t f = 0; f < mesh.faces().size(); ++f) {
    const auto& owners = mesh.faces()[f].pieces;
    if (owners[1] == CutMesh::kNone)
      continue;
    auto back = mesh.outwardLoop(f, std::uint32_t(owners[1]));
    std::reverse(back.begin(), back.end());
    ASSERT_EQ(back, mesh.outwardLoop(f, std::uint32_t(owners[0])));
  }
}

TEST(RandomCuts, AThousandLeaveSoundPieces) {
  std::printf("seed %u\n", kSeed);
  std::size_t splits = 0;
  std::size_t refused = 0;
  std::size_t most_pieces = 0;
  std::size_t islands = 0;
  double least_island = HUGE_VAL;
  MeshExtremes worst;
  double volume_error = 0.0;
  for (int n = 0; n < kBlocks; ++n) {
    CutBlock block(Vector3i::Constant(kCells));
    RandomQuads quads(kSeed + unsigned(n));
    for (int c = 0; c < kCutsOfBlock; ++c) {
      const BladeCutResult result = block.cut({quads.next()});
      splits += result.pieces_split;
      refused += result.splits_refused;
    }
    SCOPED_TRACE(n);
    const MeshExtremes extremes = extremesOf(block.mesh);
    ASSERT_NO_FATAL_FAILURE(expectSound(block, extremes));
    ASSERT_NO_FATAL_FAILURE(expectPairsFit(block.mesh));
    worst.shortest_edge_m = std::min(worst.shortest_edge_m, extremes.shortest_edge_m);
    worst.least_width_m = std::min(worst.least_width_m, extremes.least_width_m);
    worst.deepest_dent_m = std::max(worst.deepest_dent_m, extremes.deepest_dent_m);
    volume_error = std::max(volume_error, std::abs(totalVolume(block.mesh) / block.size().prod() - 1.0));
    const std::size_t parts = islandVolumes(block.mesh).size();
    ASSERT_EQ(parts, countIslands(block.mesh));
    least_island = std::min(least_island, islandVolumes(block.mesh)[0]);
    ASSERT_GE(least_island, (block.resolution.least_island - 1e-9) * std::pow(kH, 3));
    islands += parts;
    most_pieces = std::max(most_pieces, block.mesh.pieces().size());
  }
  std::printf(
      "%zu splits, %zu refused, at most %zu pieces, %zu islands of %.2f h3 and more; shortest edge %.4f h, least width "
      "%.4f h, "
      "deepest dent %.4f h, volume within %.1e\n",
      splits, refused, most_pieces, islands, least_island / std::pow(kH, 3), worst.shortest_edge_m / kH,
      worst.least_width_m / kH, worst.deepest_dent_m / kH, volume_error);
  EXPECT_GT(splits, 500U * kBlocks);
}

/// The part of a polygon where coordinate `axis` times `sign` is at most `most`.
std::vector<Vector3> clip(const std::vector<Vector3>& polygon, int axis, double sign, double most) {
  std::vector<Vector3> kept;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Vector3& p = polygon[i];
    const Vector3& q = polygon[(i + 1) % polygon.size()];
    const double at_p = most - sign * p[axis];
    const double at_q = most - sign * q[axis];
    if (at_p >= 0.0)
      kept.push_back(p);
    if ((at_p >= 0.0) != (at_q >= 0.0))
      kept.push_back(p + at_p / (at_p - at_q) * (q - p));
  }
  return kept;
}

double areaOf(const std::vector<Vector3>& polygon) {
  std::vector<std::uint32_t> loop(polygon.size());
  std::iota(loop.begin(), loop.end(), 0U);
  return polygon.size() < 3 ? 0.0 : 0.5 * areaVector(polygon, loop).norm();
}

TEST(RandomCuts, OpenWhatTheBladePassedAndNothingElse) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> part(0.0, 1.0);
  double worst = 0.0;
  double farthest = 0.0;
  std::size_t splits = 0;
  std::size_t refused = 0;
  for (int n = 0; n < caseCount(200); ++n) {
    const Vector3 middle(kCells * part(random), kCells * part(random), kCells * part(random));
    const Vector3 normal(part(random) - 0.5, part(random) - 0.5, part(random) - 0.5001);
    const double half = 0.5 + 4.0 * part(random);
    const SweptQuad quad = squareQuad(middle * kH, normal, half * kH, part(random));
    CutBlock block(Vector3i::Constant(kCells));
    const BladeCutResult result = block.cut({quad});
    splits += result.pieces_split;
    refused += result.splits_refused;
    std::vector<Vector3> passed(quad.begin(), quad.end());
    for (int axis = 0; axis < 3; ++axis)
      passed = clip(clip(passed, axis, 1.0, kCells * kH), axis, -1.0, 0.0);
    double opened = 0.0;
    for (const auto& face : block.mesh.faces()) {
      if (!face.opened)
        continue;
      std::vector<Vector3> corners;
      for (const std::uint32_t v : face.loop) {
        corners.push_back(block.mesh.restPositions()[v]);
        farthest = std::max(farthest, std::abs(normal.normalized().dot(corners.back() - middle * kH)) / kH);
      }
      opened += 0.5 * areaOf(corners);
    }
    EXPECT_NEAR(result.opened_area_m2, opened, 1e-12 * kH * kH);
    // The border of the opened area may lie two and a half snap distances beside the blade's.
    const double border = 8 * half * 2.5 * block.resolution.snap;
    const double error = std::abs(opened - areaOf(passed)) / (kH * kH);
    worst = std::max(worst, error / border);
    EXPECT_LT(error, border) << "cut " << n << ": " << opened / areaOf(passed);
  }
  std::printf("area within %.2f of the bound, %zu of %zu splits refused, lips within %.3f h of the blade's plane\n",
              worst, refused, splits, farthest);
  // Where a split was refused the lips run around the cell.
  EXPECT_LT(farthest, 0.5);
  EXPECT_LE(refused, splits / 500 + 1);
}

TEST(RandomCuts, DeformedTissueKeepsItsRestShape) {
  for (int n = 0; n < caseCount(8); ++n) {
    CutBlock block(Vector3i::Constant(kCells));
    // Sheared, bent and twisted: cells are warped, and one step of x follows up to half a step of z.
    block.deform([](const Vector3& p) {
      const Vector3 q = p / (kCells * kH) * 3.0;
      return Vector3(0.5 * p.z() + 0.6 * kH * std::sin(2 * q.y()), 0.8 * kH * std::sin(2 * q.x()),
                     0.7 * kH * std::sin(q.x() + 2 * q.y()));
    });
    RandomQuads quads(kSeed + 200 + unsigned(n));
    std::size_t splits = 0;
    for (int c = 0; c < kCutsOfBlock; ++c)
      splits += block.cut({quads.next()}).pieces_split;
    EXPECT_GT(splits, 100U);
    SCOPED_TRACE(n);
    ASSERT_NO_FATAL_FAILURE(expectSound(block));
    ASSERT_NO_FATAL_FAILURE(expectPairsFit(block.mesh));
    ASSERT_EQ(islandVolumes(block.mesh).size(), countIslands(block.mesh));
  }
}

TEST(RandomCuts, ManySmallOnesInOnePlaceStaySound) {
  CutBlock block(Vector3i::Constant(3));
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> part(0.0, 3.0);
  std::size_t splits = 0;
  for (int n = 0; n < 40 + caseCount(110); ++n) {
    const Vector3 middle(part(random), part(random), part(random));
    const Vector3 normal(part(random) - 1.5, part(random) - 1.5, part(random) - 1.49);
    splits += block.cut({squareQuad(middle * kH, normal, 0.6 * kH, part(random))}).pieces_split;
  }
  std::printf("%zu splits, %zu pieces, %zu islands\n", splits, block.mesh.pieces().size(),
              islandVolumes(block.mesh).size());
  ASSERT_NO_FATAL_FAILURE(expectSound(block));
  ASSERT_NO_FATAL_FAILURE(expectPairsFit(block.mesh));
}

TEST(RandomCuts, RepeatBitForBit) {
  std::vector<CutMesh> meshes;
  for (int n = 0; n < 2; ++n) {
    CutBlock block(Vector3i::Constant(kCells));
    RandomQuads quads(kSeed);
    for (int c = 0; c < kCutsOfBlock; ++c)
      block.cut({quads.next()});
    meshes.push_back(block.mesh);
  }
  ASSERT_NO_FATAL_FAILURE(expectSameMesh(meshes[0], meshes[1]));
}

CellGrid gridOf(const CutMesh& mesh) {
  CellGrid grid;
  for (const Vector3& p : mesh.restPositions())
    grid.addPoint((p / kH).cast<float>());
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p)
    addPolyhedron(grid, mesh.loopsOf(p));
  return grid;
}

/// Crossings of a horizontal ray with a polygon, and how near the point is to its border.
struct Hit {
  bool inside = false;
  bool at_border = false;
};
Hit hit(const SliceMesh& mesh, const SlicePolygon& polygon, double u, double v, double border = 0.01) {
  Hit found;
  for (std::uint32_t i = 0; i < polygon.size; ++i) {
    const SliceVertex& a = mesh.vertices[mesh.corners[polygon.first + i]];
    const SliceVertex& b = mesh.vertices[mesh.corners[polygon.first + (i + 1) % polygon.size]];
    if ((a.v > v) != (b.v > v) && u < (double(b.u) - a.u) * (v - a.v) / (double(b.v) - a.v) + a.u)
      found.inside = !found.inside;
    const Eigen::Vector2d along(double(b.u) - a.u, double(b.v) - a.v);
    const Eigen::Vector2d to(u - a.u, v - a.v);
    const double t = along.squaredNorm() > 0.0 ? std::clamp(to.dot(along) / along.squaredNorm(), 0.0, 1.0) : 0.0;
    found.at_border |= (to - t * along).norm() < border;
  }
  return found;
}

TEST(RandomCuts, SlicesTileTheCrossSection) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> part(-1.0, 1.0);
  std::uniform_real_distribution<double> pixel(0.0, 1000.0);
  std::size_t tested = 0;
  for (int n = 0; n < caseCount(10); ++n) {
    CutBlock block(Vector3i::Constant(kCells));
    RandomQuads quads(kSeed + 100 + unsigned(n));
    for (int c = 0; c < kCutsOfBlock; ++c)
      block.cut({quads.next()});
    const CellGrid grid = gridOf(block.mesh);
    const Vector3 target = Vector3::Constant(kCells / 2.0);
    const Vector3 direction = Vector3(part(random), part(random), part(random) + 0.01).normalized();
    Camera camera = Camera::lookAtParallel(target + 40.0 * direction, target, Vector3(0.1, 0.2, 1.0), 16.0, 1000, 1000);
    camera.far_m = 100.0;
    GridSlicer slicer;
    slicer.setCells(grid.types, grid.offsets, grid.connectivity, grid.points.size());
    slicer.transform(camera, grid.points, 1);
    const auto range = slicer.depthRange(camera);
    slicer.bucket(camera, planesThrough(range, range[0], (range[1] - range[0]) / 15, 15), {},
                  {-1000000, -1000000, 1000000, 1000000}, false);
    SliceMesh mesh;
    slicer.slice(0, slicer.planeCount(), 1, mesh);
    for (const Slice& slice : mesh.slices) {
      for (int i = 0; i < 100; ++i) {
        const double u = pixel(random);
        const double v = pixel(random);
        const Vector3 p =
            camera.T_volume_camera * Vector3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, slice.z_m);
        const Vector3 margin = (p - target).cwiseAbs();
        if (std::abs(margin.maxCoeff() - kCells / 2.0) < 1e-3)
          continue;
        int covering = 0;
        bool at_border = false;
        for (std::uint32_t k = 0; k < slice.polygon_count; ++k) {
          const Hit found = hit(mesh, mesh.polygons[slice.first_polygon + k], u, v);
          covering += found.inside ? 1 : 0;
          at_border |= found.at_border;
        }
        if (at_border)
          continue;
        ASSERT_EQ(covering, margin.maxCoeff() < kCells / 2.0 ? 1 : 0) << "block " << n << " z " << slice.z_m;
        ++tested;
      }
    }
  }
  EXPECT_GT(tested, std::size_t(caseCount(10000)));
}

/// How often the surface of a mesh, lips included, winds around a point: the sum of the solid angles of its triangles
/// (Van Oosterom and Strackee, 1983).
double windingNumber(const CutMesh& mesh, const std::vector<Vector3>& positions, const Vector3& p) {
  double angle = 0.0;
  for (const CutMesh::Face& face : mesh.faces()) {
    if (face.pieces[1] != CutMesh::kNone)
      continue;
    for (std::size_t i = 2; i < face.loop.size(); ++i) {
      const Vector3 a = positions[face.loop[0]] - p;
      const Vector3 b = positions[face.loop[i - 1]] - p;
      const Vector3 c = positions[face.loop[i]] - p;
      const double below =
          a.norm() * b.norm() * c.norm() + a.dot(b) * c.norm() + b.dot(c) * a.norm() + c.dot(a) * b.norm();
      angle += 2.0 * std::atan2(a.dot(b.cross(c)), below);
    }
  }
  return angle / (4.0 * M_PI);
}

/// Bent, and every vertex of the lattice and its copies moved a little: lips gape here and press into each other there.
std::vector<Vector3> deformed(const EmbeddedBlock& block, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> move(0.0, 0.04);
  std::vector<Vector3> nodes;
  for (const Vector3& rest_m : block.lattice.rest_positions) {
    const Vector3 p = rest_m / kH;
    nodes.push_back(p + Vector3(0.4 * std::sin(0.7 * p.y()), 0.3 * std::sin(0.8 * p.z()), 0.3 * std::sin(0.9 * p.x())) +
                    Vector3(move(random), move(random), move(random)));
  }
  std::vector<Vector3> positions;
  for (std::uint32_t v = 0; v < block.mesh.vertexCount(); ++v)
    positions.push_back(block.embedding.place(block.mesh, block.lattice, nodes, v));
  return positions;
}

TEST(RandomCuts, SlicesOfDeformedTissueShowWhatItsSurfaceEncloses) {
  constexpr double kNear = 3.0;  // pixels: slices run straight across warped faces, the surface is triangles
  constexpr int kSide = 5;
  std::size_t inside = 0;
  std::size_t outside = 0;
  double farthest = 0.0;
  for (unsigned n = 0; n < unsigned(caseCount(6)); ++n) {
    std::mt19937 random(kSeed + 300 + n);
    EmbeddedBlock block(Vector3i::Constant(kSide));
    cutAtRandom(block, 5, random);
    const std::vector<Vector3> positions = deformed(block, kSeed + n);
    CellGrid grid = gridOf(block.mesh);
    for (std::size_t v = 0; v < positions.size(); ++v) {
      farthest = std::max(farthest, (positions[v] - block.mesh.restPositions()[v] / kH).norm());
      grid.points[v] = positions[v].cast<float>();
    }
    const Vector3 target = Vector3::Constant(kSide / 2.0);
    Camera camera =
        Camera::lookAtParallel(target + Vector3(9, 14, 25 + int(n)), target, Vector3::UnitY(), 10, 600, 600);
    camera.far_m = 100.0;
    GridSlicer slicer;
    slicer.setCells(grid.types, grid.offsets, grid.connectivity, grid.points.size());
    slicer.transform(camera, grid.points, 1);
    const auto range = slicer.depthRange(camera);
    slicer.bucket(camera, planesThrough(range, range[0], (range[1] - range[0]) / 9, 9), {},
                  {-1000000, -1000000, 1000000, 1000000}, false);
    SliceMesh mesh;
    slicer.slice(0, slicer.planeCount(), 1, mesh);
    std::uniform_real_distribution<double> pixel(100.0, 500.0);
    for (const Slice& slice : mesh.slices) {
      for (int i = 0; i < 60; ++i) {
        const double u = pixel(random);
        const double v = pixel(random);
        int covering = 0;
        bool at_border = false;
        for (std::uint32_t k = 0; k < slice.polygon_count; ++k) {
          const Hit found = hit(mesh, mesh.polygons[slice.first_polygon + k], u, v, kNear);
          covering += found.inside ? 1 : 0;
          at_border |= found.at_border;
        }
        if (at_border)
          continue;
        const Vector3 p =
            camera.T_volume_camera * Vector3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, slice.z_m);
        const double winding = windingNumber(block.mesh, positions, p);
        ASSERT_NEAR(winding, std::lround(winding), 1e-6);
        ASSERT_EQ(covering, std::lround(winding)) << "block " << n << ", " << p.transpose();
        ++(covering > 0 ? inside : outside);
      }
    }
  }
  std::printf("%zu points inside, %zu outside; vertices moved by up to %.2f h\n", inside, outside, farthest);
  EXPECT_GT(inside, std::size_t(caseCount(500)));
  EXPECT_GT(outside, std::size_t(caseCount(200)));
  EXPECT_GT(farthest, 0.3);
}

}  // namespace
}  // namespace soft_volume::core
