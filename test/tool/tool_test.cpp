#include "soft_volume/tool/tool.h"

#include <gtest/gtest.h>

#include <limits>

#include "soft_volume/common/error.h"
#include "tissue_fixture.h"

namespace soft_volume::core {
namespace {

constexpr double kCycle = 0.001;
constexpr int kCyclesPerPatch = 10;
const Vector3 kAbove(0.030, 0.030, kSurfaceZ + 0.010);
const Vector3 kDeep(0.030, 0.030, kSurfaceZ - 0.004);

ToolConfig probeConfig() {
  ToolConfig config;
  config.device = deviceLimits("touch");
  return config;
}

ToolConfig scalpelConfig() {
  ToolConfig config = probeConfig();
  config.kind = ToolKind::kScalpel;
  config.tip_radius_m = 0.001;
  config.blade_length_m = 0.010;
  config.cut_button = 2;
  return config;
}

void connect(Tool& tool, const Tissue& tissue) {
  tool.setVolume(tissue.volume);
  tool.setTopology(std::make_shared<const Topology>(tissue.topology));
  tool.setPatch(tissue.patch);
}

/// A tool over the flat half-space, driven at 1 kHz. Every force command is checked against Newton's third law.
class ToolTest : public testing::Test {
 protected:
  void start(const ToolConfig& config) {
    tool_ = std::make_unique<Tool>(config);
    last_sequence_ = 0;
    last_cut_sequence_ = 0;
    connect(*tool_, tissue_);
    input_.time_s = 10.0;
    input_.pose.position_m = kAbove;
    hold(0.3);  // over the ramp
  }
  const ToolOutput& silentCycle() {
    input_.time_s += kCycle;
    if (simulated_ && ++cycles_ % kCyclesPerPatch == 0)
      tool_->setPatch(tissue_.patch);
    output_ = tool_->update(input_);
    checkForce();
    if (output_.cut) {
      if (output_.cut->quad)
        quads_.push_back(*output_.cut->quad);
      EXPECT_GT(output_.cut->header.sequence, last_cut_sequence_);
      EXPECT_TRUE(output_.cut->lifted || output_.cut->quad);
      last_cut_sequence_ = output_.cut->header.sequence;
      ends_ += output_.cut->lifted ? 1 : 0;
    }
    return output_;
  }
  const ToolOutput& cycle() {
    input_.pose_time_s = input_.time_s + kCycle;
    return silentCycle();
  }
  void hold(double seconds) {
    for (int n = 0; n < int(std::lround(seconds / kCycle)); ++n)
      cycle();
  }
  void moveTo(const Vector3& to, double speed_m_s = 0.1) {
    const Vector3 from = input_.pose.position_m;
    const int steps = std::max(1, int(std::lround((to - from).norm() / (speed_m_s * kCycle))));
    for (int n = 1; n <= steps; ++n) {
      input_.pose.position_m = from + double(n) / steps * (to - from);
      cycle();
    }
  }
  void checkForce() {
    if (!output_.force) {
      EXPECT_EQ(output_.device_force_n.norm(), 0.0) << "the device feels a force that the tissue does not";
      return;
    }
    EXPECT_EQ(output_.force->force_n, Vector3(-output_.device_force_n));
    EXPECT_GT(output_.force->header.sequence, last_sequence_);
    last_sequence_ = output_.force->header.sequence;
    ++commands_;
  }

  Tissue tissue_ = makeFlatHalfSpace();
  std::unique_ptr<Tool> tool_;
  ToolInput input_;
  ToolOutput output_;
  std::vector<SweptQuad> quads_;
  int ends_ = 0;
  std::uint64_t last_sequence_ = 0;
  std::uint64_t last_cut_sequence_ = 0;
  int commands_ = 0;
  int cycles_ = 0;
  bool simulated_ = true;  // patches come
};

TEST_F(ToolTest, IsAsStiffAsBeforeAfterItWasOutOfTheHand) {
  start(probeConfig());
  hold(1.0);
  const double stiffness_n_m = output_.coupling_stiffness_n_m;
  input_.time_s += 10.0;
  tool_->reset();
  hold(1.0);
  EXPECT_NEAR(output_.coupling_stiffness_n_m, stiffness_n_m, 1e-6 * stiffness_n_m);  // rounding of times
}

TEST_F(ToolTest, PushIsOpposedAndGivenToTheTissue) {
  start(probeConfig());
  EXPECT_EQ(commands_, 0);
  moveTo(kDeep);
  // While it moves the passivity controller brakes: at 0.1 m/s by no more than the coupling's delay makes of energy.
  EXPECT_NEAR(output_.device_force_n.z(), output_.coupling_stiffness_n_m * (0.008 + 0.00015), 1e-3);
  hold(0.02);
  const double wanted = output_.coupling_stiffness_n_m * (0.004 + 0.004);
  EXPECT_NEAR(output_.coupling_stiffness_n_m, 66.667, 1e-3);
  EXPECT_NEAR((output_.device_force_n - wanted * Vector3::UnitZ()).norm(), 0.0, 1e-3);
  ASSERT_TRUE(output_.force);
  EXPECT_EQ(output_.force->header.session, 7U);
  EXPECT_EQ(output_.force->header.revision, 3U);
  EXPECT_EQ(output_.force->hold_steps, 50U);
  EXPECT_EQ(output_.force->footprint_radius_m, probeConfig().footprint_radius_m);
  EXPECT_LT((output_.force->point_m - Vector3(0.030, 0.030, kSurfaceZ)).norm(), 1e-6);
  EXPECT_TRUE(output_.contact.touching);
}

TEST_F(ToolTest, TissueIsLetGoWithOneZeroForce) {
  start(probeConfig());
  moveTo(kDeep);
  int zeros = 0;
  while (input_.pose.position_m.z() < kAbove.z()) {
    input_.pose.position_m.z() += 0.0002;
    cycle();
    zeros += output_.force && output_.force->force_n.norm() == 0.0 ? 1 : 0;
  }
  EXPECT_EQ(zeros, 1);
  EXPECT_FALSE(output_.contact.touching);
  EXPECT_FALSE(output_.force);
}

TEST_F(ToolTest, DeadDeviceLetsGoOfTheTissueToo) {
  start(probeConfig());
  moveTo(kDeep);
  ASSERT_GT(output_.device_force_n.norm(), 0.5);
  for (int n = 0; n < 50; ++n)
    silentCycle();
  EXPECT_TRUE(output_.pose_stale);
  EXPECT_EQ(output_.fault, ForceFault::kStalePose);
  EXPECT_EQ(output_.device_force_n.norm(), 0.0);
  EXPECT_EQ(tool_->update(input_).force, std::nullopt);
}

TEST_F(ToolTest, PatchesThatStopTakeTheForceToZeroAndItRampsInWhenTheyComeAgain) {
  start(probeConfig());
  moveTo(kDeep);
  hold(0.1);
  const double before = output_.device_force_n.norm();
  ASSERT_GT(before, 0.5);
  EXPECT_NEAR(output_.patch_interval_s, kCyclesPerPatch * kCycle, 1e-9);
  simulated_ = false;
  hold(0.02);  // less than three intervals
  EXPECT_NEAR(output_.device_force_n.norm(), before, 1e-6);
  hold(0.036);
  EXPECT_EQ(output_.fault, ForceFault::kStalePatch);
  EXPECT_TRUE(output_.patch_stale);
  EXPECT_FALSE(output_.contact.touching);
  EXPECT_EQ(output_.device_force_n.norm(), 0.0);
  simulated_ = true;
  hold(0.05);
  EXPECT_LT(output_.device_force_n.norm(), 0.3 * before);
  EXPECT_GT(output_.device_force_n.norm(), 0.0);
  hold(0.3);
  EXPECT_NEAR(output_.device_force_n.norm(), before, 1e-6);
}

TEST_F(ToolTest, ADeviceThatIsNotEnabledGetsNoForce) {
  start(probeConfig());
  moveTo(kDeep);
  input_.forces_allowed = false;
  hold(0.026);
  EXPECT_EQ(output_.fault, ForceFault::kDisabled);
  EXPECT_EQ(output_.device_force_n.norm(), 0.0);
  input_.forces_allowed = true;
  hold(0.1);
  EXPECT_NEAR(output_.device_force_n.norm(), 0.5 * output_.coupling_stiffness_n_m * 0.008, 0.01);
}

TEST_F(ToolTest, SlowPosesMakeTheCouplingSofter) {
  start(probeConfig());
  moveTo(kDeep);
  const double before = output_.coupling_stiffness_n_m;
  for (int n = 0; n < 10; ++n) {
    cycle();
    for (int silent = 0; silent < 9; ++silent)
      silentCycle();
  }
  EXPECT_LT(output_.coupling_stiffness_n_m, 0.3 * before);
  EXPECT_EQ(output_.stiffness_bound, StiffnessBound::kPassivity);
  hold(2.0);  // good again, but in contact
  EXPECT_LT(output_.coupling_stiffness_n_m, 0.3 * before);
  moveTo(kAbove);
  hold(0.1);
  EXPECT_EQ(output_.coupling_stiffness_n_m, before);
}

TEST_F(ToolTest, ADeviceThatWasSilentForAWhileMakesNothingSofter) {
  start(probeConfig());
  moveTo(kDeep);
  const double before = output_.coupling_stiffness_n_m;
  for (int n = 0; n < 300; ++n)
    silentCycle();
  hold(0.3);
  EXPECT_EQ(output_.coupling_stiffness_n_m, before);
  EXPECT_GT(output_.device_force_n.norm(), 0.5);
}

TEST(ToolCommandTest, CommandsOfATickAreWholeCommandsOfItsTool) {
  TissueForce force;
  force.header = {7, 3, 99, 12};
  force.hold_steps = 50;
  force.cell = 17;
  const ToolForceCommand whole = toCommand("probe", force);
  EXPECT_EQ(whole.header.tool_id, "probe");
  EXPECT_EQ(whole.header.session, 7U);
  EXPECT_EQ(whole.header.revision, 3U);
  EXPECT_EQ(whole.header.step, 99U);
  EXPECT_EQ(whole.header.sequence, 12U);
  EXPECT_EQ(whole.header.apply_at_step, 0U);
  EXPECT_EQ(whole.cells, std::vector<std::uint32_t>{17});
  const ToolCutCommand end = toCommand("scalpel", TissueCut{force.header, std::nullopt, true});
  EXPECT_TRUE(end.quads.empty() && end.lifted);
}

TEST_F(ToolTest, UnusablePosesNeverReachTheContact) {
  start(probeConfig());
  moveTo(kDeep);
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    input_.pose.position_m.x() = bad;
    for (int n = 0; n < 30; ++n) {
      cycle();
      EXPECT_TRUE(isFinite(output_.device_force_n));
    }
    EXPECT_TRUE(output_.pose_stale);
    EXPECT_EQ(output_.device_force_n.norm(), 0.0);
    input_.pose.position_m = kDeep;
    hold(0.3);
    EXPECT_NEAR(output_.device_force_n.z(), output_.coupling_stiffness_n_m * 0.008, 1e-3);
  }
}

TEST_F(ToolTest, TripStaysUntilReset) {
  start(probeConfig());
  moveTo(kDeep);
  input_.pose.position_m.x() += 0.02;
  hold(0.5);
  EXPECT_TRUE(output_.tripped);
  EXPECT_EQ(output_.device_force_n.norm(), 0.0);
  tool_->reset();
  hold(0.3);
  EXPECT_FALSE(output_.tripped);
  EXPECT_NEAR(output_.device_force_n.z(), output_.coupling_stiffness_n_m * 0.008, 1e-3);
}

TEST_F(ToolTest, NothingHappensWithoutVolumeGridAndPatch) {
  Tool tool(probeConfig());
  ToolInput input;
  input.pose.position_m = kDeep;
  for (int n = 0; n < 500; ++n) {
    input.time_s = input.pose_time_s = n * kCycle;
    const ToolOutput output = tool.update(input);
    EXPECT_EQ(output.device_force_n.norm(), 0.0);
    EXPECT_FALSE(output.force);
  }
  EXPECT_THROW(tool.setPatch(tissue_.patch), InputError);
  tool.setVolume(tissue_.volume);
  EXPECT_THROW(tool.setPatch(tissue_.patch), InputError);
}

TEST_F(ToolTest, PatchesOfOthersAreRefused) {
  start(probeConfig());
  GridPatch patch = tissue_.patch;
  patch.tool_id = "scalpel";
  EXPECT_THROW(tool_->setPatch(patch), InputError);
  patch = tissue_.patch;
  patch.revision = 99;
  patch.step = 1234;
  EXPECT_THROW(tool_->setPatch(patch), InputError);
  EXPECT_EQ(tool_->patchHeader().revision, 3U);
  EXPECT_EQ(tool_->patchHeader().step, 0U);
}

TEST_F(ToolTest, NewSessionStartsOver) {
  start(probeConfig());
  moveTo(kDeep);
  simulated_ = false;
  tissue_.topology.session = tissue_.patch.session = 8;
  tool_->setTopology(std::make_shared<const Topology>(tissue_.topology));
  cycle();
  EXPECT_EQ(output_.device_force_n.norm(), 0.0);
  EXPECT_FALSE(output_.contact.touching);
  EXPECT_FALSE(output_.force);  // the old tissue is gone
  simulated_ = true;
  hold(0.3);
  EXPECT_GT(output_.device_force_n.z(), 0.1);
  EXPECT_EQ(output_.force->header.session, 8U);
}

TEST_F(ToolTest, VelocityIsEstimatedWhereTheDeviceHasNone) {
  start(probeConfig());
  moveTo(kAbove + Vector3(0.01, 0.0, 0.0), 0.1);
  EXPECT_LT((output_.velocity_m_s - Vector3(0.1, 0.0, 0.0)).norm(), 1e-3);
  input_.velocity_m_s = Vector3(0.0, 0.3, 0.0);
  cycle();
  EXPECT_EQ(output_.velocity_m_s, Vector3(0.0, 0.3, 0.0));
}

TEST_F(ToolTest, DampingCountsAgainstTheTissuesOwnMotion) {
  ToolConfig config = probeConfig();
  config.coupling.damping_n_s_m = 0.1;
  start(config);
  moveTo(kDeep);
  hold(0.1);
  EXPECT_NEAR(output_.device_force_n.z(), output_.coupling_stiffness_n_m * 0.008, 1e-6);
  for (int patch = 1; patch <= 5; ++patch) {  // the tissue goes away at 0.1 m/s
    tissue_.deform([=](const Vector3& p) { return Vector3(p - 0.001 * patch * Vector3::UnitZ()); });
    hold(kCyclesPerPatch * kCycle);
  }
  const double damping = 0.1 + output_.passivity_damping_n_s_m;
  EXPECT_LT(output_.contact.penetration_m, 0.005);
  EXPECT_NEAR(output_.device_force_n.z() - output_.coupling_stiffness_n_m * output_.contact.penetration_m,
              -damping * 0.1, 1e-4);
}

TEST_F(ToolTest, ScalpelPressesUntilItCutsAndAgainOnceItHasBeenFree) {
  start(scalpelConfig());
  moveTo(kDeep);
  hold(0.02);
  EXPECT_NEAR(output_.device_force_n.z(), output_.coupling_stiffness_n_m * 0.005, 1e-3);
  EXPECT_TRUE(quads_.empty());
  input_.buttons.set(2);
  cycle();
  EXPECT_LT(output_.device_force_n.norm(), 0.02);
  moveTo(kDeep + Vector3(0.010, 0.0, 0.0), 0.05);
  EXPECT_TRUE(output_.cutting);
  // Only the drag, against the motion.
  EXPECT_NEAR((output_.device_force_n - Vector3(-0.1 * 0.05, 0.0, 0.0)).norm(), 0.0, 1e-4);
  EXPECT_GT(quads_.size(), 15U);
  input_.buttons.reset();
  hold(0.1);
  EXPECT_FALSE(output_.cutting);
  EXPECT_EQ(output_.device_force_n.norm(), 0.0);
  moveTo(kAbove);
  moveTo(kDeep);
  hold(0.02);
  EXPECT_NEAR(output_.device_force_n.z(), output_.coupling_stiffness_n_m * 0.005, 1e-3);
}

TEST_F(ToolTest, TheTissueHearsOnceThatAStrokeEnded) {
  start(scalpelConfig());
  const auto cutFor10Millimetres = [this] {
    moveTo(kDeep);
    input_.buttons.set(2);
    moveTo(kDeep + Vector3(0.010, 0.0, 0.0));
  };
  cutFor10Millimetres();
  EXPECT_EQ(ends_, 0);
  input_.buttons.reset();  // the button
  cycle();
  EXPECT_EQ(ends_, 1);
  cutFor10Millimetres();
  for (int n = 0; n < 60; ++n)
    silentCycle();  // the device
  EXPECT_EQ(ends_, 2);
  input_.buttons.reset();
  cutFor10Millimetres();
  moveTo(kAbove);  // the blade is out
  EXPECT_EQ(ends_, 3);
  input_.buttons.reset();
  hold(0.1);
  EXPECT_EQ(ends_, 3);
  cutFor10Millimetres();
  const auto end = tool_->reset();  // the tool is put down
  ASSERT_TRUE(end.has_value());
  EXPECT_TRUE(end->lifted && !end->quad);
  EXPECT_GT(end->header.sequence, last_cut_sequence_);
  EXPECT_EQ(end->header.session, tissue_.patch.session);
  EXPECT_FALSE(tool_->reset().has_value());
}

TEST_F(ToolTest, AStrokeWithoutAQuadHasNoEnd) {
  start(scalpelConfig());
  moveTo(kDeep);
  input_.buttons.set(2);
  hold(0.05);
  input_.buttons.reset();
  hold(0.05);
  EXPECT_EQ(ends_, 0);
}

TEST_F(ToolTest, ABladeFeelsTheResistanceThatTheSimulationMeasured) {
  start(scalpelConfig());
  moveTo(kDeep);
  input_.buttons.set(2);
  hold(0.3);
  tissue_.patch.blade_resistance_n = 0.2;
  tool_->setPatch(tissue_.patch);
  moveTo(kDeep + Vector3(0.020, 0.0, 0.0), 0.05);
  EXPECT_NEAR((output_.device_force_n - Vector3(-0.2 - 0.1 * 0.05, 0.0, 0.0)).norm(), 0.0, 1e-4);
  tissue_.patch.blade_resistance_n = 50.0;  // more than the device may render, and not at once
  tool_->setPatch(tissue_.patch);
  const double before = output_.device_force_n.norm();
  moveTo(kDeep + Vector3(0.020, 0.001, 0.0), 0.05);
  EXPECT_LE(output_.device_force_n.norm() - before, 0.1 * 20 + 1e-9);
  tissue_.patch.blade_resistance_n = 0.0;
  tool_->setPatch(tissue_.patch);
  const double felt = output_.device_force_n.norm();
  cycle();
  EXPECT_GT(output_.device_force_n.norm(), 0.8 * felt);  // it fades, and is not gone in one tick
  hold(0.08);
  EXPECT_LT(output_.device_force_n.norm(), 0.02);
  tissue_.patch.blade_resistance_n = std::nan("");
  EXPECT_THROW(tool_->setPatch(tissue_.patch), InputError);
  tissue_.patch.blade_resistance_n = -1.0;
  EXPECT_THROW(tool_->setPatch(tissue_.patch), InputError);
}

TEST_F(ToolTest, OnlyTheCutButtonOfAScalpelCuts) {
  start(scalpelConfig());
  input_.buttons.set(0);
  moveTo(kDeep);
  moveTo(kDeep + Vector3(0.01, 0.0, 0.0));
  EXPECT_TRUE(quads_.empty());
  input_.buttons.set(2);
  start(probeConfig());
  moveTo(kDeep);
  moveTo(kDeep + Vector3(0.01, 0.0, 0.0));
  EXPECT_TRUE(quads_.empty());
}

TEST_F(ToolTest, JumpOrSilenceDoesNotCut) {
  start(scalpelConfig());
  input_.buttons.set(2);
  moveTo(kDeep);
  const std::size_t before = quads_.size();
  EXPECT_GT(before, 0U);
  for (int n = 0; n < 60; ++n)
    silentCycle();
  input_.pose.position_m.x() += 0.01;  // another place when the device is back
  hold(0.05);
  EXPECT_EQ(quads_.size(), before);
  EXPECT_FALSE(output_.tripped);
  input_.pose.position_m.x() -= 0.01;  // a jump
  hold(0.05);
  EXPECT_EQ(quads_.size(), before);
  EXPECT_TRUE(output_.tripped);
}

TEST_F(ToolTest, SequenceNumbersStartWhereTheCallerSays) {
  tool_ = std::make_unique<Tool>(probeConfig(), 5000);
  connect(*tool_, tissue_);
  input_.time_s = 10.0;
  input_.pose.position_m = kAbove;
  hold(0.3);
  moveTo(kDeep);
  EXPECT_GE(output_.force->header.sequence, 5000U);
}

void expectRefused(const std::function<void(ToolConfig&)>& damage, const std::string& field) {
  ToolConfig config = scalpelConfig();
  ASSERT_NO_THROW(config.validate());
  damage(config);
  try {
    config.validate();
    ADD_FAILURE() << field << " was accepted";
  } catch (const SceneError& error) {
    EXPECT_NE(std::string(error.what()).find(field), std::string::npos) << error.what();
  }
}

TEST(ToolConfigTest, BadValuesAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  expectRefused([](auto& c) { c.id.clear(); }, "id");
  expectRefused([=](auto& c) { c.tissue_threshold = nan; }, "tissue_threshold");
  expectRefused([](auto& c) { c.tip_radius_m = 0.0; }, "tip_radius_m");
  expectRefused([](auto& c) { c.footprint_radius_m = 1.0; }, "footprint_radius_m");
  expectRefused([](auto& c) { c.patch_radius_m = -0.1; }, "patch_radius_m");
  expectRefused([](auto& c) { c.friction_coefficient = 2.1; }, "friction_coefficient");
  expectRefused([](auto& c) { c.hold_steps = 0; }, "hold_steps");
  expectRefused([](auto& c) { c.blade_length_m = 1.0; }, "blade_length_m");
  expectRefused([](auto& c) { c.blade_min_move_m = 0.0; }, "blade_min_move_m");
  expectRefused([](auto& c) { c.cutting_drag_n_s_m = 1.0; }, "cutting_drag_n_s_m");
  expectRefused([](auto& c) { c.cut_button = 32; }, "cut_button");
  const auto refusedGrasper = [](auto damage, const std::string& field) {
    expectRefused(
        [&](ToolConfig& c) {
          c.kind = ToolKind::kGrasper;
          damage(c);
        },
        field);
  };
  refusedGrasper([](auto& c) { c.grasp_reach_m = 0.0; }, "grasp_reach_m");
  refusedGrasper([](auto& c) { c.slip_force_n = 0.0; }, "slip_force_n");
  refusedGrasper([](auto& c) { c.grasp_button = 32; }, "grasp_button");
  expectRefused([](auto& c) { c.coupling.stiffness_n_m = -1.0; }, "stiffness_n_m");
  expectRefused([](auto& c) { c.coupling.damping_n_s_m = 0.2; }, "damping_n_s_m");
  expectRefused([](auto& c) { c.coupling.device_damping_n_s_m = 0.0; }, "device_damping_n_s_m");
  expectRefused([](auto& c) { c.coupling.sample_period_s = 0.0; }, "sample_period_s");
  expectRefused([](auto& c) { c.coupling.delay_s = -0.001; }, "delay_s");
  expectRefused([](auto& c) { c.device.max_force_n = 0.0; }, "max_force_n");
  expectRefused([](auto& c) { c.device.max_stiffness_n_m = 0.0; }, "max_stiffness_n_m");
  expectRefused([](auto& c) { c.device.max_damping_n_s_m = -1.0; }, "max_damping_n_s_m");
  expectRefused([](auto& c) { c.device.workspace_radius_m = 0.0; }, "workspace_radius_m");
  expectRefused([](auto& c) { c.safety.max_growth_n_s = 101.0; }, "max_growth_n_s");
  expectRefused([](auto& c) { c.safety.ramp_in_s = 0.1; }, "ramp_in_s");
  expectRefused([](auto& c) { c.safety.stale_after_s = 0.1; }, "stale_after_s");
  expectRefused([](auto& c) { c.safety.drop_s = 0.1; }, "drop_s");
  expectRefused([](auto& c) { c.safety.max_speed_m_s = 2.0; }, "max_speed_m_s");
}

}  // namespace
}  // namespace soft_volume::core
