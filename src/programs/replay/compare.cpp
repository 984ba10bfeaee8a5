#include <cstdio>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

#include "findings.h"
#include "progress_bar.h"

namespace soft_volume::replay_program {
namespace {

/// A frame of the CT head takes a third of a second.
constexpr std::size_t kMostDrawnFrames = 24;

void append(std::vector<Judgement> from, std::vector<Judgement>& to) {
  std::move(from.begin(), from.end(), std::back_inserter(to));
}

}  // namespace

void compare(const Arguments& arguments, Findings& findings) {
  const std::string& other = arguments.resimulate ? arguments.output : arguments.against;
  if (other.empty())
    return;
  const RecordedBag first(arguments.bag);
  const RecordedBag second(other);
  core::ProgressBar bar(arguments.no_progress);
  ComparisonOptions options;
  options.most_drawn_frames = kMostDrawnFrames;
  options.threads = arguments.threads;
  findings.comparison = compareBags(
      first, second, [&bar](double done, double total) { bar.update(done, total); }, options);
}

void judgeFindings(const Arguments& arguments, Findings& findings) {
  const Tolerance tolerance = arguments.tolerance.empty() ? Tolerance() : parseTolerance(arguments.tolerance);
  if (findings.check && arguments.check && !tolerance.empty()) {
    const Tolerance measurable = measurableInReplay(tolerance);
    for (const auto& limit : tolerance.limits) {
      if (measurable.limits.count(limit.first) == 0 && !findings.comparison)
        findings.notes.push_back("the limit of " + limit.first + " was not judged: --check does not measure it");
    }
    // No limits at all would mean: bit for bit.
    if (!measurable.empty())
      append(judge(findings.check->measured, findings.check->spacing_m, measurable), findings.judgements);
  }
  if (findings.comparison && (!arguments.against.empty() || !tolerance.empty()))
    append(judge(findings.comparison->quantities, findings.comparison->spacing_m, tolerance), findings.judgements);
}

namespace {

void printQuantities(const std::vector<ComparedQuantity>& quantities, double spacing_m) {
  std::printf("  %-28s %-6s %12s %12s %10s %12s\n", "", "", "RMS", "largest", "at [s]", "compared");
  for (const ComparedQuantity& quantity : quantities) {
    const std::string name = quantity.key + (quantity.subject.empty() ? "" : " " + quantity.subject) +
                             (quantity.run > 0 ? " #" + std::to_string(quantity.run + 1) : "");
    std::printf("  %-28s %-6s %12.4g %12.4g %10.3f %12llu\n", name.c_str(), quantity.unit.c_str(), quantity.rms,
                quantity.largest, quantity.largest_at_s, static_cast<unsigned long long>(quantity.compared));
    if (quantity.key == "positions" && spacing_m > 0.0)
      std::printf("  %-28s %-6s %12.4g %12.4g\n", "", "h", quantity.rms / spacing_m, quantity.largest / spacing_m);
    if (quantity.left_out > 0)
      std::printf("  %-28s %llu left out: %s\n", "", static_cast<unsigned long long>(quantity.left_out),
                  quantity.left_out_reason.c_str());
  }
}

}  // namespace

void printComparison(const Findings& findings) {
  if (findings.check && !findings.check->measured.empty()) {
    std::printf("replayed against recorded, h = %.4g m\n", findings.check->spacing_m);
    printQuantities(findings.check->measured, findings.check->spacing_m);
  }
  if (!findings.comparison)
    return;
  const Comparison& comparison = *findings.comparison;
  std::printf("%s against %s, h = %.4g m\n", comparison.second.c_str(), comparison.first.c_str(), comparison.spacing_m);
  printQuantities(comparison.quantities, comparison.spacing_m);
  for (const std::string& change : comparison.scene_changes)
    std::printf("scene: %s\n", change.c_str());
  for (const std::string& note : comparison.notes)
    std::printf("note: %s\n", note.c_str());
}

void printJudgements(const Findings& findings) {
  for (const Judgement& judgement : findings.judgements)
    std::printf("%s: %s\n", judgement.within ? "within" : "BEYOND", judgement.text.c_str());
}

}  // namespace soft_volume::replay_program
