#include "soft_volume/ros/session_statistics.h"

#include <algorithm>

#include "soft_volume/messages/conversions.h"

namespace soft_volume {

void SessionStatistics::beginSession() {
  active_cells_max_ = 0;
  max_displacement_ever_m_ = cut_opening_max_m_ = 0.0;
  states_published_ = 0;
}

void SessionStatistics::beginPeriod() {
  period_begin_ = Clock::now();
  step_ms_.clear();
}

void SessionStatistics::countStep(Clock::duration duration, std::uint32_t active_cells) {
  step_ms_.push_back(static_cast<float>(std::chrono::duration<double, std::milli>(duration).count()));
  active_cells_max_ = std::max(active_cells_max_, active_cells);
}

void SessionStatistics::countState(const core::Session& session) {
  ++states_published_;
  trackExtremes(session);
}

void SessionStatistics::trackExtremes(const core::Session& session) {
  max_displacement_ever_m_ = std::max(max_displacement_ever_m_, session.maxDisplacement());
  cut_opening_max_m_ = std::max(cut_opening_max_m_, session.cutOpening());
}

SimulationStats SessionStatistics::make(const SimulationRun& run) {
  const double wall_s = std::chrono::duration<double>(periodLength()).count();
  SimulationStats stats = statsMessage(*run.session);
  const double steps = static_cast<double>(step_ms_.size());
  stats.real_time_factor = wall_s > 0.0 ? steps * stats.dt / wall_s : 0.0;
  if (!step_ms_.empty()) {
    std::nth_element(step_ms_.begin(), step_ms_.begin() + step_ms_.size() / 2, step_ms_.end());
    stats.step_ms_median = step_ms_[step_ms_.size() / 2];
    stats.step_ms_max = *std::max_element(step_ms_.begin(), step_ms_.end());
  }
  stats.active_cells_max = active_cells_max_;
  trackExtremes(*run.session);
  stats.max_displacement_ever = max_displacement_ever_m_;
  stats.cut_opening_max = cut_opening_max_m_;
  stats.states_published = states_published_;
  stats.inputs_applied = run.journal->applied();
  stats.inputs_refused = run.journal->refused();
  stats.paused = static_cast<std::uint8_t>(run.paused);
  return stats;
}

}  // namespace soft_volume
