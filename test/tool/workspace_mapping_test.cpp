#include "soft_volume/tool/workspace_mapping.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr double kClose = 1e-12;
constexpr std::uint32_t kClutch = 2;

Quaternion turned(double angle_rad, const Vector3& axis) {
  return Quaternion(Eigen::AngleAxisd(angle_rad, axis.normalized()));
}

/// A device that stands askew, is scaled, has its handle turned, and has a clutch.
WorkspaceMappingConfig askew() {
  WorkspaceMappingConfig config;
  config.scale = 0.5;
  config.force_scale = 3.0;
  config.device_centre_m = {0.01, -0.02, 0.03};
  config.offset_m = {0.001, 0.002, 0.003};
  config.orientation = turned(0.7, {1.0, 2.0, -1.0});
  config.handle_orientation = turned(-1.1, {0.0, 1.0, 1.0});
  config.clutch_button = kClutch;
  return config;
}

WorkspacePlace place() {
  return {{0.1, 0.2, 0.3}, turned(0.4, {0.0, 0.0, 1.0})};
}

Pose somewhere() {
  return {{0.05, 0.04, -0.02}, turned(0.9, {1.0, 0.0, 1.0})};
}

Buttons clutch(bool held) {
  Buttons buttons;
  buttons[kClutch] = held;
  return buttons;
}

TEST(WorkspaceMapping, IsTheIdentityUnlessToldOtherwise) {
  WorkspaceMapping mapping;
  const Vector3 velocity(0.1, 0.2, 0.3);
  const auto tip = mapping.toVolume(somewhere(), velocity, {});
  EXPECT_EQ(tip.pose.position_m, somewhere().position_m);
  EXPECT_TRUE(tip.pose.orientation.isApprox(somewhere().orientation, kClose));
  EXPECT_EQ(*tip.velocity_m_s, velocity);
  EXPECT_TRUE(tip.engaged);
  EXPECT_EQ(mapping.forceToDevice(velocity), velocity);
  EXPECT_EQ(mapping.atDevice(7.0), 7.0);
}

TEST(WorkspaceMapping, PutsTheCentreWhereTheSceneAndTheOffsetSay) {
  WorkspaceMapping mapping(askew(), place());
  Pose centre = somewhere();
  centre.position_m = askew().device_centre_m;
  const Vector3 expected = place().centre_m + place().orientation * askew().offset_m;
  EXPECT_TRUE(mapping.toVolume(centre, {}, {}).pose.position_m.isApprox(expected, kClose));
}

TEST(WorkspaceMapping, ScalesAndTurnsWhatTheDeviceDoes) {
  WorkspaceMapping mapping(askew(), place());
  const Quaternion R_V_B = place().orientation * askew().orientation;
  const Vector3 from = mapping.toVolume(somewhere(), {}, {}).pose.position_m;
  Pose moved = somewhere();
  const Vector3 step(0.01, -0.02, 0.005);
  moved.position_m += step;
  const auto tip = mapping.toVolume(moved, step, {});
  EXPECT_TRUE((tip.pose.position_m - from).isApprox(R_V_B * (0.5 * step), 1e-9));
  EXPECT_TRUE(tip.velocity_m_s->isApprox(R_V_B * (0.5 * step), kClose));
  EXPECT_TRUE(tip.pose.orientation.isApprox(R_V_B * moved.orientation * askew().handle_orientation, kClose));
}

TEST(WorkspaceMapping, TheDeviceFeelsTheForceInItsOwnFrame) {
  WorkspaceMapping mapping(askew(), place());
  mapping.toVolume(somewhere(), {}, {});
  const Vector3 force(1.0, -0.5, 0.25);
  const Quaternion R_V_B = place().orientation * askew().orientation;
  EXPECT_TRUE(mapping.forceToDevice(force).isApprox(R_V_B.conjugate() * (3.0 * force), kClose));
  EXPECT_TRUE(mapping.forceToVolume(mapping.forceToDevice(force), somewhere().orientation).isApprox(force, kClose));
}

TEST(WorkspaceMapping, OrInThatOfItsHandle) {
  WorkspaceMappingConfig config = askew();
  config.force_frame = ForceFrame::kBody;
  WorkspaceMapping mapping(config, place());
  mapping.toVolume(somewhere(), {}, {});
  const Vector3 force(1.0, -0.5, 0.25);
  const Quaternion R_V_B = place().orientation * askew().orientation;
  const Vector3 in_base = R_V_B.conjugate() * (3.0 * force);
  EXPECT_TRUE(mapping.forceToDevice(force).isApprox(somewhere().orientation.conjugate() * in_base, kClose));
  EXPECT_TRUE(mapping.forceToVolume(mapping.forceToDevice(force), somewhere().orientation).isApprox(force, kClose));
}

TEST(WorkspaceMapping, GoesBackToTheDevice) {
  WorkspaceMapping mapping(askew(), place());
  const Pose back = mapping.toDevice(mapping.toVolume(somewhere(), {}, {}).pose);
  EXPECT_TRUE(back.position_m.isApprox(somewhere().position_m, 1e-9));
  EXPECT_TRUE(back.orientation.isApprox(somewhere().orientation, 1e-9));
}

/// Work at the device is work at the tip, up to one constant: nothing in between puts energy in.
TEST(WorkspaceMapping, KeepsWorkUpToAConstant) {
  WorkspaceMapping mapping(askew(), place());
  const auto before = mapping.toVolume(somewhere(), {}, {});
  Pose moved = somewhere();
  moved.position_m += Vector3(0.003, 0.001, -0.002);
  const auto after = mapping.toVolume(moved, {}, {});
  const Vector3 force(0.3, -0.8, 0.1);
  const double at_tip = force.dot(after.pose.position_m - before.pose.position_m);
  const double at_device = mapping.forceToDevice(force).dot(moved.position_m - somewhere().position_m);
  EXPECT_NEAR(at_device, at_tip * 3.0 / 0.5, 1e-12);
}

TEST(WorkspaceMapping, TheClutchHoldsTheTipAndLetsGoWithoutAJump) {
  WorkspaceMapping mapping(askew(), place());
  Pose device = somewhere();
  const Vector3 held = mapping.toVolume(device, {}, clutch(false)).pose.position_m;
  for (int n = 0; n < 50; ++n) {
    device.position_m += Vector3(0.001, 0.0, -0.002);
    const auto tip = mapping.toVolume(device, Vector3(1.0, 0.0, -2.0), clutch(true));
    EXPECT_FALSE(tip.engaged);
    EXPECT_TRUE(tip.pose.position_m.isApprox(held, 1e-9));
    EXPECT_EQ(*tip.velocity_m_s, Vector3::Zero().eval());
  }
  device.position_m += Vector3(0.001, 0.0, -0.002);
  const auto released = mapping.toVolume(device, {}, clutch(false));
  EXPECT_TRUE(released.engaged);
  EXPECT_TRUE(released.pose.position_m.isApprox(held, 1e-9));
  const Vector3 step(0.004, 0.001, 0.0);
  device.position_m += step;
  const Quaternion R_V_B = place().orientation * askew().orientation;
  EXPECT_TRUE(mapping.toVolume(device, {}, clutch(false)).pose.position_m.isApprox(held + R_V_B * (0.5 * step), 1e-9));
}

TEST(WorkspaceMapping, AnUnusablePoseIsPassedOnAndForgotten) {
  WorkspaceMapping mapping(askew(), place());
  const Vector3 held = mapping.toVolume(somewhere(), {}, clutch(true)).pose.position_m;
  Pose bad = somewhere();
  bad.position_m.x() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(isUsable(mapping.toVolume(bad, {}, clutch(true)).pose));
  bad = somewhere();
  bad.orientation.coeffs().setZero();
  EXPECT_FALSE(isUsable(mapping.toVolume(bad, {}, clutch(true)).pose));
  EXPECT_TRUE(mapping.toVolume(somewhere(), {}, clutch(false)).pose.position_m.isApprox(held, 1e-9));
}

/// What the tip may do, the device may do as well, and no more.
TEST(WorkspaceMapping, LimitsHoldAtTheDevice) {
  WorkspaceMapping mapping(askew(), place());
  const DeviceLimits device{3.0, 600.0, 6.0, 0.1};
  const DeviceLimits tip = mapping.atTip(device);
  mapping.toVolume(somewhere(), {}, {});
  EXPECT_NEAR(mapping.forceToDevice(tip.max_force_n * Vector3::UnitX()).norm(), 3.0, kClose);
  EXPECT_NEAR(mapping.atDevice(tip.max_stiffness_n_m), 600.0, 1e-9);
  EXPECT_NEAR(mapping.atDevice(tip.max_damping_n_s_m), 6.0, 1e-9);
  EXPECT_NEAR(tip.workspace_radius_m, 0.05, kClose);

  // The stiffness that is felt: press 1 mm with the device.
  Pose pressed = somewhere();
  const Vector3 from = mapping.toVolume(somewhere(), {}, {}).pose.position_m;
  pressed.position_m.x() += 0.001;
  const Vector3 depth = mapping.toVolume(pressed, {}, {}).pose.position_m - from;
  EXPECT_NEAR(mapping.forceToDevice(-tip.max_stiffness_n_m * depth).norm() / 0.001, 600.0, 1e-6);

  const SafetyConfig safety = mapping.atTip(SafetyConfig());
  EXPECT_NEAR(mapping.forceToDevice(safety.max_growth_n_s * Vector3::UnitX()).norm(), 100.0, 1e-9);
  EXPECT_NEAR(safety.max_speed_m_s, 0.5, kClose);
  EXPECT_EQ(safety.stale_after_s, 0.02);
}

TEST(WorkspaceMapping, RefusesWhatCannotBeMeant) {
  const auto refused = [](auto change) {
    WorkspaceMappingConfig config = askew();
    change(config);
    EXPECT_THROW(config.validate("device 'x'"), SceneError);
  };
  EXPECT_NO_THROW(askew().validate("device 'x'"));
  refused([](auto& c) { c.scale = 0.0; });
  refused([](auto& c) { c.scale = -1.0; });
  refused([](auto& c) { c.force_scale = std::nan(""); });
  refused([](auto& c) { c.device_centre_m.y() = 11.0; });
  refused([](auto& c) { c.offset_m.z() = std::nan(""); });
  refused([](auto& c) { c.orientation.coeffs().setZero(); });
  refused([](auto& c) { c.handle_orientation.coeffs() *= 2.0; });
  refused([](auto& c) { c.clutch_button = 32; });
}

}  // namespace
}  // namespace soft_volume::core
