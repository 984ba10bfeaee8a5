#include "soft_volume/tool/proxy.h"

#include <gtest/gtest.h>

#include <random>

#include "tissue_fixture.h"

namespace soft_volume::core {
namespace {

constexpr double kRadius = 0.003;
constexpr double kDegree = M_PI / 180.0;

PatchContact contactOf(const Tissue& tissue, double threshold = 0.0) {
  PatchContact contact(tissue.volume, threshold);
  contact.update(tissue.topology, tissue.patch);
  return contact;
}

/// Moves the tip straight from one place to another in steps of at most 0.2 mm, as a hand does; returns the last
/// answer.
Contact move(Proxy& tracker, const PatchContact& field, const Vector3& from, const Vector3& to,
             double radius_m = kRadius) {
  const int steps = std::max(1, int(std::ceil((to - from).norm() / 0.0002)));
  Contact contact;
  for (int n = 1; n <= steps; ++n)
    contact = tracker.update(field, from + double(n) / steps * (to - from), radius_m, 0.0);
  return contact;
}

Contact settle(Proxy& tracker, const PatchContact& field, const Vector3& tip, double radius_m = kRadius) {
  Contact contact;
  for (int n = 0; n < 200; ++n)
    contact = tracker.update(field, tip, radius_m, 0.0);
  return contact;
}

double angle(const Vector3& a, const Vector3& b) {
  return std::acos(std::clamp(a.dot(b), -1.0, 1.0));
}

TEST(ProxyTest, HalfSpaceAtRest) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Proxy tracker;
  const Vector3 above(0.031, 0.029, kSurfaceZ + 0.010);
  EXPECT_FALSE(tracker.update(field, above, kRadius, 0.0).touching);
  for (const double depth : {0.0005, 0.002, 0.005, 0.012}) {
    const Contact contact = move(tracker, field, above, {0.031, 0.029, kSurfaceZ + kRadius - depth});
    ASSERT_TRUE(contact.touching) << depth;
    EXPECT_NEAR(contact.penetration_m, depth, 1e-6);
    EXPECT_LT(angle(contact.normal, Vector3::UnitZ()), 0.01 * kDegree);
    EXPECT_LT((contact.surface_point_m - Vector3(0.031, 0.029, kSurfaceZ)).norm(), 1e-6);
    EXPECT_FALSE(contact.patch_too_small);
  }
}

TEST(ProxyTest, TouchesWithinATenthOfTheRadius) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Proxy straight;
  const Contact contact = straight.update(field, {0.031, 0.029, kSurfaceZ + 0.999 * kRadius}, kRadius, 0.0);
  EXPECT_TRUE(contact.touching);
  EXPECT_NEAR(contact.penetration_m, 0.001 * kRadius, 1e-6);
  const Vector3 tilted = Vector3(0.25, 0.15, 1.0).normalized();  // between the directions that are looked into
  const Vector3 point(0.03, 0.03, 0.04);
  const PatchContact tilted_field = contactOf(makeHalfSpace(point, tilted));
  Proxy tracker;
  EXPECT_TRUE(tracker.update(tilted_field, point + 0.9 * kRadius * tilted, kRadius, 0.0).touching);
}

TEST(ProxyTest, TiltedShearedAndCompressedHalfSpace) {
  const Vector3 normal = Vector3(0.3, -0.2, 1.0).normalized();
  const Vector3 point(0.030, 0.030, 0.035);
  Matrix3 a;
  a << 1.0, 0.1, 0.5, 0.0, 1.2, -0.2, 0.0, 0.1, 0.6;
  Tissue tissue = makeHalfSpace(point, normal);
  tissue.deform([&](const Vector3& p) { return Vector3(a * p); });
  const PatchContact field = contactOf(tissue);
  const Vector3 deformed_normal = (a.inverse().transpose() * normal).normalized();
  const Vector3 above = a * point + 0.008 * deformed_normal;
  Proxy tracker;
  const Contact contact = move(tracker, field, above, a * point - 0.006 * deformed_normal);
  ASSERT_TRUE(contact.touching);
  EXPECT_NEAR(contact.penetration_m, 0.006 + kRadius, 2e-6);
  EXPECT_LT(angle(contact.normal, deformed_normal), 0.05 * kDegree);
}

TEST(ProxyTest, SphereFromEverySide) {
  const Vector3 centre(0.032, 0.032, 0.030);
  const double radius = 0.020;
  const auto volume = makeVolume({33, 33, 31}, 0.002, [&](const Vector3& p) { return radius - (p - centre).norm(); });
  const PatchContact field = contactOf(makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007));
  for (const Vector3& way : {Vector3(1, 0, 0), Vector3(-1, 2, 1), Vector3(0.2, -1, -0.8), Vector3(0, 0, 1)}) {
    const Vector3 out = way.normalized();
    Proxy tracker;
    const Contact contact = move(tracker, field, centre + 0.026 * out, centre + 0.015 * out);
    ASSERT_TRUE(contact.touching);
    // Trilinear interpolation of a distance with 2 mm voxels is off by h^2 / (4 R) = 0.05 mm.
    EXPECT_NEAR(contact.penetration_m, 0.005 + kRadius, 6e-5) << out.transpose();
    EXPECT_LT(angle(contact.normal, out), 2.0 * kDegree) << out.transpose();
  }
}

TEST(ProxyTest, NormalFollowsTheTipAroundASphere) {
  const Vector3 centre(0.032, 0.032, 0.030);
  const auto volume = makeVolume({33, 33, 31}, 0.002, [&](const Vector3& p) { return 0.020 - (p - centre).norm(); });
  const PatchContact field = contactOf(makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007));
  Proxy tracker;
  tracker.update(field, centre + 0.021 * Vector3::UnitZ(), kRadius, 0.0);
  double worst = 0.0;
  for (int n = 0; n <= 1500; ++n) {  // 90 degrees in 1.5 s at 1 kHz: 28 mm/s
    const double at = 90.0 * kDegree * n / 1500;
    const Vector3 out(std::sin(at), 0.0, std::cos(at));
    const Contact contact = tracker.update(field, centre + 0.018 * out, kRadius, 0.0);
    ASSERT_TRUE(contact.touching);
    worst = std::max(worst, angle(contact.normal, out));
    EXPECT_NEAR(contact.penetration_m, 0.002 + kRadius, 1e-4);
  }
  EXPECT_LT(worst, 3.0 * kDegree);
}

TEST(ProxyTest, DeepTipKeepsTheSurface) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Proxy tracker;
  const Contact contact = move(tracker, field, {0.03, 0.03, 0.05}, {0.03, 0.03, 0.006});
  ASSERT_TRUE(contact.touching);
  EXPECT_NEAR(contact.penetration_m, 0.034 + kRadius, 1e-6);
  EXPECT_LT(angle(contact.normal, Vector3::UnitZ()), 0.01 * kDegree);
  // Even out of the lattice on the other side.
  const Contact through = move(tracker, field, {0.03, 0.03, 0.006}, {0.03, 0.03, -0.002});
  ASSERT_TRUE(through.touching);
  EXPECT_NEAR(through.penetration_m, 0.042 + kRadius, 1e-6);
}

TEST(ProxyTest, LeavesAndComesBack) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Proxy tracker;
  const Vector3 above(0.03, 0.03, 0.05);
  const Vector3 below(0.03, 0.03, 0.035);
  EXPECT_TRUE(move(tracker, field, above, below).touching);
  EXPECT_TRUE(move(tracker, field, below, {0.03, 0.03, kSurfaceZ + 0.99 * kRadius}).touching);
  EXPECT_FALSE(tracker.update(field, {0.03, 0.03, kSurfaceZ + 1.01 * kRadius}, kRadius, 0.0).touching);
  EXPECT_FALSE(move(tracker, field, {0.03, 0.03, kSurfaceZ + 1.01 * kRadius}, above).touching);
  EXPECT_NEAR(move(tracker, field, above, below).penetration_m, 0.005 + kRadius, 1e-6);
}

// A closed cavity of air 8 mm below the surface, which the tip passes beside and through.
TEST(ProxyTest, ClosedCavityDoesNotSuckTheTip) {
  const Vector3 cavity(0.032, 0.030, 0.026);
  const auto volume = makeVolume(
      {33, 33, 31}, 0.002, [&](const Vector3& p) { return std::min(kSurfaceZ - p.z(), (p - cavity).norm() - 0.006); });
  const PatchContact field = contactOf(makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007));
  ASSERT_FALSE(field.sample(cavity).tissue);
  Proxy tracker;
  double last = 0.0;
  tracker.update(field, {0.030, 0.030, 0.045}, kRadius, 0.0);
  for (double z = 0.0428; z > 0.008; z -= 0.0002) {
    const Contact contact = tracker.update(field, {0.030, 0.030, z}, kRadius, 0.0);
    ASSERT_TRUE(contact.touching) << z;
    EXPECT_NEAR(contact.penetration_m, kSurfaceZ - z + kRadius, 1e-5);
    EXPECT_GT(contact.penetration_m, last);
    EXPECT_LT(angle(contact.normal, Vector3::UnitZ()), 0.1 * kDegree);
    last = contact.penetration_m;
  }
}

// Homogeneous tissue with noise above the threshold everywhere: its gradient points anywhere, but only the surface
// counts.
TEST(ProxyTest, NoiseInsideDoesNotTurnTheForce) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0.0, 20.0);
  const auto volume = makeVolume({33, 33, 31}, 0.002, [&](const Vector3& p) {
    return p.z() <= kSurfaceZ ? 100.0 + std::clamp(noise(random), -60.0, 60.0) : -1000.0;
  });
  const PatchContact field = contactOf(makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007));
  Proxy tracker;
  Contact contact = move(tracker, field, {0.03, 0.03, 0.05}, {0.03, 0.03, 0.030});
  for (int n = 0; n < 500; ++n) {
    contact = tracker.update(field, {0.03 + 0.00001 * n, 0.03, 0.030}, kRadius, 0.0);
    ASSERT_TRUE(contact.touching);
    EXPECT_LT(angle(contact.normal, Vector3::UnitZ()), 10.0 * kDegree);
    EXPECT_NEAR(contact.penetration_m, 0.010 + kRadius, 0.001);
  }
}

// The lattice itself is the surface where cells were left out: all of this volume is tissue.
TEST(ProxyTest, LatticeBoundaryIsASurface) {
  const auto volume = makeVolume({33, 33, 31}, 0.002, [](const Vector3&) { return 100.0; });
  Tissue tissue = makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007);
  Matrix3 a;
  a << 1.0, 0.0, 0.2, 0.0, 1.0, 0.1, 0.3, 0.0, 0.9;
  tissue.deform([&](const Vector3& p) { return Vector3(a * p); });
  const PatchContact field = contactOf(tissue);
  const Vector3 normal = (a.inverse().transpose() * Vector3::UnitZ()).normalized();
  const Vector3 top = a * Vector3(0.030, 0.030, 0.053);
  Proxy tracker;
  move(tracker, field, top + 0.006 * normal, top - 0.004 * normal);
  const Contact contact = settle(tracker, field, top - 0.004 * normal);
  ASSERT_TRUE(contact.touching);
  EXPECT_NEAR(contact.penetration_m, 0.004 + kRadius, 2e-6);
  EXPECT_LT(angle(contact.normal, normal), 0.1 * kDegree);
}

// Steps of one cell: the fitted normal must neither jump to a side face nor chatter while the tip slides along.
TEST(ProxyTest, SteppedLatticeBoundaryIsSmoothed) {
  const auto volume = makeVolume({33, 33, 31}, 0.002, [](const Vector3&) { return 100.0; });
  Tissue tissue = makeTissue(volume, {8, 8, 7}, Vector3::Constant(0.004), 0.007);
  const Vector3 slope = Vector3(1, 0, 1).normalized();
  const Vector3 middle(0.032, 0.032, 0.0285);
  tissue.keepCells([&](const Vector3& centre) { return slope.dot(centre - middle) < 0.0; });
  for (std::int32_t& neighbour : tissue.topology.face_neighbours) {
    const bool kept = neighbour >= 0 && std::binary_search(tissue.patch.cell_ids.begin(), tissue.patch.cell_ids.end(),
                                                           std::uint32_t(neighbour));
    if (!kept)
      neighbour = -1;
  }
  const PatchContact field = contactOf(tissue);
  Proxy tracker;
  const Vector3 along = Vector3(1, 0, -1).normalized();
  const Vector3 start = middle - 0.010 * along;
  move(tracker, field, start + 0.010 * slope, start - 0.006 * slope);
  Vector3 last = settle(tracker, field, start - 0.006 * slope).normal;
  for (int n = 0; n <= 200; ++n) {
    const Contact contact = tracker.update(field, start - 0.006 * slope + 0.0001 * n * along, kRadius, 0.0);
    ASSERT_TRUE(contact.touching);
    EXPECT_LT(angle(contact.normal, slope), 35.0 * kDegree) << n;
    EXPECT_LT(angle(contact.normal, last), 2.1 * kDegree) << n;
    last = contact.normal;
  }
}

// A tip deep below its own sharp dent: there the normal of the nearest surface turns against the tip's motion.
TEST(ProxyTest, DeepBelowASharpDentIsStable) {
  Tissue tissue = makeFlatHalfSpace();
  const Vector3 middle(0.032, 0.032, 0.0);
  tissue.deform([&](const Vector3& p) {
    const double r = (p - middle).head<2>().norm();
    return Vector3(p - Vector3(0, 0, 0.006 * std::exp(-r * r / (2 * 0.008 * 0.008)) * p.z() / kSurfaceZ));
  });
  const PatchContact field = contactOf(tissue);
  Proxy tracker;
  const Vector3 deep(0.032, 0.032, 0.012);
  move(tracker, field, {0.034, 0.031, 0.05}, deep);
  settle(tracker, field, deep);
  const Contact contact = settle(tracker, field, deep);
  ASSERT_TRUE(contact.touching);
  const Vector3 normal = contact.normal;
  for (int n = 0; n < 50; ++n)
    EXPECT_LT(angle(tracker.update(field, deep, kRadius, 0.0).normal, normal), 0.05 * kDegree);
}

TEST(ProxyTest, SurfaceMovesWithTheTissue) {
  Tissue tissue = makeFlatHalfSpace();
  PatchContact field = contactOf(tissue);
  Proxy tracker;
  const Vector3 tip(0.03, 0.03, 0.030);
  move(tracker, field, {0.03, 0.03, 0.05}, tip);
  // The surface goes 9 mm down in one patch, further than the march would see a cavity, and the patch has other cells.
  tissue.keepCells([](const Vector3& centre) { return centre.x() > 0.015; });
  tissue.deform([](const Vector3& p) { return Vector3(p - Vector3(0, 0, 0.009)); },
                [](const Vector3&) { return Vector3(0.01, 0.02, -0.3); });
  field.update(tissue.topology, tissue.patch);
  const Contact contact = tracker.update(field, tip, kRadius, 0.0);
  ASSERT_TRUE(contact.touching);
  EXPECT_NEAR(contact.penetration_m, 0.001 + kRadius, 1e-6);
  EXPECT_LT((contact.surface_velocity_m_s - Vector3(0.01, 0.02, -0.3)).norm(), 1e-6);
}

TEST(ProxyTest, PatchThatDoesNotReachTheSurfaceIsReported) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.keepCells([](const Vector3& centre) { return centre.z() < 0.026; });
  const PatchContact field = contactOf(tissue);
  Proxy tracker;
  const Contact contact = move(tracker, field, {0.03, 0.03, 0.035}, {0.03, 0.03, 0.015});
  ASSERT_TRUE(contact.touching);
  EXPECT_TRUE(contact.patch_too_small);
  EXPECT_LT(contact.penetration_m, kSurfaceZ - 0.015 + kRadius);
}

TEST(ProxyTest, StartInsideLeavesAlongTheShortestWay) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  Proxy tracker;
  const Contact contact = tracker.update(field, {0.03, 0.03, 0.031}, kRadius, 0.0);
  ASSERT_TRUE(contact.touching);
  EXPECT_NEAR(contact.penetration_m, 0.009 + kRadius, 1e-6);
  EXPECT_LT(angle(contact.normal, Vector3::UnitZ()), 0.01 * kDegree);
}

TEST(ProxyTest, NothingToTouchWithoutAPatch) {
  PatchContact field = contactOf(makeFlatHalfSpace());
  Proxy tracker;
  EXPECT_TRUE(tracker.update(field, {0.03, 0.03, 0.031}, kRadius, 0.0).touching);
  field.clear();
  EXPECT_FALSE(tracker.update(field, {0.03, 0.03, 0.031}, kRadius, 0.0).touching);
}

}  // namespace
}  // namespace soft_volume::core
