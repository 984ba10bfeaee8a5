#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/replay/recorded_run.h"

namespace soft_volume {

/// Two runs at one simulated time.
struct ComparedSample {
  double time_s = 0.0;
  double first = 0.0;    ///< what it is in the first run: largest displacement, size of a force, an energy
  double second = 0.0;   ///< in the second
  double rms = 0.0;      ///< of the differences at this time: over vertices, over the pixels of an image
  double largest = 0.0;  ///< of the differences at this time
};

/// One quantity of two runs over simulated time.
struct ComparedQuantity {
  /// positions [m], force, device_force [N], image_rmse [8-bit levels], ssim [1], energy [J], step_time [ms],
  /// active_cells, cut_area [m^2], parts, revision [1].
  std::string key;
  std::string subject;  ///< tool, device topic or camera; empty for the whole run
  std::string title;    ///< in words
  std::string unit;
  std::size_t run = 0;   ///< which session of the bags, from 0
  double rms = 0.0;      ///< over all samples and what they are taken over
  double largest = 0.0;  ///< of all differences; of ssim: the lowest
  double largest_at_s = 0.0;
  double scale = 0.0;           ///< largest value of `first`; what a relative difference refers to
  std::uint64_t compared = 0;   ///< vertices, samples or frames, summed over time
  std::uint64_t left_out = 0;   ///< that only one of the runs has
  std::string left_out_reason;  ///< empty when nothing was
  bool identical = false;       ///< bit for bit, with nothing left out
  bool reproducible = true;     ///< false: wall time, which no two runs share; told, never compared bit for bit
  std::vector<ComparedSample> samples;
};

struct Comparison {
  std::string first;  ///< paths of the bags
  std::string second;
  /// Edge of the coarser grid's cells, which fractions of h refer to; the shortest where they differ by axis. Metres.
  double spacing_m = 0.0;
  std::vector<ComparedQuantity> quantities;
  std::vector<std::string> scene_changes;  ///< keys of the scene that differ, with both values
  std::vector<std::string> notes;          ///< what was left out, and why

  /// Everything that can be the same in two runs is the same, bit for bit.
  bool identical() const;
};

struct ComparisonOptions {
  bool images = true;
  int threads = 1;
};

/// Compares two recordings of the same interaction, session by session, at equal simulated times.
///
/// - positions: of equal material points. Grids with the same vertices are compared vertex by vertex (after different
///   cuts: those vertices whose places at rest are the same, bit for bit, and whose cells are the same). Where spacings
///   differ, the second grid is interpolated at the first one's places at rest (trilinear in the lattice cell of the
///   uncut grid); points in or at cells that one of the grids has cut, and outside of either, are left out and counted.
/// - force: of each tool on the tissue as the simulation applied it; device_force: as it was sent to the device.
/// - images: pairs of frames of one camera at one simulated time, of the same size.
/// - topology, energies, step times and active cells as the simulation told them.
///
/// Throws ReplayError when the bags have nothing to compare: other volumes, no common time.
Comparison compareBags(const RecordedBag& first, const RecordedBag& second, const ComparisonOptions& options,
                       const ReplayProgress& progress);

/// As JSON text: every quantity with its figures (without samples), notes and scene changes.
std::string toJson(const Comparison& comparison);

}  // namespace soft_volume
