#pragma once

#include <chrono>
#include <thread>

namespace soft_volume {

/// Holds simulated time to a factor of wall time. Not thread-safe.
class RealTimePacer {
 public:
  /// The next step is due now.
  void begin() { due_ = Clock::now(); }

  /// Waits until the next step is due. `factor`: simulated seconds per second at most; 0: as fast as possible.
  void wait(double step_s, double factor) {
    if (factor <= 0.0)
      return;
    due_ += std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(step_s / factor));
    const Clock::time_point now = Clock::now();
    if (due_ > now) {
      std::this_thread::sleep_until(due_);
    } else if (now - due_ > std::chrono::milliseconds(100)) {
      due_ = now;  // too slow for the wished factor: do not race to make up for it later
    }
  }

 private:
  using Clock = std::chrono::steady_clock;
  Clock::time_point due_;
};

}  // namespace soft_volume
