#pragma once

#include <cstddef>
#include <thread>

#ifdef _OPENMP
#include <omp.h>
#endif

namespace soft_volume::core {

/// Calls `body(i)` for every i in [0, count) on up to `threads` threads. Results are the same for any number of threads
/// as long as body(i) writes only what belongs to i: that is the rule of every caller (gathers, never scatters). The
/// order of calls is not defined; body must not throw.
template <typename Body>
void parallelFor(std::ptrdiff_t count, int threads, const Body& body) {
#ifdef _OPENMP
#pragma omp parallel for schedule(static) num_threads(threads) if (threads > 1)
#else
  static_cast<void>(threads);
#endif
  for (std::ptrdiff_t i = 0; i < count; ++i)
    body(i);
}

/// For tasks of unequal length, with results as above: calls `body(i, worker)`, worker being less than `threads`, for
/// scratch memory.
template <typename Body>
void parallelTasks(std::ptrdiff_t count, int threads, const Body& body) {
#ifdef _OPENMP
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads) if (threads > 1)
  for (std::ptrdiff_t i = 0; i < count; ++i)
    body(i, omp_get_thread_num());
#else
  static_cast<void>(threads);
  for (std::ptrdiff_t i = 0; i < count; ++i)
    body(i, 0);
#endif
}

/// `wanted`, or as many as there are cores where that is 0.
inline int threadsFor(int wanted) {
  const int cores = static_cast<int>(std::thread::hardware_concurrency());
  return wanted > 0 ? wanted : (cores > 0 ? cores : 1);
}

}  // namespace soft_volume::core
