// A recorder that is killed at any moment, also while it begins another part or closes a bag. A program of its own: no
// thread may run where it forks.

#include <gtest/gtest.h>
#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <signal.h>
#include <soft_volume/SimulationJournal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <random>
#include <thread>

#include "replay/recorded_run.h"
#include "replay/test_folder.h"

namespace soft_volume {
namespace {

namespace fs = std::filesystem;
/// Several parts within a second.
constexpr std::uint64_t kSplitBytes = 150000;

/// What a recorder that was killed left: whole bags, and one that has to be indexed.
std::vector<std::string> indexAll(const TestFolder& folder) {
  std::vector<std::string> bags;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder / "")) {
    if (entry.file_size() > 0)  // else killed before the first byte
      bags.push_back(entry.path().string());
  }
  for (const std::string& bag : bags) {
    if (fs::path(bag).extension() != ".active")
      continue;
    if (std::system(("PATH=/usr/bin:$PATH rosbag reindex -q -f '" + bag + "' >/dev/null 2>&1").c_str()) != 0)
      ADD_FAILURE() << bag << " cannot be indexed";
  }
  return bags;
}

/// How a recording ends.
struct Ending {
  bool split = false;
  std::chrono::milliseconds close;  ///< when it is closed
  std::chrono::milliseconds kill;
};

/// Records a run, after its beginning at some 2000 steps a second, telling which step was recorded last.
[[noreturn]] void recordUntilKilled(const std::string& file, const Ending& ending, int report) {
  BagRecorderSettings settings;
  settings.file = file;
  settings.reserve_bytes = 1 << 20;
  settings.split_bytes = ending.split ? kSplitBytes : 0;
  BagRecorder recorder(settings);
  std::atomic<bool> closing{false};
  std::thread closer([&] {
    std::this_thread::sleep_for(ending.close);
    closing = true;
    recorder.close("the time was over");
  });
  RunSettings run;
  run.steps = 1000000;
  run.recorded = [&](std::uint64_t step) {
    // The first part of a run is never short.
    if (step > 3000)
      std::this_thread::sleep_for(std::chrono::microseconds(300));
    if (!closing && write(report, &step, sizeof(step)) != sizeof(step))
      _exit(1);
  };
  recordRun(recorder, run);
  _exit(0);
}

struct Killed {
  std::uint64_t last = 0;           ///< step that was recorded last
  std::uint64_t second_before = 0;  ///< step that was recorded last a second before
};

Killed killRecording(const std::string& file, const Ending& ending) {
  int report[2];
  EXPECT_EQ(pipe(report), 0);
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child == 0)
    recordUntilKilled(file, ending, report[1]);
  close(report[1]);
  Killed killed;
  const auto end = std::chrono::steady_clock::now() + ending.kill;
  std::thread killer([child, end] {
    std::this_thread::sleep_until(end);
    kill(child, SIGKILL);
  });
  for (std::uint64_t step = 0; read(report[0], &step, sizeof(step)) == sizeof(step);) {
    killed.last = step;
    if (std::chrono::steady_clock::now() < end - std::chrono::seconds(1))
      killed.second_before = step;
  }
  killer.join();
  waitpid(child, nullptr, 0);
  close(report[0]);
  return killed;
}

/// The last step up to which a bag replays; a part that had only been opened holds nothing.
std::uint64_t replayedTo(const std::string& bag) {
  const ProgramResult result = replay(bag, "--check --no-progress");
  if (result.code == 2 && result.output.find("no whole message") != std::string::npos)
    return 0;
  EXPECT_EQ(result.code, 0) << bag << "\n" << result.output;
  std::uint64_t last = 0;
  rosbag::View view;
  rosbag::Bag opened(bag);
  view.addQuery(opened, rosbag::TypeQuery("soft_volume/SimulationJournal"));
  for (const rosbag::MessageInstance& instance : view)
    last = std::max(last, instance.instantiate<SimulationJournal>()->last_step);
  return last;
}

std::string toldOf(const std::string& bag) {
  const ProgramResult result = replay(bag);
  EXPECT_EQ(result.code, 2) << result.output;
  return result.output;
}

TEST(KilledRecording, TheReplaySaysWhatToDo) {
  const TestFolder folder;
  const std::string bag = folder / "run.bag";
  BagRecorderSettings settings;
  settings.file = bag;
  settings.reserve_bytes = 1 << 20;
  {
    BagRecorder recorder(settings);
    EXPECT_NE(toldOf(bag).find("stop it first"), std::string::npos);
    EXPECT_NE(toldOf(bag + ".active").find("stop it first"), std::string::npos);
    fs::copy_file(bag + ".active", bag + ".copy");
  }
  fs::rename(bag + ".copy", bag + ".active");
  EXPECT_NE(toldOf(bag + ".active").find("`rosbag reindex '" + bag + ".active'`"), std::string::npos);
  fs::remove(bag);
  EXPECT_NE(toldOf(bag).find("`rosbag reindex '" + bag + ".active'`"), std::string::npos);
  fs::rename(bag + ".active", bag + ".interrupted");
  EXPECT_NE(toldOf(bag).find("`rosbag reindex '" + bag + ".interrupted'`"), std::string::npos);
  fs::remove(bag + ".interrupted");
  fs::copy_file("/proc/self/exe", folder / "run_0.bag");
  EXPECT_NE(toldOf(bag).find("such as '" + (folder / "run_0.bag") + "'"), std::string::npos);
}

/// SOFT_VOLUME_KILLS says how many recordings are killed.
TEST(KilledRecording, LosesAtMostASecond) {
  const char* const wanted = std::getenv("SOFT_VOLUME_KILLS");
  const int kills = wanted == nullptr ? 4 : std::atoi(wanted);
  std::mt19937 random(5);
  for (int n = 0; n < kills; ++n) {
    const TestFolder folder;
    Ending ending;
    ending.split = n % 4 != 0;
    ending.kill = std::chrono::milliseconds(1000 + random() % 1500);
    // Every second one is killed around the time at which it closes its bag.
    ending.close = ending.kill + std::chrono::milliseconds(n % 2 == 0 ? 5000 : static_cast<int>(random() % 12) - 10);
    const Killed killed = killRecording(folder / "run.bag", ending);
    std::uint64_t kept = 0;
    const std::vector<std::string> bags = indexAll(folder);
    for (const std::string& bag : bags)
      kept = std::max(kept, replayedTo(bag));
    EXPECT_GE(kept, killed.second_before) << "killed after " << ending.kill.count() << " ms";
    std::printf("killed after %4lld ms, closed after %4lld ms: %zu files, recorded step %llu, kept step %llu\n",
                static_cast<long long>(ending.kill.count()), static_cast<long long>(ending.close.count()), bags.size(),
                static_cast<unsigned long long>(killed.last), static_cast<unsigned long long>(kept));
  }
}

}  // namespace
}  // namespace soft_volume
