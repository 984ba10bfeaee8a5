#include "soft_volume/tool/coupling.h"

#include <gtest/gtest.h>

#include <limits>

namespace soft_volume::core {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A simulation of the loop: b = 0.2 N s/m gives 400 N/m at 1 kHz, 133 with a sample of delay; half of it is rendered.
TEST(CouplingTest, StiffnessIsHalfOfWhatIsPassive) {
  CouplingConfig coupling;
  coupling.stiffness_n_m = 1e4;
  coupling.device_damping_n_s_m = 0.2;
  coupling.delay_s = 0.0;
  EXPECT_NEAR(coupling.renderedStiffness(deviceLimits("touch")), 200.0, 1e-9);
  coupling.delay_s = 0.001;
  EXPECT_NEAR(coupling.renderedStiffness(deviceLimits("touch")), 66.667, 1e-3);
  coupling.damping_n_s_m = 0.1;
  EXPECT_NEAR(coupling.renderedStiffness(deviceLimits("touch")), 33.333, 1e-3);
  coupling.damping_n_s_m = 0.0;
  coupling.device_damping_n_s_m = 50.0;
  EXPECT_NEAR(coupling.renderedStiffness(deviceLimits("touch")), 400.0, 1e-9);
  coupling.stiffness_n_m = 30.0;
  EXPECT_NEAR(coupling.renderedStiffness(deviceLimits("touch")), 30.0, 1e-9);
}

/// Ticks at `period_s` for a time, poses every `ticks_per_pose` ticks that are `age_s` old when they are first used.
void run(LoopMeter& meter, double& time_s, double seconds, double period_s, int ticks_per_pose, double age_s) {
  double pose_time_s = time_s;
  const int ticks = int(std::lround(seconds / period_s));
  for (int n = 0; n < ticks; ++n) {
    time_s += period_s;
    if (n % ticks_per_pose == 0)
      pose_time_s = time_s - age_s;
    meter.tick(time_s, pose_time_s, 0.0);
  }
}

TEST(LoopMeterTest, MeasuresHowLongAPoseIsHeldAndHowOldItIs) {
  for (const int ticks_per_pose : {1, 2, 10}) {
    LoopMeter meter;
    double time_s = 5.0;
    run(meter, time_s, 1.0, 0.001, ticks_per_pose, 0.0004);
    EXPECT_NEAR(meter.timing().period_s, 0.001 * ticks_per_pose, 1e-9);
    EXPECT_NEAR(meter.timing().delay_s, 0.0004, 1e-9);
  }
}

TEST(LoopMeterTest, OneLateTickIsNoMeasureButALowerRateIsAtOnce) {
  LoopMeter meter;
  double time_s = 0.0;
  run(meter, time_s, 2.0, 0.001, 1, 0.0);
  time_s += 0.012;
  run(meter, time_s, 0.1, 0.001, 1, 0.0);
  EXPECT_NEAR(meter.timing().period_s, 0.001, 1e-9);
  run(meter, time_s, 0.06, 0.001, 10, 0.0);  // a device that falls to 100 Hz
  EXPECT_NEAR(meter.timing().period_s, 0.010, 1e-9);
  run(meter, time_s, 1.2, 0.001, 1, 0.0);
  EXPECT_NEAR(meter.timing().period_s, 0.001, 1e-9);
}

class CouplingInUseTest : public testing::Test {
 protected:
  CouplingInUseTest() { config_.stiffness_n_m = 1e4; }
  double after(const LoopTiming& timing, bool loaded, double tissue_bound_n_m = kInfinity) {
    coupling_.update(timing, tissue_bound_n_m, loaded);
    return coupling_.stiffness_n_m();
  }
  CouplingConfig config_;
  Coupling coupling_{config_, deviceLimits("touch")};
};

TEST_F(CouplingInUseTest, FallsAtOnceAndRisesOnlyUnloaded) {
  const double best = CouplingConfig().passiveStiffness({0.001, 0.001});
  EXPECT_NEAR(after({0.001, 0.0}, false), best, 1e-9);
  EXPECT_NEAR(after({0.010, 0.001}, true), 0.1 / 0.007, 1e-9);
  EXPECT_NEAR(after({0.001, 0.0}, true), 0.1 / 0.007, 1e-9);
  EXPECT_NEAR(after({0.001, 0.0}, false), best, 1e-9);
}

TEST_F(CouplingInUseTest, SaysWhatBoundsIt) {
  after({}, false);
  EXPECT_EQ(coupling_.bound(), StiffnessBound::kPassivity);
  EXPECT_NEAR(after({}, false, 30.0), 30.0, 1e-9);
  EXPECT_EQ(coupling_.bound(), StiffnessBound::kTissue);
  CouplingConfig config;
  config.device_damping_n_s_m = 50.0;
  EXPECT_EQ(Coupling(config, deviceLimits("touch")).bound(), StiffnessBound::kWish);
  config.stiffness_n_m = 1e4;
  EXPECT_EQ(Coupling(config, deviceLimits("touch")).bound(), StiffnessBound::kDevice);
}

TEST(CouplingTest, TheBestCaseIsWhatIsStated) {
  CouplingConfig config;
  EXPECT_NEAR(Coupling(config, deviceLimits("touch")).stiffness_n_m(), config.renderedStiffness(deviceLimits("touch")),
              1e-12);
}

}  // namespace
}  // namespace soft_volume::core
