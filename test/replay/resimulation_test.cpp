#include "soft_volume/replay/resimulation.h"

#include <gtest/gtest.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/ToolForce.h>

#include <filesystem>

#include "replay/recorded_run.h"
#include "soft_volume/common/error.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/replay/comparison.h"
#include "test_folder.h"

namespace soft_volume {
namespace {

namespace fs = std::filesystem;

/// A recorded run without a device: its journal is given again.
class ResimulationTest : public testing::Test {
 protected:
  void SetUp() override {
    RunSettings settings;
    settings.grips = true;
    recordBag(recorded_, settings);
  }

  Resimulation resimulateWith(const std::string& changes) const { return resimulateBag(recorded_, changes); }
  Resimulation resimulateBag(const std::string& path, const std::string& changes = "") const {
    const RecordedBag bag(path);
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

/// Of the number that the new run has, and pressing hard: it would be seen.
TEST_F(ResimulationTest, WhatTheRecordingRefusedStaysRefused) {
  const std::string bag = folder_ / "refused.bag";
  rewriteMessage<SimulationJournal>(recorded_, bag, 5, [](SimulationJournal& journal) {
    JournalEntry entry = journal.entries.at(0);
    auto force = fromPayload<ToolForce>(entry.payload);
    force.session += 1;
    force.sequence += 1000;
    force.force.z = -1.0;
    entry.payload = journalPayload(force);
    entry.outcome = JournalEntry::REFUSED;
    entry.reason = "it was too hard";
    journal.entries.push_back(entry);
  });
  const Resimulation run = resimulateBag(bag);
  EXPECT_EQ(run.inputs_refused, 2U);
  ASSERT_FALSE(run.notes.empty());
  EXPECT_NE(run.notes.back().find("it was too hard"), std::string::npos) << run.notes.back();
  EXPECT_EQ(positionError(), 0.0);
  EXPECT_EQ(replay(output_).code, 0) << replay(output_).output;
}

/// Which is not asked for its session.
TEST_F(ResimulationTest, AnIntegratorThatWasRefusedStaysRefused) {
  const std::string bag = folder_ / "refused.bag";
  rewriteMessage<SimulationJournal>(recorded_, bag, 5, [](SimulationJournal& journal) {
    SimulationControl control;
    control.integrator = "runge_kutta_4";
    JournalEntry entry = journal.entries.at(0);
    entry.topic = topics::kSetIntegrator;
    entry.type = ros::message_traits::datatype<SimulationControl>();
    entry.payload = journalPayload(control);
    entry.outcome = JournalEntry::REFUSED;
    journal.entries.push_back(entry);
  });
  resimulateBag(bag);
  EXPECT_EQ(positionError(), 0.0);
  EXPECT_EQ(replay(output_).code, 0) << replay(output_).output;
}

TEST_F(ResimulationTest, NeverReplacesTheBagThatItReads) {
  const std::string active = output_ + ".active";
  fs::copy_file(recorded_, active);
  EXPECT_THROW(resimulateBag(active), ReplayError);
  EXPECT_EQ(fs::file_size(active), fs::file_size(recorded_));
  EXPECT_FALSE(fs::exists(output_));
}

TEST_F(ResimulationTest, KeepsAnInterruptedRecording) {
  fs::copy_file(recorded_, output_ + ".active");
  resimulateWith("");
  EXPECT_TRUE(fs::exists(output_));
  EXPECT_FALSE(fs::exists(output_ + ".active"));
  ASSERT_TRUE(fs::exists(output_ + ".interrupted"));
  EXPECT_EQ(fs::file_size(output_ + ".interrupted"), fs::file_size(recorded_));
}

TEST_F(ResimulationTest, LeavesALiveRecordingAlone) {
  BagRecorderSettings settings;
  settings.file = output_;
  settings.reserve_bytes = 1 << 20;
  BagRecorder recorder(settings);
  RunSettings run;
  run.steps = 20;
  recordRun(recorder, run);
  EXPECT_THROW(resimulateWith(""), core::FileError);
  recorder.close("done");
  EXPECT_TRUE(recorder.status().closed);
  EXPECT_EQ(replay(output_).code, 0) << replay(output_).output;
}

/// At its beginning and at its end.
TEST_F(ResimulationTest, SaysThatTheNewBagCannotBeWritten) {
  for (const char* const blocks : {"1", "40"}) {
    const std::string command = "trap '' XFSZ; ulimit -f " + std::string(blocks) +
                                "; '" SOFT_VOLUME_BIN_DIR "/soft_volume_replay' '" + recorded_ +
                                "' --threads 1 --no-progress --resimulate --output '" + output_ + "' 2>&1";
    const ProgramResult result = runShell(command);
    EXPECT_EQ(result.code, 2) << result.output;
    EXPECT_NE(result.output.find(output_ + ": the bag cannot be written"), std::string::npos) << result.output;
    EXPECT_FALSE(fs::exists(output_));
    EXPECT_FALSE(fs::exists(output_ + ".active"));
  }
}

}  // namespace
}  // namespace soft_volume
