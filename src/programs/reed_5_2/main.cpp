// soft_volume_reed_5_2: section 5.2 of the dissertation, run again and timed. Needs no ROS.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>

#include "experiment.h"
#include "progress_bar.h"
#include "soft_volume/common/error.h"

namespace {

using namespace soft_volume::core;
using namespace soft_volume::core::reed_5_2;

constexpr int kDone = 0;
constexpr int kImpossible = 2;

/// What the dissertation measured on an SGI with a 194 MHz R10000 (section 5.2); milliseconds.
constexpr double kStep1997_ms = 4.0;
constexpr double kFrame1997_ms = 135.0;
constexpr double kUpdated1997_ms = 100.0;

struct Arguments {
  std::string scene = SOFT_VOLUME_SOURCE_DIR "/config/scenes/reed_5_2.yaml";
  std::filesystem::path out;
  std::string json;
  int threads = 1;
  bool no_progress = false;
};

constexpr char kExplanation[] =
    "The dissertation's times are those of its figures 5.3 (push) and 5.4 (incision), with 144 active cells. The "
    "ratios\n"
    "do not depend on how fast the machine is: how a frame's time is divided between simulation and picture, and what\n"
    "redrawing only what moved saves.\n"
    "\n"
    "Example:\n"
    "  SOFT_VOLUME_CACHE=~/.cache/soft_volume soft_volume_reed_5_2 --out reed\n"
    "      The times, and reed/growth_before.png and the others: the slice of figure 5.2 before and after the growth,\n"
    "      the push of figure 5.3 and the incision of figure 5.4.\n"
    "\n"
    "scripts/sample_data makes the volume. Exit code: 0 done, 2 it cannot be done.\n";

void printRow(const char* name, double in_1997, const Cost& push, const Cost& incision, double Cost::*value) {
  std::printf("  %-44s %12.4g %12.4g %12.4g\n", name, in_1997, push.*value, incision.*value);
}

/// Of the time of a frame with its steps, what the steps take.
double stepShare(double step_ms, double frame_ms) {
  const double steps_ms = kStepsPerFrame * step_ms;
  return steps_ms / (steps_ms + frame_ms);
}

void printRatios(const Cost& push, const Cost& incision) {
  const auto row = [](const char* name, double in_1997, double pushed, double cut) {
    std::printf("  %-44s %12.4g %12.4g %12.4g\n", name, in_1997, pushed, cut);
  };
  row("update / frame", kUpdated1997_ms / kFrame1997_ms, push.updated_ms / push.frame_ms,
      incision.updated_ms / incision.frame_ms);
  row("two steps / (two steps + update)", stepShare(kStep1997_ms, kUpdated1997_ms),
      stepShare(push.step_ms, push.updated_ms), stepShare(incision.step_ms, incision.updated_ms));
  row("times faster: step", 1.0, kStep1997_ms / push.step_ms, kStep1997_ms / incision.step_ms);
  row("times faster: frame", 1.0, kFrame1997_ms / push.frame_ms, kFrame1997_ms / incision.frame_ms);
  row("times faster: update", 1.0, kUpdated1997_ms / push.updated_ms, kUpdated1997_ms / incision.updated_ms);
}

void print(const Results& results) {
  std::printf("%zu cells, time step %.3g ms, %d steps a frame\n", results.cells, 1e3 * results.dt_s, kStepsPerFrame);
  std::printf(
      "growth moved the tissue by up to %.1f mm, the push by %.1f mm; the incision cut %zu cells and opened by "
      "%.1f mm\n\n",
      1e3 * results.grown_m, 1e3 * results.pushed_m, results.cells_cut, 1e3 * results.opened_m);
  std::printf("  %-44s %12s %12s %12s\n", "medians", "1997", "push", "incision");
  printRow("active cells", 144.0, results.push, results.incision, &Cost::active_cells);
  printRow("step, ms", kStep1997_ms, results.push, results.incision, &Cost::step_ms);
  printRow("frame, ms", kFrame1997_ms, results.push, results.incision, &Cost::frame_ms);
  printRow("frame, only what moved, ms", kUpdated1997_ms, results.push, results.incision, &Cost::updated_ms);
  printRatios(results.push, results.incision);
}

nlohmann::json toJson(const Cost& cost) {
  return {{"frames", cost.frames},
          {"active_cells", cost.active_cells},
          {"step_ms", cost.step_ms},
          {"frame_ms", cost.frame_ms},
          {"updated_ms", cost.updated_ms}};
}

void writeJson(const std::string& path, const Results& results) {
  const nlohmann::json json = {{"cells", results.cells},
                               {"dt_s", results.dt_s},
                               {"cells_cut", results.cells_cut},
                               {"steps_per_frame", kStepsPerFrame},
                               {"dissertation", toJson({0, kStep1997_ms, kFrame1997_ms, kUpdated1997_ms, 144.0})},
                               {"growth", toJson(results.growth)},
                               {"push", toJson(results.push)},
                               {"incision", toJson(results.incision)},
                               {"grown_m", results.grown_m},
                               {"pushed_m", results.pushed_m},
                               {"opened_m", results.opened_m}};
  std::ofstream file(path);
  file << json.dump(2) << '\n';
  file.close();
  if (!file)
    throw FileError(path + ": the JSON cannot be written");
}

/// A minute of work should not end with a folder that cannot be made.
void makeFolder(const std::filesystem::path& folder) {
  std::error_code error;
  if (!folder.empty() && !std::filesystem::create_directories(folder, error) && error)
    throw FileError(folder.string() + ": the folder cannot be made: " + error.message());
}

void run(const Arguments& arguments) {
  makeFolder(arguments.out);
  const Scene scene = loadScene(arguments.scene);
  Results results;
  {
    ProgressBar bar(arguments.no_progress);
    results = runExperiments(scene, arguments.threads, [&](double done) { bar.update(done, 1.0); });
  }
  print(results);
  if (!arguments.json.empty())
    writeJson(arguments.json, results);
  if (arguments.out.empty())
    return;
  for (const Picture& picture : results.pictures)
    writePng(arguments.out / (picture.name + ".png"), picture.image);
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app(
      "Runs the experiment of the dissertation's section 5.2 on an MRI: growth from inside, a push on the skin and\n"
      "an incision. Prints its times beside the dissertation's.");
  app.add_option("--scene", arguments.scene, "scene to run (default: config/scenes/reed_5_2.yaml of the sources)");
  app.add_option("--out", arguments.out, "write pictures (PNG) into this folder");
  app.add_option("--json", arguments.json, "write the numbers into this file");
  app.add_option("--threads", arguments.threads,
                 "threads of simulation and renderer (default 1, as in the dissertation)")
      ->check(CLI::Range(1, 256));
  app.add_flag("--no-progress", arguments.no_progress, "print no progress");
  app.footer(kExplanation);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kImpossible;
  }
  try {
    run(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_reed_5_2: %s\n", error.what());
    return kImpossible;
  }
  return kDone;
}
