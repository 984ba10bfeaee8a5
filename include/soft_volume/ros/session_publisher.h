#pragma once

#include <ros/node_handle.h>
#include <ros/publisher.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationStats.h>

#include <atomic>
#include <boost/shared_ptr.hpp>
#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <string>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/state_stream.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/resume_file.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/ros/session_statistics.h"
#include "soft_volume/ros/simulation_run.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

/// Publishes what a session is and does, on the topics of topics.h: each message at its interval of simulated time, and
/// once more for who joins. Keeps journal and checkpoints in the resume file, where there is one.
///
/// Only for the simulation's thread, but for lastStats().
class SessionPublisher {
 public:
  /// Between two journal messages, simulated time.
  static constexpr double kJournalInterval_s = 0.02;

  struct Settings {
    core::SimulationOutput output;
    bool clock = false;                 ///< publish /clock
    std::uint32_t patch_queue = 100;    ///< messages that may wait for a subscriber
    ResumeFile* resume_file = nullptr;  ///< null when the run is not kept
    /// Has work done by the simulation's thread between two steps; called from any thread.
    std::function<void(std::function<void()>)> post;
  };

  /// Advertises. `run` has a session when anything but waitForListeners() is called; both references are to outlive
  /// this.
  SessionPublisher(ros::NodeHandle& node, Settings settings, const SimulationRun& run, IncidentLog& incidents);
  SessionPublisher(const SessionPublisher&) = delete;
  SessionPublisher& operator=(const SessionPublisher&) = delete;

  /// The journal is not latched, and who misses its beginning cannot replay the session: those that are there already,
  /// because this is not their first simulation, are to be connected.
  void waitForListeners() const;

  /// The run has a new session: forgets the former one.
  void beginSession();
  /// The time step is another: counts the intervals anew.
  void setRates();
  /// What a session is, and, where it has begun, its first state.
  void publishSession();
  /// Journal, state and checkpoint that a session begins with.
  void publishBeginning();

  /// A step was done, which took so long.
  void countStep(std::chrono::steady_clock::duration duration);
  bool patchDue() const { return patch_every_.due(run_.session->steps()); }
  void publishDueClock();
  /// All but clock and patches, after a step.
  void publishDue();

  void publishTopology(bool full);
  /// When the grid was changed since the last one.
  void publishChangedTopology();
  /// The latched message is enough unless it is a delta.
  void sendFullTopology();
  /// Somebody joined who cannot use deltas.
  bool keyFrameWanted() const { return key_frame_wanted_; }
  void publishState(bool key_frame);
  void publishJournal();
  /// Around a tool at a point of the volume frame.
  void publishPatch(const std::string& tool_id, const core::Vector3& point_m, double radius_m);
  /// A checkpoint that somebody asked for; the kept run goes on from its own.
  SimulationCheckpoint publishAskedCheckpoint();

  /// From now on the period of the statistics counts.
  void beginStats() { statistics_.beginPeriod(); }
  void publishStats();
  /// Once a second of wall time.
  void publishDueStats();
  /// Those published last; any thread.
  SimulationStats lastStats() const;

 private:
  /// A simulated interval counted in steps.
  struct Every {
    std::uint64_t steps = 1;
    bool due(std::uint64_t step) const { return step % steps == 0; }
  };

  void advertise(ros::NodeHandle& node);
  Every every(double interval_s) const;
  void publishCheckpoint();
  boost::shared_ptr<const SimulationCheckpoint> makeCheckpoint() const;
  void keepCheckpoint(boost::shared_ptr<const SimulationCheckpoint> checkpoint);

  Settings settings_;
  const SimulationRun& run_;
  IncidentLog& incidents_;

  core::StateEncoder encoder_;
  TopologyEncoder topologies_;
  std::uint32_t published_revision_ = 0;
  std::uint64_t journaled_step_ = 0;
  std::atomic<bool> key_frame_wanted_{true};
  Every state_every_, patch_every_, key_frame_every_, checkpoint_every_, journal_every_, clock_every_, keep_every_;
  SessionStatistics statistics_;
  mutable std::mutex stats_mutex_;
  SimulationStats stats_;  // guarded by it

  ros::Publisher scene_publisher_, volume_publisher_, topology_publisher_, state_publisher_, patch_publisher_;
  ros::Publisher journal_publisher_, checkpoint_publisher_, stats_publisher_, clock_publisher_;
};

}  // namespace soft_volume
