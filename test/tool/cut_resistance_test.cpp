#include "soft_volume/tool/cut_resistance.h"

#include <gtest/gtest.h>

#include <functional>

namespace soft_volume::core {
namespace {

constexpr double kPeriod = 0.001;
constexpr double kStiffness = 66.7;  // that of a Touch's default coupling, N/m
constexpr double kResistance = 0.3;

/// Moves a blade along x at a speed that may change with time; returns the work that the hand does [J].
double work(CutResistance& tissue, double seconds, const std::function<double(double)>& speed_m_s,
            double resistance_n = kResistance) {
  double done = 0.0;
  Vector3 before = tissue.update(Vector3::Zero(), 0.0, resistance_n, kStiffness);
  for (int n = 0; n < int(std::lround(seconds / kPeriod)); ++n) {
    const Vector3 move(speed_m_s(n * kPeriod) * kPeriod, 0.0, 0.0);
    const Vector3 force = tissue.update(move, kPeriod, resistance_n, kStiffness);
    done -= 0.5 * (before + force).dot(move);
    before = force;
  }
  return done;
}

TEST(CutResistanceTest, AStrokeCostsItsFractureEnergy) {
  constexpr double kToughness = 20.0;  // J/m^2
  constexpr double kDepth = 0.015;
  constexpr double kLength = 0.060;
  const double resistance = kToughness * kDepth;
  const double energy = kToughness * kDepth * kLength;
  const double spring = 0.5 * resistance * resistance / kStiffness;
  for (const double speed : {0.01, 0.03, 0.1}) {
    CutResistance tissue;
    const double done = work(
        tissue, kLength / speed, [&](double) { return speed; }, resistance);
    EXPECT_LT(done, energy) << speed;
    // The spring's share is a little more where the blade creeps up to the full force.
    EXPECT_GT(done, energy - 1.4 * spring) << speed;
    EXPECT_GT(done, 0.94 * energy) << speed;
  }
}

TEST(CutResistanceTest, SlowBladesFeelLess) {
  for (const double share : {0.1, 0.5, 0.9}) {
    CutResistance tissue;
    const double speed = share * CutResistance::kFullSpeed_m_s;
    work(tissue, 20.0, [&](double) { return speed; });
    const Vector3 force = tissue.update(speed * kPeriod * Vector3::UnitX(), kPeriod, kResistance, kStiffness);
    EXPECT_NEAR(force.x(), -share * kResistance, 1e-3 * kResistance);
  }
}

TEST(CutResistanceTest, BladeAtRestComesToFeelNothing) {
  CutResistance tissue;
  work(tissue, 1.0, [](double) { return 0.05; });
  const double relax_s = kResistance / (kStiffness * CutResistance::kFullSpeed_m_s);
  work(tissue, relax_s, [](double) { return 0.0; });
  EXPECT_NEAR(tissue.update(Vector3::Zero(), 0.0, kResistance, kStiffness).norm(), std::exp(-1.0) * kResistance, 1e-3);
  work(tissue, 10.0 * relax_s, [](double) { return 0.0; });
  EXPECT_LT(tissue.update(Vector3::Zero(), 0.0, kResistance, kStiffness).norm(), 1e-4);
}

TEST(CutResistanceTest, NeverGivesMoreThanItTook) {
  CutResistance tissue;
  double taken = 0.0;
  for (int n = 0; n < 40; ++n) {
    const double turns = 1.0 + n % 7;
    taken += work(
        tissue, 0.5, [&](double t) { return 0.08 * std::sin(2.0 * M_PI * turns * t); }, kResistance * (n % 3));
    EXPECT_GE(taken, -1e-12);
  }
  EXPECT_GT(taken, 0.0);
}

TEST(CutResistanceTest, FollowsATurnAndEndsWithTheResistance) {
  CutResistance tissue;
  work(tissue, 1.0, [](double) { return 0.05; });
  Vector3 force;
  for (int n = 0; n < 1000; ++n)
    force = tissue.update(Vector3(0.0, 5e-5, 0.0), kPeriod, kResistance, kStiffness);
  EXPECT_NEAR((force - Vector3(0.0, -kResistance, 0.0)).norm(), 0.0, 1e-3);
  double before = kResistance;
  for (int n = 0; n < 80; ++n) {  // out of the tissue: less and less, but never at once
    const double after = tissue.update(Vector3(0.0, 5e-5, 0.0), kPeriod, 0.0, kStiffness).norm();
    EXPECT_LE(after, before);
    EXPECT_GE(after, 0.85 * before - 2e-4);
    before = after;
    if (n == 24) {
      EXPECT_LT(after, 0.05 * kResistance);
    }
  }
  EXPECT_EQ(before, 0.0);
  EXPECT_FALSE(tissue.loaded());
  EXPECT_LT(tissue.update(Vector3(0.0, 5e-5, 0.0), kPeriod, kResistance, kStiffness).norm(), 0.01);
}

}  // namespace
}  // namespace soft_volume::core
