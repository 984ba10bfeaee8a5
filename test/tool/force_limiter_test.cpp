#include "soft_volume/tool/force_limiter.h"

#include <gtest/gtest.h>

#include <limits>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr double kCycle = 0.001;

/// Drives a limiter at 1 kHz with a pose that is at rest unless a test says otherwise.
class LimiterTest : public testing::Test {
 protected:
  /// One cycle with a fresh pose.
  ForceLimiter::Output cycle(const Vector3& wish) {
    time_s_ += kCycle;
    pose_time_s_ = time_s_;
    return again(wish);
  }
  /// One cycle without a new pose.
  ForceLimiter::Output silentCycle(const Vector3& wish) {
    time_s_ += kCycle;
    return again(wish);
  }
  ForceLimiter::Output again(const Vector3& wish) {
    fault_ = limiter_.check(time_s_, pose_time_s_, pose_, velocity_, stamp_s_);
    last_ = limiter_.limit(time_s_, wish);
    return last_;
  }
  void run(double seconds, const Vector3& wish) {
    for (int n = 0; n < int(std::lround(seconds / kCycle)); ++n)
      cycle(wish);
  }
  /// Expects a fault that is on already to take the force down evenly, to zero within 25 ms.
  void expectFall(double from_n, const std::function<ForceLimiter::Output()>& next) {
    double before = from_n;
    for (int n = 1; n <= 25; ++n) {
      const double now = next().force_n.norm();
      EXPECT_NEAR(before - now, from_n / 25.0, 1e-9) << "cycle " << n;
      before = now;
    }
    EXPECT_NEAR(before, 0.0, 1e-12);
  }

  ForceLimiter limiter_{deviceLimits("touch"), SafetyConfig()};
  Pose pose_;
  std::optional<Vector3> velocity_;
  std::optional<double> stamp_s_;
  double time_s_ = 100.0;
  double pose_time_s_ = 0.0;
  ForceFault fault_ = ForceFault::kNone;
  ForceLimiter::Output last_;
};

TEST_F(LimiterTest, SaturatesAtTheDevicesMaximum) {
  run(1.0, {0.0, 3.0, 4.0});
  EXPECT_NEAR((last_.force_n - Vector3(0.0, 0.6 * 3.3, 0.8 * 3.3)).norm(), 0.0, 1e-9);
  EXPECT_TRUE(last_.saturated);
  cycle({0.0, 0.0, 3.2});
  EXPECT_FALSE(last_.saturated);
}

TEST_F(LimiterTest, GrowsByATenthOfANewtonPerMillisecondAtMost) {
  run(0.5, Vector3::Zero());
  double before = 0.0;
  for (int n = 0; n < 40; ++n) {
    const ForceLimiter::Output output = cycle({3.0, 0.0, 0.0});
    EXPECT_LE(output.force_n.norm() - before, 0.1 + 1e-9);
    EXPECT_EQ(output.slew_limited, n < 29) << n;
    before = output.force_n.norm();
  }
  EXPECT_NEAR(before, 3.0, 1e-9);
}

TEST_F(LimiterTest, DecreasesAreFree) {
  run(1.0, {3.0, 0.0, 0.0});
  EXPECT_NEAR(cycle({0.5, 0.0, 0.0}).force_n.x(), 0.5, 1e-12);
  EXPECT_FALSE(last_.slew_limited);
  EXPECT_EQ(cycle(Vector3::Zero()).force_n, Vector3(0.0, 0.0, 0.0));
}

TEST_F(LimiterTest, ReversalAndTurnsAreGrowthToo) {
  run(1.0, {3.0, 0.0, 0.0});
  EXPECT_NEAR(cycle({-3.0, 0.0, 0.0}).force_n.x(), -0.1, 1e-9);
  limiter_.reset();
  run(1.0, {3.0, 0.0, 0.0});
  EXPECT_NEAR((cycle({0.0, 3.0, 0.0}).force_n - Vector3(0.0, 0.1, 0.0)).norm(), 0.0, 1e-9);
}

TEST_F(LimiterTest, LateCycleDoesNotAllowALargeStep) {
  run(0.5, Vector3::Zero());
  time_s_ += 1.0;
  pose_time_s_ = time_s_;
  EXPECT_LE(again({3.0, 0.0, 0.0}).force_n.norm(), 2.0 + 1e-9);
}

TEST_F(LimiterTest, StartsAtZeroAndRampsIn) {
  EXPECT_EQ(cycle({1.0, 0.0, 0.0}).force_n, Vector3(0.0, 0.0, 0.0));
  for (int n = 1; n <= 200; ++n)
    EXPECT_NEAR(cycle({1.0, 0.0, 0.0}).force_n.x(), n / 200.0, 1e-9);
  EXPECT_NEAR(cycle({1.0, 0.0, 0.0}).force_n.x(), 1.0, 1e-12);
}

TEST_F(LimiterTest, StalePoseFallsToZeroWithin50Milliseconds) {
  run(1.0, {2.0, 0.0, 0.0});
  const double last_pose = time_s_;
  while (last_.force_n.norm() > 0.0 && time_s_ < last_pose + 1.0) {
    const double before = last_.force_n.norm();
    silentCycle({2.0, 0.0, 0.0});
    const double age = time_s_ - last_pose;
    if (std::abs(age - 0.02) > 0.0005) {
      EXPECT_EQ(fault_, age < 0.02 ? ForceFault::kNone : ForceFault::kStalePose) << age;
    }
    EXPECT_LE(last_.force_n.norm(), before);
  }
  EXPECT_GT(time_s_ - last_pose, 0.040);
  EXPECT_LE(time_s_ - last_pose, 0.050);
  // Reconnected: from zero, with the ramp.
  EXPECT_EQ(cycle({2.0, 0.0, 0.0}).force_n.norm(), 0.0);
  EXPECT_EQ(fault_, ForceFault::kNone);
  run(0.1, {2.0, 0.0, 0.0});
  EXPECT_NEAR(last_.force_n.x(), 1.0, 1e-9);
}

TEST_F(LimiterTest, PoseFromAnotherClockIsStale) {
  time_s_ += kCycle;
  pose_time_s_ = time_s_ + 5.0;
  again({1.0, 0.0, 0.0});
  EXPECT_EQ(fault_, ForceFault::kStalePose);
}

TEST_F(LimiterTest, NonFinitePoseFallsToZeroIn25Milliseconds) {
  run(1.0, {2.0, 0.0, 0.0});
  pose_.position_m.y() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NEAR(cycle({2.0, 0.0, 0.0}).force_n.norm(), 2.0, 1e-9);
  EXPECT_EQ(fault_, ForceFault::kUnusablePose);
  expectFall(2.0, [this] { return cycle({2.0, 0.0, 0.0}); });
  EXPECT_FALSE(limiter_.tripped());
}

TEST_F(LimiterTest, ZeroQuaternionFallsToZero) {
  run(1.0, {2.0, 0.0, 0.0});
  pose_.orientation.coeffs().setZero();
  cycle({2.0, 0.0, 0.0});
  EXPECT_EQ(fault_, ForceFault::kUnusablePose);
  expectFall(2.0, [this] { return cycle({2.0, 0.0, 0.0}); });
}

TEST_F(LimiterTest, NonFiniteWishFallsToZero) {
  run(1.0, {2.0, 0.0, 0.0});
  const Vector3 bad(0.0, std::numeric_limits<double>::infinity(), 0.0);
  cycle(bad);
  EXPECT_EQ(limiter_.fault(), ForceFault::kUnusableForce);
  expectFall(2.0, [&] { return cycle(bad); });
}

TEST_F(LimiterTest, TeleportLatchesUntilReset) {
  run(1.0, {2.0, 0.0, 0.0});
  pose_.position_m.x() += 0.05;
  cycle({2.0, 0.0, 0.0});
  EXPECT_EQ(fault_, ForceFault::kTripped);
  expectFall(2.0, [this] { return cycle({2.0, 0.0, 0.0}); });
  run(1.0, {2.0, 0.0, 0.0});  // the pose is good again, and stays where it is
  EXPECT_TRUE(limiter_.tripped());
  EXPECT_EQ(last_.force_n.norm(), 0.0);
  limiter_.reset();
  EXPECT_FALSE(limiter_.tripped());
  EXPECT_EQ(cycle({2.0, 0.0, 0.0}).force_n.norm(), 0.0);
  run(0.1, {2.0, 0.0, 0.0});
  EXPECT_NEAR(last_.force_n.x(), 1.0, 1e-9);
}

TEST_F(LimiterTest, SteadyOverspeedTripsAndSlowerMotionDoesNot) {
  for (int n = 0; n < 200; ++n) {
    pose_.position_m.x() += 0.95 * kCycle;
    cycle(Vector3::Zero());
  }
  EXPECT_FALSE(limiter_.tripped());
  for (int n = 0; n < 45 && !limiter_.tripped(); ++n) {
    pose_.position_m.x() += 1.1 * kCycle;
    cycle(Vector3::Zero());
  }
  EXPECT_TRUE(limiter_.tripped());
}

TEST_F(LimiterTest, MeasuredVelocityTripsAtOnce) {
  velocity_ = Vector3(0.0, 0.99, 0.0);
  cycle(Vector3::Zero());
  EXPECT_FALSE(limiter_.tripped());
  velocity_ = Vector3(0.0, 1.01, 0.0);
  cycle(Vector3::Zero());
  EXPECT_TRUE(limiter_.tripped());
}

// Four poses of a hand at 0.3 m/s come late and in one burst, 10 us apart: 30 m/s between two of them, but no jump.
TEST_F(LimiterTest, BurstOfLateMessagesDoesNotTrip) {
  run(0.1, Vector3::Zero());
  for (int burst = 0; burst < 200; ++burst) {
    time_s_ += 4 * kCycle;
    for (int n = 0; n < 4; ++n) {
      pose_.position_m.x() += 0.3 * kCycle;
      pose_time_s_ = time_s_ + 1e-5 * n;
      limiter_.check(pose_time_s_, pose_time_s_, pose_, velocity_);
    }
  }
  EXPECT_FALSE(limiter_.tripped());
}

/// A hand at 0.5 m/s whose poses were held up for 60 ms and then come in three cycles. `tooth_m` goes in between.
class HeldUpPosesTest : public LimiterTest {
 protected:
  void burst(bool stamped, double tooth_m) {
    run(0.5, Vector3::Zero());
    double device_s = 7.0;  // a clock of its own
    for (int n = 0; n < 60; ++n)
      silentCycle(Vector3::Zero());
    for (int n = 0; n < 3; ++n) {
      device_s += 0.020;
      pose_.position_m.x() += 0.5 * 0.020 + (n == 1 ? tooth_m : 0.0);
      if (stamped)
        stamp_s_ = device_s;
      cycle(Vector3::Zero());
    }
  }
};

TEST_F(HeldUpPosesTest, DoNotTripWhereTheirStampsTellOfIt) {
  burst(true, 0.0);
  EXPECT_FALSE(limiter_.tripped());
}

TEST_F(HeldUpPosesTest, TripWithoutStamps) {
  burst(false, 0.0);
  EXPECT_TRUE(limiter_.tripped());
}

TEST_F(HeldUpPosesTest, ATeleportAmongThemTrips) {
  burst(true, 0.05);
  EXPECT_TRUE(limiter_.tripped());
}

TEST_F(LimiterTest, StampsExcuseNoJumpBeyondATenthOfASecond) {
  run(0.5, Vector3::Zero());
  stamp_s_ = 1.0;
  cycle(Vector3::Zero());
  stamp_s_ = 100.0;
  pose_.position_m.x() += 0.2;
  cycle(Vector3::Zero());
  EXPECT_TRUE(limiter_.tripped());
}

TEST_F(LimiterTest, StampsThatDoNotIncreaseSayNothing) {
  stamp_s_ = 1.0;
  for (int n = 0; n < 200; ++n) {
    *stamp_s_ -= n % 2 == 0 ? 0.5 : -0.4;
    pose_.position_m.x() += 0.0005;
    cycle(Vector3::Zero());
  }
  EXPECT_FALSE(limiter_.tripped());
  *stamp_s_ -= 1.0;
  pose_.position_m.x() += 0.02;
  cycle(Vector3::Zero());
  EXPECT_TRUE(limiter_.tripped());
}

TEST_F(LimiterTest, PoseAfterAGapIsAReconnectNotAJump) {
  run(1.0, {2.0, 0.0, 0.0});
  for (int n = 0; n < 100; ++n)
    silentCycle({2.0, 0.0, 0.0});
  pose_.position_m.x() += 0.1;
  EXPECT_EQ(cycle({2.0, 0.0, 0.0}).force_n.norm(), 0.0);
  EXPECT_EQ(fault_, ForceFault::kNone);
}

TEST_F(LimiterTest, ClockThatJumpsBackRestarts) {
  run(1.0, {2.0, 0.0, 0.0});
  time_s_ -= 50.0;
  EXPECT_EQ(cycle({2.0, 0.0, 0.0}).force_n.norm(), 0.0);
  EXPECT_EQ(fault_, ForceFault::kNone);
}

TEST(ForceFaultTest, EveryFaultHasItsSentence) {
  EXPECT_EQ(describe(ForceFault::kNone), "");
  EXPECT_NE(describe(ForceFault::kTripped).find("reset"), std::string::npos);
  EXPECT_NE(describe(ForceFault::kStalePose), describe(ForceFault::kUnusablePose));
}

TEST(DeviceLimitsTest, KnowsTheDevices) {
  EXPECT_EQ(deviceLimits("touch").max_force_n, 3.3);
  EXPECT_EQ(deviceLimits("touch").max_stiffness_n_m, 400);
  EXPECT_EQ(deviceLimits("omega_7").max_damping_n_s_m, 30);
  EXPECT_EQ(deviceLimits("premium_3_0").workspace_radius_m, 0.25);
  for (const char* name : {"touch", "omni", "desktop", "premium_1_5", "premium_3_0", "omega_7", "falcon"}) {
    EXPECT_NO_THROW(deviceLimits(name).validate(name));
  }
  try {
    deviceLimits("joystick");
    FAIL() << "an unknown device was accepted";
  } catch (const SceneError& error) {
    EXPECT_NE(std::string(error.what()).find("premium_1_5"), std::string::npos);
  }
}

}  // namespace
}  // namespace soft_volume::core
