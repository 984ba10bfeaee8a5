// A disk that is full while something records, for which a small file system is mounted: needs root, else skipped.

#include <gtest/gtest.h>
#include <soft_volume/ToolForce.h>
#include <sys/mount.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include "replay/recorded_run.h"
#include "replay/test_folder.h"

namespace soft_volume {
namespace {

namespace fs = std::filesystem;

class FullDisk : public testing::Test {
 protected:
  void SetUp() override {
    fs::create_directory(disk());
    mounted_ = mount("none", disk().c_str(), "tmpfs", 0, "size=3m") == 0;
    if (!mounted_)
      GTEST_SKIP() << "only root can mount a small file system";
  }
  void TearDown() override {
    if (mounted_)
      umount2(disk().c_str(), MNT_DETACH);
  }

  std::string disk() const { return folder_ / "disk"; }
  std::string bag() const { return disk() + "/run.bag"; }

  BagRecorderSettings settings() const {
    BagRecorderSettings settings;
    settings.file = bag();
    settings.compress = false;
    settings.reserve_bytes = 1 << 20;
    return settings;
  }

  /// Records until the recorder stops by itself; calls `meanwhile` after each step.
  BagRecorder::Status recordUntilItStops(const std::function<void(std::uint64_t)>& meanwhile = {}) const {
    BagRecorder recorder(settings());
    RunSettings run;
    run.steps = 20000;
    run.recorded = [&](std::uint64_t step) {
      std::this_thread::sleep_for(std::chrono::microseconds(300));
      if (meanwhile)
        meanwhile(step);
      if (!recorder.status().recording)
        throw Stopped();
    };
    try {
      recordRun(recorder, run);
    } catch (const Stopped&) {
      recorder.write("late", ros::Time(1.0), ToolForce());  // is dropped, and counted
    }
    recorder.close("closed by hand");
    return recorder.status();
  }

  const TestFolder folder_;

 private:
  struct Stopped {};
  bool mounted_ = false;
};

TEST_F(FullDisk, RecordingStopsAtTheReserveWithAWholeBag) {
  const BagRecorder::Status status = recordUntilItStops();
  EXPECT_FALSE(status.recording);
  EXPECT_TRUE(status.closed);
  EXPECT_GT(status.dropped, 0U);
  EXPECT_NE(status.stop_reason.find("less than the reserve"), std::string::npos) << status.stop_reason;
  EXPECT_FALSE(fs::exists(bag() + ".active"));
  const ProgramResult result = replay(bag());
  EXPECT_EQ(result.code, 0) << result.output;
}

/// Somebody else takes the reserve within a moment.
TEST_F(FullDisk, WhatWasWrittenBeforeADiskFilledUpReplays) {
  const BagRecorder::Status status = recordUntilItStops([this](std::uint64_t step) {
    if (step != 1000)
      return;
    std::ofstream other(disk() + "/other");
    const std::string much(1 << 16, 'x');
    while (other << much << std::flush) {
    }
  });
  EXPECT_FALSE(status.recording);
  EXPECT_NE(status.stop_reason, "closed by hand");
  EXPECT_GT(status.dropped, 0U);
  const std::string left = fs::exists(bag()) ? bag() : bag() + ".active";
  const std::string copy = folder_ / "copy.bag";
  fs::copy_file(left, copy);
  if (left != bag()) {
    EXPECT_FALSE(status.closed);
    EXPECT_NE(status.stop_reason.find("rosbag reindex"), std::string::npos) << status.stop_reason;
    ASSERT_EQ(std::system(("PATH=/usr/bin:$PATH rosbag reindex -q -f '" + copy + "' >/dev/null 2>&1").c_str()), 0);
  }
  RecordProperty("reason", status.stop_reason);
  const ProgramResult result = replay(copy);
  EXPECT_EQ(result.code, 0) << status.stop_reason << "\n" << result.output;
}

}  // namespace
}  // namespace soft_volume
