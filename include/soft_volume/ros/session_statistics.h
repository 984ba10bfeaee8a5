#pragma once

#include <soft_volume/SimulationStats.h>

#include <chrono>
#include <cstdint>
#include <vector>

#include "soft_volume/ros/simulation_run.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// Counts what a session does and how long that takes, in periods of wall time. Not thread-safe.
class SessionStatistics {
 public:
  using Clock = std::chrono::steady_clock;

  /// From rest again: extremes and counts of the former session are forgotten, the period goes on.
  void beginSession();
  void beginPeriod();
  Clock::duration periodLength() const { return Clock::now() - period_begin_; }

  void countStep(Clock::duration duration, std::uint32_t active_cells);
  void countState(const core::Session& session);
  /// Of the session, and of the period until now.
  SimulationStats make(const SimulationRun& run);

 private:
  void trackExtremes(const core::Session& session);

  Clock::time_point period_begin_;
  std::vector<float> step_ms_;  // of this period
  // Of this session.
  std::uint32_t active_cells_max_ = 0;
  double max_displacement_ever_m_ = 0.0;
  double cut_opening_max_m_ = 0.0;
  std::uint64_t states_published_ = 0;
};

}  // namespace soft_volume
