#pragma once

#include <vector>

#include "findings.h"
#include "report_plots.h"
#include "soft_volume/replay/recorded_run.h"

namespace soft_volume::replay_program {

/// The runs that a report is about.
struct ReportedRun {
  const RecordedRun* run = nullptr;
  std::string name;  ///< of its curves and pictures; empty where there is only one run
  bool second = false;
  double begin_s = 0.0;  ///< what its time 0 is in the first run's time
};

/// Displacement, forces of tissue and device, energies and step times of the runs, and the differences that were
/// found, all over the first run's simulated time. What was not recorded gives empty curves.
std::vector<Plot> reportPlots(const std::vector<ReportedRun>& runs, const Findings& findings);

}  // namespace soft_volume::replay_program
