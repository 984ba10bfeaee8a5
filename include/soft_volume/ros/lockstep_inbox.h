#pragma once

#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolGrip.h>

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "soft_volume/session/lockstep.h"

namespace soft_volume {

/// What a tool wants of the tissue.
using SimulationInput = std::variant<ToolForce::ConstPtr, ToolCut::ConstPtr, ToolGrip::ConstPtr>;

/// The simulation's side of a session in lockstep (session/lockstep.h): inputs by the time of their stamps, what the
/// hands told, and why the lockstep is to end. Not thread-safe.
class LockstepInbox {
 public:
  /// Of a session, with so many hands.
  void begin(std::uint64_t session, std::size_t hands);
  std::uint64_t session() const { return session_; }

  std::size_t waiting() const { return timed_inputs_.size(); }  ///< inputs
  void add(const SimulationInput& input);
  /// Somebody is there; begins the wait for the next notice.
  void noteProgress() { progress_heard_ = Clock::now(); }
  /// A hand's notice of this session; a wrong one ends the lockstep.
  void hear(const core::ToolNotice& notice);
  /// The lockstep is to end: a hand left, say.
  void end(const std::string& reason) { end_ = reason; }

  /// Nanoseconds of time zero; nothing before every hand has told its first sample.
  std::optional<std::int64_t> epoch() const { return gate_.epoch(); }
  /// Everything that is stamped up to this time is here.
  bool complete(std::int64_t time_ns) const { return gate_.complete(time_ns); }
  bool ending() const { return !end_.empty(); }
  /// Why the lockstep is to end, or who was silent for so long that it is to; empty: it goes on.
  std::string endReason(std::int64_t time_ns, double timeout_s) const;

  /// Inputs that are stamped up to a time, in the order in which they are applied.
  std::vector<SimulationInput> take(std::int64_t time_ns) { return timed_inputs_.take(time_ns); }
  std::vector<core::ToolNotice> noticesAt(std::int64_t time_ns) { return gate_.noticesAt(time_ns); }

 private:
  using Clock = std::chrono::steady_clock;

  core::LockstepGate gate_;
  core::LockstepInputs<SimulationInput> timed_inputs_;
  std::uint64_t session_ = 0;
  std::string end_;  // why it is to end
  Clock::time_point progress_heard_;
};

}  // namespace soft_volume
