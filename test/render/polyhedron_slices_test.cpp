#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <set>

#include "render/cell_grids.h"
#include "soft_volume/render/grid_slicer.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 20240612;
constexpr PixelRect kEverywhere = {-1000000, -1000000, 1000000, 1000000};

/// One cell, and whether a point lies in it.
struct Solid {
  CellGrid grid;
  std::function<bool(const Vector3&)> holds;
};

/// Whether cube (i, j, k), which reaches from there to one more, belongs to the solid.
using IsFull = std::function<bool(int, int, int)>;

/// The union of unit cubes as one polyhedron, a face for every outer side of a cube: dents, tunnels and cavities.
Solid makeCubes(const Vector3i& size, const IsFull& isFull) {
  const auto full = [=](const Vector3i& c) {
    return (c.array() >= 0).all() && (c.array() < size.array()).all() && isFull(c.x(), c.y(), c.z());
  };
  Solid solid;
  std::map<std::array<int, 3>, std::uint32_t> numbers;
  const auto number = [&](const Vector3i& p) {
    const auto [place, is_new] = numbers.insert({{p.x(), p.y(), p.z()}, 0});
    if (is_new)
      place->second = solid.grid.addPoint(p.cast<float>());
    return place->second;
  };
  Faces faces;
  const CellShape& shape = shapeOf(CellType::kVoxel);
  const std::array<Vector3i, 6> outward = {Vector3i(-1, 0, 0), {1, 0, 0}, {0, -1, 0}, {0, 1, 0}, {0, 0, -1}, {0, 0, 1}};
  for (int i = 0; i < size.prod(); ++i) {
    const Vector3i cube(i % size.x(), i / size.x() % size.y(), i / size.x() / size.y());
    if (!full(cube))
      continue;
    for (std::size_t f = 0; f < 6; ++f) {
      if (full(cube + outward[f]))
        continue;
      std::vector<std::uint32_t> face;
      for (const std::uint8_t v : shape.faces[f])
        face.push_back(number(cube + Vector3i(v & 1, v >> 1 & 1, v >> 2)));
      faces.push_back(face);
    }
  }
  addPolyhedron(solid.grid, faces);
  solid.holds = [=](const Vector3& p) { return full(p.array().floor().matrix().cast<int>()); };
  return solid;
}

/// A prism over an outline (counter-clockwise) of integer points from z = 0 to 1.
Solid makePrism(const std::vector<std::array<double, 2>>& outline) {
  Solid solid;
  const auto size = std::uint32_t(outline.size());
  for (const float z : {0.0F, 1.0F}) {
    for (const auto& p : outline)
      solid.grid.addPoint({float(p[0]), float(p[1]), z});
  }
  Faces faces(2);
  for (std::uint32_t i = 0; i < size; ++i) {
    faces[0].insert(faces[0].begin(), i);
    faces[1].push_back(size + i);
    faces.push_back({i, (i + 1) % size, size + (i + 1) % size, size + i});
  }
  addPolyhedron(solid.grid, faces);
  solid.holds = [outline](const Vector3& p) {
    bool inside = false;
    for (std::size_t i = 0; i < outline.size(); ++i) {
      const auto& a = outline[i];
      const auto& b = outline[(i + 1) % outline.size()];
      if ((a[1] > p.y()) != (b[1] > p.y()) && p.x() < (b[0] - a[0]) * (p.y() - a[1]) / (b[1] - a[1]) + a[0])
        inside = !inside;
    }
    return inside && p.z() > 0.0 && p.z() < 1.0;
  };
  return solid;
}

const std::vector<std::array<double, 2>> kComb = {{0, 0}, {7, 0}, {7, 3}, {6, 3}, {6, 1}, {5, 1}, {5, 4}, {4, 4},
                                                  {4, 1}, {3, 1}, {3, 3}, {2, 3}, {2, 1}, {1, 1}, {1, 5}, {0, 5}};

Camera randomCamera(std::mt19937& random) {
  std::uniform_real_distribution<double> part(-1.0, 1.0);
  const Vector3 target(1.93, 2.04, 0.89);  // no plane through a vertex: there loops may touch
  Vector3 direction;
  do
    direction = Vector3(part(random), part(random), part(random));
  while (direction.norm() < 0.1);
  Camera camera =
      Camera::lookAtParallel(target + 20.0 * direction.normalized(), target, Vector3(0.1, 0.2, 1.0), 10.0, 1000, 1000);
  camera.far_m = 100.0;
  return camera;
}

bool isInside(const SliceMesh& mesh, const SlicePolygon& polygon, double u, double v) {
  bool inside = false;
  for (std::uint32_t i = 0; i < polygon.size; ++i) {
    const SliceVertex& a = mesh.vertices[mesh.corners[polygon.first + i]];
    const SliceVertex& b = mesh.vertices[mesh.corners[polygon.first + (i + 1) % polygon.size]];
    if ((a.v > v) != (b.v > v) && u < (double(b.u) - a.u) * (v - a.v) / (double(b.v) - a.v) + a.u)
      inside = !inside;
  }
  return inside;
}

/// Whether the solid begins or ends within a hundredth of a pixel, where rounding decides.
bool isAtBorder(const Solid& solid, const Camera& camera, double u, double v, double z_m) {
  int held = 0;
  for (const double du : {-0.01, 0.01}) {
    for (const double dv : {-0.01, 0.01}) {
      const Vector3 p((u + du - camera.cx) / camera.fx, (v + dv - camera.cy) / camera.fy, z_m);
      held += solid.holds(camera.T_volume_camera * p) ? 1 : 0;
    }
  }
  return held % 4 != 0;
}

/// Fails where a polygon covers what is not in the solid, where none covers what is, or two do.
void expectCovered(const Solid& solid, const Camera& camera, std::mt19937& random, std::size_t* most_loops) {
  GridSlicer slicer;
  slicer.setCells(solid.grid.types, solid.grid.offsets, solid.grid.connectivity, solid.grid.points.size());
  slicer.transform(camera, solid.grid.points, 1);
  const auto range = slicer.depthRange(camera);
  slicer.bucket(camera, planesThrough(range, range[0], (range[1] - range[0]) / 13, 13), {}, kEverywhere, false);
  SliceMesh mesh;
  slicer.slice(0, slicer.planeCount(), 1, mesh);
  std::uniform_real_distribution<double> place(100.0, 900.0);
  for (const Slice& slice : mesh.slices) {
    *most_loops = std::max(*most_loops, std::size_t(slice.polygon_count));
    for (int i = 0; i < 300; ++i) {
      const double u = place(random);
      const double v = place(random);
      if (isAtBorder(solid, camera, u, v, slice.z_m))
        continue;
      const Vector3 p((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, slice.z_m);
      int covering = 0;
      for (std::uint32_t k = 0; k < slice.polygon_count; ++k)
        covering += isInside(mesh, mesh.polygons[slice.first_polygon + k], u, v) ? 1 : 0;
      ASSERT_EQ(covering, solid.holds(camera.T_volume_camera * p) ? 1 : 0)
          << "u " << u << " v " << v << " z " << slice.z_m << " loops " << slice.polygon_count;
    }
  }
}

void expectCoveredFromAllSides(const Solid& solid, std::mt19937& random, std::size_t loops) {
  std::size_t most_loops = 0;
  for (int view = 0; view < 40; ++view)
    expectCovered(solid, randomCamera(random), random, &most_loops);
  EXPECT_GE(most_loops, loops);
}

TEST(PolyhedronSlices, ConcaveFacesGiveSeveralLoops) {
  std::printf("seed %u\n", kSeed);
  std::mt19937 random(kSeed);
  expectCoveredFromAllSides(makePrism({{0, 0}, {3, 0}, {3, 3}, {2, 3}, {2, 1}, {1, 1}, {1, 3}, {0, 3}}), random, 2);
  expectCoveredFromAllSides(makePrism({{0, 0}, {3, 0}, {3, 1}, {1, 1}, {1, 4}, {0, 4}}), random, 1);
  expectCoveredFromAllSides(makePrism(kComb), random, 4);
}

TEST(PolyhedronSlices, DentsTunnelsAndCavitiesAreLeftOpen) {
  std::mt19937 random(kSeed + 1);
  // Each slice through a hole is cut apart, which gives two polygons or more.
  expectCoveredFromAllSides(makeCubes({3, 3, 3}, [](int i, int j, int k) { return i != 1 || j != 1 || k == 0; }),
                            random, 2);
  expectCoveredFromAllSides(makeCubes({3, 3, 1}, [](int i, int j, int) { return i != 1 || j != 1; }), random, 2);
  expectCoveredFromAllSides(makeCubes({3, 3, 3}, [](int i, int j, int k) { return i != 1 || j != 1 || k != 1; }),
                            random, 2);
  expectCoveredFromAllSides(makeCubes({5, 5, 3}, [](int i, int j, int) { return i % 2 == 0 || j % 2 == 0; }), random,
                            5);
}

constexpr int kSide = 4;
using Cubes = std::array<std::array<std::array<bool, kSide>, kSide>, kSide>;

/// Fills a cube where two cubes have an edge in common and no other cube is there: a plane leaves two loops there that
/// touch, which is not a solid's border. Says whether there was one.
bool fillAtTouchingEdge(Cubes& cubes) {
  for (int i = 0; i < kSide * kSide * kSide; ++i) {
    for (int axis = 0; axis < 3; ++axis) {
      const Vector3i low(i % kSide, i / kSide % kSide, i / kSide / kSide);
      const Vector3i a = low + Vector3i::Unit((axis + 1) % 3);
      const Vector3i b = low + Vector3i::Unit((axis + 2) % 3);
      const Vector3i both = a + b - low;
      if (both.maxCoeff() >= kSide)
        continue;
      const auto at = [&](const Vector3i& p) -> bool& {
        return cubes[std::size_t(p.x())][std::size_t(p.y())][std::size_t(p.z())];
      };
      if (at(low) == at(both) && at(a) == at(b) && at(low) != at(a)) {
        at(low) = at(a) = true;
        return true;
      }
    }
  }
  return false;
}

TEST(PolyhedronSlices, AnyUnionOfCubesIsCovered) {
  std::mt19937 random(kSeed + 2);
  for (int round = 0; round < 200 && !HasFatalFailure(); ++round) {
    Cubes cubes{};
    for (auto& plane : cubes) {
      for (auto& row : plane)
        std::generate(row.begin(), row.end(), [&] { return random() % 100 < 40; });
    }
    while (fillAtTouchingEdge(cubes)) {
    }
    const Solid solid = makeCubes({kSide, kSide, kSide}, [&](int i, int j, int k) {
      return cubes[std::size_t(i)][std::size_t(j)][std::size_t(k)];
    });
    std::size_t loops = 0;
    for (int view = 0; view < 4 && !HasFatalFailure(); ++view)
      expectCovered(solid, randomCamera(random), random, &loops);
  }
}

/// How many sides of a slice's polygons have no opposite.
std::size_t unmatchedSides(const SliceMesh& mesh, const Slice& slice) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> balance;
  for (std::uint32_t i = slice.first_polygon; i < slice.first_polygon + slice.polygon_count; ++i) {
    const SlicePolygon& polygon = mesh.polygons[i];
    for (std::uint32_t k = 0; k < polygon.size; ++k) {
      const std::uint32_t a = mesh.corners[polygon.first + k];
      const std::uint32_t b = mesh.corners[polygon.first + (k + 1) % polygon.size];
      balance[std::minmax(a, b)] += a < b ? 1 : -1;
    }
  }
  std::size_t unmatched = 0;
  for (const auto& side : balance)
    unmatched += std::size_t(std::abs(side.second));
  return unmatched;
}

/// Two combs one behind the other and hexahedra between their teeth, all warped: the combs' common face has sixteen
/// corners.
TEST(PolyhedronSlices, WarpedNeighboursFitAtConcaveFaces) {
  std::mt19937 random(kSeed + 3);
  CellGrid grid;
  const auto size = std::uint32_t(kComb.size());
  for (const float z : {0.0F, 1.0F, 2.0F}) {
    for (const auto& p : kComb)
      grid.addPoint({float(p[0]), float(p[1]), z});
  }
  for (const std::uint32_t layer : {0U, size}) {
    Faces faces(2);
    for (std::uint32_t i = 0; i < size; ++i) {
      faces[0].insert(faces[0].begin(), layer + i);
      faces[1].push_back(layer + size + i);
      faces.push_back({layer + i, layer + (i + 1) % size, layer + size + (i + 1) % size, layer + size + i});
    }
    addPolyhedron(grid, faces);
    for (const std::uint32_t gap : {3U, 7U, 11U}) {
      const std::uint32_t g = layer + gap;  // right edge's top, right bottom, left bottom, left top
      addHexahedron(grid, {g + 2, g + 1, g, g + 3, g + 2 + size, g + 1 + size, g + size, g + 3 + size});
    }
  }
  const auto outer = boundaryFaces(grid.types, grid.offsets, grid.connectivity);
  const auto signChanges = [&](const std::vector<Vector3f>& positions, float z_m) {
    std::size_t changes = 0;
    for (const GridFace& wanted : outer) {
      forEachFace(grid.types[wanted.cell], &grid.connectivity[grid.offsets[wanted.cell]],
                  [&](std::size_t number, const std::uint32_t* face, std::size_t corners) {
                    for (std::size_t i = 0; number == wanted.face && i < corners; ++i) {
                      changes += std::size_t((positions[face[i]].z() >= z_m) !=
                                             (positions[face[(i + 1) % corners]].z() >= z_m));
                    }
                  });
    }
    return changes;
  };
  for (int view = 0; view < 100; ++view) {
    const Camera camera = randomCamera(random);
    GridSlicer slicer;
    slicer.setCells(grid.types, grid.offsets, grid.connectivity, grid.points.size());
    slicer.transform(camera, jittered(grid.points, view < 50 ? 0.05F : 0.6F, random), 1);
    const auto range = slicer.depthRange(camera);
    slicer.bucket(camera, planesThrough(range, range[0], (range[1] - range[0]) / 21, 21), {}, kEverywhere, false);
    SliceMesh mesh;
    slicer.slice(0, slicer.planeCount(), 1, mesh);
    for (const Slice& slice : mesh.slices) {
      const std::size_t outline = signChanges(slicer.positions(), slice.z_m) / 2;
      const std::size_t unmatched = unmatchedSides(mesh, slice);
      // Where the outside itself is folded, two of its faces may have the same line, which cancels.
      ASSERT_TRUE(view < 50 ? unmatched == outline : unmatched <= outline && (outline - unmatched) % 2 == 0)
          << "view " << view << ": " << unmatched << " of " << outline;
    }
  }
}

}  // namespace
}  // namespace soft_volume::core
