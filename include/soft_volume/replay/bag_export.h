#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/replay/recorded_run.h"

namespace soft_volume {

/// What an export wrote, and what it could not.
struct ExportResult {
  std::size_t files = 0;
  std::size_t states = 0;
  std::vector<std::string> notes;  ///< what is missing, and why
};

/// Writes the states of a run for ParaView, into a folder that is there: tissue.pvd with one file a state in tissue/
/// (deformed grid; at its points `displacement` [m] and `fixed`, at its cells `material` and `lattice_cell`; pieces
/// of cut cells as polyhedra), and tools.pvd with one file a state in tools/ (tip and resting place of every tool then,
/// with `tool`, a number, `at_rest_place`, `force_on_tissue` and `device_force` [N]). Lengths in metres, volume frame;
/// times are simulated seconds since the start of the run. Throws core::FileError and ReplayError.
ExportResult exportVtu(const RecordedRun& run, const std::string& folder, const ReplayProgress& progress);

/// Writes tissue_force.csv, device_force.csv, device_pose.csv, tool.csv, inputs.csv, simulation.csv and rendering.csv
/// into a folder that is there: a header with units, then a message a line. A file of messages that were not recorded
/// has a header alone. Times as above, by stamp. Throws core::FileError and ReplayError.
ExportResult exportCsv(const RecordedRun& run, const std::string& folder);

}  // namespace soft_volume
