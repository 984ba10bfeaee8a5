// soft_volume_replay: runs a recorded bag again and compares. Needs no ROS master.

#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <new>
#include <string>

#include "progress_bar.h"
#include "soft_volume/replay/replay_bag.h"

namespace {

using soft_volume::ReplayDifference;
using soft_volume::ReplayError;
using soft_volume::ReplayOptions;
using soft_volume::ReplayReport;
using soft_volume::core::ProgressBar;

constexpr int kIdentical = 0;
constexpr int kDifferent = 1;
constexpr int kImpossible = 2;

struct Arguments {
  std::string bag;
  std::string json;
  ReplayOptions options;
  bool no_progress = false;
};

constexpr char kExamples[] =
    "Examples:\n"
    "  soft_volume_replay demo.bag --check\n"
    "      Is everything that the bag recorded computed again, bit for bit?\n"
    "  soft_volume_replay demo.bag --check --json result.json --threads 2\n"
    "      The same in a script: counts, `identical` and `first_difference` as JSON.\n"
    "  soft_volume_replay demo.bag --frames frames\n"
    "      Only render the recorded frames again, as frames/CAMERA_STEP.png.\n"
    "\n"
    "The bag holds its own volume and scene; no other file is needed, nor a ROS master. A bag of a recorder that was\n"
    "killed has no index: `rosbag reindex FILE` first; the replay then goes as far as the bag does.\n"
    "\n"
    "Exit code: 0 everything is identical, 1 something differs, 2 it cannot be done (bad arguments; a bag that is\n"
    "damaged, lacks a topic or comes from another version).\n";

void printRow(const char* name, std::uint64_t count, const char* remark = "") {
  std::printf("  %-28s %10llu  %s\n", name, static_cast<unsigned long long>(count), remark);
}

void printDifference(const char* title, const ReplayDifference& difference) {
  std::printf("%s: step %llu, %s: %s\n", title, static_cast<unsigned long long>(difference.step),
              difference.kind.c_str(), difference.text.c_str());
}

void printSummary(const ReplayReport& report, bool check) {
  printRow("sessions", report.sessions);
  if (report.sessions_skipped > 0)
    printRow("sessions skipped", report.sessions_skipped);
  printRow("steps", report.steps);
  printRow("inputs applied again", report.inputs);
  printRow("  of these refused", report.inputs_refused, "as in the run");
  if (check) {
    printRow("journal hashes", report.journals);
    printRow("states", report.states, "bit for bit");
    printRow("topologies", report.topologies);
    printRow("checkpoints", report.checkpoints);
  }
  printRow("frames", report.frames, !check ? "rendered" : report.frames_by_psnr > 0 ? "by PSNR" : "byte for byte");
  if (report.frames_without_image > 0)
    printRow("frames by hash alone", report.frames_without_image, "no image recorded");
  if (report.images_without_stats > 0)
    printRow("images not checked", report.images_without_stats, "no render/stats");
  if (report.inputs_not_recorded > 0) {
    printRow("inputs not recorded", report.inputs_not_recorded, "journaled before or after their topic was recorded");
  }
  if (report.inputs_not_journaled > 0) {
    printRow("inputs not journaled", report.inputs_not_journaled, "recorded, but the simulation never had them");
  }
  if (report.not_checked > 0)
    printRow("not checked", report.not_checked, "outside the journal");
  for (const std::string& note : report.notes)
    std::printf("note: %s\n", note.c_str());
  if (!report.first_differences.empty())
    printDifference("first difference", report.first_differences.front());
  for (std::size_t n = 1; n < std::min<std::size_t>(4, report.first_differences.size()); ++n) {
    printDifference("           then", report.first_differences[n]);
  }
}

void writeJson(const std::string& path, const ReplayReport& report, const std::string& error) {
  if (path.empty())
    return;
  std::ofstream file(path);
  file << soft_volume::toJson(report, error);
  file.close();
  if (!file)
    throw ReplayError(path + ": the JSON cannot be written");
}

int finish(const Arguments& arguments, const ReplayReport& report, const std::string& error) {
  writeJson(arguments.json, report, error);
  if (error.empty() || report.steps > 0 || !report.identical())
    printSummary(report, arguments.options.check);
  std::fflush(stdout);
  if (!error.empty())
    std::fprintf(stderr, "soft_volume_replay: %s\n", error.c_str());
  if (!report.identical()) {
    std::printf("DIFFERENT: %llu differences\n", static_cast<unsigned long long>(report.differences));
    return kDifferent;
  }
  if (!error.empty())
    return kImpossible;
  std::printf(arguments.options.check ? "identical (%.1f s)\n" : "done (%.1f s)\n", report.wall_s);
  return kIdentical;
}

int replay(const Arguments& arguments) {
  ReplayReport report;
  std::string error;
  try {
    ProgressBar bar(arguments.no_progress);
    soft_volume::replayBag(
        arguments.bag, arguments.options, [&bar](double done, double total) { bar.update(done, total); }, report);
  } catch (const std::bad_alloc&) {
    error = arguments.bag + ": the bag is damaged, or the memory does not suffice for it";
  } catch (const std::exception& failure) {
    error = failure.what();
  }
  return finish(arguments, report, error);
}

/// A damaged length in a bag may ask for any amount of memory. What a replay really needs is far below this.
void limitMemory(const std::string& bag) {
#ifndef __SANITIZE_ADDRESS__
  std::error_code ignored;
  const std::uintmax_t bytes = std::filesystem::file_size(bag, ignored);
  const rlim_t most = (rlim_t(4) << 30) + 16 * (ignored ? 0 : bytes);
  rlimit limit{};
  getrlimit(RLIMIT_AS, &limit);
  limit.rlim_cur = std::min(limit.rlim_max, most);
  setrlimit(RLIMIT_AS, &limit);
#else
  static_cast<void>(bag);
#endif
}

/// rosbag's library crashes on some damaged bags, so the work is done in a process of its own.
int replayInChild(const Arguments& arguments) {
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child < 0)
    throw ReplayError(std::string("no process can be started: ") + std::strerror(errno));
  if (child == 0) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    const rlimit no_core{0, 0};
    setrlimit(RLIMIT_CORE, &no_core);
    limitMemory(arguments.bag);
    const int code = replay(arguments);
    std::fflush(nullptr);
    // Without destructors of static objects: libraries that were confused by a damaged bag need not end cleanly.
    _exit(code);
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  if (WIFEXITED(status))
    return WEXITSTATUS(status);
  return finish(
      arguments, ReplayReport(),
      arguments.bag + ": the bag is damaged (its reader died with signal " + std::to_string(WTERMSIG(status)) + ")");
}

void checkArguments(const Arguments& arguments) {
  if (!arguments.options.check && arguments.options.frames_dir.empty()) {
    throw ReplayError("say what to do: --check, --frames DIR, or both");
  }
  if (arguments.options.frames_dir.empty())
    return;
  std::error_code error;
  std::filesystem::create_directories(arguments.options.frames_dir, error);
  if (error)
    throw ReplayError(arguments.options.frames_dir + ": the folder cannot be made: " + error.message());
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  arguments.options.check = false;
  CLI::App app("Runs a recorded bag again, without a ROS master, and compares every state and frame with the record.");
  app.add_option("bag", arguments.bag, "bag file, as written by the recorder or by rosbag record")->required();
  app.add_flag("--check", arguments.options.check, "compare inputs, states, topologies, checkpoints and frames");
  app.add_option("--frames", arguments.options.frames_dir, "write the frames that are rendered again into this folder");
  app.add_option("--json", arguments.json, "write counts and the first differences into this file");
  app.add_option("--threads", arguments.options.threads,
                 "threads of the simulation (default 1); results do not depend on it")
      ->check(CLI::Range(1, 256));
  app.add_flag("--no-progress", arguments.no_progress, "print no progress");
  app.footer(kExamples);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kIdentical : kImpossible;
  }
  try {
    checkArguments(arguments);
    return replayInChild(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_replay: %s\n", error.what());
    return kImpossible;
  }
}
