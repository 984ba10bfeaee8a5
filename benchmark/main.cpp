// soft_volume_benchmark: times the parts of the core with Google Benchmark; scripts/benchmark runs and judges it.

#include <benchmark/benchmark.h>

#include <fstream>
#include <string>

#include "render_benchmark.h"
#include "simulation_benchmark.h"
#include "tool_benchmark.h"

namespace {

/// Google Benchmark reports cores and caches but not which processor it is.
std::string processorName() {
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);) {
    if (line.rfind("model name", 0) == 0)
      return line.substr(line.find(':') + 2);
  }
  return "unknown";
}

}  // namespace

int main(int argc, char** argv) {
  benchmark::AddCustomContext("processor", processorName());
#ifdef __clang__
  benchmark::AddCustomContext("compiler", "clang " __clang_version__);
#else
  benchmark::AddCustomContext("compiler", "gcc " __VERSION__);
#endif
  benchmark::AddCustomContext("build", SOFT_VOLUME_BUILD);
  soft_volume::core::registerSimulationBenchmarks();
  soft_volume::core::registerRenderBenchmarks();
  soft_volume::core::registerToolBenchmarks();
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv))
    return 2;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  benchmark::ClearRegisteredBenchmarks();  // they hold OpenGL contexts, which must go before Mesa does
  return 0;
}
