// The loop's thread in simulated time, where a tick follows every pose: nothing here depends on the machine's speed.

#include "soft_volume/ros/haptic_loop.h"

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "tool/tissue_fixture.h"

namespace soft_volume {
namespace {

using core::kSurfaceZ;
using core::Vector3;

constexpr double kWait_s = 10.0;

class HapticLoopTest : public testing::Test {
 protected:
  HapticLoopTest() : loop_(settings()) { giveRig(1); }

  HapticLoop::Settings settings() {
    HapticLoop::Settings settings;
    settings.simulated_time = [this] { return 1e-9 * double(time_ns_.load()); };
    settings.buttons = [this] { return core::Buttons(buttons_.load()); };
    settings.wall_timeout_s = 10.0;
    return settings;
  }
  void giveRig(std::uint64_t generation) {
    auto rig = std::make_unique<ToolRig>();
    rig->generation = generation_ = generation;
    rig->swap_button = 1;
    for (const char* id : {"probe", "other"}) {
      core::ToolConfig config;
      config.id = id;
      rig->tools.push_back(std::make_unique<core::Tool>(config));
    }
    loop_.give(std::move(rig));
  }
  void givePatch() {
    PatchParcel parcel;
    core::PatchIntake intake("probe", 0.0);
    intake.setVolume(tissue_.volume);
    intake.setTopology(std::make_shared<const core::Topology>(tissue_.topology));
    parcel.patch = intake.makeEmpty();
    intake.fill(tissue_.patch, parcel.patch.get());
    parcel.generation = generation_;
    loop_.give(std::move(parcel));
  }
  /// One pose a millisecond later, and the tick that answers it. Ticks of a silence in between are of an older stamp.
  LoopTick cycle() {
    time_ns_ += 1000000;
    HeardPose heard;
    heard.pose.position_m = tip_m_;
    heard.stamp_ns = time_ns_;
    heard.heard_s = HapticLoop::now();
    loop_.hear(heard);
    LoopTick tick;
    do {
      if (!loop_.next(tick, kWait_s)) {
        ADD_FAILURE() << "no tick";
        break;
      }
    } while (tick.stamp_ns != heard.stamp_ns);
    return tick;
  }
  LoopTick hold(int cycles) {
    LoopTick tick;
    for (int n = 0; n < cycles; ++n) {
      if (n % 10 == 0)
        givePatch();
      tick = cycle();
    }
    return tick;
  }

  core::Tissue tissue_ = core::makeFlatHalfSpace();
  std::atomic<std::int64_t> time_ns_{5000000000};
  std::atomic<unsigned> buttons_{0};
  Vector3 tip_m_{0.030, 0.030, kSurfaceZ - 0.004};
  std::uint64_t generation_ = 0;
  HapticLoop loop_;
};

TEST_F(HapticLoopTest, TicksTheToolForEveryPoseAndGivesPatchesBack) {
  LoopTick tick = hold(400);
  EXPECT_EQ(tick.generation, 1U);
  EXPECT_EQ(tick.tool, 0U);
  EXPECT_TRUE(tick.output.contact.touching);
  EXPECT_GT(tick.output.device_force_n.z(), 0.3);
  EXPECT_EQ(tick.servo_n, tick.output.device_force_n);
  ASSERT_TRUE(tick.output.force);
  EXPECT_EQ(tick.output.force->force_n, Vector3(-tick.output.device_force_n));
  EXPECT_GE(loop_.statistics().ticks.load(), 400U);
  int returned = 0;
  PatchParcel parcel;
  while (loop_.takeBack(parcel))
    returned += parcel.patch ? 1 : 0;
  EXPECT_GT(returned, 10);
}

TEST_F(HapticLoopTest, ATripSurvivesANewSceneAndATriedSwapAndEndsWithAReset) {
  EXPECT_GT(hold(400).output.device_force_n.norm(), 0.3);
  tip_m_.x() += 0.02;
  EXPECT_TRUE(hold(40).output.tripped);
  giveRig(2);
  const LoopTick after = hold(400);
  EXPECT_EQ(after.generation, 2U);
  EXPECT_TRUE(after.output.tripped);
  EXPECT_EQ(after.output.device_force_n.norm(), 0.0);
  buttons_ = 2;
  EXPECT_EQ(hold(20).tool, 0U);
  buttons_ = 0;
  hold(20);
  loop_.reset();
  EXPECT_GT(hold(400).output.device_force_n.norm(), 0.3);
  EXPECT_EQ(loop_.statistics().faults[std::size_t(core::ForceFault::kTripped)].load(), 1U);
}

TEST_F(HapticLoopTest, AMachineThatIsLateIsNoLateDevice) {
  const LoopTick before = hold(400);
  for (int n = 0; n < 20; ++n) {
    time_ns_ += 10000000;  // the simulation is ten poses ahead of a device that has no core
    std::this_thread::sleep_for(std::chrono::milliseconds(15));
    time_ns_ -= 10000000;
    hold(10);
  }
  const LoopTick after = hold(1);
  EXPECT_EQ(after.output.fault, core::ForceFault::kNone);
  EXPECT_NEAR(after.output.timing.period_s, before.output.timing.period_s, 1e-9);  // rounding of stamps
}

TEST_F(HapticLoopTest, APressOfTheSwapButtonPutsTheNextToolIntoTheHand) {
  hold(20);
  buttons_ = 2;
  EXPECT_EQ(hold(20).tool, 1U);
  buttons_ = 0;
  hold(5);
  buttons_ = 2;
  EXPECT_EQ(hold(20).tool, 0U);
  EXPECT_EQ(loop_.statistics().swaps.load(), 2U);
}

TEST(TimeCountsTest, QuantilesAreWithinABin) {
  TimeCounts times;
  for (int n = 1; n <= 1000; ++n)
    times.add(1e-6 * n);
  for (const double share : {0.5, 0.99, 0.999})
    EXPECT_NEAR(TimeCounts::quantile(times.counts(), share), 1e-3 * share, 0.05e-3 * share) << share;
  EXPECT_EQ(TimeCounts::quantile({}, 0.5), 0.0);
}

}  // namespace
}  // namespace soft_volume
