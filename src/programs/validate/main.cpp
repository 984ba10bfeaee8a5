// soft_volume_validate: the simulation against known answers. Needs no ROS.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <limits>
#include <string>

#include "plot.h"
#include "progress_bar.h"
#include "report.h"
#include "soft_volume/common/error.h"

namespace {

using soft_volume::core::Error;
using soft_volume::core::FileError;
using soft_volume::core::ProgressBar;
using namespace soft_volume::core::validate;

constexpr int kAllPass = 0;
constexpr int kSomeFail = 1;
constexpr int kImpossible = 2;

const std::array<Suite, 9> kSuites{{
    {"patch", "affine deformations: E, nu and G exact for any spacing and nu; rigid motion costs no force", patchCases},
    {"cantilever", "8:1 beams, 1 to 8 cells across: Timoshenko's deflection, and the elastica for large ones",
     cantileverCases},
    {"half_space", "a square patch pressed into a half-space: Boussinesq's displacement", halfSpaceCases},
    {"indentation", "a tool of 3x3 vertices: active sets against the whole lattice", indentationCases},
    {"truth_cube", "245 beads in compressed silicone as measured (needs data; see below)", truthCubeCases},
    {"free_vibration", "period and energy of each integrator against the exact motion of the lattice",
     freeVibrationCases},
    {"extremes", "huge forces, steps, masses and deformations; beside each number the dissertation's rule's",
     extremesCases},
    {"cutting",
     "random incisions, lips, halves of a bar, steps and cost; beside embedded pieces completely connected ones",
     cuttingCases},
    {"haptics", "virtual devices, hands, dampings, delays, jitters, rates and tissues in closed loops; then sabotage",
     hapticsCases},
}};

struct Arguments {
  std::string suite = "all";
  std::string part;
  std::string json;
  bool list = false;
  bool no_progress = false;
  Options options;
};

constexpr char kExamples[] =
    "Examples:\n"
    "  soft_volume_validate\n"
    "      Everything, in some minutes.\n"
    "  soft_volume_validate --suite all --quick --json quick.json\n"
    "      Short forms of the same cases, under a minute: what the tests run.\n"
    "  soft_volume_validate --suite cantilever --plots plots\n"
    "      One suite, and its deformed shapes and errors as plots/cantilever_*.png.\n"
    "\n"
    "How to read the table: a row compares a value with its reference (a formula, a measurement, or the converged\n"
    "lattice); it passes when the error is at most the bound. Errors are relative where the reference is not 0. Rows\n"
    "with '-' for the bound are for comparison. '1997:' is what the dissertation's rule reaches in the same case "
    "('-':\n"
    "it has no such case, or the step is refused). NOT REACHED: a goal that is known to be missed, no failure. Times\n"
    "are measured on this machine, and left out of short forms.\n"
    "\n"
    "truth_cube reads truth_cube/uniaxial_positions.csv in the folder that the environment variable SOFT_VOLUME_DATA\n"
    "names, by default ../shared/data beside the sources or the current folder. Without it the suite is skipped.\n"
    "\n"
    "Exit code: 0 every row passes, 1 some row fails, 2 it cannot be done (bad arguments, a file that cannot be\n"
    "written, gnuplot missing for --plots).\n";

void listSuites(const Options& options) {
  for (const Suite& suite : kSuites) {
    std::printf("%s: %s\n", suite.name.c_str(), suite.about.c_str());
    std::string before;
    for (const Case& part : suite.cases(options)) {
      if (part.name != before)
        std::printf("    %s\n", part.name.c_str());
      before = part.name;
    }
  }
}

std::vector<Suite> chosenSuites(const std::string& name) {
  std::vector<Suite> chosen;
  std::string known = "all";
  for (const Suite& suite : kSuites) {
    known += ", " + suite.name;
    if (name == "all" || name == suite.name)
      chosen.push_back(suite);
  }
  if (chosen.empty())
    throw Error("there is no suite '" + name + "'; use one of " + known);
  return chosen;
}

/// Minutes of work should not end with a file that cannot be written.
void checkOutputs(const Arguments& arguments) {
  if (!arguments.json.empty() && !std::ofstream(arguments.json, std::ios::app))
    throw FileError(arguments.json + ": the JSON cannot be written");
  const auto& plots = arguments.options.plots;
  if (plots.empty())
    return;
  std::error_code error;
  std::filesystem::create_directories(plots, error);
  if (error)
    throw FileError(plots.string() + ": the folder cannot be made: " + error.message());
  soft_volume::core::plotWithGnuplot("");
}

/// A case that throws is a failure of the simulation, not of the program: the others go on.
void runCase(const Case& part, Report& report) {
  try {
    part.run(report);
  } catch (const std::exception& error) {
    const double nothing = std::numeric_limits<double>::quiet_NaN();
    report.row(part.name + " threw: " + error.what(), nothing, nothing, nothing);
  }
}

std::vector<Case> chosenCases(const Suite& suite, const Arguments& arguments) {
  std::vector<Case> cases = suite.cases(arguments.options);
  const auto other = [&](const Case& part) { return part.name.find(arguments.part) == std::string::npos; };
  cases.erase(std::remove_if(cases.begin(), cases.end(), other), cases.end());
  return cases;
}

void runSuites(const std::vector<Suite>& suites, const Arguments& arguments, Report& report) {
  std::vector<std::vector<Case>> cases;
  double total_s = 0.0;
  for (const Suite& suite : suites) {
    cases.push_back(chosenCases(suite, arguments));
    for (const Case& part : cases.back())
      total_s += part.seconds;
  }
  if (total_s == 0.0)
    throw Error("no case has '" + arguments.part + "' in its name; --list names them");
  ProgressBar bar(arguments.no_progress);
  double done_s = 0.0;
  for (std::size_t s = 0; s < suites.size(); ++s) {
    report.beginSuite(suites[s].name);
    for (const Case& part : cases[s]) {
      bar.update(done_s, total_s);
      runCase(part, report);
      done_s += part.seconds;
    }
  }
}

int validate(const Arguments& arguments) {
  if (arguments.list) {
    listSuites(arguments.options);
    return kAllPass;
  }
  const std::vector<Suite> suites = chosenSuites(arguments.suite);
  checkOutputs(arguments);
  Report report;
  runSuites(suites, arguments, report);
  report.printSummary();
  if (!arguments.json.empty())
    report.writeJson(arguments.json);
  return report.failures() == 0 ? kAllPass : kSomeFail;
}

}  // namespace

int main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Compares the simulation with known answers: formulas, measurements, and itself where it must agree.");
  app.add_option("--suite", arguments.suite, "which suite to run (default all); --list names them");
  app.add_option("--case", arguments.part, "run only the cases with this in their name");
  app.add_flag("--list", arguments.list, "list the suites, what they check, and their cases");
  app.add_flag("--quick", arguments.options.quick, "short forms of the cases");
  app.add_flag("--full", arguments.options.full, "every combination in the suite haptics, for hours")
      ->excludes("--quick");
  app.add_option("--json", arguments.json, "write all rows into this file");
  app.add_option("--plots", arguments.options.plots, "write plots (PNG, needs gnuplot) into this folder");
  app.add_option("--threads", arguments.options.threads,
                 "threads of the simulation (default 1); results do not depend on it")
      ->check(CLI::Range(1, 256));
  app.add_flag("--no-progress", arguments.no_progress, "print no progress");
  app.footer(kExamples);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kAllPass : kImpossible;
  }
  try {
    return validate(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_validate: %s\n", error.what());
    return kImpossible;
  }
}
