#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "arguments.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/comparison.h"
#include "soft_volume/replay/replay_bag.h"
#include "soft_volume/replay/resimulation.h"
#include "soft_volume/replay/tolerance.h"

namespace soft_volume::replay_program {

/// A picture that --render made.
struct DrawnFrame {
  std::string file;
  std::string camera;
  double time_s = 0.0;
  std::uint64_t step = 0;
  std::optional<core::ImageDifference> difference;  ///< from the recorded frame, where there is one of this size
};

/// A recorded frame beside another one of the same moment, as a report shows them.
struct FrameTriplet {
  std::string caption;
  std::string first_name;
  std::string second_name;
  core::Image first;
  core::Image second;  ///< empty where there is none
  std::optional<core::ImageDifference> difference;
};

/// What the parts of the program did and found, for its output, its report and its exit code.
struct Findings {
  std::optional<ReplayReport> check;  ///< as far as it came
  std::optional<Resimulation> resimulation;
  std::optional<Comparison> comparison;  ///< of --against, or of what --resimulate wrote with what was recorded
  std::vector<Judgement> judgements;     ///< of the check and the comparison
  std::vector<DrawnFrame> drawn;
  std::vector<FrameTriplet> replayed_frames;  ///< of the check, for the report
  std::vector<std::string> notes;             ///< of the other parts, for the output
  std::string error;                          ///< why something could not be done; empty when all was
  double wall_s = 0.0;
};

// The parts of the program in the order in which they run, in the guarded process. Each does nothing when its option
// was not given, adds to the findings, and throws ReplayError or another exception of common/error.h.

/// --check and --frames.
void check(const Arguments& arguments, Findings& findings);

/// --resimulate, without the comparison.
void resimulateRun(const Arguments& arguments, Findings& findings);

/// --against.
void compare(const Arguments& arguments, Findings& findings);
/// Holds what was found against --tolerance; without one, what --against finds has to be identical.
void judgeFindings(const Arguments& arguments, Findings& findings);

/// --render.
void render(const Arguments& arguments, Findings& findings);

/// --video, of what render() drew where it did.
void video(const Arguments& arguments, Findings& findings);

/// --export-csv and --export-vtu.
void exportRun(const Arguments& arguments, Findings& findings);

/// --report, of all that was found.
void report(const Arguments& arguments, const Findings& findings);

// What was found, on stdout.
void printCheck(const Arguments& arguments, const Findings& findings);
void printComparison(const Findings& findings);
void printJudgements(const Findings& findings);

}  // namespace soft_volume::replay_program
