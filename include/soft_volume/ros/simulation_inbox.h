#pragma once

#include <ros/time.h>
#include <soft_volume/ToolProgress.h>
#include <soft_volume/ToolState.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/ros/lockstep_inbox.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

/// What callbacks leave for the simulation's thread: inputs, places that tools want patches of, and work between two
/// steps. Every wait of that thread for others is here too.
class SimulationInbox {
 public:
  /// Waits are cut in pieces, so that services and the end of the node are not held up.
  static constexpr std::chrono::milliseconds kPatience{20};

  struct PatchRequest {
    core::Vector3 point_m;  ///< volume frame
    double radius_m;
    ros::Time stamp;  ///< of the pose
    ros::WallTime heard;
  };

  /// Both are to outlive this; `scene` may be filled before the first message comes.
  SimulationInbox(const core::Scene& scene, IncidentLog& incidents) : scene_(scene), incidents_(incidents) {}
  SimulationInbox(const SimulationInbox&) = delete;
  SimulationInbox& operator=(const SimulationInbox&) = delete;

  // Any thread.

  void queueInput(SimulationInput input);
  void hearTool(const ToolState& message);
  void hearProgress(const ToolProgress& message);
  /// Has work done by the simulation's thread between two steps.
  void post(std::function<void()> work);
  /// The same, and waits for it; false when the node is shutting down.
  bool inLoop(const std::function<void()>& work);
  /// Ends all waits.
  void stop();
  bool running() const { return running_; }
  bool inLockstep() const { return in_lockstep_; }

  // The simulation's thread.

  /// Does what was posted; a paused simulation waits a while for some.
  void runPosted(bool paused);
  /// Until no tool's pose is older than `needed`; one that stays behind is not waited for any more.
  void waitForTools(const ros::Time& needed);
  /// Inputs to apply before `next_step`, in order; in lockstep of those that are stamped up to now. Those that state a
  /// later step wait for it.
  std::vector<SimulationInput> takeInputs(std::int64_t now_ns, std::uint64_t next_step);
  /// Their session has ended.
  void forgetLaterInputs() { later_.clear(); }
  /// The newest of every tool.
  std::map<std::string, PatchRequest> patchRequests() const;

  /// From now on inputs wait for their time.
  void beginLockstep(std::uint64_t session, std::size_t hands);
  /// From now on inputs are applied as they come.
  void endLockstep();
  /// Nanoseconds of time zero; nothing when it is not known after a while.
  std::optional<std::int64_t> waitForEpoch();
  struct Readiness {
    bool complete = false;   ///< all that is needed is here
    std::string end_reason;  ///< why the lockstep is to end; empty: it goes on
  };
  /// Waits a while for all that is stamped up to now.
  Readiness waitForHands(std::int64_t now_ns, double timeout_s);
  std::vector<core::ToolNotice> noticesAt(std::int64_t time_ns);

 private:
  std::vector<SimulationInput> takeQueued(std::int64_t now_ns);

  const core::Scene& scene_;
  IncidentLog& incidents_;
  std::atomic<bool> running_{true};
  std::atomic<bool> in_lockstep_{false};                 // changed by the simulation's thread, under the mutex
  std::multimap<std::uint64_t, SimulationInput> later_;  // by step; in the simulation's thread

  mutable std::mutex mutex_;  // guards all below
  std::condition_variable wake_;
  std::vector<SimulationInput> inputs_;
  std::map<std::string, PatchRequest> patch_requests_;
  std::vector<std::function<void()>> posted_;
  LockstepInbox lockstep_;
};

}  // namespace soft_volume
