#pragma once

#include <functional>
#include <string>
#include <vector>

#include "tradeoff_table.h"

namespace soft_volume::core {

/// What of a recorded interaction is computed and drawn again, with which settings.
struct InteractionOptions {
  std::string bag;
  std::string work_dir;     ///< for the bags of the runs, which are deleted
  bool quick = false;       ///< few settings
  double seconds = 0.0;     ///< of the interaction, from its start; 0: all
  std::string device_file;  ///< of the recorded device; empty: the scene's own
  int threads = 1;
};

/// A way to simulate, and what it did to the interaction.
struct InteractionRun {
  std::string name;
  std::string changes;  ///< of the recorded scene, KEY=VALUE,...
  std::string preset;
  bool is_reference = false;
  std::string failure;  ///< why it cannot be done, else empty
  double spacing_m = 0.0;
  double dt_s = 0.0;
  double ms_per_simulated_s = 0.0;  ///< of all steps: processor time of one thread, or wall time of more
  double step_ms = 0.0;             ///< median
  double position_error = 0.0;      ///< RMS over what moved, as a part of the largest displacement
  double force_error = 0.0;         ///< RMS of the tool that is farthest off, as a part of its largest force
  double device_force_error = 0.0;  ///< the same at the device
};

/// A way to draw.
struct InteractionDrawing {
  std::string backend;
  int slices = 0;
  bool is_reference = false;
  double frame_ms = 0.0;  ///< median
};

/// Both together: a picture as the user would have seen it, against the reference's.
struct InteractionPair {
  std::size_t run = 0;
  std::size_t drawing = 0;
  double image_error = 0.0;  ///< RMSE as a part of the 255 levels
  double ssim = 1.0;
  double ms_per_simulated_s = 0.0;  ///< steps and frames at the scene's rate
  double latency_ms = 0.0;          ///< a step and a frame: from a sample to the picture that shows it, at best
};

struct InteractionResults {
  std::string scene;
  double simulated_s = 0.0;
  double frame_rate_hz = 0.0;
  std::vector<InteractionRun> runs;          ///< the reference first
  std::vector<InteractionDrawing> drawings;  ///< the reference first
  std::vector<InteractionPair> pairs;
  std::vector<double> frame_times_s;
  std::vector<std::string> notes;
};

/// Runs the interaction with every setting of the simulation (replay/resimulation.h), draws some moments of every run
/// with every setting of the renderer, and compares with the most exact of both. Throws ReplayError and FileError.
InteractionResults sweepInteraction(const InteractionOptions& options,
                                    const std::function<void(double done, double total)>& progress);

/// Rows for positions, forces and images as three scenes, with fronts marked and presets named; the memory column is
/// the latency.
TradeoffTable interactionTable(const InteractionResults& results);
TradeoffPlot interactionPlot(const InteractionResults& results, const std::string& png_path);
/// In Markdown.
std::string interactionReport(const InteractionResults& results, const TradeoffTable& table);

}  // namespace soft_volume::core
