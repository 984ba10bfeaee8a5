#include "soft_volume/replay/resimulation.h"

#include <gtest/gtest.h>

#include "replay/recorded_run.h"
#include "soft_volume/replay/comparison.h"
#include "test_folder.h"

namespace soft_volume {
namespace {

/// A recorded run without a device: its journal is given again.
class ResimulationTest : public testing::Test {
 protected:
  void SetUp() override {
    RunSettings settings;
    settings.grips = true;
    recordBag(recorded_, settings);
  }

  Resimulation resimulateWith(const std::string& changes) const {
    const RecordedBag bag(recorded_);
    ResimulationOptions options;
    options.output = output_;
    if (!changes.empty())
      options.changes = core::parseOverrides(changes);
    return resimulate(bag, options, [](double, double) {});
  }

  double positionError() const {
    const RecordedBag first(recorded_);
    const RecordedBag second(output_);
    for (const ComparedQuantity& quantity : compareBags(first, second, [](double, double) {}).quantities) {
      if (quantity.key == "positions")
        return quantity.largest;
    }
    return -1.0;
  }

  TestFolder folder_;
  std::string recorded_ = folder_ / "recorded.bag";
  std::string output_ = folder_ / "again.bag";
};

TEST_F(ResimulationTest, WithoutChangesItIsTheSameRun) {
  const Resimulation run = resimulateWith("");
  EXPECT_EQ(run.steps, 400U);
  EXPECT_GT(run.inputs_given_again, 40U);
  EXPECT_EQ(run.inputs_refused, 1U);  // the force that is no number
  EXPECT_EQ(positionError(), 0.0);
  EXPECT_EQ(replay(output_).code, 0) << replay(output_).output;
}

TEST_F(ResimulationTest, OnePerCentOfAMaterialShows) {
  resimulateWith("materials.tissue.youngs_modulus_pa=10100");
  EXPECT_GT(positionError(), 1e-7);
  EXPECT_EQ(replay(output_).code, 0);
}

TEST_F(ResimulationTest, AnotherLatticeAndMethodReplayToo) {
  const Resimulation run = resimulateWith("lattice.spacing_m=0.01,simulation.preset=fast");
  EXPECT_GT(run.steps, 0U);
  EXPECT_FALSE(run.notes.empty());
  EXPECT_GT(positionError(), 1e-7);
  EXPECT_EQ(replay(output_).code, 0) << replay(output_).output;
}

TEST_F(ResimulationTest, TheProgramTellsHowFarTheResultMoved) {
  const std::string to = " --no-progress --output '" + output_ + "'";
  const ProgramResult same = replay(recorded_, "--resimulate '' --tolerance positions=1e-9" + to);
  EXPECT_EQ(same.code, 0) << same.output;
  const std::string stiffer = "--resimulate materials.tissue.youngs_modulus_pa=20000 --tolerance positions=1e-9";
  const ProgramResult other = replay(recorded_, stiffer + to);
  EXPECT_EQ(other.code, 1) << other.output;
  EXPECT_NE(other.output.find("positions"), std::string::npos) << other.output;
  EXPECT_EQ(replay(recorded_, "--resimulate simulation.speed=3" + to).code, 2);
  EXPECT_EQ(replay(recorded_, "--resimulate").code, 2);  // where to?
  EXPECT_EQ(replay(recorded_, "--resimulate --output '" + recorded_ + "'").code, 2);
}

}  // namespace
}  // namespace soft_volume
