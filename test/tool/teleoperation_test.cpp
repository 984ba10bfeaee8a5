#include "soft_volume/tool/teleoperation.h"

#include <gtest/gtest.h>

#include <limits>

namespace soft_volume::core {
namespace {

constexpr double kTick_s = 0.001;

class TeleoperationTest : public testing::Test {
 protected:
  TeleopConfig config() const {
    TeleopConfig config;
    config.max_speed_m_s = 0.1;
    config.max_turn_rad_s = 0.5;
    config.dead_zone = 0.1;
    return config;
  }
  void run(const Deflection& deflection, double time_s) {
    for (int n = 0; n < int(std::lround(time_s / kTick_s)); ++n)
      teleop_.step(deflection, kTick_s);
  }
  static Deflection along(const Vector3& linear) { return {linear, Vector3::Zero()}; }

  const Vector3 centre_{0.1, 0.0, -0.1};
  Teleoperation teleop_{config(), centre_, 0.05};
};

TEST_F(TeleoperationTest, FullDeflectionMovesAtTheStatedSpeed) {
  run(along({0.0, 1.0, 0.0}), 0.4);
  EXPECT_NEAR(teleop_.velocity_m_s().y(), 0.1, 1e-4);
  const double from_m = teleop_.pose().position_m.y();
  run(along({0.0, 1.0, 0.0}), 0.1);
  EXPECT_NEAR(teleop_.pose().position_m.y() - from_m, 0.01, 1e-5);
}

TEST_F(TeleoperationTest, NeverFasterWhateverTheDeflection) {
  run(along({1.0, -1.0, 1.0}), 0.4);
  EXPECT_LE(teleop_.velocity_m_s().norm(), 0.1 + 1e-12);
  run(along({50.0, -50.0, 1e300}), 0.1);
  EXPECT_LE(teleop_.velocity_m_s().norm(), 0.1 + 1e-12);
}

TEST_F(TeleoperationTest, TheDeadZoneIsStillAndItsEdgeIsSmooth) {
  run(along({0.1, -0.1, 0.05}), 0.5);
  EXPECT_EQ(teleop_.pose().position_m, centre_);
  run(along({0.55, 0.0, 0.0}), 0.5);
  EXPECT_NEAR(teleop_.velocity_m_s().x(), 0.05, 1e-4);
}

TEST_F(TeleoperationTest, WhatIsNotFiniteIsNoDeflection) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  run({{nan, std::numeric_limits<double>::infinity(), 0.0}, {nan, nan, nan}}, 0.5);
  EXPECT_EQ(teleop_.pose().position_m, centre_);
  EXPECT_TRUE(isUsable(teleop_.pose()));
}

TEST_F(TeleoperationTest, StaysInTheWorkspaceAndTellsTheVelocityThatItHas) {
  run(along({1.0, 1.0, 0.0}), 3.0);
  EXPECT_NEAR((teleop_.pose().position_m - centre_).norm(), 0.05, 1e-9);
  EXPECT_LT(teleop_.velocity_m_s().norm(), 1e-3);
  run(along({-1.0, 0.0, 0.0}), 0.3);
  EXPECT_LT((teleop_.pose().position_m - centre_).norm(), 0.045);
}

TEST_F(TeleoperationTest, TurnsAboutTheAxesOfTheUser) {
  run({Vector3::Zero(), Vector3::UnitZ()}, 2.0);
  const Eigen::AngleAxisd turned(teleop_.pose().orientation);
  EXPECT_NEAR(turned.angle(), 0.5 * (2.0 - 0.05), 0.01);
  EXPECT_TRUE(turned.axis().isApprox(Vector3::UnitZ(), 1e-6));
}

TEST(Keyboard, AKeyMovesForAMomentAndItsOppositeTheOtherWay) {
  Keyboard keyboard;
  EXPECT_EQ(keyboard.deflection(0.0).linear, Vector3::Zero().eval());
  keyboard.press('d', 1.0);
  EXPECT_EQ(keyboard.deflection(1.1).linear, Vector3::UnitX().eval());
  EXPECT_EQ(keyboard.deflection(1.2).linear, Vector3::Zero().eval());
  keyboard.press('a', 1.3);
  EXPECT_EQ(keyboard.deflection(1.3).linear, Vector3(-1.0, 0.0, 0.0));
  keyboard.press('e', 1.4);
  EXPECT_EQ(keyboard.deflection(1.4).linear, Vector3(0.0, 1.0, 0.0));
  keyboard.press('w', 1.4);
  EXPECT_EQ(keyboard.deflection(1.4).linear, Vector3(0.0, 0.0, 1.0));
  keyboard.press('j', 1.4);
  EXPECT_EQ(keyboard.deflection(1.4).angular, Vector3(0.0, 0.0, 1.0));
  EXPECT_EQ(keyboard.deflection(1.4).linear, Vector3::Zero().eval());
}

TEST(Keyboard, SpaceTogglesAndTabTaps) {
  Keyboard keyboard;
  keyboard.press(' ', 1.0);
  EXPECT_TRUE(keyboard.buttons(50.0)[0]);
  keyboard.press(' ', 51.0);
  EXPECT_FALSE(keyboard.buttons(51.0)[0]);
  EXPECT_FALSE(keyboard.buttons(51.0)[1]);
  keyboard.press('\t', 52.0);
  EXPECT_TRUE(keyboard.buttons(52.05)[1]);
  EXPECT_FALSE(keyboard.buttons(52.2)[1]);
}

TEST(Keyboard, OtherKeysDoNothing) {
  Keyboard keyboard;
  for (const char key : {'x', '\n', '\x1b', '[', '\x80'})
    keyboard.press(key, 1.0);
  EXPECT_EQ(keyboard.deflection(1.0).linear, Vector3::Zero().eval());
  EXPECT_TRUE(keyboard.buttons(1.0).none());
}

}  // namespace
}  // namespace soft_volume::core
