#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "soft_volume/session/lockstep.h"
#include "soft_volume/tool/device_streams.h"

namespace soft_volume {

/// The tool's loop in lockstep (session/lockstep.h): a thread that ticks once per sample of the device, in the order of
/// stamps, and waits for the simulation before every tick. It reads no clock but to notice that somebody is gone:
/// - a topic of the device that stays behind the poses is taken to be sent on change only;
/// - a device that falls silent, and a simulation that sends no patches, end the lockstep. Then forces go to zero, and
///   what comes later is ticked without waiting, until the next session.
///
/// Any thread may call any function; what is published comes from the loop's thread, in order.
class LockstepLoop {
 public:
  struct Settings {
    bool has_velocity = true;
    std::size_t button_topics = 1;
    double timeout_s = 2.0;  ///< wall time
    std::function<bool()> forces_allowed = [] { return true; };
    std::function<void(const core::ToolNotice&)> publish_notice;
    std::function<void(std::uint64_t generation, const core::HandTick&)> publish_tick;
    /// The lockstep of the session ended.
    std::function<void(std::uint64_t session, const std::string& reason)> leave;
    std::function<void(const std::string& text)> warn;
  };

  explicit LockstepLoop(Settings settings);
  ~LockstepLoop();
  LockstepLoop(const LockstepLoop&) = delete;
  LockstepLoop& operator=(const LockstepLoop&) = delete;

  /// The hand of a new session; samples wait until there is one.
  void give(std::unique_ptr<core::LockstepHand> hand, std::uint64_t generation);
  void addTopology(std::shared_ptr<const core::Topology> topology);
  void addPatch(core::GridPatch patch, std::int64_t stamp_ns, std::int64_t next_ns);
  /// Gives the device's messages to `hear`.
  void hear(const std::function<void(core::DeviceStreams&)>& hear);
  void reset();

  struct Counts {
    std::uint64_t ticks = 0;
    std::uint64_t waiting = 0;  ///< poses that were heard and not ticked
    std::uint64_t late = 0;     ///< messages that came too late for their sample
    bool in_lockstep = false;
  };
  Counts counts() const;

 private:
  using Lock = std::unique_lock<std::mutex>;
  void run();
  bool takeSample(Lock& lock);
  void work(Lock& lock);
  void leaveLockstep(Lock& lock, const std::string& reason);
  void fadeForces(Lock& lock);

  Settings settings_;
  mutable std::mutex mutex_;  // guards all below
  std::condition_variable wake_;
  bool running_ = true;
  core::DeviceStreams streams_;
  std::unique_ptr<core::LockstepHand> hand_;
  std::uint64_t generation_ = 0;
  core::DeviceSample sample_;
  bool has_heard_ = false;  // a sample of this session
  bool left_ = false;       // the lockstep of this session
  std::uint64_t ticks_ = 0;
  std::thread thread_;
};

}  // namespace soft_volume
