#include "soft_volume/replay/bag_recorder.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <signal.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/Volume.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include "replay/test_folder.h"
#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

using Clock = std::chrono::steady_clock;

ToolForce force(std::uint64_t sequence) {
  ToolForce message;
  message.tool_id = "probe";
  message.sequence = sequence;
  message.force.x = 0.001 * static_cast<double>(sequence);
  return message;
}

ros::Time at(std::uint64_t sequence) {
  return ros::Time(100, 0) + ros::Duration(0.001 * static_cast<double>(sequence));
}

BagRecorderSettings settingsFor(const std::string& file) {
  BagRecorderSettings settings;
  settings.file = file;
  settings.reserve_bytes = 1 << 20;
  return settings;
}

std::vector<std::uint64_t> recordedSequences(const std::string& file) {
  rosbag::Bag bag(file);
  rosbag::View view(bag, rosbag::TypeQuery("soft_volume/ToolForce"));
  std::vector<std::uint64_t> sequences;
  for (const rosbag::MessageInstance& instance : view)
    sequences.push_back(instance.instantiate<ToolForce>()->sequence);
  return sequences;
}

bool isConsecutive(const std::vector<std::uint64_t>& sequences) {
  for (std::size_t n = 0; n < sequences.size(); ++n) {
    if (sequences[n] != n)
      return false;
  }
  return true;
}

/// Records at 1 kHz until it is killed, telling through a pipe which message was queued last.
[[noreturn]] void recordForEver(const std::string& file, int report) {
  BagRecorder recorder(settingsFor(file));
  const auto start = Clock::now();
  for (std::uint64_t n = 0;; ++n) {
    std::this_thread::sleep_until(start + std::chrono::milliseconds(n));
    recorder.write("tool/force", at(n), force(n));
    if (write(report, &n, sizeof(n)) != sizeof(n))
      _exit(1);
  }
}

std::uint64_t lastReported(int report) {
  std::uint64_t last = 0;
  for (std::uint64_t value = 0; read(report, &value, sizeof(value)) == sizeof(value);)
    last = value;
  return last;
}

TEST(BagRecorder, SigkillLosesLessThanASecond) {
  const TestFolder folder;
  const std::string file = folder / "killed.bag";
  int report[2];
  ASSERT_EQ(pipe(report), 0);
  fcntl(report[1], F_SETPIPE_SZ, 1 << 20);
  const pid_t child = fork();
  if (child == 0)
    recordForEver(file, report[1]);
  close(report[1]);
  std::this_thread::sleep_for(std::chrono::milliseconds(3300));
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  const std::uint64_t last = lastReported(report[0]);
  close(report[0]);
  ASSERT_GT(last, 2000U);

  ASSERT_FALSE(std::filesystem::exists(file));
  std::filesystem::rename(file + ".active", file);
  ASSERT_EQ(std::system(("PATH=/usr/bin:$PATH rosbag reindex -q '" + file + "'").c_str()), 0);
  const std::vector<std::uint64_t> kept = recordedSequences(file);
  EXPECT_TRUE(isConsecutive(kept));
  EXPECT_GE(kept.size() + 1000, last) << "more than the last second is missing";
  RecordProperty("kept", static_cast<int>(kept.size()));
  RecordProperty("sent", static_cast<int>(last));
}

TEST(BagRecorder, KeepsEveryMessageInOrder) {
  const TestFolder folder;
  BagRecorder recorder(settingsFor(folder / "a.bag"));
  constexpr std::uint64_t kMessages = 20000;
  for (std::uint64_t n = 0; n < kMessages; ++n)
    EXPECT_TRUE(recorder.write("tool/force", at(n), force(n)));
  recorder.close("the test ended");
  const BagRecorder::Status status = recorder.status();
  EXPECT_FALSE(status.recording);
  EXPECT_EQ(status.stop_reason, "the test ended");
  EXPECT_EQ(status.messages, kMessages);
  EXPECT_EQ(status.dropped, 0U);
  EXPECT_EQ(status.bytes, std::filesystem::file_size(folder / "a.bag"));
  const std::vector<std::uint64_t> sequences = recordedSequences(folder / "a.bag");
  EXPECT_EQ(sequences.size(), kMessages);
  EXPECT_TRUE(isConsecutive(sequences));
  EXPECT_FALSE(std::filesystem::exists(folder / "a.bag.active"));
}

TEST(BagRecorder, KeepsConnectionHeaders) {
  const TestFolder folder;
  {
    BagRecorder recorder(settingsFor(folder / "a.bag"));
    const auto header = boost::make_shared<ros::M_string>();
    (*header)["callerid"] = "/tool";
    recorder.write("tool/force", at(0), anyMessage(force(0)), header, false);
    recorder.write("volume", at(1), Volume(), true);
  }
  rosbag::Bag bag(folder / "a.bag");
  rosbag::View view(bag);
  ASSERT_EQ(view.size(), 2U);
  const rosbag::MessageInstance first = *view.begin();
  EXPECT_EQ(first.getCallerId(), "/tool");
  EXPECT_FALSE(first.isLatching());
  EXPECT_EQ(first.getMessageDefinition(), ros::message_traits::Definition<ToolForce>::value());
  const rosbag::MessageInstance second = *std::next(view.begin());
  EXPECT_TRUE(second.isLatching());
  EXPECT_EQ(second.getMD5Sum(), ros::message_traits::MD5Sum<Volume>::value());
}

TEST(BagRecorder, ClosesChunksWithoutNewMessages) {
  const TestFolder folder;
  BagRecorder recorder(settingsFor(folder / "a.bag"));
  recorder.write("tool/force", at(0), force(0));
  std::this_thread::sleep_for(std::chrono::milliseconds(1000));
  std::filesystem::copy_file(folder / "a.bag.active", folder / "copy.bag");
  ASSERT_EQ(std::system(("PATH=/usr/bin:$PATH rosbag reindex -q '" + (folder / "copy.bag") + "'").c_str()), 0);
  EXPECT_EQ(recordedSequences(folder / "copy.bag").size(), 1U);
}

TEST(BagRecorder, DropsBeyondTheQueueButNeverLatchedMessages) {
  const TestFolder folder;
  BagRecorderSettings settings = settingsFor(folder / "a.bag");
  settings.queue_bytes = 1000;
  BagRecorder recorder(settings);
  Volume volume;
  volume.data.assign(1 << 20, 0);
  EXPECT_FALSE(recorder.write("volume", at(0), volume, false));
  EXPECT_TRUE(recorder.write("volume", at(1), volume, true));
  recorder.close("");
  EXPECT_EQ(recorder.status().dropped, 1U);
  EXPECT_EQ(recorder.status().messages, 1U);
}

TEST(BagRecorder, RefusesToStartBelowTheReserve) {
  const TestFolder folder;
  BagRecorderSettings settings = settingsFor(folder / "a.bag");
  settings.reserve_bytes = std::uint64_t(1) << 60;
  try {
    BagRecorder recorder(settings);
    FAIL() << "it recorded";
  } catch (const core::FileError& error) {
    EXPECT_NE(std::string(error.what()).find("less than the reserve"), std::string::npos) << error.what();
  }
}

/// Ends the process with 0 when a recorder that hits a limit on its file's size stops and says so.
[[noreturn]] void recordIntoAFullDisk(const std::string& file) {
  signal(SIGXFSZ, SIG_IGN);
  const rlimit limit{200000, 200000};
  setrlimit(RLIMIT_FSIZE, &limit);
  BagRecorderSettings settings = settingsFor(file);
  settings.compress = false;
  BagRecorder recorder(settings);
  for (std::uint64_t n = 0; n < 20000 && recorder.write("tool/force", at(n), force(n)); ++n) {
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
  recorder.close("closed by hand");
  const BagRecorder::Status status = recorder.status();
  const bool told = !status.recording && status.stop_reason.find("closed by hand") == std::string::npos;
  _exit(told && status.dropped > 0 ? 0 : 1);
}

TEST(BagRecorder, StopsWithAReasonWhenAWriteFails) {
  const TestFolder folder;
  const pid_t child = fork();
  if (child == 0)
    recordIntoAFullDisk(folder / "a.bag");
  int result = 0;
  waitpid(child, &result, 0);
  EXPECT_TRUE(WIFEXITED(result)) << "died with signal " << WTERMSIG(result);
  EXPECT_EQ(WEXITSTATUS(result), 0);
}

TEST(BagRecorder, KeepsWhatAKilledRecorderLeftBehind) {
  const TestFolder folder;
  std::ofstream(folder / "a.bag.active") << "the only copy";
  BagRecorder(settingsFor(folder / "a.bag")).write("tool/force", at(0), force(0));
  std::string text;
  std::getline(std::ifstream(folder / "a.bag.interrupted"), text);
  EXPECT_EQ(text, "the only copy");
  EXPECT_EQ(recordedSequences(folder / "a.bag").size(), 1U);
}

TEST(BagRecorder, KeepsFormerRecordings) {
  const TestFolder folder;
  for (std::uint64_t n = 1; n <= 3; ++n) {
    BagRecorder recorder(settingsFor(folder / "a.bag"));
    for (std::uint64_t sequence = 0; sequence < n; ++sequence)
      recorder.write("tool/force", at(sequence), force(sequence));
  }
  EXPECT_EQ(recordedSequences(folder / "a.bag.former").size(), 1U);
  EXPECT_EQ(recordedSequences(folder / "a.bag.former.2").size(), 2U);
  EXPECT_EQ(recordedSequences(folder / "a.bag").size(), 3U);
}

TEST(BagRecorder, RefusesTheFileOfAnotherRecorder) {
  const TestFolder folder;
  BagRecorder first(settingsFor(folder / "a.bag"));
  EXPECT_THROW(BagRecorder second(settingsFor(folder / "a.bag")), core::FileError);
  EXPECT_TRUE(first.write("tool/force", at(0), force(0)));
}

TEST(BagRecorder, RefusesAFolderThatDoesNotExist) {
  const TestFolder folder;
  EXPECT_THROW(BagRecorder recorder(settingsFor(folder / "nowhere/a.bag")), core::FileError);
}

TEST(BagRecorder, TakesAClockThatHasNotStarted) {
  const TestFolder folder;
  BagRecorder recorder(settingsFor(folder / "a.bag"));
  recorder.write("tool/force", ros::Time(), force(0));
  recorder.close("");
  EXPECT_EQ(recordedSequences(folder / "a.bag").size(), 1U);
}

}  // namespace
}  // namespace soft_volume
