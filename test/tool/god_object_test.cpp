// What the spring between a tip and its proxy may do, and what the proxy may not.

#include <gtest/gtest.h>

#include <iostream>
#include <random>

#include "soft_volume/tool/proxy.h"
#include "tissue_fixture.h"
#include "tissue_in_pieces.h"

namespace soft_volume::core {
namespace {

constexpr double kRadius = 0.003;
constexpr double kTick = 0.001;

Tissue makeBlock(const Field& intensity) {
  return makeTissue(makeVolume({33, 33, 31}, 0.002, intensity), {8, 8, 7}, Vector3::Constant(0.004), 0.007);
}

/// A smooth deformation that bends the surface and the cells' faces.
Vector3 bend(const Vector3& p) {
  return {p.x() + 0.002 * std::sin(90.0 * p.z()), p.y() + 0.001 * std::cos(60.0 * p.x()),
          p.z() + 0.003 * std::sin(90.0 * p.x()) * std::cos(70.0 * p.y())};
}

/// A tip, its proxy and what the spring of 1 N/m between them does.
class Hand {
 public:
  explicit Hand(const PatchContact& field, double friction = 0.0) : field_(&field), friction_(friction) {}

  void on(const PatchContact& field) { field_ = &field; }
  const Contact& go(const Vector3& tip_m) {
    const Vector3 before = force();
    contact_ = proxy_.update(*field_, tip_m, kRadius, friction_);
    const Vector3 move = has_tip_ ? Vector3(tip_m - tip_m_) : Vector3(0.0, 0.0, 0.0);
    tip_m_ = tip_m;
    has_tip_ = true;
    work_ += 0.5 * (before + force()).dot(move);
    change_ = (force() - before).norm();
    return contact_;
  }
  /// In steps of at most `step_m`.
  template <typename See>
  void go(const Vector3& to_m, double step_m, const See& see) {
    const Vector3 from_m = tip_m_;
    const int steps = std::max(1, int(std::ceil((to_m - from_m).norm() / step_m)));
    for (int n = 1; n <= steps; ++n) {
      go(from_m + double(n) / steps * (to_m - from_m));
      see();
    }
  }
  void go(const Vector3& to_m, double step_m) {
    go(to_m, step_m, [] {});
  }

  const Contact& contact() const { return contact_; }
  const Vector3& tip() const { return tip_m_; }
  Vector3 force() const { return contact_.touching ? Vector3(contact_.proxy_m - tip_m_) : Vector3(0.0, 0.0, 0.0); }
  /// Of the newest tick.
  double change() const { return change_; }
  /// That the hand got from the spring.
  double work() const { return work_; }

 private:
  const PatchContact* field_;
  double friction_;
  Proxy proxy_;
  Contact contact_;
  Vector3 tip_m_ = Vector3::Zero();
  bool has_tip_ = false;
  double change_ = 0.0;
  double work_ = 0.0;
};

PatchContact contactOf(const Tissue& tissue) {
  PatchContact contact(tissue.volume, 0.0);
  contact.update(tissue.topology, tissue.patch);
  return contact;
}

double depthOfSheet(const Vector3& p, double middle_m, double thickness_m) {
  return 1000.0 * (0.5 * thickness_m - std::abs(p.z() - middle_m));
}

TEST(GodObjectTest, NeverPassesThroughThinTissue) {
  Tissue tissue = makeBlock([](const Vector3& p) { return depthOfSheet(p, 0.030, 0.003); });
  tissue.deform(bend);
  const PatchContact field = contactOf(tissue);
  std::mt19937 random(4);
  std::uniform_real_distribution<double> number(-1.0, 1.0);
  for (const double step : {0.0001, 0.001, 0.01}) {  // at 1 kHz: 0.1, 1 and 10 m/s
    Hand hand(field, 0.2);
    hand.go({0.032, 0.032, 0.045});
    for (int n = 0; n < 60; ++n) {
      const Vector3 to(0.032 + 0.012 * number(random), 0.032 + 0.012 * number(random), 0.022 + 0.013 * number(random));
      hand.go(to, step, [&] {
        if (!hand.contact().touching)
          return;
        const auto below = field.locate(hand.contact().proxy_m - 0.0035 * Vector3::UnitZ());
        ASSERT_TRUE(below.found());
        ASSERT_GT(field.volumePoint(below).z(), 0.0285) << hand.tip().transpose();
      });
    }
    EXPECT_TRUE(hand.contact().touching);
  }
}

TEST(GodObjectTest, StaysInTheFrictionConeAndSticksInIt) {
  const PatchContact field = contactOf(makeFlatHalfSpace());
  for (const double friction : {0.1, 0.4, 1.0}) {
    Hand hand(field, friction);
    const double depth = 0.004;
    const Vector3 start(0.025, 0.030, kSurfaceZ + kRadius - depth);
    hand.go(start + Vector3(0.0, 0.0, 0.010));
    hand.go(start, 0.0001);
    const Vector3 rest = hand.contact().proxy_m;
    double worst = 0.0;
    hand.go(start + Vector3(0.012, 0.0, 0.0), 0.0001, [&] {
      const double tangential = -hand.force().x();
      const double moved = hand.tip().x() - start.x();
      EXPECT_LE(tangential, friction * depth + 1e-6);
      if (moved < friction * depth)
        EXPECT_LT((hand.contact().proxy_m - rest).norm(), 1e-6);
      else
        worst = std::max(worst, std::abs(tangential - friction * depth));
      EXPECT_NEAR(hand.force().z(), depth, 1e-6);
    });
    EXPECT_LT(worst, 0.01 * friction * depth) << friction;
    const Vector3 stopped = hand.contact().proxy_m;
    for (int n = 0; n < 1000; ++n)
      hand.go(hand.tip());
    EXPECT_LT((hand.contact().proxy_m - stopped).norm(), 1e-6);  // and does not creep
  }
}

TEST(GodObjectTest, SticksToTissueThatMoves) {
  Tissue tissue = makeFlatHalfSpace();
  PatchContact field = contactOf(tissue);
  Hand hand(field, 0.5);
  const Vector3 tip(0.030, 0.030, kSurfaceZ + kRadius - 0.004);
  hand.go(tip + Vector3(0.0, 0.0, 0.010));
  hand.go(tip, 0.0001);
  for (int n = 1; n <= 15; ++n) {
    const Vector3 shift(0.0001 * n, 0.0, 0.0);
    tissue.deform([&](const Vector3& p) { return Vector3(p + shift); });
    field.update(tissue.topology, tissue.patch);
    hand.go(tip);
    EXPECT_LT((hand.force() - Vector3(0.0, 0.0, 0.004) - shift).norm(), 2e-6);
  }
}

TEST(GodObjectTest, SlidesOverCellsWithoutSteps) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.deform(bend);
  const PatchContact field = contactOf(tissue);
  for (const double friction : {0.0, 0.3}) {
    for (const double depth : {0.001, 0.005, 0.010}) {
      Hand hand(field, friction);
      const Vector3 start(0.012, 0.021, kSurfaceZ + kRadius - depth);
      hand.go(start + Vector3(0.0, 0.0, 0.012));
      hand.go(start, 0.00005);
      for (int n = 0; n < 300; ++n)
        hand.go(start);
      double worst = 0.0;
      hand.go(start + Vector3(0.040, 0.018, 0.0), 0.00005, [&] {
        ASSERT_TRUE(hand.contact().touching);
        worst = std::max(worst, hand.change());
      });
      std::cout << "[ measure  ] friction " << friction << " depth " << depth << ": the force changes by at most "
                << worst / 0.00005 << " K times the tip's way\n";
      EXPECT_LT(worst, (friction > 0.0 ? 1.01 : 0.6) * 0.00005);  // a proxy that sticks: the tip's own way
    }
  }
}

TEST(GodObjectTest, GivesNoEnergyThatTheHandDidNotPutIn) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.deform(bend);
  const PatchContact field = contactOf(tissue);
  std::mt19937 random(8);
  std::uniform_real_distribution<double> number(-1.0, 1.0);
  for (const double friction : {0.0, 0.3}) {
    double put_in = 0.0;
    double got = 0.0;
    for (int round = 0; round < 10; ++round) {
      const double before_round = put_in;
      Hand hand(field, friction);
      hand.go({0.032, 0.032, 0.050});
      for (int n = 0; n < 6; ++n) {
        const double before = hand.work();
        hand.go({0.032 + 0.015 * number(random), 0.032 + 0.015 * number(random), 0.036 + 0.006 * number(random)},
                0.00005);
        put_in += std::max(0.0, before - hand.work());
      }
      hand.go({hand.tip().x(), hand.tip().y(), 0.050}, 0.00005);
      EXPECT_FALSE(hand.contact().touching);
      got += hand.work();
      // Force shading is not quite conservative: 1.3 % here, where the surface has a kink of ten degrees at every cell.
      EXPECT_LT(hand.work(), 0.02 * (put_in - before_round));
    }
    std::cout << "[ measure  ] friction " << friction << ": of " << put_in << " m^2 the hand gets back net " << got
              << "\n";
    EXPECT_LT(got, 0.0);
    EXPECT_GT(got, friction > 0.0 ? -1.0 * put_in : -0.01 * put_in);
  }
}

/// Two slabs with a slit between them that is open towards -x.
double fold(const Vector3& p) {
  const double solid = std::min({p.x() - 0.012, 0.044 - p.z(), p.z() - 0.008});
  const double slit = std::max(std::abs(p.z() - 0.028) - 0.004, p.x() - 0.046);
  return 1000.0 * std::min(solid, slit);
}

TEST(GodObjectTest, AFoldStopsItFromBothSides) {
  const PatchContact field = contactOf(makeBlock(fold));
  ASSERT_TRUE(field.sample({0.030, 0.032, 0.038}).tissue);
  ASSERT_FALSE(field.sample({0.030, 0.032, 0.028}).tissue);
  // Through the upper slab, the slit and into the lower one: the upper side holds.
  Hand above(field);
  above.go({0.030, 0.032, 0.055});
  above.go({0.030, 0.032, 0.015}, 0.0002);
  above.go({0.038, 0.036, 0.026}, 0.0002);
  ASSERT_TRUE(above.contact().touching);
  EXPECT_NEAR(above.contact().proxy_m.z(), 0.044 + kRadius, 1e-4);
  // Through the slit's mouth, then pressing up and down in it.
  Hand inside(field);
  inside.go({0.005, 0.032, 0.028});
  inside.go({0.030, 0.032, 0.028}, 0.0002);
  inside.go({0.030, 0.032, 0.050}, 0.0002);
  ASSERT_TRUE(inside.contact().touching);
  EXPECT_NEAR(inside.contact().proxy_m.z(), 0.032 - kRadius, 1e-4);
  EXPECT_LT(inside.contact().normal.z(), -0.99);
  inside.go({0.030, 0.032, 0.010}, 0.0002);
  ASSERT_TRUE(inside.contact().touching);
  EXPECT_NEAR(inside.contact().proxy_m.z(), 0.024 + kRadius, 1e-4);
  // Into the slit's bottom: it stops there.
  inside.go({0.055, 0.032, 0.024}, 0.0002);
  ASSERT_TRUE(inside.contact().touching);
  EXPECT_LT(inside.contact().proxy_m.x(), 0.0465);
  EXPECT_FALSE(field.sample(inside.contact().proxy_m).tissue);
}

/// A floor and, from a line across it on, a block that begins `gap_m` above it.
double stepped(const Vector3& p, double gap_m) {
  const double block = std::min({p.z() - 0.024 - gap_m, 0.048 - p.z(), p.x() - 0.030 - 0.5 * (p.y() - 0.032)});
  return 1000.0 * std::max(0.024 - p.z(), block);
}
const Vector3 kStepsEdge = Vector3(0.5, 1.0, 0.0).normalized();

TEST(GodObjectTest, GoesAlongAWall) {
  const PatchContact field = contactOf(makeBlock([](const Vector3& p) { return stepped(p, -0.010); }));
  Hand hand(field);
  hand.go({0.020, 0.020, 0.040});
  hand.go({0.020, 0.020, 0.024}, 0.0001);
  double worst = 0.0;
  const auto see = [&] {
    ASSERT_TRUE(hand.contact().touching);
    ASSERT_FALSE(field.sample(hand.contact().proxy_m).tissue);
    worst = std::max(worst, hand.change());
  };
  hand.go({0.032, 0.020, 0.024}, 0.0001, see);  // into it
  for (int n = 0; n < 200; ++n)
    hand.go(hand.tip());
  const Vector3 stopped = hand.contact().proxy_m;
  hand.go(hand.tip() + 0.012 * kStepsEdge, 0.0001, see);
  for (int n = 0; n < 200; ++n)
    hand.go(hand.tip());
  std::cout << "[ measure  ] wall: " << worst / 0.0001 << ", along it "
            << (hand.contact().proxy_m - stopped).dot(kStepsEdge) << ", off it "
            << (hand.contact().proxy_m - stopped).cross(kStepsEdge).norm() << "\n";
  EXPECT_NEAR((hand.contact().proxy_m - stopped).dot(kStepsEdge), 0.012, 0.001);
  EXPECT_LT((hand.contact().proxy_m - stopped).cross(kStepsEdge).norm(), 0.001);
  EXPECT_LT(worst, 0.0003);
}

// An overhang that is lower than the sphere holds it, though it slides along the edge by fits and starts.
TEST(GodObjectTest, AnOverhangStopsIt) {
  const PatchContact field = contactOf(makeBlock([](const Vector3& p) { return stepped(p, 0.002); }));
  Hand hand(field);
  hand.go({0.020, 0.026, 0.040});
  hand.go({0.020, 0.026, 0.024}, 0.0001);
  const auto see = [&] {
    ASSERT_TRUE(hand.contact().touching);
    ASSERT_FALSE(field.sample(hand.contact().proxy_m).tissue);
    ASSERT_LT(hand.contact().proxy_m.x() - 0.030 - 0.5 * (hand.contact().proxy_m.y() - 0.032), 0.0);
  };
  hand.go({0.036, 0.026, 0.024}, 0.0001, see);  // under it
  const Vector3 stopped = hand.contact().proxy_m;
  hand.go(hand.tip() + 0.012 * kStepsEdge, 0.0001, see);
  EXPECT_GT((hand.contact().proxy_m - stopped).dot(kStepsEdge), 0.006);
}

/// A valley between two slopes of 45 degrees along y.
TEST(GodObjectTest, RestsInAValleyAndSlidesAlongIt) {
  const PatchContact field =
      contactOf(makeBlock([](const Vector3& p) { return 1000.0 * (0.030 + std::abs(p.x() - 0.032) - p.z()); }));
  Hand hand(field);
  hand.go({0.034, 0.020, 0.050});
  hand.go({0.034, 0.020, 0.022}, 0.0001);
  for (int n = 0; n < 500; ++n)
    hand.go(hand.tip());
  const double x = hand.contact().proxy_m.x();
  double worst = 0.0;
  hand.go({0.034, 0.045, 0.022}, 0.0001, [&] {
    worst = std::max({worst, hand.change() / 0.0001, std::abs(hand.contact().proxy_m.y() - hand.tip().y()) / 0.003});
  });
  EXPECT_NEAR(hand.contact().proxy_m.x(), x, 0.0005);
  EXPECT_NEAR(x, 0.0325, 0.0015);
  EXPECT_LT(worst, 1.5);
}

TEST(GodObjectTest, GoesOverAnEdgeWithoutAStep) {
  // The lattice's own end: a block of tissue with edges of 90 degrees.
  const PatchContact field = contactOf(makeBlock([](const Vector3&) { return 100.0; }));
  Hand hand(field);
  const double top = 0.053;
  const double side = 0.060;
  hand.go({0.050, 0.032, top + 0.006});
  hand.go({0.050, 0.032, top + kRadius - 0.001}, 0.0001);
  double worst = 0.0;
  hand.go({0.066, 0.032, top + kRadius - 0.001}, 0.00005, [&] { worst = std::max(worst, hand.change()); });
  EXPECT_FALSE(hand.contact().touching);
  hand.go({side + kRadius - 0.001, 0.032, top - 0.010}, 0.00005, [&] { worst = std::max(worst, hand.change()); });
  ASSERT_TRUE(hand.contact().touching);
  EXPECT_GT(hand.contact().normal.x(), 0.99);
  EXPECT_LT(worst / 0.00005, 2.5);
  std::cout << "[ measure  ] edge: " << worst / 0.00005 << "\n";
}

TEST(GodObjectTest, MirrorsAreFeltMirrored) {
  const auto mirror = [](const Vector3& p) { return Vector3(0.064 - p.x(), p.y(), p.z()); };
  const auto hill = [](const Vector3& p) {
    return 1000.0 * (kSurfaceZ + 0.004 * std::sin(100.0 * p.x()) * std::cos(80.0 * p.y()) - p.z());
  };
  const PatchContact left = contactOf(makeBlock(hill));
  const PatchContact right = contactOf(makeBlock([&](const Vector3& p) { return hill(mirror(p)); }));
  Hand one(left, 0.1);
  Hand other(right, 0.1);
  double worst = 0.0;
  for (int n = 0; n < 3000; ++n) {
    const Vector3 tip(0.032 + 0.015 * std::sin(0.003 * n), 0.032 + 0.012 * std::cos(0.0043 * n),
                      0.040 + 0.006 * std::cos(0.0029 * n));
    one.go(tip);
    other.go(mirror(tip));
    const Vector3 f = other.force();
    worst = std::max(worst, (one.force() - Vector3(-f.x(), f.y(), f.z())).norm());
  }
  std::cout << "[ measure  ] mirrored forces differ by " << worst * 1e3 << " mm K\n";
  EXPECT_LT(worst, 0.0003);
}

TEST(GodObjectTest, RoughTissueIsNotSticky) {
  std::mt19937 random(5);
  std::normal_distribution<double> noise(0.0, 0.1);  // millimetres of the surface
  const PatchContact field = contactOf(
      makeBlock([&](const Vector3& p) { return 1000.0 * (kSurfaceZ - p.z()) + std::clamp(noise(random), -0.3, 0.3); }));
  Hand hand(field);
  const Vector3 start(0.015, 0.025, kSurfaceZ + kRadius - 0.005);
  hand.go(start + Vector3(0, 0, 0.01));
  hand.go(start, 0.0001);
  double along = 0.0;
  double worst = 0.0;
  double change = 0.0;
  int count = 0;
  hand.go(start + Vector3(0.035, 0.012, 0.0), 0.00005, [&] {
    ++count;
    const double pull = -hand.force().dot(Vector3(0.035, 0.012, 0.0).normalized());
    along += pull;
    worst = std::max(worst, pull);
    change = std::max(change, hand.change());
  });
  std::cout << "[ measure  ] rough: mean pull " << along / count / 0.005 << " of the press, worst " << worst / 0.005
            << ", change " << change / 0.00005 << "\n";
  EXPECT_LT(std::abs(along) / count, 0.01 * 0.005);
  EXPECT_LT(worst, 0.03 * 0.005);
  EXPECT_LT(change, 1.0 * 0.00005);
}

TEST(GodObjectTest, APatchAt30HzDoesNotBuzz) {
  Tissue tissue = makeFlatHalfSpace();
  const auto at = [&](double time_s) {
    tissue.deform([&](const Vector3& p) {
      const double wave = std::sin(2.0 * M_PI * 1.5 * time_s) * p.z() / kSurfaceZ;
      return Vector3(p + Vector3(0.002 * wave, 0.0, 0.003 * wave));
    });
    PatchContact field(tissue.volume, 0.0);
    field.update(tissue.topology, tissue.patch);
    return field;
  };
  for (const bool interpolate : {true, false}) {
    PatchContact shown = at(0.0);
    Hand hand(shown, 0.2);
    const Vector3 tip(0.030, 0.030, kSurfaceZ + kRadius - 0.006);
    hand.go(tip + Vector3(0, 0, 0.012));
    hand.go(tip, 0.0001);
    double worst = 0.0;
    for (int n = 1; n <= 1000; ++n) {
      if (n % 33 == 0) {
        PatchContact next = at(n * kTick);
        if (interpolate)
          next.beginFrom(shown, 0.033);
        shown = next;
      }
      shown.advance(kTick);
      hand.go(tip);
      worst = std::max(worst, hand.change());
    }
    // The surface moves at 28 mm/s and 19 mm/s at most.
    if (interpolate)
      EXPECT_LT(worst, 1.1 * 0.035 * kTick);
    else
      EXPECT_GT(worst, 10.0 * 0.035 * kTick);  // that is what the interpolation is for
  }
}

/// A block cut along x = 3.63 cells that opens to a gap.
class LipsTest : public testing::Test {
 protected:
  static constexpr double kPlane = 3.63 * kH;
  void SetUp() override {
    const Vector3 size = tissue_.block.size();
    tissue_.cut({{Vector3(kPlane, -kH, -kH), Vector3(kPlane, -kH, 8.0 * kH), Vector3(kPlane, size.y() + kH, 8.0 * kH),
                  Vector3(kPlane, size.y() + kH, -kH)}});
  }
  PatchContact openTo(double gap_m) {
    tissue_.part(kPlane, [&](const Vector3&, int side) { return Vector3(0.5 * gap_m * side, 0.0, 0.0); });
    return tissue_.contact();
  }
  int lipOf(const Contact& contact) { return tissue_.middleOf(contact.cell).x() < kPlane ? -1 : 1; }
  TissueInPieces tissue_{{7, 6, 6}, [](const Vector3& p) { return 1000.0 * (5.4 * kH - p.z()); }};
};

// Pressed against one lip, dragged along and across below the skin while the lips close: never felt by the other one.
TEST_F(LipsTest, NeverPassesFromLipToLip) {
  std::mt19937 random(12);
  std::uniform_real_distribution<double> number(-1.0, 1.0);
  for (const int side : {-1, 1}) {
    for (const double friction : {0.0, 0.3}) {
      PatchContact field = openTo(0.010);
      Hand hand(field, friction);
      hand.go({kPlane, 3.0 * kH, 3.0 * kH});
      hand.go({kPlane + side * 0.005, 3.0 * kH, 3.0 * kH}, 0.0002);
      ASSERT_TRUE(hand.contact().touching);
      for (int n = 0; n < 60; ++n) {
        PatchContact next = openTo(std::max(0.0, 0.010 - 0.0003 * n));
        next.beginFrom(field, 0.02);
        field = next;
        const Vector3 to(kPlane + side * (0.008 + 0.004 * number(random)), (3.0 + 1.2 * number(random)) * kH,
                         (3.0 + 1.2 * number(random)) * kH);
        const Vector3 from = hand.tip();
        for (int tick = 1; tick <= 20; ++tick) {
          field.advance(kTick);
          hand.go(from + tick / 20.0 * (to - from));
          ASSERT_TRUE(hand.contact().touching);
          ASSERT_EQ(lipOf(hand.contact()), side);
          ASSERT_LT(side * hand.contact().normal.x(), -0.9);
        }
      }
    }
  }
}

// The probe presses the skin while a blade opens it: what it feels changes as the tissue does, not with the revision.
TEST(GodObjectTest, ACutUnderTheTipIsNoStep) {
  TissueInPieces tissue({7, 6, 6}, [](const Vector3& p) { return 1000.0 * (5.4 * kH - p.z()); });
  PatchContact field = tissue.contact();
  Hand hand(field, 0.2);
  const Vector3 tip(3.4 * kH, 3.0 * kH, 5.4 * kH + kRadius - 0.002);
  hand.go(tip + Vector3(0, 0, 0.006));
  hand.go(tip, 0.0001);
  const double plane = 3.63 * kH;
  tissue.cut({{Vector3(plane, -kH, 2.0 * kH), Vector3(plane, -kH, 8.0 * kH), Vector3(plane, 7.0 * kH, 8.0 * kH),
               Vector3(plane, 7.0 * kH, 2.0 * kH)}});
  double worst = 0.0;
  const auto show = [&] {
    PatchContact next = tissue.contact();
    next.beginFrom(field, 0.033);
    field = next;
    for (int n = 0; n < 33; ++n) {
      hand.go(tip);
      worst = std::max(worst, hand.change());
      field.advance(kTick);
    }
  };
  show();
  EXPECT_LT(worst, 1e-6);  // nothing has moved yet
  for (int n = 1; n <= 20; ++n) {
    tissue.part(plane, [&](const Vector3& p, int side) {
      return Vector3(0.5 * side * 0.0002 * n * std::max(0.0, (p.z() / kH - 2.0) / 3.4), 0.0, 0.0);
    });
    show();
  }
  ASSERT_TRUE(hand.contact().touching);
  std::cout << "[ measure  ] the force changes by at most " << worst * 1e3 << " mm K per tick as the lips open\n";
  EXPECT_LT(worst, 0.0005);  // it slips off the rim
}

// Anything may come: wild tissue, cuts, jumps of the tip, patches that go. Nothing may come of it but sane contacts.
TEST(GodObjectTest, HoldsItsPromisesOnWildTissue) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> number(-1.0, 1.0);
    const auto direction = [&] { return Vector3(number(random), number(random), number(random)); };
    const Vector3 wave = 60.0 * direction();
    TissueInPieces tissue(
        {7, 7, 6}, [&](const Vector3& p) { return 0.4 + std::sin(wave.dot(p)) + 0.5 * std::cos(150.0 * p.z()); });
    cutAtRandom(tissue, int(seed % 4), random);
    PatchContact field = tissue.contact();
    const double friction = seed % 2 == 0 ? 0.4 : 0.0;
    Hand hand(field, friction);
    const Vector3 size = tissue.block.size();
    Vector3 tip = 0.5 * size;
    for (int n = 0; n < 1200; ++n) {
      if (n % 50 == 0) {
        if (n % 500 == 450 && seed > 1)
          cutAtRandom(tissue, 1, random);
        const double amount = 0.3 * number(random);
        tissue.part(3.0 * kH, [&](const Vector3& p, int side) {
          return Vector3(amount * (warp(p) - 0.2 * p) + 0.1 * kH * side * amount * Vector3::UnitX());
        });
        PatchContact next = tissue.contact();
        next.beginFrom(field, 0.04);
        field = next;
      }
      field.advance(kTick);
      tip = n % 777 == 0 ? Vector3(0.5 * size + 0.6 * size.cwiseProduct(direction()))
                         : Vector3(tip + 0.0008 * direction());
      tip = tip.cwiseMax(-0.2 * size).cwiseMin(1.2 * size);
      const Contact& contact = hand.go(tip);
      if (!contact.touching)
        continue;
      ASSERT_TRUE(isFinite(contact.proxy_m) && isFinite(contact.surface_velocity_m_s));
      ASSERT_NEAR(contact.normal.norm(), 1.0, 1e-9);
      ASSERT_GT(contact.penetration_m, 0.0);
      ASSERT_LT(contact.penetration_m, 2.0 * size.norm());
      ASSERT_NE(field.cellOfId(contact.cell), PatchContact::kNoCell);
    }
  }
}

TEST(GodObjectTest, IsDeterministic) {
  Tissue tissue = makeFlatHalfSpace();
  tissue.deform(bend);
  const PatchContact field = contactOf(tissue);
  const auto run = [&] {
    Hand hand(field, 0.2);
    std::mt19937 random(8);
    std::uniform_real_distribution<double> number(-1.0, 1.0);
    std::vector<Vector3> forces;
    for (int n = 0; n < 10; ++n) {
      hand.go({0.032 + 0.015 * number(random), 0.032 + 0.015 * number(random), 0.040 + 0.006 * number(random)}, 0.0002,
              [&] { forces.push_back(hand.force()); });
    }
    return forces;
  };
  EXPECT_EQ(run(), run());
}

}  // namespace
}  // namespace soft_volume::core
