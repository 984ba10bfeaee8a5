#include "soft_volume/ros/simulation_inbox.h"

#include <ros/init.h>

#include <algorithm>
#include <future>
#include <iterator>
#include <memory>
#include <utility>
#include <variant>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

/// A device delivers at most some thousand inputs a second; more than this at once is a fault, not a hand.
constexpr std::size_t kMaxQueuedInputs = 100000;
constexpr std::size_t kMaxLaterInputs = 10000;
/// A tool that stays behind for longer is not waited for any more.
constexpr std::chrono::milliseconds kToolTimeout(200);

bool usable(const core::Scene& scene, const std::string& tool_id, const core::Vector3& point_m, double radius_m) {
  return scene.findTool(tool_id) != nullptr && core::isFinite(point_m) && radius_m > 0.0 && radius_m <= 1.0;
}

std::uint64_t applyAtStep(const SimulationInput& input) {
  return std::visit([](const auto& message) { return message->apply_at_step; }, input);
}

}  // namespace

void SimulationInbox::queueInput(SimulationInput input) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (in_lockstep_) {
    // In lockstep none may be lost, so it ends.
    if (lockstep_.waiting() < kMaxQueuedInputs)
      lockstep_.add(input);
    else
      lockstep_.end("more inputs wait than the simulation can take");
    wake_.notify_all();
    return;
  }
  if (inputs_.size() >= kMaxQueuedInputs) {
    incidents_.report("tool inputs", "more came than the simulation can take; some were dropped");
    return;
  }
  inputs_.push_back(std::move(input));
}

void SimulationInbox::hearTool(const ToolState& message) {
  const core::Vector3 point = fromPoint(message.pose.position);
  if (!usable(scene_, message.tool_id, point, message.patch_radius)) {
    incidents_.report(topics::kToolState, "a tool that the scene does not have, or a pose or radius out of range");
    return;
  }
  // A tool whose device fell silent repeats its last pose: nothing newer will come, so it is not waited for.
  const ros::Time stamp = message.pose_stale != 0 ? ros::TIME_MAX : message.header.stamp;
  const std::lock_guard<std::mutex> lock(mutex_);
  patch_requests_[message.tool_id] = {point, message.patch_radius, stamp, ros::WallTime::now()};
  wake_.notify_all();
}

void SimulationInbox::hearProgress(const ToolProgress& message) {
  try {
    const core::ToolNotice notice = fromMessage(message);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!in_lockstep_ || notice.session != lockstep_.session())
      return;
    lockstep_.noteProgress();
    wake_.notify_all();
    if (message.left != 0)
      lockstep_.end(notice.hand + " has left it");
    else if (!usable(scene_, notice.tool_id, notice.point_m, notice.patch_radius_m))
      incidents_.report(topics::kToolProgress,
                        "a tool that the scene does not have, or a place or radius out of range");
    else
      lockstep_.hear(notice);
  } catch (const core::Error& error) {
    incidents_.report(topics::kToolProgress, error.what());
  }
}

void SimulationInbox::post(std::function<void()> work) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    posted_.push_back(std::move(work));
  }
  wake_.notify_all();
}

bool SimulationInbox::inLoop(const std::function<void()>& work) {
  auto done = std::make_shared<std::promise<void>>();
  std::future<void> result = done->get_future();
  post([work, done] {
    work();
    done->set_value();
  });
  while (result.wait_for(std::chrono::milliseconds(100)) != std::future_status::ready) {
    if (!running_ || !ros::ok())
      return false;
  }
  return true;
}

void SimulationInbox::stop() {
  running_ = false;
  wake_.notify_all();
}

void SimulationInbox::runPosted(bool paused) {
  std::vector<std::function<void()>> posted;
  {
    std::unique_lock<std::mutex> lock(mutex_);
    if (paused && posted_.empty())
      wake_.wait_for(lock, kPatience);
    posted.swap(posted_);
  }
  for (const auto& work : posted)
    work();
}

void SimulationInbox::waitForTools(const ros::Time& needed) {
  const auto behind = [&needed](const auto& entry) { return entry.second.stamp < needed; };
  std::unique_lock<std::mutex> lock(mutex_);
  const bool caught_up = wake_.wait_for(lock, kToolTimeout, [&] {
    return !running_ || std::none_of(patch_requests_.begin(), patch_requests_.end(), behind);
  });
  if (caught_up)
    return;
  for (auto it = patch_requests_.begin(); it != patch_requests_.end();) {
    it = behind(*it) ? patch_requests_.erase(it) : std::next(it);
  }
}

std::vector<SimulationInput> SimulationInbox::takeInputs(std::int64_t now_ns, std::uint64_t next_step) {
  std::vector<SimulationInput> due;
  for (SimulationInput& input : takeQueued(now_ns)) {
    const std::uint64_t at = applyAtStep(input);
    if (at <= next_step) {
      due.push_back(std::move(input));
    } else if (later_.size() < kMaxLaterInputs) {
      later_.emplace(at, std::move(input));
    } else {
      incidents_.report("tool inputs", "too many are waiting for a later step; one was dropped");
    }
  }
  while (!later_.empty() && later_.begin()->first <= next_step) {
    due.push_back(std::move(later_.begin()->second));
    later_.erase(later_.begin());
  }
  return due;
}

std::vector<SimulationInput> SimulationInbox::takeQueued(std::int64_t now_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (in_lockstep_)
    return lockstep_.take(now_ns);
  return std::exchange(inputs_, {});
}

std::map<std::string, SimulationInbox::PatchRequest> SimulationInbox::patchRequests() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return patch_requests_;
}

void SimulationInbox::beginLockstep(std::uint64_t session, std::size_t hands) {
  const std::lock_guard<std::mutex> lock(mutex_);
  in_lockstep_ = true;
  lockstep_.begin(session, hands);
}

void SimulationInbox::endLockstep() {
  const std::lock_guard<std::mutex> lock(mutex_);
  in_lockstep_ = false;
  inputs_ = lockstep_.take(INT64_MAX);
}

std::optional<std::int64_t> SimulationInbox::waitForEpoch() {
  std::unique_lock<std::mutex> lock(mutex_);
  wake_.wait_for(lock, kPatience,
                 [this] { return !running_ || !posted_.empty() || lockstep_.epoch() || lockstep_.ending(); });
  return lockstep_.epoch();
}

SimulationInbox::Readiness SimulationInbox::waitForHands(std::int64_t now_ns, double timeout_s) {
  std::unique_lock<std::mutex> lock(mutex_);
  const bool ready = wake_.wait_for(lock, kPatience, [&] {
    return !running_ || !posted_.empty() || lockstep_.ending() || lockstep_.complete(now_ns);
  });
  if (ready && lockstep_.complete(now_ns))
    return {true, ""};
  return {false, lockstep_.endReason(now_ns, timeout_s)};
}

std::vector<core::ToolNotice> SimulationInbox::noticesAt(std::int64_t time_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  return lockstep_.noticesAt(time_ns);
}

}  // namespace soft_volume
