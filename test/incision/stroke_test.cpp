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
      EXPECT_LT(stroke.lips().side_of_piece.size(), 80U) << "far lips are forgotten";
    }
    stroke.end(quads);
    cutEach(quads);
    EXPECT_GT(calls, 15U);
    EXPECT_EQ(islandVolumes(block.mesh).size(), 2U) << sweeps;
    ASSERT_NO_FATAL_FAILURE(expectSameMesh(block.mesh, whole.mesh));
    ASSERT_EQ(block.positions_m, whole.positions_m);
  }
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
