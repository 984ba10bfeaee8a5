#include "soft_volume/incision/stroke.h"

#include <gtest/gtest.h>

#include "incision/cut_cases.h"

namespace soft_volume::core {
namespace {

constexpr Stroke::Settings kSettings = {0.5 * kH, 0.2 * kH, 0.03 * kH};

/// The upright edge of a blade at a place of a curved path through a block of 8 x 8 x 3 cells.
SweptQuad sweepBetween(double from, double to) {
  const auto tip = [](double s) -> Vector3 { return Vector3(s, 4.1 + 1.7 * std::sin(s), -1.0) * kH; };
  const Vector3 up = Vector3(0.3, 0.2, 5.0) * kH;
  return {tip(from), tip(from) + up, tip(to) + up, tip(to)};
}

/// The n-th part of the way across the block.
SweptQuad sweepOf(int n, int sweeps) {
  return sweepBetween(-1.0 + 10.0 * n / sweeps, -1.0 + 10.0 * (n + 1) / sweeps);
}

std::vector<SweptQuad> strokeOf(int sweeps) {
  Stroke stroke(kSettings);
  std::vector<SweptQuad> quads;
  for (int n = 0; n < sweeps; ++n)
    stroke.add(sweepOf(n, sweeps), quads);
  stroke.end(quads);
  return quads;
}

TEST(Stroke, QuadsJoinExactlyAndReachFromEndToEnd) {
  for (const int sweeps : {1, 7, 50, 500, 5000}) {
    const std::vector<SweptQuad> quads = strokeOf(sweeps);
    ASSERT_FALSE(quads.empty());
    EXPECT_EQ(quads.front()[0], sweepBetween(-1.0, 0.0)[0]);
    EXPECT_EQ(quads.back()[2], sweepBetween(0.0, 9.0)[2]);
    for (std::size_t n = 1; n < quads.size(); ++n) {
      ASSERT_EQ(quads[n][0], quads[n - 1][3]);
      ASSERT_EQ(quads[n][1], quads[n - 1][2]);
      ASSERT_GE((quads[n - 1][3] - quads[n - 1][0]).norm(), kSettings.least_width_m);
    }
    EXPECT_LE(quads.size(), std::size_t(std::min(sweeps, 60)));
  }
}

TEST(Stroke, AHandsStrokePartsABlockAtAnySpeed) {
  for (const int sweeps : {25, 200, 3000}) {
    CutBlock block({8, 8, 3});
    block.cut(strokeOf(sweeps));
    EXPECT_EQ(islandVolumes(block.mesh).size(), 2U) << sweeps;
    ASSERT_NO_FATAL_FAILURE(expectSound(block));
  }
}

TEST(Stroke, QuadsThatAreCutAsTheyCompletePartABlockLikeOneCall) {
  for (const int sweeps : {25, 200, 3000}) {
    CutBlock whole({8, 8, 3});
    whole.cut(strokeOf(sweeps));

    CutBlock block({8, 8, 3});
    Stroke stroke(kSettings);
    std::size_t calls = 0;
    const auto cutEach = [&](std::vector<SweptQuad>& quads) {
      for (const SweptQuad& quad : quads)
        block.cut({quad}, stroke.lips());
      calls += quads.size();
      quads.clear();
    };
    std::vector<SweptQuad> quads;
    for (int n = 0; n < sweeps; ++n) {
      stroke.add(sweepOf(n, sweeps), quads);
      ASSERT_LE(quads.size(), 2U);
      cutEach(quads);
      EXPECT_LT(stroke.lips().side_of_piece.size(), 120U) << "far lips are forgotten";
    }
    stroke.end(quads);
    cutEach(quads);
    EXPECT_GT(calls, 15U);
    EXPECT_EQ(islandVolumes(block.mesh).size(), 2U) << sweeps;
    ASSERT_NO_FATAL_FAILURE(expectSameMesh(block.mesh, whole.mesh));
    ASSERT_EQ(block.positions_m, whole.positions_m);
  }
}

TEST(Stroke, GoesOnWhereItsJointWasMovedTo) {
  Stroke stroke(kSettings);
  std::vector<SweptQuad> quads;
  EXPECT_FALSE(stroke.joint());
  stroke.add(sweepBetween(0.0, 0.1), quads);
  EXPECT_FALSE(stroke.joint()) << "nothing is cut yet";
  stroke.add(sweepBetween(0.1, 1.0), quads);
  ASSERT_EQ(quads.size(), 1U);
  ASSERT_TRUE(stroke.joint());
  EXPECT_EQ((*stroke.joint())[0], quads[0][3]);
  EXPECT_EQ((*stroke.joint())[1], quads[0][2]);

  CutBlock block({8, 8, 3});
  block.cut(quads, stroke.lips());
  stroke.add(sweepBetween(1.0, 1.1), quads);
  ASSERT_EQ(quads.size(), 1U);
  const std::array<Vector3, 2> moved = {quads[0][3] + Vector3(0, 1e-4, 0), quads[0][2] + Vector3(1e-4, 0, 0)};
  stroke.moveJoint(moved);
  EXPECT_EQ(*stroke.joint(), moved);
  EXPECT_EQ(stroke.lips().edge_m, moved);
  stroke.add(sweepBetween(1.1, 2.0), quads);
  ASSERT_EQ(quads.size(), 2U) << "the same stroke";
  EXPECT_EQ(quads[1][0], moved[0]);
  EXPECT_EQ(quads[1][1], moved[1]);
  EXPECT_EQ(quads[1][3], sweepBetween(1.0, 2.0)[3]);
  stroke.end(quads);
  EXPECT_FALSE(stroke.joint());
}

TEST(Stroke, PartsABlockThatMovesOnBetweenItsQuads) {
  for (const int sweeps : {25, 200}) {
    CutBlock block({8, 8, 3});
    Stroke stroke(kSettings);
    std::vector<SweptQuad> quads;
    Vector3 gone = Vector3::Zero();
    const Vector3 step = Vector3(-0.02, 0.3, 0.1) * kH / 50;
    const auto cut = [&] {
      for (const SweptQuad& quad : quads)
        block.cut({quad}, stroke.lips());
      quads.clear();
      block.deform([&](const Vector3&) { return step * 200.0 / sweeps; });
      gone += step * 200.0 / sweeps;
      block.reach_m = gone.norm();
      if (const auto joint = stroke.joint())
        stroke.moveJoint({(*joint)[0] + step * 200.0 / sweeps, (*joint)[1] + step * 200.0 / sweeps});
    };
    for (int n = 0; n < sweeps; ++n) {
      stroke.add(sweepOf(n, sweeps), quads);
      cut();
    }
    stroke.end(quads);
    cut();
    EXPECT_EQ(islandVolumes(block.mesh).size(), 2U) << sweeps;
    ASSERT_NO_FATAL_FAILURE(expectConsistent(block.mesh));
  }
}

TEST(Stroke, AMovedJointRightAfterAQuadKeepsTheStroke) {
  Stroke stroke(kSettings);
  std::vector<SweptQuad> quads;
  stroke.add(sweepBetween(0.0, 1.0), quads);
  CutBlock block({8, 8, 3});
  block.cut(quads, stroke.lips());
  const std::array<Vector3, 2> moved = {quads[0][3] + Vector3(0, 1e-4, 0), quads[0][2]};
  stroke.moveJoint(moved);
  stroke.add(sweepBetween(1.0, 2.0), quads);
  ASSERT_EQ(quads.size(), 2U);
  EXPECT_EQ(quads[1][0], moved[0]);
  stroke.end(quads);
  EXPECT_EQ(quads.size(), 2U) << "nothing is left";
}

TEST(Stroke, ABladeThatStandsStillGivesNothing) {
  Stroke stroke(kSettings);
  std::vector<SweptQuad> quads;
  for (int n = 0; n < 100; ++n)
    stroke.add(sweepBetween(1.0, 1.0), quads);
  stroke.end(quads);
  EXPECT_TRUE(quads.empty());
}

TEST(Stroke, ASweepElsewhereBeginsANewOne) {
  Stroke stroke(kSettings);
  std::vector<SweptQuad> quads;
  stroke.add(sweepBetween(0.0, 0.1), quads);
  EXPECT_TRUE(quads.empty());
  stroke.add(sweepBetween(3.0, 3.1), quads);
  ASSERT_EQ(quads.size(), 1U);
  EXPECT_EQ(quads[0][2], sweepBetween(0.0, 0.1)[2]);
  stroke.end(quads);
  ASSERT_EQ(quads.size(), 2U);
  EXPECT_EQ(quads[1][0], sweepBetween(3.0, 3.1)[0]);
  stroke.end(quads);
  EXPECT_EQ(quads.size(), 2U);
}

}  // namespace
}  // namespace soft_volume::core
