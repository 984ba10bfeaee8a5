#include "soft_volume/tool/grasp.h"

#include <gtest/gtest.h>

#include "tissue_fixture.h"
#include "tissue_in_pieces.h"

namespace soft_volume::core {
namespace {

constexpr double kReach = 0.004;
constexpr double kSlip = 2.0;
constexpr double kStiffness = 200.0;
const Vector3 kJaws(0.031, 0.029, kSurfaceZ + 0.002);

PatchContact contactOf(const Tissue& tissue) {
  PatchContact contact(tissue.volume, 0.0);
  contact.update(tissue.topology, tissue.patch);
  return contact;
}

TEST(GraspTest, GripsWhatIsNearestAndPullsInAnyDirection) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Grasp grasp(kReach, kSlip);
  EXPECT_FALSE(grasp.update(field, kJaws, false, kStiffness).holding);
  const Grasp::Hold closed = grasp.update(field, kJaws, true, kStiffness);
  ASSERT_TRUE(closed.holding);
  EXPECT_LT((closed.point_m - Vector3(kJaws.x(), kJaws.y(), kSurfaceZ)).norm(), 2e-6);
  EXPECT_EQ(closed.force_n, Vector3::Zero());
  for (const Vector3& way : {Vector3(0, 0, 0.005), Vector3(0.004, -0.003, 0), Vector3(0, 0, -0.006)}) {
    const Grasp::Hold pulled = grasp.update(field, kJaws + way, true, kStiffness);
    ASSERT_TRUE(pulled.holding);
    EXPECT_LT((pulled.force_n + kStiffness * way).norm(), 1e-9);
    EXPECT_EQ(pulled.point_m, closed.point_m);
    EXPECT_LT((pulled.anchor_m - kJaws).norm(), 1e-12);
  }
  EXPECT_EQ(grasp.update(field, kJaws, true, kStiffness).force_n.norm(), 0.0);  // no energy stays behind
}

TEST(GraspTest, HoldsNothingThatIsOutOfReach) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Grasp grasp(kReach, kSlip);
  const Vector3 far(0.031, 0.029, kSurfaceZ + 1.05 * kReach);
  EXPECT_FALSE(grasp.update(field, far, true, kStiffness).holding);
  // Closed jaws that come to the tissue are no open ones.
  EXPECT_FALSE(grasp.update(field, kJaws, true, kStiffness).holding);
  EXPECT_FALSE(grasp.update(field, kJaws, false, kStiffness).holding);
  EXPECT_TRUE(grasp.update(field, kJaws, true, kStiffness).holding);
}

TEST(GraspTest, LetsGoWhenTheJawsOpenOrSlip) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Grasp grasp(kReach, kSlip);
  const Vector3 up(0, 0, 0.99 * kSlip / kStiffness);
  grasp.update(field, kJaws, true, kStiffness);
  EXPECT_TRUE(grasp.update(field, kJaws + up, true, kStiffness).holding);
  const Grasp::Hold opened = grasp.update(field, kJaws + up, false, kStiffness);
  EXPECT_FALSE(opened.holding);
  EXPECT_FALSE(opened.slipped);
  EXPECT_EQ(opened.force_n, Vector3::Zero());
  grasp.update(field, kJaws, true, kStiffness);
  const Grasp::Hold slipped = grasp.update(field, kJaws + 1.02 * up, true, kStiffness);
  EXPECT_TRUE(slipped.slipped);
  EXPECT_FALSE(slipped.holding);
  EXPECT_EQ(slipped.force_n, Vector3::Zero());
  EXPECT_FALSE(grasp.update(field, kJaws, true, kStiffness).holding);
  EXPECT_FALSE(grasp.update(field, kJaws, true, kStiffness).slipped);
}

TEST(GraspTest, TheGrippedPointMovesWithTheTissue) {
  Tissue tissue = makeFlatHalfSpace();
  PatchContact field = contactOf(tissue);
  Grasp grasp(kReach, kSlip);
  const Vector3 gripped = grasp.update(field, kJaws, true, kStiffness).point_m;
  Matrix3 a;
  a << 1.0, 0.1, 0.02, 0.0, 1.05, 0.03, 0.0, 0.1, 0.95;
  tissue.deform([&](const Vector3& p) { return Vector3(a * p); },
                [](const Vector3&) { return Vector3(0.1, 0.2, 0.3); });
  field.update(tissue.topology, tissue.patch);
  const Grasp::Hold hold = grasp.update(field, kJaws, true, kStiffness);
  ASSERT_TRUE(hold.holding);
  EXPECT_LT((hold.point_m - a * gripped).norm(), 1e-7);
  EXPECT_LT((hold.force_n - kStiffness * (a * gripped - gripped)).norm(), 1e-4);
  EXPECT_LT((hold.velocity_m_s - Vector3(0.1, 0.2, 0.3)).norm(), 1e-6);
}

TEST(GraspTest, ACutPartsItOnlyWhereItHolds) {
  TissueInPieces tissue({6, 6, 6});
  PatchContact field = tissue.contact();
  Grasp grasp(kReach, 10.0 * kSlip);
  const Vector3 jaws = Vector3(2.5, 2.4, 3.3) * kH;
  const Vector3 pulled = jaws + Vector3(0.001, 0.0, 0.0);
  grasp.update(field, jaws, true, kStiffness);
  const Grasp::Hold before = grasp.update(field, pulled, true, kStiffness);
  ASSERT_TRUE(before.holding);
  tissue.cut({squareQuad(Vector3(4.6, 2.4, 3.3) * kH, Vector3::UnitX(), 20.0 * kH)});
  field.update(tissue.topology, tissue.patch);
  const Grasp::Hold after = grasp.update(field, pulled, true, kStiffness);
  ASSERT_TRUE(after.holding);
  EXPECT_LT((after.force_n - before.force_n).norm(), 1e-6);
  tissue.cut({squareQuad(Vector3(2.6, 2.4, 3.3) * kH, Vector3(1.0, 0.1, 0.1), 20.0 * kH)});
  field.update(tissue.topology, tissue.patch);
  const Grasp::Hold parted = grasp.update(field, pulled, true, kStiffness);
  EXPECT_FALSE(parted.holding);
  EXPECT_TRUE(parted.slipped);
}

}  // namespace
}  // namespace soft_volume::core
