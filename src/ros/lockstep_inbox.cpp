#include "soft_volume/ros/lockstep_inbox.h"

namespace soft_volume {

void LockstepInbox::begin(std::uint64_t session, std::size_t hands) {
  gate_ = core::LockstepGate(hands);
  timed_inputs_.clear();
  session_ = session;
  end_.clear();
  noteProgress();
}

void LockstepInbox::add(const SimulationInput& input) {
  using Kind = core::LockstepInputs<SimulationInput>::Kind;
  const auto add = [this, &input](const auto& message, Kind kind) {
    timed_inputs_.add(static_cast<std::int64_t>(message.header.stamp.toNSec()), message.tool_id, kind, message.sequence,
                      input);
  };
  if (const auto* force = std::get_if<ToolForce::ConstPtr>(&input)) {
    add(**force, Kind::kForce);
    gate_.countForce((*force)->tool_id, (*force)->sequence);
  } else if (const auto* cut = std::get_if<ToolCut::ConstPtr>(&input)) {
    add(**cut, Kind::kCut);
    gate_.countCut((*cut)->tool_id, (*cut)->sequence);
  } else {
    add(*std::get<ToolGrip::ConstPtr>(input), Kind::kGrip);
  }
}

void LockstepInbox::hear(const core::ToolNotice& notice) {
  if (!gate_.hear(notice, session_))
    end_ = notice.hand + " joined it later, or its stamps went back";
}

std::string LockstepInbox::endReason(std::int64_t time_ns, double timeout_s) const {
  if (end_.empty() && Clock::now() - progress_heard_ > std::chrono::duration<double>(timeout_s))
    return "nothing came from " + gate_.waitsFor(time_ns);
  return end_;
}

}  // namespace soft_volume
