#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/replay/recorded_run.h"
#include "soft_volume/replay/replay_bag.h"
#include "soft_volume/scene/scene_override.h"

namespace soft_volume {

struct ResimulationOptions {
  std::vector<core::SceneOverride> changes;  ///< of the scene; none: as it was recorded
  std::string device_file;                   ///< of the device that was recorded; empty: the scene's own
  std::string output;                        ///< bag that is written; an old one is replaced
  double seconds = 0.0;                      ///< of simulated time, from the first sample on; 0: all
  int threads = 1;
};

/// What a resimulation did.
struct Resimulation {
  std::uint64_t steps = 0;
  std::uint64_t samples = 0;  ///< of the device
  std::uint64_t inputs_applied = 0;
  std::uint64_t inputs_refused = 0;
  std::uint64_t inputs_given_again = 0;  ///< from the journal, because no device explains them
  double simulated_s = 0.0;
  double time_step_s = 0.0;
  std::uint64_t cells = 0;
  double step_ms_median = 0.0;  ///< wall time
  double step_ms_max = 0.0;
  double stepping_s = 0.0;         ///< of all steps
  double processor_s = 0.0;        ///< processor time of the thread that steps, in all steps
  std::vector<std::string> notes;  ///< what the recording lacks, what could not be kept
};

/// Runs the longest session of a bag again from the motion of its device: recorded poses, velocities and buttons go
/// through tool and simulation in lockstep (session/lockstep.h), with other settings where given, and everything that
/// the graph would have published is written into a bag of its own, which replays and compares like any other. Device
/// messages are copied. The device moves as it did: what it would feel otherwise does not change the hand.
///
/// Inputs of the journal that no recorded device explains (another program's forces, grips, cuts, a change of the
/// integrator) are given again at their simulated times.
///
/// The same bits come out in every run, with any number of threads, and from a live graph in lockstep that the device's
/// topics are played into. Throws ReplayError, and SceneError for settings that cannot be used.
Resimulation resimulate(const RecordedBag& bag, const ResimulationOptions& options, const ReplayProgress& progress);

}  // namespace soft_volume
