#pragma once

#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>

namespace soft_volume::core {

/// Progress of a program on stderr: a bar with the time left on a terminal, a line now and then elsewhere.
class ProgressBar {
 public:
  explicit ProgressBar(bool quiet) : quiet_(quiet), terminal_(isatty(STDERR_FILENO) != 0) {}
  ~ProgressBar() {
    if (drawn_ && terminal_)
      std::fprintf(stderr, "\r%78s\r", "");
  }
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  /// `done` of `total`, in any unit that grows evenly with time; the time left follows from it.
  void update(double done, double total) {
    if (quiet_ || total <= 0.0)
      return;
    const Clock::time_point now = Clock::now();
    if (now - last_ < std::chrono::milliseconds(terminal_ ? 100 : 5000))
      return;
    last_ = now;
    drawn_ = true;
    const double fraction = std::min(1.0, done / total);
    const double spent_s = std::chrono::duration<double>(now - start_).count();
    const double left_s = fraction > 0.0 ? spent_s * (1.0 - fraction) / fraction : 0.0;
    const int filled = static_cast<int>(40.0 * fraction);
    const std::string bar =
        std::string(static_cast<std::size_t>(filled), '#') + std::string(static_cast<std::size_t>(40 - filled), '.');
    std::fprintf(stderr, terminal_ ? "\r[%s] %3.0f %%  %4.0f s left " : "[%s] %3.0f %%  %4.0f s left\n", bar.c_str(),
                 100.0 * fraction, left_s);
    std::fflush(stderr);
  }

 private:
  using Clock = std::chrono::steady_clock;
  bool quiet_;
  bool terminal_;
  bool drawn_ = false;
  Clock::time_point start_ = Clock::now();
  Clock::time_point last_ = start_;
};

}  // namespace soft_volume::core
