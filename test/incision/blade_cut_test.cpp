#include "soft_volume/incision/blade_cut.h"

#include <gtest/gtest.h>

#include <cstdio>

#include "incision/cut_cases.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 19970601;

/// Corners of the section of a cell that is cut once; 0 when it was not split.
std::size_t sectionCorners(const CutMesh& mesh) {
  for (const auto& face : mesh.faces()) {
    if (face.opened)
      return face.loop.size();
  }
  return 0;
}

/// A vertical quad (along z) from a to b in the plane of x and y.
SweptQuad wall(double ax, double ay, double bx, double by, double low, double high) {
  return {Vector3(ax, ay, low) * kH, Vector3(ax, ay, high) * kH, Vector3(bx, by, high) * kH, Vector3(bx, by, low) * kH};
}

TEST(BladeCut, AllFiveCasesOfAPlaneThroughAHexahedron) {
  struct Case {
    Vector3 point;
    Vector3 normal;
    std::size_t corners;
    double behind;  // share of the volume
  };
  const Vector3 diagonal(1, 1, 1);
  const std::vector<Case> cases = {
      {{0.4, 0, 0}, diagonal, 3, 0.4 * 0.4 * 0.4 / 6},
      {{0.3, 0, 0}, {1, 0, 0}, 4, 0.3},         // four parallel edges
      {{0.5, 0, 0}, {1, 1, 0.0001}, 4, 0.125},  // two pairs: a wedge is cut off
      {{1.5, 0, 0}, {1, 1, 2}, 5, (1.5 * 1.5 * 1.5 - 2 * 0.5 * 0.5 * 0.5) / 12},
      {{0.5, 0.5, 0.5}, diagonal, 6, 0.5},
  };
  for (const Case& c : cases) {
    CutBlock block({1, 1, 1});
    block.resolution.least_island = 0.0;
    const BladeCutResult result = block.cut({squareQuad(c.point * kH, c.normal, 10 * kH)});
    EXPECT_EQ(result.pieces_split, 1U);
    EXPECT_EQ(result.splits_refused, 0U);
    EXPECT_EQ(result.faces_opened, 1U);
    EXPECT_EQ(sectionCorners(block.mesh), c.corners);
    EXPECT_EQ(result.vertices_added, 2 * c.corners);
    const std::vector<double> volumes = islandVolumes(block.mesh);
    ASSERT_EQ(volumes.size(), 2U);
    EXPECT_NEAR(volumes[0] / std::pow(kH, 3), c.behind, 1e-4);
    ASSERT_NO_FATAL_FAILURE(expectSound(block));
  }
}

TEST(BladeCut, ACellCutThreeTimesFallsIntoEight) {
  CutBlock block({1, 1, 1});
  block.resolution.least_island = 0.0;
  block.cut({squareQuad(Vector3(0.3, 0.5, 0.5) * kH, {1, 0.1, 0.05}, 10 * kH)});
  block.cut({squareQuad(Vector3(0.5, 0.6, 0.5) * kH, {-0.1, 1, 0.2}, 10 * kH)});
  block.cut({squareQuad(Vector3(0.5, 0.5, 0.45) * kH, {0.2, -0.1, 1}, 10 * kH)});
  EXPECT_EQ(block.mesh.pieces().size(), 8U);
  EXPECT_EQ(islandVolumes(block.mesh).size(), 8U);
  ASSERT_NO_FATAL_FAILURE(expectSound(block));
}

TEST(BladeCut, WhatIsTooSmallForAnIslandStays) {
  for (const double size : {0.8, 0.9}) {  // 0.085 and 0.122 h3
    CutBlock block({3, 3, 3});
    block.cut({squareQuad(Vector3(size, 0, 0) * kH, {1, 1, 1}, 10 * kH)});
    EXPECT_EQ(islandVolumes(block.mesh).size(), size < 0.85 ? 1U : 2U);
    ASSERT_NO_FATAL_FAILURE(expectSound(block));
  }
  // A strip 0.5 h long, cut off by a second blade.
  for (const double width : {0.16, 0.3}) {
    CutBlock block({2, 3, 1});
    block.cut({wall(width, -1, width, 0.6, -1, 2)});
    EXPECT_EQ(islandVolumes(block.mesh).size(), 1U);
    const BladeCutResult off = block.cut({wall(-1, 0.5, width + 0.1, 0.5, -1, 2)});
    EXPECT_GT(off.pieces_split, 0U);
    EXPECT_EQ(islandVolumes(block.mesh).size(), width < 0.2 ? 1U : 2U);
    ASSERT_NO_FATAL_FAILURE(expectSound(block));
  }
}

TEST(BladeCut, PlanesThroughFacesEdgesAndVerticesSplitOnlyWhatTheyCross) {
  CutBlock faces({4, 4, 4});
  const BladeCutResult along = faces.cut({squareQuad(Vector3(2, 2, 2) * kH, {1, 0, 0}, 10 * kH)});
  EXPECT_EQ(along.pieces_split, 0U);
  EXPECT_EQ(along.faces_opened, 16U);
  EXPECT_EQ(islandVolumes(faces.mesh).size(), 2U);

  CutBlock edges({4, 4, 4});
  const BladeCutResult through = edges.cut({squareQuad(Vector3(2, 2, 2) * kH, {1, 1, 0}, 10 * kH)});
  EXPECT_EQ(through.pieces_split, 16U);
  EXPECT_EQ(edges.mesh.vertexCount(), 125U + 25U) << "no vertex is made, those of the plane part";
  EXPECT_EQ(islandVolumes(edges.mesh).size(), 2U);
  ASSERT_NO_FATAL_FAILURE(expectSound(edges));
}

TEST(BladeCut, NearVerticesItSnapsToThem) {
  for (const double x : {2.01, 1.99}) {
    CutBlock block({4, 4, 4});
    const BladeCutResult result = block.cut({squareQuad(Vector3(x, 2, 2) * kH, {1, 0, 0}, 10 * kH)});
    EXPECT_EQ(result.pieces_split, 0U);
    EXPECT_EQ(islandVolumes(block.mesh).size(), 2U);
  }
  CutBlock block({4, 4, 4});
  // Crosses some edges at 1 % of their length, others anywhere.
  block.cut({squareQuad(Vector3(2.01, 2, 2) * kH, {1, 0.37, 0.21}, 10 * kH)});
  EXPECT_EQ(islandVolumes(block.mesh).size(), 2U);
  ASSERT_NO_FATAL_FAILURE(expectSound(block));
}

TEST(BladeCut, PlanesPartABlockIntoAsManyIslandsAsTheyShould) {
  CutBlock slabs({6, 4, 4});
  for (const double x : {1.3, 2.5, 4.8})
    slabs.cut({squareQuad(Vector3(x, 2, 2) * kH, {1, 0.05, -0.1}, 10 * kH)});
  EXPECT_EQ(islandVolumes(slabs.mesh).size(), 4U);
  ASSERT_NO_FATAL_FAILURE(expectSound(slabs));
  slabs.cut({squareQuad(Vector3(3, 2.2, 2) * kH, {0.1, 1, 0.3}, 10 * kH)});
  EXPECT_EQ(islandVolumes(slabs.mesh).size(), 8U);
  ASSERT_NO_FATAL_FAILURE(expectSound(slabs));
}

TEST(BladeCut, FourWallsAndAFloorTakeABlockOut) {
  CutBlock block({6, 6, 5});
  const double low = 2.3;
  block.cut({wall(1.4, 1.7, 4.3, 1.7, low, 7), wall(4.3, 1.7, 4.3, 4.6, low, 7), wall(4.3, 4.6, 1.4, 4.6, low, 7),
             wall(1.4, 4.6, 1.4, 1.7, low, 7)});
  EXPECT_EQ(islandVolumes(block.mesh).size(), 1U);
  ASSERT_NO_FATAL_FAILURE(expectSound(block));
  block.cut({{Vector3(1.4, 1.7, low) * kH, Vector3(4.3, 1.7, low) * kH, Vector3(4.3, 4.6, low) * kH,
              Vector3(1.4, 4.6, low) * kH}});
  const std::vector<double> volumes = islandVolumes(block.mesh);
  ASSERT_EQ(volumes.size(), 2U);
  EXPECT_NEAR(volumes[0] / std::pow(kH, 3), 2.9 * 2.9 * (5 - low), 1e-6);
  ASSERT_NO_FATAL_FAILURE(expectSound(block));
}

TEST(BladeCut, ACurvedStrokeOfManySweepsHasNoGap) {
  for (const int sweeps : {8, 16, 24}) {
    CutBlock block({8, 8, 3});
    for (int n = 0; n < sweeps; ++n) {
      const auto x = [&](int i) { return -0.5 + 9.0 * i / sweeps; };
      const auto y = [&](int i) { return 4.1 + 2.3 * std::sin(0.5 * x(i)); };
      block.cut({wall(x(n), y(n), x(n + 1), y(n + 1), -1, 4)});
    }
    EXPECT_EQ(islandVolumes(block.mesh).size(), 2U) << sweeps;
    ASSERT_NO_FATAL_FAILURE(expectSound(block));
  }
}

/// How far opened faces reach along y at most.
double frontOf(const CutMesh& mesh) {
  double farthest = 0.0;
  for (const auto& face : mesh.faces()) {
    for (const std::uint32_t v : face.loop)
      farthest = face.opened ? std::max(farthest, mesh.restPositions()[v].y()) : farthest;
  }
  return farthest;
}

TEST(BladeCut, APartialCutEndsWhereTheBladeEndedAndStaysClosedThere) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<double> part(0.0, 1.0);
  double farthest = 0.0;
  for (int n = 0; n < caseCount(200); ++n) {
    CutBlock block({4, 6, 4});
    const double end = 1.5 + 3.0 * part(random);
    const double tilt = part(random) - 0.5;
    const double x = 1.2 + 1.6 * part(random);
    // The blade leans, goes along y and reaches through the top.
    const Vector3 low = Vector3(x - tilt, 0, 0.7 + part(random)) * kH;
    const Vector3 high = Vector3(x + tilt, 0, 6) * kH;
    const Vector3 go = Vector3::UnitY() * kH;
    const BladeCutResult result = block.cut({{low - go, high - go, high + end * go, low + end * go}});
    ASSERT_GT(result.faces_opened, 0U);
    ASSERT_EQ(islandVolumes(block.mesh).size(), 1U);
    farthest = std::max(farthest, std::abs(frontOf(block.mesh) / kH - end));
    ASSERT_NO_FATAL_FAILURE(expectSound(block));
  }
  std::printf("front within %.3f h of the blade's end\n", farthest);
  EXPECT_LT(farthest, 0.5);
}

TEST(BladeCut, EnergyIsOpenedAreaTimesTheMeanResistanceOfBothSides) {
  CutBlock block({4, 3, 3});
  block.materials = {block.materials[0], block.materials[0], block.materials[0]};
  block.materials[0].cut_resistance_j_m2 = 100.0;
  block.materials[1].cut_resistance_j_m2 = 300.0;
  block.materials[2].cut_resistance_j_m2 = 50.0;
  for (std::uint32_t c = 0; c < block.lattice.cellCount(); ++c)
    block.lattice.materials[c] = c % 4 == 2 ? 1 : c % 4 == 3 ? 2 : 0;
  const double area = 9 * kH * kH;
  const BladeCutResult between = block.cut({squareQuad(Vector3(2, 2, 2) * kH, {1, 0, 0}, 10 * kH)});
  EXPECT_NEAR(between.opened_area_m2, area, 1e-9 * area);
  EXPECT_NEAR(between.opened_energy_j, 200.0 * area, 1e-6 * area);
  // The tissue is stretched to twice its length: areas are those at rest.
  block.deform([](const Vector3& p) { return Vector3(p); });
  const BladeCutResult inside = block.cut({squareQuad(Vector3(7.2, 4, 4) * kH, {1, 0, 0}, 20 * kH)});
  EXPECT_NEAR(inside.opened_area_m2, area, 1e-9 * area);
  EXPECT_NEAR(inside.opened_energy_j, 50.0 * area, 1e-6 * area);
}

TEST(BladeCut, IgnoresWhatIsNoCut) {
  CutBlock block({3, 3, 3});
  const Vector3 p(1.2 * kH, 1.3 * kH, 1.1 * kH);
  const Vector3 u(5 * kH, 0, 0);
  EXPECT_EQ(block.cut({{p, p, p, p}}).pieces_split, 0U) << "a point";
  EXPECT_EQ(block.cut({{p - u, p + u, p + u, p - u}}).pieces_split, 0U) << "a blade that stands still";
  EXPECT_EQ(block.cut({squareQuad(100.0 * u, {1, 2, 3}, kH)}).pieces_split, 0U) << "a miss";
  block.materials[0].fixed = true;
  const BladeCutResult bone = block.cut({squareQuad(p, {1, 2, 3}, 10 * kH)});
  EXPECT_EQ(bone.pieces_split + bone.faces_opened + bone.vertices_added, 0U);
  EXPECT_TRUE(bone.rest_box_m.isEmpty());
}

}  // namespace
}  // namespace soft_volume::core
