#pragma once

#include <cstddef>

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

}  // namespace soft_volume::core
