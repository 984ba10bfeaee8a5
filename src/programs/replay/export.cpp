#include "soft_volume/replay/bag_export.h"

#include <cstdio>

#include "findings.h"
#include "folders.h"
#include "progress_bar.h"

namespace soft_volume::replay_program {
namespace {

void tell(const char* what, const std::string& folder, const ExportResult& result, Findings& findings) {
  std::printf("  %s: %zu files of %zu states\n", folder.c_str(), result.files, result.states);
  for (const std::string& note : result.notes)
    findings.notes.push_back(std::string(what) + ": " + note);
}

}  // namespace

void exportRun(const Arguments& arguments, Findings& findings) {
  if (arguments.csv_dir.empty() && arguments.vtu_dir.empty())
    return;
  const RecordedBag bag(arguments.bag);
  const RecordedRun& run = bag.longest();
  if (bag.size() > 1)
    findings.notes.push_back("the bag holds " + std::to_string(bag.size()) +
                             " sessions; the longest was exported: " + std::to_string(run.session()));
  if (!arguments.csv_dir.empty()) {
    makeFolder(arguments.csv_dir);
    tell("--export-csv", arguments.csv_dir, exportCsv(run, arguments.csv_dir), findings);
  }
  if (!arguments.vtu_dir.empty()) {
    makeFolder(arguments.vtu_dir);
    core::ProgressBar bar(arguments.no_progress);
    const auto progress = [&bar](double done, double total) { bar.update(done, total); };
    tell("--export-vtu", arguments.vtu_dir, exportVtu(run, arguments.vtu_dir, progress), findings);
  }
  findings.notes.insert(findings.notes.end(), bag.notes().begin(), bag.notes().end());
}

}  // namespace soft_volume::replay_program
