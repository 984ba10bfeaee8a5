#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/replay/compared_quantity.h"
#include "soft_volume/replay/recorded_run.h"

namespace soft_volume {

/// How far two recordings are apart.
struct Comparison {
  std::string first;  ///< paths of the bags
  std::string second;
  /// Edge of the coarser grid's cells, which fractions of h refer to; the shortest where they differ by axis. Metres.
  double spacing_m = 0.0;
  std::vector<ComparedQuantity> quantities;
  std::vector<std::string> scene_changes;  ///< "key: first -> second" of the scenes
  std::vector<std::string> notes;          ///< what could not be compared, and why

  /// Everything that can be the same in two runs is there in both, and the same, bit for bit.
  bool identical() const;
};

struct ComparisonOptions {
  /// Where one bag holds no images, so many frames of the other one are drawn from its states; 0: none.
  std::size_t most_drawn_frames = 0;
  int threads = 1;  ///< of the renderer
};

/// Compares two recordings of the same interaction, session by session, at equal times: by the stamps of the graph
/// where these overlap (a resimulation, a replay of the same device messages), else by simulated time since the start.
///
/// - duration: simulated time at the begin and the end that only one of the bags holds; more than kSameDuration_s is
/// not
///   the same run.
/// - positions: of equal material points, in the first run's states; where the second was recorded at other times,
///   between its states before and after (linear). RMS counts the points that moved by more than 1 % of h in either
///   run, so that tissue at rest does not make it small. Which points grids share: vertices of one lattice that no cut
///   of only one of the runs touches; for other spacings the coarser grid's vertices, looked up in the finer grid's
///   cells. What is left out is counted.
/// - force: of each tool on the tissue as far as the simulation applied it, a function of the pose's time that holds
///   until the next message or until it expires; device_force: as it was sent to the device.
/// - image_rmse and ssim: frames of one camera and one simulated time (within 1 ms), of the same size. Of a bag without
///   images, as a resimulation writes it, they can be drawn as the other bag's were, from states within 5 ms.
/// - cut_area, parts and revision from the topologies; energy, active_cells and step_time from simulation/stats.
///
/// Deterministic. Throws ReplayError when the bags have nothing to compare: other volumes, no common time.
Comparison compareBags(const RecordedBag& first, const RecordedBag& second, const ReplayProgress& progress,
                       const ComparisonOptions& options = {});

/// As JSON text: every quantity with its figures (without samples), scene changes and notes.
std::string toJson(const Comparison& comparison);

}  // namespace soft_volume
