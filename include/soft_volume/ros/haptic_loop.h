#pragma once

#include <pthread.h>
#include <semaphore.h>

#include <array>
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "soft_volume/scene/tool_rig.h"
#include "soft_volume/session/lockstep.h"
#include "soft_volume/tool/spsc_ring.h"
#include "soft_volume/tool/tool.h"
#include "soft_volume/tool/workspace_mapping.h"

namespace soft_volume {

using core::ToolRig;

/// A patch on its way to or from a tool of a rig.
struct PatchParcel {
  std::unique_ptr<core::ReadyPatch> patch;
  std::uint64_t generation = 0;
  std::size_t tool = 0;
};

/// A pose as a driver sent it.
struct HeardPose {
  core::Pose pose;
  std::int64_t stamp_ns = 0;
  double heard_s = 0.0;  ///< HapticLoop::now()
  double delay_s = 0.0;  ///< from its stamp until it was heard, where that can be known
};

/// What a tick gives, to be published by another thread.
struct LoopTick : core::HandTick {
  std::uint64_t generation = 0;
};

/// Counts of times in bins of a sixteenth of an octave, for percentiles. One thread adds without ever waiting; any
/// thread may read.
class TimeCounts {
 public:
  static constexpr std::size_t kBins = 336;  ///< 1 us to 2 s
  using Counts = std::array<std::uint64_t, kBins>;

  void add(double seconds);
  Counts counts() const;
  /// Upper end of the bin that holds the quantile [s]; 0 without counts.
  static double quantile(const Counts& counts, double share);

 private:
  std::array<std::atomic<std::uint64_t>, kBins> bins_{};
};

/// What the loop did so far; any thread may read.
struct LoopStatistics {
  TimeCounts periods;  ///< from one tick's start to the next one's
  TimeCounts work;     ///< of a tick
  std::atomic<std::uint64_t> ticks{0};
  std::atomic<std::uint64_t> late{0};                  ///< that began more than half a period late
  std::atomic<std::uint64_t> lost{0};                  ///< whose results found no room to be published
  std::array<std::atomic<std::uint64_t>, 8> faults{};  ///< beginnings, by core::ForceFault
  std::atomic<std::uint64_t> swaps{0};
};

/// The haptic loop: a thread that ticks the tool in the hand at a fixed rate by the monotonic clock, with SCHED_FIFO
/// where that is permitted. It takes no lock and no memory; all else reaches and leaves it through queues that never
/// wait. With the driver's poses at the loop's rate or a fraction of it, the ticks are shifted (by up to 2 % of a
/// period each) to come a quarter of a period after the poses.
///
/// In simulated time there is nothing to keep up with: a tick follows every pose, at the time of its stamp if that is
/// not 20 ms old, so that what the loop measures does not depend on how fast the machine is.
class HapticLoop {
 public:
  struct Settings {
    double rate_hz = 1000.0;
    int priority = 50;                       ///< of SCHED_FIFO
    std::function<double()> simulated_time;  ///< [s]; empty where time is real
    double wall_timeout_s = 0.25;            ///< real time without a pose after which simulated time is taken to go on
    std::function<core::Buttons()> buttons = [] { return core::Buttons(); };  ///< held now; must not wait
    std::function<bool()> forces_allowed = [] { return true; };               ///< by the device; must not wait
  };

  explicit HapticLoop(Settings settings);
  ~HapticLoop();
  HapticLoop(const HapticLoop&) = delete;
  HapticLoop& operator=(const HapticLoop&) = delete;

  /// Seconds of the monotonic clock.
  static double now();

  // Each by one thread at a time. What does not fit because the loop is starved is dropped: the newest rig and reset
  // never are.
  void give(std::unique_ptr<ToolRig> rig);
  void give(PatchParcel parcel);
  void hear(const HeardPose& pose);
  void hear(const core::Vector3& velocity_m_s, double heard_s);
  void reset() { ++resets_asked_; }

  /// A patch's memory that the loop no longer needs, for reuse. By the thread that gives parcels.
  bool takeBack(PatchParcel& parcel) { return returned_.pop(parcel); }
  /// The next tick, in order; waits up to `wait_s` for it. By one thread.
  bool next(LoopTick& tick, double wait_s);

  const LoopStatistics& statistics() const { return statistics_; }
  bool realTime() const { return real_time_; }
  const Settings& settings() const { return settings_; }

 private:
  struct HeardVelocity {
    core::Vector3 velocity_m_s;
    double heard_s = 0.0;
  };

  void run();
  void runLive();
  void runSimulated();
  void wantRealTime();
  void takeAll();
  bool takePose();
  void takeRig();
  void takePatches();
  void takeButtons();
  void takeReset();
  void swapTool();
  core::Tool& tool() { return *rig_->tools[selected_]; }
  bool ready() const { return rig_ && !rig_->tools.empty() && has_pose_; }
  void tick(double time_s);
  void putDown(std::optional<core::TissueCut> cut);
  void publish(const LoopTick& tick);
  void count(const core::ToolOutput& output);
  double phaseShift(double time_s) const;
  bool isSilent(double ago_s) const;
  double simulatedPoseTime() const;
  double simulatedSilenceTime(double silent_s) const;

  Settings settings_;
  LoopStatistics statistics_;
  std::atomic<bool> running_{true};
  std::atomic<bool> real_time_{false};
  sem_t work_;       // poses of simulated time
  sem_t published_;  // ticks

  std::atomic<ToolRig*> new_rig_{nullptr};
  std::atomic<std::uint64_t> resets_asked_{0};
  core::SpscRing<PatchParcel, 8> parcels_;
  core::SpscRing<PatchParcel, 32> returned_;
  core::SpscRing<ToolRig*, 8> old_rigs_;
  core::SpscRing<HeardPose, 1024> poses_;
  core::SpscRing<HeardVelocity, 1024> velocities_;
  core::SpscRing<LoopTick, 1024> ticks_;

  // The loop's own.
  std::unique_ptr<ToolRig> rig_;
  std::size_t selected_ = 0;
  std::uint64_t resets_done_ = 0;
  core::ToolInput input_;
  HeardPose pose_;
  bool has_pose_ = false;
  HeardVelocity velocity_;
  bool engaged_ = true;
  core::ForceFault fault_ = core::ForceFault::kNone;
  double next_s_ = 0.0;

  std::thread thread_;
};

}  // namespace soft_volume
