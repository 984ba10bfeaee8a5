#include "soft_volume/replay/resimulation.h"

#include <cstdio>

#include "findings.h"
#include "progress_bar.h"

namespace soft_volume::replay_program {
namespace {

void print(const Resimulation& run) {
  std::printf("  %-28s %10llu  of %g ms\n", "steps computed", static_cast<unsigned long long>(run.steps),
              1e3 * run.time_step_s);
  std::printf("  %-28s %10.3f  s\n", "simulated time", run.simulated_s);
  std::printf("  %-28s %10llu\n", "samples of the device", static_cast<unsigned long long>(run.samples));
  std::printf("  %-28s %10llu  %llu refused\n", "inputs", static_cast<unsigned long long>(run.inputs_applied),
              static_cast<unsigned long long>(run.inputs_refused));
  if (run.inputs_given_again > 0) {
    std::printf("  %-28s %10llu\n", "  of these from the journal",
                static_cast<unsigned long long>(run.inputs_given_again));
  }
  std::printf("  %-28s %10llu\n", "cells", static_cast<unsigned long long>(run.cells));
  std::printf("  %-28s %10.4g  ms median, %.4g ms at most\n", "a step's time", run.step_ms_median, run.step_ms_max);
  const double factor = run.stepping_s > 0.0 ? run.simulated_s / run.stepping_s : 0.0;
  std::printf("  %-28s %10.3g  simulated seconds per second\n", "speed", factor);
}

ResimulationOptions optionsOf(const Arguments& arguments) {
  if (arguments.output.empty())
    throw ReplayError("--resimulate: say with --output OTHER.bag where the new run goes");
  ResimulationOptions options;
  if (!arguments.resimulate->empty())
    options.changes = core::parseOverrides(*arguments.resimulate);
  options.device_file = arguments.device;
  options.output = arguments.output;
  options.threads = arguments.threads;
  return options;
}

}  // namespace

void resimulateRun(const Arguments& arguments, Findings& findings) {
  if (!arguments.resimulate)
    return;
  const ResimulationOptions options = optionsOf(arguments);
  const RecordedBag bag(arguments.bag);
  {
    core::ProgressBar bar(arguments.no_progress);
    findings.resimulation = resimulate(bag, options, [&bar](double done, double total) { bar.update(done, total); });
  }
  print(*findings.resimulation);
  for (const std::string& text : findings.resimulation->notes)
    findings.notes.push_back(text);
}

}  // namespace soft_volume::replay_program
