// soft_volume_tradeoff: what a faster or a more exact answer costs. Needs no ROS.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#ifdef SOFT_VOLUME_INTERACTION
#include "interaction_sweep.h"
#include "replay/guarded_process.h"
#endif
#include "plot.h"
#include "progress_bar.h"
#include "rendering_report.h"
#include "rendering_scene.h"
#include "rendering_sweep.h"
#include "simulation_report.h"
#include "simulation_scene.h"
#include "simulation_sweep.h"
#include "soft_volume/common/error.h"
#include "tradeoff_table.h"

namespace {

using soft_volume::core::FileError;
using soft_volume::core::ProgressBar;
using soft_volume::core::RenderingCase;
using soft_volume::core::RenderingResults;
using soft_volume::core::RenderingScene;
using soft_volume::core::SceneResults;
using soft_volume::core::TradeoffTable;

constexpr int kDone = 0;
constexpr int kImpossible = 2;

struct Arguments {
  bool simulation = false;
  bool rendering = false;
  std::string interaction;  ///< a bag
  std::string device;
  double seconds = 0.0;
  int threads = 1;
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
    "  soft_volume_tradeoff --rendering --out tradeoff\n"
    "      How many slices, which back end, which options? Ten minutes or so.\n"
    "  soft_volume_tradeoff --simulation --rendering --quick --out tradeoff\n"
    "      Both with few settings on small scenes, in seconds; for a first look and for tests.\n"
    "  soft_volume_tradeoff --interaction demo.bag --out tradeoff\n"
    "      What do settings of simulation and renderer do to what a hand really did?\n"
    "\n"
    "--simulation: two scenes are simulated with every setting: a footprint that presses into a slab of tissue, "
    "slides\n"
    "and lets go, compared with a converged reference; and a loaded cantilever, compared with Timoshenko's "
    "deflection.\n"
    "The cost is processor time of one core. Written are\n"
    "  DIR/simulation.md   what to choose for which need, and why, in words: read this first\n"
    "  DIR/simulation.png  error against cost of every setting, with the Pareto front\n"
    "  DIR/simulation.csv  every setting with its errors (per cent), ms per simulated second and bytes per vertex\n"
    "--rendering: a curvilinear grid and, where the sample data are (scripts/sample_data), a deformed lattice with an\n"
    "MRI are drawn with every setting and compared with the exact back end. The cost is the time of a frame on all "
    "cores.\n"
    "Written are DIR/rendering.md, .png and .csv in the same form; errors in 8-bit levels, memory in MiB.\n"
    "--interaction: the motion of the device in a bag goes through tool and simulation with every setting, moments of "
    "it\n"
    "are drawn with every setting, and positions, forces and pictures are compared with the most exact ones. Written "
    "are\n"
    "DIR/interaction.md, .png and .csv.\n"
    "\n"
    "Costs are medians of interleaved repeats; best run nothing else meanwhile. Errors are the same in every run.\n"
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

/// The scenes that there are; `skipped` takes the reasons for those that are not.
std::vector<std::unique_ptr<RenderingScene>> renderingScenes(bool quick, std::vector<std::string>& skipped) {
  std::vector<std::unique_ptr<RenderingScene>> scenes;
  scenes.push_back(std::make_unique<RenderingScene>(soft_volume::core::curvilinearScene(quick ? 1000 : 40000)));
  if (quick)
    return scenes;
  std::string why_not;
  if (auto mri = soft_volume::core::mriLatticeScene(why_not))
    scenes.push_back(std::move(mri));
  else
    skipped.push_back("mri_lattice: " + why_not);
  return scenes;
}

/// Every scene at an angle to its cells, as haze and as narrow peaks.
std::vector<RenderingCase> renderingCases(const std::vector<std::unique_ptr<RenderingScene>>& scenes) {
  std::vector<RenderingCase> cases;
  for (const auto& scene : scenes) {
    for (std::size_t f = 0; f < 2; ++f)
      cases.push_back({scene.get(), scene->functions[f], scene->views[1]});
  }
  return cases;
}

std::vector<RenderingResults> drawCases(const Arguments& arguments, const std::vector<RenderingCase>& cases) {
  using namespace soft_volume::core;
  double total = 0.0;
  for (const RenderingCase& c : cases)
    total += renderingWork(renderingSettings(*c.scene, arguments.quick), arguments.repeats);
  ProgressBar bar(arguments.no_progress);
  double before = 0.0;
  std::vector<RenderingResults> results;
  for (const RenderingCase& c : cases) {
    const std::vector<RenderingSetting> settings = renderingSettings(*c.scene, arguments.quick);
    const auto progress = [&](double done, double) { bar.update(before + done, total); };
    results.push_back({c, runRenderingSweep(c, settings, arguments.repeats, progress)});
    before += renderingWork(settings, arguments.repeats);
  }
  return results;
}

void sweepRendering(const Arguments& arguments) {
  const std::string stem = outputFolder(arguments.out) + "rendering";
  writeText(stem + ".md", "soft_volume_tradeoff has not finished.\n");
  std::vector<std::string> skipped;
  const auto scenes = renderingScenes(arguments.quick, skipped);
  for (const std::string& reason : skipped)
    std::fprintf(stderr, "left out %s\n", reason.c_str());
  const std::vector<RenderingResults> cases = drawCases(arguments, renderingCases(scenes));
  const TradeoffTable table = renderingTable(cases);
  writeCsv(table, stem + ".csv");
  writeText(stem + ".md", renderingReport(cases, table, skipped));
  soft_volume::core::plotWithGnuplot(plotScript(table, renderingPlot(cases, stem + ".png")));
  std::printf("%s.md, .png and .csv: %zu settings\n", stem.c_str(), table.rows.size());
  for (const auto& row : table.rows) {
    if (!row.preset.empty()) {
      std::printf("  %-34s %-18s %s, %s slices: error %.3g levels, %.4g ms a frame\n", row.scene.c_str(),
                  row.preset.c_str(), row.settings[0].c_str(), row.settings[1].c_str(), row.error(), row.cost);
    }
  }
}

#ifdef SOFT_VOLUME_INTERACTION
void sweepInteraction(const Arguments& arguments) {
  using namespace soft_volume::core;
  const std::string stem = outputFolder(arguments.out) + "interaction";
  writeText(stem + ".md", "soft_volume_tradeoff has not finished.\n");
  InteractionOptions options;
  options.bag = arguments.interaction;
  options.work_dir = stem + "_runs";
  options.quick = arguments.quick;
  options.seconds = arguments.seconds;
  options.device_file = arguments.device;
  options.threads = arguments.threads;
  outputFolder(options.work_dir);
  InteractionResults results;
  {
    ProgressBar bar(arguments.no_progress);
    results = sweepInteraction(options, [&bar](double done, double total) { bar.update(done, total); });
  }
  std::filesystem::remove_all(options.work_dir);
  const TradeoffTable table = interactionTable(results);
  writeCsv(table, stem + ".csv");
  writeText(stem + ".md", interactionReport(results, table));
  plotWithGnuplot(plotScript(table, interactionPlot(results, stem + ".png")));
  std::printf("%s.md, .png and .csv: %zu ways to simulate, %zu to draw\n", stem.c_str(), results.runs.size(),
              results.drawings.size());
  for (const InteractionRun& run : results.runs) {
    std::printf("  %-16s positions %.3g %%, force %.3g %%, %.4g ms per simulated second%s\n", run.name.c_str(),
                100.0 * run.position_error, 100.0 * run.force_error, run.ms_per_simulated_s,
                run.failure.empty() ? "" : (": " + run.failure).c_str());
  }
}

/// Bags are read in a process of its own, as in soft_volume_replay.
int sweepInteractionGuarded(const Arguments& arguments) {
  const auto work = [&arguments] {
    try {
      sweepInteraction(arguments);
      return kDone;
    } catch (const std::exception& error) {
      std::fprintf(stderr, "soft_volume_tradeoff: %s\n", error.what());
      return kImpossible;
    }
  };
  const auto died = [&arguments](int signal) {
    std::fprintf(stderr, "soft_volume_tradeoff: %s: the bag is damaged (its reader died with signal %d)\n",
                 arguments.interaction.c_str(), signal);
    return kImpossible;
  };
  return soft_volume::replay_program::runGuarded({arguments.interaction}, work, died);
}
#else
int sweepInteractionGuarded(const Arguments&) {
  throw soft_volume::core::InputError("--interaction reads bags: it needs a build with ROS");
}
#endif

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Measures what a faster or a more exact answer costs, and says what to choose.");
  app.add_flag("--simulation", arguments.simulation, "sweep the settings of the simulation");
  app.add_flag("--rendering", arguments.rendering, "sweep the settings of the renderer");
  CLI::Option* interaction =
      app.add_option("--interaction", arguments.interaction, "sweep both on the interaction in this bag")
          ->type_name("BAG");
  app.add_option("--seconds", arguments.seconds, "with --interaction: so much of it, from its start (default: all)")
      ->check(CLI::Range(0.01, 1e6))
      ->needs(interaction);
  app.add_option("--device", arguments.device, "with --interaction: file of the recorded device, as in config/devices")
      ->needs(interaction);
  app.add_option("--threads", arguments.threads, "with --interaction: threads of simulation and renderer (default 1)")
      ->check(CLI::Range(1, 256))
      ->needs(interaction);
  app.add_option("--out", arguments.out, "folder for the results; made when it does not exist")->required();
  app.add_flag("--quick", arguments.quick, "few settings, small scenes");
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
    if (!arguments.simulation && !arguments.rendering && arguments.interaction.empty())
      throw soft_volume::core::InputError("say what to measure: --simulation, --rendering, --interaction BAG");
    if (arguments.simulation)
      sweepSimulation(arguments);
    if (arguments.rendering)
      sweepRendering(arguments);
    return arguments.interaction.empty() ? kDone : sweepInteractionGuarded(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_tradeoff: %s\n", error.what());
    return kImpossible;
  }
}
