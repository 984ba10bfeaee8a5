#include "soft_volume/tool/virtual_device.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

VirtualDeviceConfig holdAt(const Vector3& position_m) {
  VirtualDeviceConfig config;
  config.limits = deviceLimits("touch");
  config.workspace_centre_m = position_m;
  config.way_points = {WayPoint{0.0, position_m, std::nullopt, Buttons()}};
  return config;
}

VirtualDeviceConfig moveAlongX() {
  VirtualDeviceConfig config = holdAt(Vector3::Zero());
  config.way_points.push_back(WayPoint{1.0, Vector3(0.05, 0.0, 0.0), std::nullopt, Buttons(1)});
  config.way_points.push_back(
      WayPoint{2.0, Vector3::Zero(), Quaternion(Eigen::AngleAxisd(M_PI / 2, Vector3::UnitX())), Buttons(2)});
  return config;
}

void run(VirtualDevice& device, double seconds) {
  for (int n = 0; n < int(std::lround(seconds / VirtualDevice::kStep_s)); ++n)
    device.step();
}

TEST(VirtualDeviceTest, FollowsTheScriptSmoothly) {
  VirtualDevice device(moveAlongX());
  double fastest = 0.0;
  double last_speed = 0.0;
  for (int n = 0; n < 1000; ++n) {
    device.step();
    const double speed = device.velocity_m_s().norm();
    EXPECT_LT(std::abs(speed - last_speed), 0.001);  // 1 m/s^2; minimum jerk peaks at 0.29
    last_speed = speed;
    fastest = std::max(fastest, speed);
  }
  EXPECT_NEAR(fastest, 1.875 * 0.05, 0.005);  // peak of minimum jerk: 15/8 of the mean speed
  EXPECT_NEAR(device.pose().position_m.x(), 0.05, 0.0005);
  EXPECT_FALSE(device.scriptEnded());
  run(device, 1.5);
  EXPECT_TRUE(device.scriptEnded());
  EXPECT_LT(device.pose().position_m.norm(), 1e-6);
}

TEST(VirtualDeviceTest, ButtonsAndOrientationFollowTheWayPoints) {
  VirtualDevice device(moveAlongX());
  EXPECT_EQ(device.buttons(), Buttons(0));
  run(device, 1.0005);
  EXPECT_EQ(device.buttons(), Buttons(1));
  EXPECT_TRUE(device.pose().orientation.isApprox(Quaternion::Identity(), 1e-6));
  run(device, 0.5);
  EXPECT_NEAR(device.pose().orientation.angularDistance(Quaternion::Identity()), M_PI / 4, 0.01);
  run(device, 0.6);
  EXPECT_EQ(device.buttons(), Buttons(2));
  EXPECT_NEAR(device.pose().orientation.angularDistance(Quaternion::Identity()), M_PI / 2, 1e-6);
}

constexpr double kArcRadius = 0.040;
constexpr double kArcSpeed = 0.015;

/// At an angle of an arc about z; the tool's x axis points along it.
WayPoint onArc(double time_s, double angle) {
  return {time_s, kArcRadius * Vector3(std::cos(angle), std::sin(angle), 0.0),
          Quaternion(Eigen::AngleAxisd(angle + M_PI / 2, Vector3::UnitZ())), Buttons(), true};
}

/// A curved stroke of 60 mm in six pieces, from rest to rest, at 15 mm/s in between.
VirtualDeviceConfig moveAlongAnArc() {
  VirtualDeviceConfig config = holdAt(Vector3::Zero());
  config.way_points.clear();
  for (int n = 0; n <= 6; ++n)
    config.way_points.push_back(onArc(n * 0.010 / kArcSpeed, n * 0.010 / kArcRadius));
  return config;
}

TEST(VirtualDeviceTest, PassesWayPointsAlongASmoothCurve) {
  VirtualDevice device(moveAlongAnArc());
  Vector3 last_velocity = Vector3::Zero();
  const double end_s = 6 * 0.010 / kArcSpeed;
  while (device.time_s() < end_s - 1e-9) {
    device.step();
    EXPECT_LT((device.velocity_m_s() - last_velocity).norm(), 2e-4);  // 0.2 m/s^2
    last_velocity = device.velocity_m_s();
    EXPECT_NEAR(device.pose().position_m.norm(), kArcRadius, 2e-4);
    const bool between = device.time_s() > 0.8 && device.time_s() < end_s - 0.8;
    if (!between)
      continue;
    EXPECT_NEAR(last_velocity.norm(), kArcSpeed, 0.1 * kArcSpeed);
    const Vector3 ahead = device.pose().orientation * Vector3::UnitX();
    EXPECT_GT(ahead.dot(last_velocity.normalized()), std::cos(3.0 * M_PI / 180.0));
  }
  EXPECT_LT((device.pose().position_m - moveAlongAnArc().way_points.back().position_m).norm(), 2e-4);
}

TEST(VirtualDeviceTest, IsAtEveryWayPointThatItPassesInTime) {
  const VirtualDeviceConfig config = moveAlongAnArc();
  VirtualDevice device(config);
  for (const WayPoint& point : config.way_points) {
    while (device.time_s() < point.time_s - 1e-9)
      device.step();
    EXPECT_LT((device.pose().position_m - point.position_m).norm(), 2e-4);
    EXPECT_LT(device.pose().orientation.angularDistance(*point.orientation), 0.01);
  }
}

TEST(VirtualDeviceTest, FirstAndLastWayPointAreRests) {
  VirtualDeviceConfig passing = moveAlongX();
  passing.way_points.front().pass = passing.way_points.back().pass = true;
  VirtualDevice one(passing);
  VirtualDevice other(moveAlongX());
  for (int n = 0; n < 2500; ++n) {
    one.step();
    other.step();
    ASSERT_EQ(one.pose().position_m, other.pose().position_m);
  }
}

TEST(VirtualDeviceTest, ServoForceMovesItAgainstTheHand) {
  VirtualDevice device(holdAt(Vector3::Zero()));
  for (int n = 0; n < 1000; ++n) {
    device.setServoForce({0.0, 1.5, 0.0});
    device.step();
  }
  EXPECT_NEAR(device.pose().position_m.y(), 1.5 / 300.0, 1e-6);
  EXPECT_NEAR(device.handForce_n().y(), 1.5, 1e-3);
}

TEST(VirtualDeviceTest, ServoForceIsSaturatedAndNeverNotANumber) {
  VirtualDevice device(holdAt(Vector3::Zero()));
  device.setServoForce({0.0, 30.0, 40.0});
  EXPECT_NEAR((device.renderedForce_n() - Vector3(0.0, 0.6 * 3.3, 0.8 * 3.3)).norm(), 0.0, 1e-12);
  device.setServoForce({0.0, std::numeric_limits<double>::quiet_NaN(), 0.0});
  EXPECT_EQ(device.renderedForce_n().norm(), 0.0);
  device.setServoForce({0.0, std::numeric_limits<double>::infinity(), 0.0});
  EXPECT_EQ(device.renderedForce_n().norm(), 0.0);
}

TEST(VirtualDeviceTest, OldServoForceIsDropped) {
  VirtualDevice device(holdAt(Vector3::Zero()));
  device.setServoForce({1.0, 0.0, 0.0});
  run(device, 0.020);
  EXPECT_EQ(device.renderedForce_n().x(), 1.0);
  device.step();
  EXPECT_EQ(device.renderedForce_n().x(), 0.0);
}

TEST(VirtualDeviceTest, WorkspaceHasAnEnd) {
  VirtualDeviceConfig config = holdAt(Vector3(0.1, 0.1, 0.1));
  config.hand_stiffness_n_m = 10.0;
  VirtualDevice device(config);
  for (int n = 0; n < 3000; ++n) {
    device.setServoForce({3.3, 0.0, 0.0});
    device.step();
  }
  EXPECT_NEAR((device.pose().position_m - config.workspace_centre_m).norm(), 0.075, 1e-9);
  EXPECT_NEAR(device.velocity_m_s().norm(), 0.0, 1e-9);
}

TEST(VirtualDeviceTest, EncodersRound) {
  VirtualDeviceConfig config = moveAlongX();
  config.position_resolution_m = 0.0005;
  VirtualDevice device(config);
  run(device, 0.5);
  const double steps = device.pose().position_m.x() / 0.0005;
  EXPECT_NEAR(steps, std::round(steps), 1e-9);
  EXPECT_GT(steps, 10.0);
}

TEST(VirtualDeviceTest, IsDeterministic) {
  VirtualDevice a(moveAlongX());
  VirtualDevice b(moveAlongX());
  for (int n = 0; n < 2500; ++n) {
    for (VirtualDevice* device : {&a, &b}) {
      device->setServoForce({0.1 * std::sin(0.01 * n), 0.2, 0.0});
      device->step();
    }
    ASSERT_EQ(a.pose().position_m, b.pose().position_m);
  }
}

void expectRefused(const std::function<void(VirtualDeviceConfig&)>& damage, const std::string& field) {
  VirtualDeviceConfig config = moveAlongX();
  ASSERT_NO_THROW(config.validate());
  damage(config);
  try {
    VirtualDevice device(config);
    ADD_FAILURE() << field << " was accepted";
  } catch (const SceneError& error) {
    EXPECT_NE(std::string(error.what()).find(field), std::string::npos) << error.what();
  }
}

TEST(VirtualDeviceTest, BadConfigurationsAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  expectRefused([](auto& c) { c.mass_kg = 0.0; }, "mass_kg");
  expectRefused([](auto& c) { c.damping_n_s_m = -1.0; }, "damping_n_s_m");
  expectRefused([](auto& c) { c.hand_stiffness_n_m = 1e6; }, "hand_stiffness_n_m");
  expectRefused([=](auto& c) { c.hand_damping_n_s_m = nan; }, "hand_damping_n_s_m");
  expectRefused([](auto& c) { c.position_resolution_m = 0.1; }, "position_resolution_m");
  expectRefused([=](auto& c) { c.workspace_centre_m.x() = nan; }, "workspace_centre_m");
  expectRefused([](auto& c) { c.limits.max_force_n = -3.0; }, "max_force_n");
  expectRefused([](auto& c) { c.way_points.clear(); }, "way-point");
  expectRefused([](auto& c) { c.way_points[1].time_s = -1.0; }, "way-point 2: time_s");
  expectRefused([](auto& c) { c.way_points[2].time_s = 1.0; }, "way-point 3: time_s");
  expectRefused([](auto& c) { c.way_points[1].position_m.x() = 0.2; }, "way-point 2: distance");
  expectRefused([](auto& c) { c.way_points[2].orientation->coeffs().setZero(); }, "way-point 3: norm");
}

TEST(VirtualDeviceTest, FrictionHoldsUntilItIsOvercome) {
  VirtualDeviceConfig config = holdAt(Vector3::Zero());
  config.friction_n = 0.26;
  VirtualDevice device(config);
  device.setGrip(0.0, 0.0);
  for (const double force_n : {0.25, 0.30}) {
    for (int n = 0; n < 20; ++n) {
      device.setServoForce({force_n, 0.0, 0.0});
      device.step();
    }
    EXPECT_EQ(device.velocity_m_s().x() > 0.0, force_n > 0.26);
  }
  const double speed = device.velocity_m_s().x();
  EXPECT_NEAR(speed, 0.02 * (0.30 - 0.26) / config.mass_kg, 0.1 * speed);  // less by the damping
  device.setServoForce(Vector3::Zero());
  run(device, 0.1);
  EXPECT_EQ(device.velocity_m_s().norm(), 0.0);
}

/// Works through both ports and the energy that is left tell what was dissipated; that is never negative.
TEST(VirtualDeviceTest, WorksAddUp) {
  VirtualDeviceConfig config = moveAlongX();
  config.step_s = 5e-5;
  config.damping_n_s_m = 0.0;
  VirtualDevice device(config);
  double hand_j = 0.0;
  for (int n = 0; n < 10000; ++n) {
    const Vector3 before = device.position_m();
    device.setServoForce({-1.0, 0.0, 0.0});
    device.step();
    hand_j -= device.handForce_n().dot(device.position_m() - before);
  }
  const double motor_j = device.motorWork().into_device_j - device.motorWork().out_of_device_j;
  const double hand_by_ports_j = device.handWork().into_device_j - device.handWork().out_of_device_j;
  EXPECT_NEAR(motor_j, -1.0 * device.position_m().x(), 1e-12);
  EXPECT_NEAR(hand_by_ports_j, hand_j, 0.01 * hand_j);  // by the spring's stretch before and after a step
  // Without damping and friction only the scheme loses anything, and never gains.
  const double lost_j = hand_by_ports_j + motor_j - device.kineticEnergy_j();
  EXPECT_GE(lost_j, 0.0);
  EXPECT_LT(lost_j, 0.005 * hand_j);
}

TEST(VirtualDeviceTest, MechanicsOfEveryKnownDeviceAreStated) {
  for (const char* name : {"touch", "omni", "desktop", "premium_1_5", "premium_3_0", "omega_7", "falcon"}) {
    const DeviceMechanics mechanics = deviceMechanics(name);
    VirtualDeviceConfig config = holdAt(Vector3::Zero());
    config.mass_kg = mechanics.mass_kg;
    config.friction_n = mechanics.friction_n;
    config.position_resolution_m = mechanics.position_resolution_m;
    EXPECT_NO_THROW(config.validate()) << name;
    EXPECT_GE(mechanics.rate_hz, 1000.0) << name;
    EXPECT_NE(std::string(mechanics.source), "") << name;
  }
  EXPECT_THROW(deviceMechanics("mouse"), SceneError);
}

}  // namespace
}  // namespace soft_volume::core
