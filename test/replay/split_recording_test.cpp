// Recordings in parts, and what a recording says of itself.

#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <soft_volume/RecorderStatus.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/Volume.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <random>
#include <thread>

#include "replay/recorded_run.h"
#include "replay/test_folder.h"

namespace soft_volume {
namespace {

namespace fs = std::filesystem;
constexpr std::uint64_t kSplitBytes = 250000;

BagRecorderSettings partedSettings(const std::string& file) {
  BagRecorderSettings settings;
  settings.file = file;
  settings.reserve_bytes = 1 << 20;
  settings.split_bytes = kSplitBytes;
  return settings;
}

RunSettings longRun() {
  RunSettings run;
  run.steps = 6000;
  return run;
}

std::vector<std::string> partsOf(const std::string& file) {
  std::vector<std::string> parts;
  const std::string stem = file.substr(0, file.rfind('.'));
  for (int n = 0; fs::exists(stem + "_" + std::to_string(n) + ".bag"); ++n)
    parts.push_back(stem + "_" + std::to_string(n) + ".bag");
  return parts;
}

nlohmann::json replayed(const std::string& bag, int expected_code = 0) {
  const std::string json = bag + ".json";
  const ProgramResult result = replay(bag, "--check --no-progress --json '" + json + "'");
  EXPECT_EQ(result.code, expected_code) << bag << "\n" << result.output;
  return nlohmann::json::parse(std::ifstream(json));
}

/// First and last step of the journal in a bag.
std::pair<std::uint64_t, std::uint64_t> journalRange(const std::string& file) {
  rosbag::Bag bag(file);
  rosbag::View view(bag, rosbag::TypeQuery("soft_volume/SimulationJournal"));
  std::pair<std::uint64_t, std::uint64_t> range(~std::uint64_t(0), 0);
  for (const rosbag::MessageInstance& instance : view) {
    const auto journal = instance.instantiate<SimulationJournal>();
    range.first = std::min(range.first, journal->first_step);
    range.second = std::max(range.second, journal->last_step);
  }
  return range;
}

TEST(SplitRecording, EveryPartReplaysAlone) {
  const TestFolder folder;
  const std::string file = folder / "run.bag";
  {
    BagRecorder recorder(partedSettings(file));
    recordRun(recorder, longRun());
    recorder.close("the test ended");
    EXPECT_EQ(recorder.status().dropped, 0U);
    EXPECT_TRUE(recorder.status().closed);
    EXPECT_EQ(recorder.status().parts + 1, partsOf(file).size());
  }
  const std::vector<std::string> parts = partsOf(file);
  ASSERT_GT(parts.size(), 2U);
  std::uint64_t done = 0;
  for (const std::string& part : parts) {
    const auto range = journalRange(part);
    EXPECT_LE(range.first, done) << "steps are missing before " << part;
    EXPECT_GT(range.second, done);
    done = range.second;
    const nlohmann::json result = replayed(part);
    EXPECT_EQ(result["identical"], true) << part << result.dump(2);
    EXPECT_EQ(result["sessions"], 1);
    EXPECT_GT(result["states"], 0);
    EXPECT_GT(result["steps"], 0);
    // The run is faster than the disk here, so a part ends only when what waited is written.
    EXPECT_LE(fs::file_size(part), 6 * kSplitBytes) << part;
  }
  EXPECT_EQ(done, longRun().steps);
}

TEST(SplitRecording, PartsOfGripsAndCutsReplayAlone) {
  const TestFolder folder;
  const std::string file = folder / "run.bag";
  RunSettings run = longRun();
  run.grips = run.deltas = true;
  {
    BagRecorder recorder(partedSettings(file));
    recordRun(recorder, run);
  }
  const std::vector<std::string> parts = partsOf(file);
  ASSERT_GT(parts.size(), 2U);
  for (const std::string& part : parts)
    EXPECT_EQ(replayed(part)["identical"], true) << part;
}

TEST(SplitRecording, NumbersGoOnBehindAnEarlierRecording) {
  const TestFolder folder;
  const std::string file = folder / "run.bag";
  std::ofstream(folder / "run_0.bag") << "the only copy";
  std::ofstream(folder / "run_4.bag.active") << "another";
  { BagRecorder recorder(partedSettings(file)); }
  EXPECT_TRUE(fs::exists(folder / "run_5.bag"));
  EXPECT_TRUE(fs::exists(folder / "run_4.bag.active"));
  std::string text;
  std::getline(std::ifstream(folder / "run_0.bag"), text);
  EXPECT_EQ(text, "the only copy");
}

TEST(SplitRecording, ASizeBelowTheLatchedDataIsRefusedWithTheSizeNeeded) {
  const TestFolder folder;
  BagRecorderSettings settings = partedSettings(folder / "run.bag");
  settings.split_bytes = 20000;
  BagRecorder recorder(settings);
  recordRun(recorder, longRun());
  recorder.close("");
  const BagRecorder::Status status = recorder.status();
  EXPECT_TRUE(status.refused);
  EXPECT_EQ(status.parts, 0U);
  EXPECT_NE(status.stop_reason.find("split_mib must be at least 1"), std::string::npos) << status.stop_reason;
  EXPECT_EQ(replayed(folder / "run_0.bag")["identical"], true);
}

TEST(SplitRecording, WithoutACheckpointTheFileGrowsOn) {
  const TestFolder folder;
  BagRecorder recorder(partedSettings(folder / "run.bag"));
  Volume volume;
  volume.data.assign(1000, 0);
  for (int n = 0; n < 2000; ++n) {
    std::generate(volume.data.begin(), volume.data.end(), std::mt19937(n));
    recorder.write("volume", ros::Time(100.0 + n), volume);
  }
  for (int n = 0; n < 100 && !recorder.status().split_waits; ++n)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  EXPECT_TRUE(recorder.status().split_waits);
  recorder.close("");
  EXPECT_EQ(partsOf(folder / "run.bag").size(), 1U);
}

TEST(SplitRecording, TheLastMessageOfEveryPartNamesTheNext) {
  const TestFolder folder;
  BagRecorderSettings settings = partedSettings(folder / "run.bag");
  settings.last_topic = "/recorder/status";
  settings.last_message = [](const std::string& next_file, const std::string& reason) {
    RecorderStatus status;
    status.events.emplace_back();
    status.events.back().text = next_file.empty() ? reason : next_file;
    return anyMessage(status);
  };
  {
    BagRecorder recorder(settings);
    recordRun(recorder, longRun());
    recorder.close("enough");
  }
  const std::vector<std::string> parts = partsOf(folder / "run.bag");
  ASSERT_GT(parts.size(), 2U);
  for (std::size_t n = 0; n < parts.size(); ++n) {
    const std::string told = n + 1 < parts.size() ? parts[n + 1] : "enough";
    const auto notes = replayed(parts[n])["notes"].dump();
    EXPECT_NE(notes.find(told), std::string::npos) << notes;
  }
}

}  // namespace
}  // namespace soft_volume
