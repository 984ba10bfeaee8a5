#include <cstdio>
#include <string>

#include "findings.h"
#include "progress_bar.h"

namespace soft_volume::replay_program {

void compare(const Arguments& arguments, Findings& findings) {
  const std::string& other = arguments.resimulate ? arguments.output : arguments.against;
  if (other.empty())
    return;
  const RecordedBag first(arguments.bag);
  const RecordedBag second(other);
  core::ProgressBar bar(arguments.no_progress);
  findings.comparison = compareBags(first, second, [&bar](double done, double total) { bar.update(done, total); });
}

void judgeFindings(const Arguments& arguments, Findings& findings) {
  const bool judged = !arguments.against.empty() || !arguments.tolerance.empty();
  if (!findings.comparison || !judged)
    return;
  const Tolerance tolerance = arguments.tolerance.empty() ? Tolerance() : parseTolerance(arguments.tolerance);
  for (Judgement& judgement : judge(findings.comparison->quantities, findings.comparison->spacing_m, tolerance))
    findings.judgements.push_back(std::move(judgement));
}

namespace {

void printQuantities(const Comparison& comparison) {
  std::printf("  %-28s %-6s %12s %12s %10s %12s\n", "", "", "RMS", "largest", "at [s]", "compared");
  for (const ComparedQuantity& quantity : comparison.quantities) {
    const std::string name = quantity.key + (quantity.subject.empty() ? "" : " " + quantity.subject) +
                             (quantity.run > 0 ? " #" + std::to_string(quantity.run + 1) : "");
    std::printf("  %-28s %-6s %12.4g %12.4g %10.3f %12llu\n", name.c_str(), quantity.unit.c_str(), quantity.rms,
                quantity.largest, quantity.largest_at_s, static_cast<unsigned long long>(quantity.compared));
    if (quantity.key == "positions" && comparison.spacing_m > 0.0)
      std::printf("  %-28s %-6s %12.4g %12.4g\n", "", "h", quantity.rms / comparison.spacing_m,
                  quantity.largest / comparison.spacing_m);
    if (quantity.left_out > 0)
      std::printf("  %-28s %llu left out: %s\n", "", static_cast<unsigned long long>(quantity.left_out),
                  quantity.left_out_reason.c_str());
  }
}

}  // namespace

void printComparison(const Findings& findings) {
  if (!findings.comparison)
    return;
  const Comparison& comparison = *findings.comparison;
  std::printf("%s against %s, h = %.4g m\n", comparison.second.c_str(), comparison.first.c_str(), comparison.spacing_m);
  printQuantities(comparison);
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
