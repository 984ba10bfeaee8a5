// soft_volume_replay: runs a recorded bag again, compares it, and writes it in other forms. Needs no ROS master.

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <exception>
#include <fstream>
#include <new>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "arguments.h"
#include "findings.h"
#include "guarded_process.h"

namespace {

using namespace soft_volume::replay_program;
using soft_volume::ReplayError;
using soft_volume::ReplayReport;

void runParts(const Arguments& arguments, Findings& findings) {
  check(arguments, findings);
  resimulateRun(arguments, findings);
  compare(arguments, findings);
  judgeFindings(arguments, findings);
  render(arguments, findings);
  video(arguments, findings);
  exportRun(arguments, findings);
}

bool isDifferent(const Findings& findings) {
  return (findings.check && !findings.check->identical()) || !soft_volume::allWithin(findings.judgements);
}

std::uint64_t countDifferences(const Findings& findings) {
  const auto beyond = std::count_if(findings.judgements.begin(), findings.judgements.end(),
                                    [](const soft_volume::Judgement& j) { return !j.within; });
  return (findings.check ? findings.check->differences : 0) + static_cast<std::uint64_t>(beyond);
}

bool isCompared(const Arguments& arguments) {
  return arguments.check || !arguments.against.empty() || !arguments.tolerance.empty();
}

nlohmann::json drawnJson(const Findings& findings) {
  nlohmann::json frames = nlohmann::json::array();
  for (const DrawnFrame& frame : findings.drawn) {
    frames.push_back({{"file", frame.file}, {"camera", frame.camera}, {"step", frame.step}, {"time_s", frame.time_s}});
    if (frame.difference)
      frames.back().update({{"rmse", frame.difference->rmse},
                            {"ssim", frame.difference->ssim},
                            {"largest", frame.difference->largest},
                            {"pixels", frame.difference->pixels}});
  }
  return frames;
}

/// The counts of the check as they have always been, with what else was found beside them.
nlohmann::json toJson(const Findings& findings) {
  nlohmann::json json =
      nlohmann::json::parse(soft_volume::toJson(findings.check.value_or(ReplayReport()), findings.error));
  if (findings.comparison) {
    json["comparison"] = nlohmann::json::parse(soft_volume::toJson(*findings.comparison));
    json["identical"] = json["identical"].get<bool>() && findings.comparison->identical();
  }
  nlohmann::json judgements = nlohmann::json::array();
  for (const soft_volume::Judgement& judgement : findings.judgements) {
    judgements.push_back({{"key", judgement.key},
                          {"subject", judgement.subject},
                          {"measured", judgement.measured},
                          {"limit", judgement.limit},
                          {"within", judgement.within},
                          {"text", judgement.text}});
  }
  json["judgements"] = judgements;
  json["rendered"] = drawnJson(findings);
  json["within"] = findings.error.empty() && !isDifferent(findings);
  return json;
}

void writeJson(const Arguments& arguments, const Findings& findings) {
  if (arguments.json.empty())
    return;
  std::ofstream file(arguments.json);
  file << toJson(findings).dump(2, ' ', false, nlohmann::json::error_handler_t::replace) << "\n";
  file.close();
  if (!file)
    throw ReplayError(arguments.json + ": the JSON cannot be written");
}

/// The last line of the output, and the exit code.
int conclude(const Arguments& arguments, const Findings& findings) {
  std::fflush(stdout);
  if (!findings.error.empty())
    std::fprintf(stderr, "soft_volume_replay: %s\n", findings.error.c_str());
  if (isDifferent(findings)) {
    std::printf("DIFFERENT: %llu differences\n", static_cast<unsigned long long>(countDifferences(findings)));
    return kDifferent;
  }
  if (!findings.error.empty())
    return kImpossible;
  const char* verdict = !isCompared(arguments) ? "done" : arguments.tolerance.empty() ? "identical" : "within";
  std::printf("%s (%.1f s)\n", verdict, findings.wall_s);
  return kWithin;
}

int finish(const Arguments& arguments, const Findings& findings) {
  writeJson(arguments, findings);
  printCheck(arguments, findings);
  printComparison(findings);
  printJudgements(findings);
  for (const std::string& note : findings.notes)
    std::printf("note: %s\n", note.c_str());
  return conclude(arguments, findings);
}

/// Also of what could not be done.
void writeReport(const Arguments& arguments, Findings& findings) {
  try {
    report(arguments, findings);
  } catch (const std::exception& failure) {
    findings.error += (findings.error.empty() ? "" : "; ") + std::string(failure.what());
  }
}

int work(const Arguments& arguments) {
  const auto begin = std::chrono::steady_clock::now();
  Findings findings;
  try {
    runParts(arguments, findings);
  } catch (const std::bad_alloc&) {
    findings.error = arguments.bag + ": the bag is damaged, or the memory does not suffice for it";
  } catch (const std::exception& failure) {
    findings.error = failure.what();
  }
  findings.wall_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  writeReport(arguments, findings);
  return finish(arguments, findings);
}

int workGuarded(const Arguments& arguments) {
  std::vector<std::string> bags = {arguments.bag};
  if (!arguments.against.empty())
    bags.push_back(arguments.against);
  const std::string damaged = bags.size() == 1 ? ": the bag is damaged" : " or " + bags.back() + ": a bag is damaged";
  return runGuarded(
      bags, [&arguments] { return work(arguments); },
      [&arguments, &damaged](int signal) {
        Findings findings;
        findings.error = arguments.bag + damaged + " (its reader died with signal " + std::to_string(signal) + ")";
        return finish(arguments, findings);
      });
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  try {
    if (const auto code = parseArguments(argc, argv, arguments))
      return *code;
    return workGuarded(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_replay: %s\n", error.what());
    return kImpossible;
  }
}
