#include "tool_benchmark.h"

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <string>
#include <utility>
#include <vector>

#include "tool/tick_loop.h"

namespace soft_volume::core {
namespace {

constexpr int kRounds = 3000;
constexpr int kBefore = 500;  // until the tool has come down

double at(const std::vector<double>& sorted, double share) {
  return sorted[std::size_t(share * double(sorted.size() - 1))];
}

/// The ticks alone are timed, each by itself: taking a new patch every fourth time, contact, force and all limits.
void timeTicks(benchmark::State& state, TickWork work) {
  TickLoop loop(work);
  for (int n = 0; n < kBefore; ++n)
    loop.run();
  std::vector<double> ticks_us;
  for (auto _ : state) {
    loop.prepare();
    const auto start = std::chrono::steady_clock::now();
    loop.tick();
    const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    state.SetIterationTime(seconds);
    ticks_us.push_back(1e6 * seconds);
    loop.answer();
  }
  std::sort(ticks_us.begin(), ticks_us.end());
  state.counters["median_us"] = at(ticks_us, 0.5);
  state.counters["p99_us"] = at(ticks_us, 0.99);
  state.counters["patch_cells"] = double(loop.patchCells());
}

}  // namespace

void registerToolBenchmarks() {
  const std::pair<const char*, TickWork> works[] = {
      {"free", TickWork::kFree},   {"press", TickWork::kPress},
      {"slide", TickWork::kSlide}, {"slide_over_cut", TickWork::kSlideOverCut},
      {"cut", TickWork::kCut},     {"grip", TickWork::kGrip}};
  for (const auto& named : works) {
    const TickWork work = named.second;
    benchmark::RegisterBenchmark((std::string("tool/tick/500/") + named.first).c_str(),
                                 [work](benchmark::State& state) { timeTicks(state, work); })
        ->Iterations(kRounds)
        ->UseManualTime()
        ->Unit(benchmark::kMicrosecond);
  }
}

}  // namespace soft_volume::core
