// soft_volume_tradeoff: what a faster or a more exact answer costs. Needs no ROS.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "plot.h"
#include "progress_bar.h"
#include "simulation_report.h"
#include "simulation_scene.h"
#include "simulation_sweep.h"
#include "soft_volume/common/error.h"
#include "tradeoff_table.h"

namespace {

using soft_volume::core::FileError;
using soft_volume::core::ProgressBar;
using soft_volume::core::SceneResults;
using soft_volume::core::TradeoffTable;

constexpr int kDone = 0;
constexpr int kImpossible = 2;

struct Arguments {
  bool simulation = false;
  std::string out;
  bool quick = false;
  int repeats = 3;
  bool no_progress = false;
};

constexpr char kFooter[] =
    "Examples:\n"
    "  soft_volume_tradeoff --simulation --out tradeoff\n"
    "      Which lattice spacing, integrator, step, active set and precision are worth their cost? Twenty minutes or "
    "so.\n"
    "  soft_volume_tradeoff --simulation --quick --out tradeoff\n"
    "      The same with few settings on a small slab, in seconds; for a first look and for tests.\n"
    "\n"
    "Two scenes are simulated with every setting: a footprint that presses into a slab of tissue, slides and lets go,\n"
    "compared with a converged reference; and a loaded cantilever, compared with Timoshenko's deflection. Written are\n"
    "  DIR/simulation.md   what to choose for which need, and why, in words: read this first\n"
    "  DIR/simulation.png  error against cost of every setting, with the Pareto front\n"
    "  DIR/simulation.csv  every setting with its errors (per cent), ms per simulated second and bytes per vertex\n"
    "The cost is processor time of one core, the median of interleaved repeats; best run nothing else meanwhile. "
    "Errors are the same "
    "in\n"
    "every run.\n"
    "\n"
    "Exit code: 0 done, 2 it cannot be done (bad arguments, a folder that cannot be written, gnuplot missing).\n";

std::string outputFolder(const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error)
    throw FileError(folder + ": the folder cannot be made: " + error.message());
  return folder + "/";
}

void writeText(const std::string& path, const std::string& text) {
  std::ofstream file(path);
  file << text;
  file.close();
  if (!file)
    throw FileError(path + ": cannot be written");
}

std::vector<SceneResults> runScenes(const Arguments& arguments) {
  using namespace soft_volume::core;
  const std::vector<TradeoffScene> scenes = {indentationScene(arguments.quick), cantileverScene()};
  const std::vector<SweepSetting> settings = sweepSettings(arguments.quick);
  double total = 0.0;
  for (const TradeoffScene& scene : scenes)
    total += sweepWork(scene, settings, arguments.repeats);
  ProgressBar bar(arguments.no_progress);
  double before = 0.0;
  std::vector<SceneResults> results;
  for (const TradeoffScene& scene : scenes) {
    const auto progress = [&](double done, double) { bar.update(before + done, total); };
    results.push_back({scene, runSweep(scene, settings, arguments.repeats, progress)});
    before += sweepWork(scene, settings, arguments.repeats);
  }
  return results;
}

void sweepSimulation(const Arguments& arguments) {
  const std::string stem = outputFolder(arguments.out) + "simulation";
  // Before the long work: a folder that cannot be written is noticed at once.
  writeText(stem + ".md", "soft_volume_tradeoff has not finished.\n");
  const std::vector<SceneResults> scenes = runScenes(arguments);
  const TradeoffTable table = simulationTable(scenes);
  writeCsv(table, stem + ".csv");
  writeText(stem + ".md", simulationReport(scenes, table));
  soft_volume::core::plotWithGnuplot(plotScript(table, simulationPlot(scenes, stem + ".png")));
  std::printf("%s.md, .png and .csv: %zu settings\n", stem.c_str(), table.rows.size());
  for (const auto& row : table.rows) {
    if (!row.preset.empty()) {
      std::printf("  %-12s %-10s %s mm: error %.3g %%, %.4g ms per simulated second\n", row.scene.c_str(),
                  row.preset.c_str(), row.settings.front().c_str(), 100.0 * row.error(), row.cost);
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Measures what a faster or a more exact answer costs, and says what to choose.");
  app.add_flag("--simulation", arguments.simulation, "sweep the settings of the simulation");
  app.add_option("--out", arguments.out, "folder for the results; made when it does not exist")->required();
  app.add_flag("--quick", arguments.quick, "few settings, a small slab and a short course");
  app.add_option("--repeats", arguments.repeats, "times that every setting runs for its cost (default 3)")
      ->check(CLI::Range(1, 99));
  app.add_flag("--no-progress", arguments.no_progress, "print no progress");
  app.footer(kFooter);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kDone : kImpossible;
  }
  try {
    if (!arguments.simulation)
      throw soft_volume::core::InputError("say what to measure: --simulation");
    sweepSimulation(arguments);
    return kDone;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_tradeoff: %s\n", error.what());
    return kImpossible;
  }
}
