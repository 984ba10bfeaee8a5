// A probe at the lips of an incision.

#include <gtest/gtest.h>

#include "soft_volume/tool/proxy.h"
#include "soft_volume/tool/tool.h"
#include "tissue_in_pieces.h"

namespace soft_volume::core {
namespace {

constexpr double kRadius = 0.003;
constexpr double kDegree = M_PI / 180.0;
constexpr double kPlane = 3.63 * kH;  // the incision's, which no face of the lattice lies in
constexpr double kSkin = 5.4 * kH;
constexpr double kMiddle = 3.03 * kH;  // along the incision

double depthBelowSkin(const Vector3& p) {
  return 1000.0 * (kSkin - p.z());
}

double angle(const Vector3& a, const Vector3& b) {
  return std::acos(std::clamp(a.dot(b), -1.0, 1.0));
}

/// A block with skin on top, cut along x = kPlane from above down to a height.
class LipContactTest : public testing::Test {
 protected:
  void cutDownTo(double bottom_m) {
    const double y = tissue_.block.size().y() + kH;
    tissue_.cut({{Vector3(kPlane, -kH, bottom_m), Vector3(kPlane, -kH, 7.0 * kH), Vector3(kPlane, y, 7.0 * kH),
                  Vector3(kPlane, y, bottom_m)}});
    bottom_m_ = bottom_m;
    ASSERT_GT(tissue_.polyhedra(), 20U);
  }
  /// Walls that stay upright, where the block is cut through.
  void openTo(double gap_m) {
    tissue_.part(kPlane, [&](const Vector3&, int side) { return Vector3(0.5 * gap_m * side, 0.0, 0.0); });
    field_.update(tissue_.topology, tissue_.patch);
  }
  /// A wedge that is as wide as this at the skin.
  void openWedgeTo(double gap_m) {
    tissue_.part(kPlane, [&](const Vector3& p, int side) {
      const double share = std::max(0.0, (p.z() - bottom_m_) / (kSkin - bottom_m_));
      return Vector3(0.5 * gap_m * share * side, 0.0, 0.0);
    });
    field_.update(tissue_.topology, tissue_.patch);
  }
  /// In steps of at most 0.1 mm.
  Contact move(const Vector3& from, const Vector3& to) {
    const int steps = std::max(1, int(std::ceil((to - from).norm() / 0.0001)));
    for (int n = 1; n <= steps; ++n)
      contact_ = tracker_.update(field_, from + double(n) / steps * (to - from), kRadius, 0.0);
    return contact_;
  }
  /// -1 or 1: the lip that the contact is on.
  int lip() const {
    const auto at = field_.locate(contact_.surface_point_m);
    return at.found() ? (tissue_.middleOf(field_.cellId(at.cell)).x() < kPlane ? -1 : 1) : 0;
  }

  TissueInPieces tissue_{{7, 6, 6}, depthBelowSkin};
  PatchContact field_{tissue_.volume, 0.0};
  Proxy tracker_;
  Contact contact_;
  double bottom_m_ = 0.0;
};

TEST_F(LipContactTest, PassesBetweenOpenLipsAndPressesTheOneBesideIt) {
  cutDownTo(-kH);
  openTo(0.010);
  const Vector3 above(kPlane, kMiddle, kSkin + 0.008);
  const Vector3 between(kPlane + 0.001, kMiddle, 3.0 * kH);
  for (const int side : {-1, 1}) {
    tracker_.reset();
    EXPECT_FALSE(move(above, between).touching);
    const Vector3 pressing(kPlane + side * 0.006, kMiddle, between.z());
    move(between, pressing);
    ASSERT_TRUE(contact_.touching);
    EXPECT_EQ(lip(), side);
    EXPECT_LT(angle(contact_.normal, -side * Vector3::UnitX()), 0.1 * kDegree);
    EXPECT_NEAR(contact_.penetration_m, 0.001 + kRadius, 1e-6);
    EXPECT_NEAR(contact_.surface_point_m.x(), kPlane + side * 0.005, 1e-6);
    EXPECT_FALSE(contact_.patch_too_small);
    EXPECT_FALSE(move(pressing, between).touching);
  }
}

TEST_F(LipContactTest, StaysOnItsLipHoweverNearTheOtherComes) {
  cutDownTo(-kH);
  for (const int side : {-1, 1}) {
    tracker_.reset();
    openTo(0.010);
    const Vector3 tip(kPlane + side * 0.003, kMiddle, 3.0 * kH);
    move({kPlane, kMiddle, 3.0 * kH}, tip);
    ASSERT_TRUE(contact_.touching);
    for (double gap = 0.010; gap > -0.0002; gap -= 0.00005) {  // in the end the lips lie in each other by 0.2 mm
      openTo(gap);
      contact_ = tracker_.update(field_, tip, kRadius, 0.0);
      ASSERT_TRUE(contact_.touching) << gap;
      ASSERT_NEAR(contact_.penetration_m, 0.003 + kRadius - 0.5 * gap, 2e-6) << gap;
      ASSERT_LT(angle(contact_.normal, -side * Vector3::UnitX()), 0.5 * kDegree) << gap;
    }
    const auto at = field_.locateIn(field_.cellOfId(field_.cellId(field_.locate(tip).cell)), tip);
    EXPECT_TRUE(at.found());
  }
}

TEST_F(LipContactTest, TheForceGoesToThePressedLip) {
  cutDownTo(-kH);
  openTo(0.010);
  ToolConfig config;
  config.tip_radius_m = kRadius;
  config.device = deviceLimits("touch");
  Tool tool(config);
  tool.setVolume(tissue_.volume);
  tool.setTopology(std::make_shared<const Topology>(tissue_.topology));
  ToolInput input;
  ToolOutput output;
  for (int n = 0; n < 1500; ++n) {
    const double x = std::min(0.006, n * 0.00001);
    input.pose.position_m = {kPlane + x, kMiddle, 3.0 * kH};
    input.time_s = input.pose_time_s = n * 0.001;
    if (n % 20 == 0)
      tool.setPatch(tissue_.patch);
    output = tool.update(input);
  }
  ASSERT_TRUE(output.force.has_value());
  EXPECT_NEAR(output.force->force_n.x(), output.coupling_stiffness_n_m * (0.001 + kRadius), 1e-4);
  EXPECT_LT(output.force->force_n.tail<2>().norm(), 0.01 * output.force->force_n.x());
  contact_ = output.contact;
  EXPECT_EQ(lip(), 1);
  EXPECT_EQ(output.force->point_m, contact_.surface_point_m);
  ASSERT_TRUE(output.force->cell.has_value());
  EXPECT_GT(tissue_.middleOf(*output.force->cell).x(), kPlane);
}

TEST_F(LipContactTest, ASphereRestsOnTheRimsOfANarrowOpening) {
  cutDownTo(-kH);
  for (const double gap : {0.00002, 0.0001, 0.0003, 0.001}) {
    openTo(gap);
    for (const double across : {0.0, 0.7}) {
      tracker_.reset();
      const double y = kMiddle + across * 0.003;
      const double depth = 0.002;
      double least = 1.0;
      for (double x = -0.006; x <= 0.006; x += 0.0000501) {
        const Vector3 tip(kPlane + x, y + across * x, kSkin + kRadius - depth);
        if (x < -0.0059)
          move(tip + Vector3(0.0, 0.0, 0.004), tip);
        contact_ = tracker_.update(field_, tip, kRadius, 0.0);
        ASSERT_TRUE(contact_.touching) << gap << " " << x;
        ASSERT_LT(contact_.penetration_m, depth + 2e-6);
        ASSERT_LT(angle(contact_.normal, Vector3::UnitZ()), 5.0 * kDegree) << gap << " " << x;
        least = std::min(least, contact_.penetration_m);
      }
      EXPECT_GT(least, depth - 0.12 * kRadius) << gap;
    }
  }
}

TEST_F(LipContactTest, FirstTouchOverANarrowOpeningIsFelt) {
  cutDownTo(-kH);
  openTo(0.0005);
  move({kPlane, kMiddle, kSkin + 0.008}, {kPlane, kMiddle, kSkin + kRadius - 0.003});
  ASSERT_TRUE(contact_.touching);
  EXPECT_LT(angle(contact_.normal, Vector3::UnitZ()), 10.0 * kDegree);
  EXPECT_NEAR(contact_.penetration_m, 0.003, 0.12 * kRadius);
}

TEST_F(LipContactTest, ClosedLipsFeelLikeUncutSkin) {
  cutDownTo(2.0 * kH);
  const TissueInPieces uncut({7, 6, 6}, depthBelowSkin);
  const PatchContact whole = uncut.contact();
  field_.update(tissue_.topology, tissue_.patch);
  Proxy tracker;
  for (int n = 0; n < 400; ++n) {
    const Vector3 tip(kPlane - 0.006 + 0.00003 * n, kMiddle, kSkin + kRadius + 0.004 - 0.00002 * n);
    const Contact a = tracker_.update(field_, tip, kRadius, 0.0);
    const Contact b = tracker.update(whole, tip, kRadius, 0.0);
    ASSERT_EQ(a.touching, b.touching);
    EXPECT_NEAR(a.penetration_m, b.penetration_m, 1e-6);
    EXPECT_LT((a.normal - b.normal).norm(), 1e-3);
  }
}

TEST_F(LipContactTest, AWedgeIsFeltWithoutJumps) {
  cutDownTo(1.5 * kH);
  openWedgeTo(0.008);
  const Vector3 from(kPlane + 0.0004, kMiddle, kSkin + 0.004);
  double before = 0.0;
  double deepest = 0.0;
  for (int n = 0; n <= 1500; ++n) {
    contact_ = tracker_.update(field_, from - Vector3(0.0, 0.0, 0.00001 * n), kRadius, 0.0);
    const double now = contact_.touching ? contact_.penetration_m : 0.0;
    ASSERT_LT(std::abs(now - before), 0.3 * kRadius) << n;
    before = now;
    deepest = std::max(deepest, now);
  }
  EXPECT_GT(deepest, 0.0005);
  EXPECT_LT(deepest, 0.015);
  EXPECT_NE(lip(), 0);
}

TEST_F(LipContactTest, AContactOutlivesCutsElsewhere) {
  cutDownTo(-kH);
  openTo(0.010);
  const Vector3 pressing(kPlane + 0.006, kMiddle, 3.0 * kH);
  move({kPlane, kMiddle, 3.0 * kH}, pressing);
  const Contact before = contact_;
  const double y = 1.4 * kH;
  tissue_.cut({{Vector3(kPlane + 0.004, y, -kH), Vector3(kPlane + 0.004, y, 7.0 * kH), Vector3(8.0 * kH, y, 7.0 * kH),
                Vector3(8.0 * kH, y, -kH)}});
  field_.update(tissue_.topology, tissue_.patch);
  contact_ = tracker_.update(field_, pressing, kRadius, 0.0);
  ASSERT_TRUE(contact_.touching);
  EXPECT_NEAR(contact_.penetration_m, before.penetration_m, 1e-6);
  EXPECT_LT(angle(contact_.normal, before.normal), 3.0 * kDegree);
}

}  // namespace
}  // namespace soft_volume::core
