// The virtual device, a tool and tissue in one loop at 1 kHz, as the nodes run it. The force that the tool computes
// from a pose reaches the device one period later: the delay that a tool's default coupling allows for.

#include <gtest/gtest.h>

#include <algorithm>
#include <deque>

#include "soft_volume/tool/tool.h"
#include "soft_volume/tool/virtual_device.h"
#include "tissue_fixture.h"

namespace soft_volume::core {
namespace {

constexpr double kStep = VirtualDevice::kStep_s;
constexpr double kTipRadius = 0.004;
const Vector3 kStart(0.031, 0.030, kSurfaceZ + 0.010);

/// Tissue as one mass on a spring, which moves the whole half-space up and down. A force acts `delay` steps later.
struct TissueModel {
  double stiffness_n_m = 0.0;  // 0: fixed
  double mass_kg = 0.02;
  double damping_n_s_m = 1.0;
  std::size_t delay_steps = 1;

  double height_m = 0.0;
  double velocity_m_s = 0.0;
  double force_n = 0.0;
  std::deque<double> coming;

  void apply(const std::optional<TissueForce>& command) {
    if (command)
      force_n = command->force_n.z();
    coming.push_back(force_n);
  }
  void step() {
    if (stiffness_n_m == 0.0 || coming.size() <= delay_steps)
      return;
    const double force = coming.front() - stiffness_n_m * height_m - damping_n_s_m * velocity_m_s;
    coming.pop_front();
    velocity_m_s += kStep * force / mass_kg;
    height_m += kStep * velocity_m_s;
  }
};

struct Loop {
  Loop(const VirtualDeviceConfig& device_config, const ToolConfig& tool_config, const TissueModel& tissue_model)
      : device(device_config), tool(tool_config), model(tissue_model) {
    if (model.stiffness_n_m == 0.0)
      tissue.patch.stiffness_pa.assign(tissue.patch.cell_ids.size(), 1e9F);
    tool.setVolume(tissue.volume);
    tool.setTopology(std::make_shared<const Topology>(tissue.topology));
    tool.setPatch(tissue.patch);
  }

  void movePatch() {
    tissue.deform([this](const Vector3& p) { return Vector3(p + model.height_m * Vector3::UnitZ()); },
                  [this](const Vector3&) { return Vector3(0.0, 0.0, model.velocity_m_s); });
    tool.setPatch(tissue.patch);
  }

  void step() {
    device.step();
    device.setServoForce(output.device_force_n);  // of the pose before: it was on its way for a period
    model.step();
    movePatch();
    ToolInput input;
    input.time_s = input.pose_time_s = device.time_s();
    input.pose = device.pose();
    input.velocity_m_s = device.velocity_m_s();
    input.buttons = device.buttons();
    output = tool.update(input);
    model.apply(output.force);
    const double pushed = (device.handForce_n()).dot(output.device_force_n);
    if (output.contact.touching && device.velocity_m_s().norm() < 1e-3)
      opposed &= pushed >= 0.0;
    opposed &= output.device_force_n.z() >= 0.0;  // the push is downwards
  }

  /// Runs and returns the swing of the force, peak to peak [N], over the last `window_s`.
  double swing(double seconds, double window_s) {
    double low = 1e9;
    double high = -1e9;
    const int steps = int(std::lround(seconds / kStep));
    for (int n = 0; n < steps; ++n) {
      step();
      if (n < steps - int(window_s / kStep))
        continue;
      low = std::min(low, output.device_force_n.norm());
      high = std::max(high, output.device_force_n.norm());
    }
    return high - low;
  }

  VirtualDevice device;
  Tissue tissue = makeFlatHalfSpace();
  Tool tool;
  TissueModel model;
  ToolOutput output;
  bool opposed = true;
};

/// The hand wants the sphere `depth_m` below the surface after half a second, and keeps it there.
VirtualDeviceConfig pushTo(double depth_m) {
  VirtualDeviceConfig config;
  config.limits = deviceLimits("touch");
  config.workspace_centre_m = kStart;
  config.way_points = {
      WayPoint{0.0, kStart, std::nullopt, Buttons()},
      WayPoint{0.5, Vector3(kStart.x(), kStart.y(), kSurfaceZ + kTipRadius - depth_m), std::nullopt, Buttons()}};
  return config;
}

ToolConfig probe() {
  ToolConfig config;
  config.tip_radius_m = kTipRadius;
  config.device = deviceLimits("touch");
  return config;
}

double series(std::initializer_list<double> stiffnesses) {
  double compliance = 0.0;
  for (const double k : stiffnesses)
    compliance += 1.0 / k;
  return 1.0 / compliance;
}

TEST(ClosedLoopTest, FixedHalfSpaceGivesTheSeriesStiffness) {
  Loop loop(pushTo(0.012), probe(), {});
  EXPECT_LT(loop.swing(3.0, 1.0), 1e-3);
  EXPECT_TRUE(loop.opposed);
  const double k = series({300.0, loop.output.coupling_stiffness_n_m});
  EXPECT_NEAR(loop.output.device_force_n.z(), 0.012 * k, 0.02 * 0.012 * k);
  EXPECT_NEAR(loop.device.handForce_n().z(), 0.012 * k, 0.02 * 0.012 * k);
}

class CompliantTissueTest : public testing::TestWithParam<std::size_t> {};

TEST_P(CompliantTissueTest, SettlesAtTheSeriesStiffnessInSpiteOfTheDelay) {
  TissueModel model;
  model.stiffness_n_m = 200.0;
  model.delay_steps = GetParam();
  Loop loop(pushTo(0.012), probe(), model);
  EXPECT_LT(loop.swing(3.0, 1.0), 1e-3);
  EXPECT_TRUE(loop.opposed);
  const double k = series({300.0, loop.output.coupling_stiffness_n_m, 200.0});
  EXPECT_NEAR(loop.output.device_force_n.z(), 0.012 * k, 0.02 * 0.012 * k);
  EXPECT_NEAR(loop.model.height_m, -0.012 * k / 200.0, 0.02 * 0.012 * k / 200.0);
}

INSTANTIATE_TEST_SUITE_P(Delay, CompliantTissueTest, testing::Values(1, 2, 3, 5));

// A hand that only leans on the device adds no damping: all that calms the loop is the device's own 0.2 N s/m.
VirtualDeviceConfig looseHand() {
  VirtualDeviceConfig config = pushTo(0.030);
  config.way_points.back().position_m.z() = kStart.z() - 0.040;
  config.hand_stiffness_n_m = 20.0;
  config.hand_damping_n_s_m = 0.0;
  return config;
}

TEST(ClosedLoopTest, StiffnessWithinTheBoundIsStableEvenWithALooseHand) {
  Loop loop(looseHand(), probe(), {});
  EXPECT_LT(loop.swing(8.0, 0.5), 1e-2);
  EXPECT_GT(loop.output.device_force_n.z(), 0.3);
}

// A wrong claim about the device makes a stiffness beyond the passive one; the passivity controller holds it.
TEST(ClosedLoopTest, ThePassivityControllerHoldsAStiffnessBeyondTheBound) {
  ToolConfig config = probe();
  config.coupling.stiffness_n_m = 300.0;
  config.coupling.device_damping_n_s_m = 5.0;
  Loop loop(looseHand(), config, {});
  EXPECT_LT(loop.swing(8.0, 0.5), 2e-2);
  EXPECT_EQ(loop.output.coupling_stiffness_n_m, 300.0);
  EXPECT_FALSE(loop.output.tripped);
}

// The control of the two tests above: the same stiffness on a device that may render no damping swings.
TEST(ClosedLoopTest, StiffnessBeyondTheBoundSwings) {
  ToolConfig config = probe();
  config.coupling.stiffness_n_m = 300.0;
  config.coupling.device_damping_n_s_m = 5.0;
  config.device.max_damping_n_s_m = 0.0;
  Loop loop(looseHand(), config, {});
  EXPECT_GT(loop.swing(2.0, 0.5), 0.5);
  loop.swing(2.0, 0.5);
  EXPECT_TRUE(loop.output.tripped);  // the swing grows until the speed limit ends it
  EXPECT_EQ(loop.output.device_force_n.norm(), 0.0);
}

TEST(ClosedLoopTest, DeviceLetsGoWhenTheHandLeaves) {
  VirtualDeviceConfig config = pushTo(0.012);
  config.way_points.push_back(WayPoint{1.0, config.way_points.back().position_m, std::nullopt, Buttons()});
  config.way_points.push_back(WayPoint{1.5, kStart, std::nullopt, Buttons()});
  TissueModel model;
  model.stiffness_n_m = 200.0;
  Loop loop(config, probe(), model);
  loop.swing(1.0, 0.1);
  EXPECT_GT(loop.output.device_force_n.z(), 0.3);
  loop.swing(1.5, 0.1);
  EXPECT_EQ(loop.output.device_force_n.norm(), 0.0);
  EXPECT_NEAR(loop.model.height_m, 0.0, 1e-5);
}

TEST(ClosedLoopTest, IsDeterministic) {
  TissueModel model;
  model.stiffness_n_m = 200.0;
  Loop a(pushTo(0.012), probe(), model);
  Loop b(pushTo(0.012), probe(), model);
  for (int n = 0; n < 800; ++n) {
    a.step();
    b.step();
    ASSERT_EQ(a.output.device_force_n, b.output.device_force_n) << "step " << n;
  }
}

}  // namespace
}  // namespace soft_volume::core
