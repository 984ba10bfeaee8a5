#pragma once

#include <ros/time.h>
#include <soft_volume/JournalEntry.h>
#include <soft_volume/SimulationCheckpoint.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/grid/state_stream.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/replay/bag_recorder.h"
#include "soft_volume/session/lockstep.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// An input that no device explains: it is given again at its time.
struct TimedEntry {
  std::int64_t stamp_ns = 0;
  JournalEntry entry;
};

/// What a run without a graph consists of.
struct LockstepPlan {
  core::Scene scene;
  VolumeAndLabels volume;
  std::uint64_t session = 1;
  int threads = 1;
  std::string frame_id = "volume";
  std::string device_frame_id = "volume";
  std::string prefix = "/";  ///< namespace of the topics
  std::optional<core::DeviceProfile> profile;
  double rate_hz = 1000.0;
  std::vector<core::DeviceSample> samples;  ///< increasing stamps; may be empty
  std::vector<TimedEntry> entries;          ///< increasing stamps
  /// They are given before the step that they were given before, up to end_step, because every step is the same.
  bool entries_by_step = false;
  std::uint64_t end_step = 0;
  bool same_grid = true;  ///< as that which the entries were made for
  /// Stamps of the states that are wanted, increasing: those of the steps around each are published.
  std::vector<std::int64_t> states_ns;
  std::int64_t epoch_ns = 0;  ///< time zero where there are no samples
  std::int64_t end_ns = 0;    ///< the last step that begins before this is the last one
  /// The run continues from here; its simulated time is that of the stamp.
  std::optional<SimulationCheckpoint> start;
};

/// What a run did.
struct LockstepCounts {
  std::uint64_t steps = 0;
  std::uint64_t samples = 0;
  std::uint64_t inputs_applied = 0;
  std::uint64_t inputs_refused = 0;
  std::string first_refusal;
  double simulated_s = 0.0;
  double step_ms_median = 0.0;
  double step_ms_max = 0.0;
  double stepping_s = 0.0;   ///< wall time of all steps
  double processor_s = 0.0;  ///< of the thread that steps, in all steps
};

/// Runs a scene in lockstep with the samples of a device (session/lockstep.h), without a graph, and publishes what the
/// nodes would: scene, volume, topology, states, journal, checkpoints, statistics, tool/force, tool/cut, tool/state and
/// servo_cf, each stamped as there. Not thread-safe.
class LockstepRun {
 public:
  using Publish = std::function<void(const std::string& topic, const ros::Time& stamp,
                                     const boost::shared_ptr<const AnyMessage>& message, bool latched)>;
  using Progress = std::function<void(double done, double total)>;

  /// Throws SceneError when scene and volume do not fit, and InputError when the checkpoint does not.
  LockstepRun(LockstepPlan plan, Publish publish);
  void run(const Progress& progress);
  const LockstepCounts& counts() const { return counts_; }
  const core::Session& session() const { return session_; }

 private:
  using Input = std::function<void()>;
  /// A simulated interval counted in steps.
  struct Every {
    std::uint64_t steps = 1;
    bool due(std::uint64_t step) const { return step % steps == 0; }
  };
  Every every(double interval_s) const;
  void setRates();
  void begin();
  void useSample(const core::DeviceSample& sample);
  void send(const core::HandTick& tick);
  void advance();
  void applyInputs(std::int64_t time_ns);
  bool ended() const;
  bool isDue(const TimedEntry& entry, std::int64_t time_ns) const;
  void applyEntries(std::int64_t time_ns);
  void applyEntry(const JournalEntry& entry);
  template <typename Message>
  void applyMessage(const Message& message);
  template <typename Message>
  void applyRefused(const JournalEntry& entry);
  template <typename Message>
  void applyAdapted(const JournalEntry& entry);
  void count(const JournalEntry& entry);
  void makePatches(std::int64_t time_ns);
  void publishStep();
  bool stateIsDue();
  void publishTopology(bool full);
  void publishState(bool key_frame);
  void publishJournal();
  void publishCheckpoint();
  void publishStats();

  std::int64_t stampOf(std::uint64_t step) const;
  std::int64_t stampNow() const { return stampOf(session_.steps()); }
  template <typename Message>
  void publish(const char* topic, Message message, bool latched = false);
  template <typename Message>
  void publishAt(std::int64_t stamp_ns, const std::string& topic, const Message& message, bool latched = false);

  LockstepPlan plan_;
  Publish publish_;
  core::Session session_;
  Journal journal_;
  TopologyEncoder topologies_;
  core::StateEncoder encoder_;
  std::optional<core::LockstepHand> hand_;
  core::LockstepGate gate_;
  core::LockstepInputs<Input> inputs_;
  std::int64_t epoch_ns_ = 0;
  Every state_every_, patch_every_, key_frame_every_, checkpoint_every_, journal_every_, stats_every_;
  std::uint32_t published_revision_ = 0;
  std::uint64_t journaled_step_ = 0;
  std::uint64_t state_sequence_ = 0;
  std::size_t next_entry_ = 0;
  std::size_t next_state_ = 0;
  bool key_frame_wanted_ = true;
  LockstepCounts counts_;
  std::vector<float> step_ms_;  // since the last statistics
  std::vector<float> all_step_ms_;
  std::uint64_t states_published_ = 0;
  std::uint32_t active_cells_max_ = 0;
  double max_displacement_ever_m_ = 0.0;
  double cut_opening_max_m_ = 0.0;
};

}  // namespace soft_volume
