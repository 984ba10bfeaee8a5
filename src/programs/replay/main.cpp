// soft_volume_replay: runs a recorded bag again, compares it, and writes it in other forms. Needs no ROS master.

#include <cstdio>
#include <exception>
#include <fstream>
#include <new>
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
  exportRun(arguments, findings);
}

void writeJson(const Arguments& arguments, const Findings& findings) {
  if (arguments.json.empty())
    return;
  std::ofstream file(arguments.json);
  file << soft_volume::toJson(findings.check.value_or(ReplayReport()), findings.error);
  file.close();
  if (!file)
    throw ReplayError(arguments.json + ": the JSON cannot be written");
}

/// The last line of the output, and the exit code.
int conclude(const Arguments& arguments, const Findings& findings) {
  std::fflush(stdout);
  if (!findings.error.empty())
    std::fprintf(stderr, "soft_volume_replay: %s\n", findings.error.c_str());
  if (findings.check && !findings.check->identical()) {
    std::printf("DIFFERENT: %llu differences\n", static_cast<unsigned long long>(findings.check->differences));
    return kDifferent;
  }
  if (!findings.error.empty())
    return kImpossible;
  const double wall_s = findings.check ? findings.check->wall_s : 0.0;
  std::printf(arguments.check ? "identical (%.1f s)\n" : "done (%.1f s)\n", wall_s);
  return kWithin;
}

int finish(const Arguments& arguments, const Findings& findings) {
  writeJson(arguments, findings);
  printCheck(arguments, findings);
  for (const std::string& note : findings.notes)
    std::printf("note: %s\n", note.c_str());
  return conclude(arguments, findings);
}

int work(const Arguments& arguments) {
  Findings findings;
  try {
    runParts(arguments, findings);
  } catch (const std::bad_alloc&) {
    findings.error = arguments.bag + ": the bag is damaged, or the memory does not suffice for it";
  } catch (const std::exception& failure) {
    findings.error = failure.what();
  }
  return finish(arguments, findings);
}

int workGuarded(const Arguments& arguments) {
  std::vector<std::string> bags = {arguments.bag};
  if (!arguments.against.empty())
    bags.push_back(arguments.against);
  return runGuarded(
      bags, [&arguments] { return work(arguments); },
      [&arguments](int signal) {
        Findings findings;
        findings.error =
            arguments.bag + ": the bag is damaged (its reader died with signal " + std::to_string(signal) + ")";
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
