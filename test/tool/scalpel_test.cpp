#include "soft_volume/tool/scalpel.h"

#include <gtest/gtest.h>

#include "tissue_fixture.h"

namespace soft_volume::core {
namespace {

constexpr double kBlade = 0.010;
constexpr double kMinMove = 0.0005;
constexpr double kMillisecond = 0.001;

class ScalpelTest : public testing::Test {
 protected:
  ScalpelTest() { field_.update(tissue_.topology, tissue_.patch); }

  void cutAt(const Vector3& tip, const Quaternion& orientation = Quaternion::Identity()) {
    const Scalpel::Sweep sweep = scalpel_.cut(field_, {tip, orientation});
    if (sweep.quad)
      quads_.push_back(*sweep.quad);
    ends_ += sweep.ended ? 1 : 0;
  }
  /// Draws the blade from one place to another at a speed, a pose every millisecond.
  void draw(const Vector3& from, const Vector3& to, double speed_m_s) {
    const int steps = std::max(1, int(std::lround((to - from).norm() / (speed_m_s * kMillisecond))));
    for (int n = 0; n <= steps; ++n)
      cutAt(from + double(n) / steps * (to - from));
  }
  void expectNoGaps() const {
    for (std::size_t q = 1; q < quads_.size(); ++q) {
      EXPECT_EQ(quads_[q][0], quads_[q - 1][3]) << "tip of quad " << q;
      EXPECT_EQ(quads_[q][1], quads_[q - 1][2]) << "heel of quad " << q;
    }
  }

  Tissue tissue_ = makeFlatHalfSpace();
  PatchContact field_{tissue_.volume, 0.0};
  Scalpel scalpel_{kBlade, kMinMove};
  std::vector<SweptQuad> quads_;
  int ends_ = 0;
};

TEST_F(ScalpelTest, SweepsJoinWithoutGapsAtEverySpeed) {
  const Vector3 from(0.010, 0.030, kSurfaceZ - 0.004);
  const Vector3 to(0.050, 0.030, kSurfaceZ - 0.004);
  for (const double speed : {0.002, 0.02, 0.1, 0.9}) {
    quads_.clear();
    scalpel_.lift();
    draw(from, to, speed);
    ASSERT_FALSE(quads_.empty()) << speed;
    expectNoGaps();
    EXPECT_EQ(quads_.front()[0], from);
    EXPECT_LT((quads_.back()[3] - to).norm(), kMinMove) << speed;
    for (const SweptQuad& quad : quads_) {
      EXPECT_GE((quad[3] - quad[0]).norm(), kMinMove);
      EXPECT_NEAR((quad[1] - quad[0]).norm(), kBlade, 1e-12);
      EXPECT_NEAR(quad[2].z() - quad[3].z(), kBlade, 1e-12);
    }
  }
}

TEST_F(ScalpelTest, StillBladeCutsNothing) {
  for (int n = 0; n < 5000; ++n)
    cutAt({0.030 + 0.0002 * std::sin(0.01 * n), 0.030, 0.035});
  EXPECT_TRUE(quads_.empty());
  EXPECT_TRUE(scalpel_.inTissue());
}

TEST_F(ScalpelTest, SlowMovesAddUp) {
  for (int n = 0; n <= 80; ++n)
    cutAt({0.030 + 0.00001 * n, 0.030, 0.035});
  ASSERT_EQ(quads_.size(), 1U);
  EXPECT_NEAR((quads_[0][3] - quads_[0][0]).norm(), kMinMove, 1.1e-5);
}

TEST_F(ScalpelTest, TurningOnTheSpotCuts) {
  for (int n = 0; n <= 50; ++n) {
    cutAt({0.030, 0.030, 0.035}, Quaternion(Eigen::AngleAxisd(0.01 * n, Vector3::UnitY())));
  }
  EXPECT_FALSE(quads_.empty());
  expectNoGaps();
}

TEST_F(ScalpelTest, NothingIsCutInAir) {
  draw({0.010, 0.030, 0.045}, {0.050, 0.030, 0.045}, 0.1);
  EXPECT_TRUE(quads_.empty());
  EXPECT_FALSE(scalpel_.inTissue());
}

TEST_F(ScalpelTest, StrokeFromAirCutsTheSkin) {
  draw({0.020, 0.030, 0.045}, {0.030, 0.030, 0.035}, 0.3);
  ASSERT_FALSE(quads_.empty());
  expectNoGaps();
  EXPECT_GT(quads_.front()[0].z(), kSurfaceZ);
  EXPECT_LT(quads_.front()[0].z(), kSurfaceZ + 0.001);
}

TEST_F(ScalpelTest, FastBladeDoesNotJumpOverThinTissue) {
  const auto sheet = makeVolume({33, 33, 31}, 0.002, [](const Vector3& p) { return 0.003 - std::abs(p.x() - 0.030); });
  tissue_ = makeTissue(sheet, {8, 8, 7}, Vector3::Constant(0.004), 0.007);
  field_ = PatchContact(sheet, 0.0);
  field_.update(tissue_.topology, tissue_.patch);
  cutAt({0.020, 0.030, 0.030});
  cutAt({0.040, 0.030, 0.030});
  ASSERT_EQ(quads_.size(), 1U);
  EXPECT_EQ(quads_[0][3], Vector3(0.040, 0.030, 0.030));
}

TEST_F(ScalpelTest, LeavingTheTissueEndsAStrokeOnce) {
  draw({0.020, 0.030, 0.035}, {0.030, 0.030, 0.035}, 0.1);
  EXPECT_EQ(ends_, 0);
  draw({0.030, 0.030, 0.035}, {0.035, 0.030, 0.045}, 0.1);
  draw({0.035, 0.030, 0.045}, {0.035, 0.030, 0.050}, 0.1);
  EXPECT_EQ(ends_, 1);
  EXPECT_FALSE(scalpel_.lift());
  draw({0.035, 0.030, 0.050}, {0.035, 0.030, 0.035}, 0.1);  // in again: another stroke
  EXPECT_EQ(ends_, 1);
  EXPECT_TRUE(scalpel_.lift());
  EXPECT_FALSE(scalpel_.lift());
}

TEST_F(ScalpelTest, AGapIsCrossedInOneStrokeUnlessItIsWide) {
  for (const double width : {0.003, 0.009}) {
    const auto lips =
        makeVolume({33, 33, 31}, 0.001, [&](const Vector3& p) { return std::abs(p.x() - 0.016) - 0.5 * width; });
    tissue_ = makeTissue(lips, {8, 8, 7}, Vector3::Constant(0.002), 0.0035);
    field_ = PatchContact(lips, 0.0);
    field_.update(tissue_.topology, tissue_.patch);
    scalpel_.lift();
    quads_.clear();
    ends_ = 0;
    draw({0.004, 0.015, 0.010}, {0.028, 0.015, 0.010}, 0.05);
    EXPECT_EQ(ends_, width < 0.005 ? 0 : 1);
    EXPECT_TRUE(scalpel_.lift());
    if (ends_ == 0)
      expectNoGaps();
    double cut = 0.0;
    for (const SweptQuad& quad : quads_)
      cut += (quad[3] - quad[0]).norm();
    EXPECT_GT(cut, ends_ == 0 ? 0.023 : 0.018);
  }
}

TEST_F(ScalpelTest, BladeThatDidNotCutHasNoStrokeToEnd) {
  cutAt({0.030, 0.030, 0.035});
  EXPECT_FALSE(scalpel_.lift());
  draw({0.010, 0.030, 0.045}, {0.050, 0.030, 0.045}, 0.1);
  EXPECT_EQ(ends_, 0);
  EXPECT_FALSE(scalpel_.lift());
}

TEST_F(ScalpelTest, LiftedBladeStartsANewStroke) {
  draw({0.010, 0.030, 0.035}, {0.020, 0.030, 0.035}, 0.1);
  const std::size_t before = quads_.size();
  scalpel_.lift();
  EXPECT_FALSE(scalpel_.inTissue());
  cutAt({0.040, 0.030, 0.035});
  EXPECT_EQ(quads_.size(), before);  // nothing between the two strokes
  draw({0.040, 0.030, 0.035}, {0.045, 0.030, 0.035}, 0.1);
  ASSERT_GT(quads_.size(), before);
  EXPECT_EQ(quads_[before][0], Vector3(0.040, 0.030, 0.035));
}

}  // namespace
}  // namespace soft_volume::core
