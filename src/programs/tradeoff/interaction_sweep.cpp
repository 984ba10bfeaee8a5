#include "interaction_sweep.h"

#include <time.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <memory>
#include <optional>

#include "report_text.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/comparison.h"
#include "soft_volume/replay/resimulation.h"
#include "soft_volume/replay/state_renderer.h"

namespace soft_volume::core {
namespace {

constexpr std::size_t kMoments = 4;
constexpr double kReferenceWork = 6.0;  // of a run, for the progress
constexpr double kLevels = 255.0;

InteractionRun makeRun(const std::string& name, const std::string& changes, const std::string& preset = "") {
  InteractionRun run;
  run.name = name;
  run.changes = changes;
  run.preset = preset;
  return run;
}

/// A load must not be narrower than a cell.
double largestSpacing(const Scene& scene) {
  double largest_m = std::numeric_limits<double>::infinity();
  for (const ToolConfig& tool : scene.tools)
    largest_m = std::min(largest_m, tool.footprint_radius_m);
  return largest_m;
}

void addSpacings(const Scene& scene, const std::vector<double>& times, std::vector<InteractionRun>& runs) {
  for (const double t : times) {
    const Vector3 s = t * scene.lattice.spacing_m;
    if (s.maxCoeff() <= largestSpacing(scene)) {
      runs.push_back(makeRun(format("h = %.3g mm", 1e3 * s.maxCoeff()),
                             format("lattice.spacing_m=[%.6g,%.6g,%.6g]", s.x(), s.y(), s.z())));
    }
  }
}

std::vector<InteractionRun> chooseRuns(const Scene& scene, bool quick) {
  std::vector<InteractionRun> runs = {makeRun("reference",
                                              "simulation.integrator=symplectic_euler,simulation.dt_fraction=0.3,"
                                              "simulation.active_set=all,simulation.precision=double"),
                                      makeRun("as recorded", ""),
                                      makeRun("preset fast", "simulation.preset=fast", "fast")};
  runs.front().is_reference = true;
  addSpacings(scene, {1.25}, runs);
  if (quick)
    return runs;
  runs.push_back(makeRun("preset balanced", "simulation.preset=balanced", "balanced"));
  runs.push_back(makeRun("preset reed1997", "simulation.preset=reed1997", "reed1997"));
  runs.push_back(makeRun("backward Euler", "simulation.integrator=backward_euler,simulation.dt_s=0.004"));
  runs.push_back(makeRun("all cells", "simulation.active_set=all"));
  addSpacings(scene, {0.8, 1.5, 2.0}, runs);
  return runs;
}

std::vector<InteractionDrawing> chooseDrawings(const RenderSettings& settings, bool quick) {
  const int slices = std::max(8, settings.options.slices);
  std::vector<InteractionDrawing> drawings = {
      {"exact", slices, true, 0.0}, {"native", slices / 2, false, 0.0}, {"native", slices, false, 0.0}};
  if (!quick) {
    drawings.push_back({"native", slices / 4, false, 0.0});
    drawings.push_back({"native", 2 * slices, false, 0.0});
  }
  return drawings;
}

const ComparedQuantity* worst(const Comparison& comparison, const std::string& key) {
  const ComparedQuantity* result = nullptr;
  for (const ComparedQuantity& q : comparison.quantities) {
    const auto part = [](const ComparedQuantity& quantity) { return quantity.rms / quantity.scale; };
    if (q.key == key && q.scale > 0.0 && (result == nullptr || part(q) > part(*result)))
      result = &q;
  }
  return result;
}

double partOf(const Comparison& comparison, const std::string& key) {
  const ComparedQuantity* quantity = worst(comparison, key);
  return quantity == nullptr ? 0.0 : quantity->rms / quantity->scale;
}

RenderSettings withDrawing(RenderSettings settings, const InteractionDrawing& drawing) {
  settings.backend = drawing.backend == "exact" ? Backend::kExact : Backend::kNative;
  settings.options.slices = drawing.slices;
  settings.options.step_m = 0.0;
  settings.incremental = settings.progressive = false;
  return settings;
}

/// Seconds of a clock of which other programs take nothing, as far as there is one: with one thread its own.
double clockTime(int threads) {
  timespec now{};
  clock_gettime(threads == 1 ? CLOCK_THREAD_CPUTIME_ID : CLOCK_MONOTONIC, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The sweep under way.
class Sweep {
 public:
  Sweep(const InteractionOptions& options, const std::function<void(double, double)>& progress)
      : options_(options), progress_(progress), recorded_(options.bag) {
    const RecordedRun& run = recorded_.longest();
    const Scene scene = run.scene();
    if (scene.rendering.cameras.empty())
      throw ReplayError(options.bag + ": its scene has no camera, so no picture can be compared");
    results_.scene = scene.name;
    results_.frame_rate_hz = scene.rendering.rate_hz;
    results_.runs = chooseRuns(scene, options.quick);
    results_.drawings = chooseDrawings(scene.rendering, options.quick);
    const auto runs = static_cast<double>(results_.runs.size());
    total_ = kReferenceWork + 2.0 * (runs - 1.0) + 1.0;
  }

  InteractionResults run() {
    for (std::size_t n = 0; n < results_.runs.size(); ++n)
      simulate(n);
    if (!results_.runs.front().failure.empty())
      throw ReplayError("the reference of the interaction cannot run: " + results_.runs.front().failure);
    reference_ = std::make_unique<RecordedBag>(path(0));
    chooseMoments();
    for (std::size_t n = 0; n < results_.runs.size(); ++n) {
      if (results_.runs[n].failure.empty())
        judge(n);
      std::error_code ignored;
      if (n > 0)
        std::filesystem::remove(path(n), ignored);
      advance(1.0);
    }
    return std::move(results_);
  }

 private:
  std::string path(std::size_t run) const { return options_.work_dir + "/run_" + std::to_string(run) + ".bag"; }

  void advance(double work) { progress_(done_ += work, total_); }

  void simulate(std::size_t n) {
    InteractionRun& run = results_.runs[n];
    const double work = run.is_reference ? kReferenceWork - 1.0 : 1.0;
    const double before = done_;
    try {
      ResimulationOptions options;
      if (!run.changes.empty())
        options.changes = parseOverrides(run.changes);
      options.output = path(n);
      options.device_file = options_.device_file;
      options.seconds = options_.seconds;
      options.threads = options_.threads;
      const Resimulation done = resimulate(
          recorded_, options, [&](double part, double whole) { progress_(before + work * part / whole, total_); });
      run.dt_s = done.time_step_s;
      run.step_ms = done.step_ms_median;
      const double spent_s = options_.threads == 1 ? done.processor_s : done.stepping_s;
      run.ms_per_simulated_s = 1e3 * spent_s / done.simulated_s;
      results_.simulated_s = std::max(results_.simulated_s, done.simulated_s);
      if (n == 0)
        results_.notes = done.notes;
    } catch (const Error& error) {
      run.failure = error.what();
    }
    done_ = before;
    advance(work);
  }

  /// Moments of the reference, spread over the interaction.
  void chooseMoments() {
    const RecordedRun& run = reference_->longest();
    const std::size_t states = run.states().size();
    for (std::size_t n = 0; n < kMoments; ++n)
      moments_.push_back((2 * n + 1) * states / (2 * kMoments));
    const Camera& camera = run.scene().rendering.cameras.front().camera;
    StateRenderer renderer(run, options_.threads);
    const RenderSettings settings = withDrawing(run.scene().rendering, results_.drawings.front());
    for (const std::size_t moment : moments_) {
      results_.frame_times_s.push_back(run.states()[moment].time_s);
      pictures_.push_back(renderer.draw(moment, settings, "scene", camera));
    }
  }

  void judge(std::size_t n) {
    InteractionRun& run = results_.runs[n];
    const RecordedBag bag(path(n));
    run.spacing_m = bag.longest().scene().lattice.spacing_m.maxCoeff();
    if (!run.is_reference) {
      const Comparison comparison = compareBags(*reference_, bag, [](double, double) {});
      run.position_error = partOf(comparison, "positions");
      run.force_error = partOf(comparison, "force");
      run.device_force_error = partOf(comparison, "device_force");
    }
    draw(n, bag.longest());
  }

  /// The state at a stamp of the reference's.
  static std::size_t stateAt(const RecordedRun& run, const ros::Time& stamp) {
    const double time_s = run.timeOf(stamp);
    const auto apart = [&](const RecordedState& state) { return std::abs(state.time_s - time_s); };
    const auto nearest = std::min_element(run.states().begin(), run.states().end(),
                                          [&](const auto& a, const auto& b) { return apart(a) < apart(b); });
    return static_cast<std::size_t>(nearest - run.states().begin());
  }

  void draw(std::size_t n, const RecordedRun& run) {
    const RecordedRun& reference = reference_->longest();
    const Scene scene = run.scene();
    for (std::size_t d = 0; d < results_.drawings.size(); ++d) {
      InteractionDrawing& drawing = results_.drawings[d];
      if (drawing.is_reference && !results_.runs[n].is_reference)
        continue;
      StateRenderer renderer(run, options_.threads);
      const RenderSettings settings = withDrawing(scene.rendering, drawing);
      double squares = 0.0;
      double ssim = 0.0;
      std::vector<double> times_ms;
      for (std::size_t m = 0; m < moments_.size(); ++m) {
        const ros::Time stamp = reference.stampAt(reference.states()[moments_[m]].time_s);
        const double begin_s = clockTime(options_.threads);
        const Image image =
            renderer.draw(stateAt(run, stamp), settings, "scene", scene.rendering.cameras.front().camera);
        times_ms.push_back(1e3 * (clockTime(options_.threads) - begin_s));
        const ImageDifference difference = compareImages(pictures_[m], image);
        squares += difference.rmse * difference.rmse;
        ssim += difference.ssim;
      }
      times_ms.erase(times_ms.begin());  // that one prepared the volume
      const auto count = static_cast<double>(moments_.size());
      addPair(n, d, std::sqrt(squares / count) / kLevels, ssim / count, median(times_ms));
    }
  }

  void addPair(std::size_t n, std::size_t d, double error, double ssim, double frame_ms) {
    const InteractionRun& run = results_.runs[n];
    if (n == 0)
      results_.drawings[d].frame_ms = frame_ms;
    InteractionPair pair;
    pair.run = n;
    pair.drawing = d;
    pair.image_error = error;
    pair.ssim = ssim;
    pair.latency_ms = run.step_ms + frame_ms;
    pair.ms_per_simulated_s = run.ms_per_simulated_s + results_.frame_rate_hz * frame_ms;
    results_.pairs.push_back(pair);
  }

  const InteractionOptions& options_;
  const std::function<void(double, double)>& progress_;
  RecordedBag recorded_;
  std::unique_ptr<RecordedBag> reference_;
  InteractionResults results_;
  std::vector<std::size_t> moments_;
  std::vector<Image> pictures_;
  double done_ = 0.0;
  double total_ = 1.0;
};

constexpr char kPositions[] = "positions";
constexpr char kForces[] = "force";
constexpr char kImages[] = "image";

TradeoffRow rowOf(const char* scene, const InteractionRun& run, double error) {
  TradeoffRow row;
  row.scene = scene;
  row.settings = {run.name, format("%.3g", 1e3 * run.spacing_m), format("%.3g", 1e3 * run.dt_s), "-", "-"};
  row.cost = run.ms_per_simulated_s;
  row.memory = run.step_ms;
  row.reference_error = error;
  row.preset = run.preset;
  row.is_reference = run.is_reference;
  return row;
}

std::string percent(double part) {
  return number(100.0 * part) + " %";
}

std::string runTable(const InteractionResults& results) {
  std::string text =
      "| simulation | h [mm] | step [ms] | ms per simulated s | positions | force | force at the device |\n"
      "|---|---|---|---|---|---|---|\n";
  for (const InteractionRun& run : results.runs) {
    if (!run.failure.empty())
      continue;
    text += "| " + run.name + " | " + number(1e3 * run.spacing_m) + " | " + number(1e3 * run.dt_s) + " | " +
            number(run.ms_per_simulated_s) + " | " + percent(run.position_error) + " | " + percent(run.force_error) +
            " | " + percent(run.device_force_error) + " |\n";
  }
  return text;
}

std::string pairTable(const InteractionResults& results) {
  std::string text =
      "| simulation | drawing | image error | SSIM | ms per simulated s | latency [ms] |\n"
      "|---|---|---|---|---|---|\n";
  for (const InteractionPair& pair : results.pairs) {
    const InteractionDrawing& drawing = results.drawings[pair.drawing];
    text += "| " + results.runs[pair.run].name + " | " + drawing.backend + ", " + std::to_string(drawing.slices) +
            (drawing.is_reference ? " (reference)" : " slices") + " | " + percent(pair.image_error) + " | " +
            format("%.4f", pair.ssim) + " | " + number(pair.ms_per_simulated_s) + " | " + number(pair.latency_ms) +
            " |\n";
  }
  return text;
}

std::string frontText(const TradeoffTable& table) {
  std::string text;
  for (const TradeoffRow& row : table.rows) {
    if (row.on_front) {
      text += "- " + row.scene + ": " + row.settings[0] +
              (row.scene == kImages ? ", " + row.settings[3] + " " + row.settings[4] : "") + ": " +
              percent(row.error()) + " for " + number(row.cost) + " ms per simulated second\n";
    }
  }
  return text;
}

}  // namespace

InteractionResults sweepInteraction(const InteractionOptions& options,
                                    const std::function<void(double, double)>& progress) {
  return Sweep(options, progress).run();
}

TradeoffTable interactionTable(const InteractionResults& results) {
  TradeoffTable table;
  table.setting_names = {"simulation", "h_mm", "step_ms", "backend", "slices"};
  table.cost_name = "ms_per_simulated_s";
  table.memory_name = "latency_ms";
  for (const InteractionRun& run : results.runs) {
    if (!run.failure.empty())
      continue;
    table.rows.push_back(rowOf(kPositions, run, run.position_error));
    table.rows.push_back(rowOf(kForces, run, run.force_error));
  }
  for (const InteractionPair& pair : results.pairs) {
    const InteractionDrawing& drawing = results.drawings[pair.drawing];
    TradeoffRow row = rowOf(kImages, results.runs[pair.run], pair.image_error);
    row.settings[3] = drawing.backend;
    row.settings[4] = std::to_string(drawing.slices);
    row.cost = pair.ms_per_simulated_s;
    row.memory = pair.latency_ms;
    row.is_reference = drawing.is_reference && row.is_reference;
    if (drawing.slices != results.drawings.front().slices || drawing.is_reference)
      row.preset.clear();  // one name for each is enough in a plot
    table.rows.push_back(row);
  }
  markFront(table);
  return table;
}

TradeoffPlot interactionPlot(const InteractionResults& results, const std::string& png_path) {
  TradeoffPlot plot;
  plot.png_path = png_path;
  plot.title = "Recorded interaction, scene " + results.scene;
  plot.cost_label = "computing time per simulated second [ms]";
  plot.panels = {{kPositions, "Positions", "RMS, of the largest displacement"},
                 {kForces, "Force on the tissue", "RMS, of the largest force"},
                 {kImages, "Pictures", "RMSE, of 255 levels"}};
  plot.colour_setting = 0;
  plot.shape_setting = 4;
  return plot;
}

std::string interactionReport(const InteractionResults& results, const TradeoffTable& table) {
  std::string text = "# What settings do to a recorded interaction\n\n";
  text += format("Scene %s, %.3g s of a recorded hand, on %s. ", results.scene.c_str(), results.simulated_s,
                 processorName().c_str());
  text +=
      "The device moves in every run as it was recorded, and tool and simulation follow it in lockstep, so errors "
      "are the same in every run; times are processor times of one thread (wall times where more were asked for).\n\n"
      "Positions, forces and pictures are compared with the run \"reference\": the recorded lattice with all cells, "
      "in double precision, with steps of 0.3 of the stability limit, drawn by the back end `exact`. So errors of "
      "the lattice's own spacing are not among them. A run of less than 1000 ms per simulated second keeps up with "
      "the hand on one core.\n\n## Simulation\n\n";
  text += runTable(results);
  for (const InteractionRun& run : results.runs) {
    if (!run.failure.empty())
      text += "\nLeft out: " + run.name + ": " + run.failure + "\n";
  }
  text += "\n## Simulation and rendering\n\n";
  text += format(
      "Cost with %.3g frames per simulated second; latency is a step and a frame: from a sample of the device "
      "to the picture that shows it, when nothing else waits.\n\n",
      results.frame_rate_hz);
  text += pairTable(results);
  text += "\n## Worth their cost\n\nNo cheaper setting is as exact as these:\n\n" + frontText(table);
  for (const std::string& note : results.notes)
    text += "\nNote: " + note + "\n";
  return text;
}

}  // namespace soft_volume::core
