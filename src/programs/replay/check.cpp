#include <algorithm>
#include <cstdio>
#include <new>

#include "findings.h"
#include "folders.h"
#include "progress_bar.h"
#include "report_frames.h"

namespace soft_volume::replay_program {
namespace {

void printRow(const char* name, std::uint64_t count, const char* remark = "") {
  std::printf("  %-28s %10llu  %s\n", name, static_cast<unsigned long long>(count), remark);
}

void printDifference(const char* title, const ReplayDifference& difference) {
  std::printf("%s: step %llu, %s: %s\n", title, static_cast<unsigned long long>(difference.step),
              difference.kind.c_str(), difference.text.c_str());
}

void printSummary(const ReplayReport& report, bool check) {
  printRow("sessions", report.sessions);
  if (report.sessions_skipped > 0)
    printRow("sessions skipped", report.sessions_skipped);
  printRow("steps", report.steps);
  printRow("inputs applied again", report.inputs);
  printRow("  of these refused", report.inputs_refused, "as in the run");
  if (check) {
    printRow("journal hashes", report.journals);
    printRow("states", report.states, report.measured.empty() ? "bit for bit" : "measured");
    printRow("topologies", report.topologies);
    printRow("checkpoints", report.checkpoints);
  }
  const char* frames = !check                      ? "rendered"
                       : !report.measured.empty()  ? "measured"
                       : report.frames_by_psnr > 0 ? "by PSNR"
                                                   : "byte for byte";
  printRow("frames", report.frames, frames);
  if (report.frames_without_image > 0)
    printRow("frames by hash alone", report.frames_without_image, "no image recorded");
  if (report.images_without_stats > 0)
    printRow("images not checked", report.images_without_stats, "no render/stats");
  if (report.inputs_not_recorded > 0) {
    printRow("inputs not recorded", report.inputs_not_recorded, "journaled before or after their topic was recorded");
  }
  if (report.inputs_not_journaled > 0) {
    printRow("inputs not journaled", report.inputs_not_journaled, "recorded, but the simulation never had them");
  }
  if (report.not_checked > 0)
    printRow("not checked", report.not_checked, "outside the journal");
  for (const std::string& note : report.notes)
    std::printf("note: %s\n", note.c_str());
  if (!report.first_differences.empty())
    printDifference("first difference", report.first_differences.front());
  for (std::size_t n = 1; n < std::min<std::size_t>(4, report.first_differences.size()); ++n) {
    printDifference("           then", report.first_differences[n]);
  }
}

}  // namespace

void check(const Arguments& arguments, Findings& findings) {
  if (!arguments.check && arguments.frames_dir.empty())
    return;
  if (!arguments.frames_dir.empty())
    makeFolder(arguments.frames_dir);
  ReplayOptions options;
  options.check = arguments.check;
  options.measure = arguments.check && !arguments.tolerance.empty();
  options.frames_dir = arguments.frames_dir;
  options.threads = arguments.threads;
  std::optional<ReplayedFrames> frames;
  if (arguments.check && !arguments.report.empty()) {
    frames.emplace(RecordedBag(arguments.bag));
    options.on_frame = [&frames](const ReplayedFrame& frame) { frames->add(frame); };
  }
  core::ProgressBar bar(arguments.no_progress);
  findings.check.emplace();
  replayBag(
      arguments.bag, options, [&bar](double done, double total) { bar.update(done, total); }, *findings.check);
  if (frames)
    findings.replayed_frames = frames->take();
}

void printCheck(const Arguments& arguments, const Findings& findings) {
  if (findings.check && (findings.error.empty() || findings.check->steps > 0 || !findings.check->identical()))
    printSummary(*findings.check, arguments.check);
}

}  // namespace soft_volume::replay_program
