#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>
#include <soft_volume/RemovePart.h>
#include <soft_volume/RestoreCheckpoint.h>
#include <soft_volume/SaveCheckpoint.h>
#include <soft_volume/SetIntegrator.h>
#include <soft_volume/SimulationStats.h>
#include <soft_volume/StepSimulation.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolGrip.h>
#include <soft_volume/ToolProgress.h>
#include <soft_volume/ToolState.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "soft_volume/grid/state_stream.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/messages/resume_file.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/session/lockstep.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// Owns the lattice: applies what tools send, steps, publishes. Topics and services are those of topics.h.
///
/// Private parameters: ~scene (file), ~threads (1), ~real_time_factor (1; simulated seconds per second at most, 0: as
/// fast as possible), ~publish_clock (false; be the source of /clock, for use_sim_time), ~start_paused (false),
/// ~stop_after_s (0; shut down after so many simulated seconds), ~frame_id ("volume"), ~resume_file (none; keep the run
/// there, and go on with what a killed simulation kept: see ResumeFile), ~lockstep (false; for repeatable runs, do
/// every step with all that tools sent until its time, see session/lockstep.h; tool nodes need it too), ~lockstep_tools
/// (1; tool nodes that are waited for), ~lockstep_timeout_s (5; wall time after which silent tools end the lockstep).
///
/// With ~publish_clock the simulation waits for tools that fall behind simulated time by more than 10 ms (for at most
/// 0.2 s), so that a slow machine slows everything down alike.
///
/// Stamps are those of the simulation: the ROS time at the start of the session plus the simulated time. With
/// use_sim_time and without ~publish_clock, the session starts with the first message of /clock and follows it. In
/// lockstep it starts at the stamp of the first device sample, and follows the samples.
///
/// Threads: callbacks only queue; one thread applies, steps and publishes, and services run in it between two steps.
class SimulationNode {
 public:
  /// Reads scene and volume, which can take seconds. Throws Error when they cannot be used.
  SimulationNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  ~SimulationNode();
  SimulationNode(const SimulationNode&) = delete;
  SimulationNode& operator=(const SimulationNode&) = delete;

 private:
  using Input = std::variant<ToolForce::ConstPtr, ToolCut::ConstPtr, ToolGrip::ConstPtr>;
  using Clock = std::chrono::steady_clock;

  /// A simulated interval counted in steps.
  struct Every {
    std::uint64_t steps = 1;
    bool due(std::uint64_t step) const { return step % steps == 0; }
  };
  struct PatchRequest {
    core::Vector3 point_m;
    double radius_m;
    ros::Time stamp;  ///< of the pose
    ros::WallTime heard;
  };

  void advertise();
  void advertiseServices();
  void subscribe();
  void setRates();
  Every every(double interval_s) const;
  void waitForListeners() const;
  std::optional<ResumedRun> keptRun();
  void startOrResume();

  // In callbacks.
  void queueInput(Input input);
  void hearTool(const ToolState::ConstPtr& message);
  void hearProgress(const ToolProgress::ConstPtr& message);
  void queueLockstepInput(const Input& input);
  bool inLoop(const std::function<void()>& work);

  // In the simulation's thread.
  void run();
  void startLockstep();
  bool readyForStep();
  bool readyInLockstep();
  void leaveLockstep(const std::string& reason);
  bool waitForStart();
  void beginAt(const ros::Time& now);
  bool waitForClock();
  void publishLockstepPatches();
  void runCommands();
  void waitForDueTime();
  void waitForTools();
  void applyInputs();
  void applyInput(const Input& input);
  void advance();
  void removePart(const RemovePart::Request& request, RemovePart::Response& response);
  void setIntegrator(const SetIntegrator::Request& request, SetIntegrator::Response& response);
  void startSession(const SimulationCheckpoint* checkpoint, const std::string& resumed = "");
  void setPaused(bool paused);
  void publishSession();
  void publishTopology(bool full);
  void sendFullTopology();
  void publishState(bool key_frame);
  void publishJournal();
  void publishPatches();
  void publishPatch(const std::string& tool_id, const core::Vector3& point_m, double radius_m);
  void publishCheckpoint();
  boost::shared_ptr<const SimulationCheckpoint> makeCheckpoint() const;
  void keepCheckpoint(boost::shared_ptr<const SimulationCheckpoint> checkpoint);
  void publishClock();
  void publishStats();
  void trackExtremes();
  SimulationStats makeStats();
  template <typename Message>
  void stamp(Message& message) const;
  ros::Time stampOf(std::uint64_t step) const;
  ros::Time stampNow() const;
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  ros::NodeHandle private_node_;
  std::string frame_id_;
  int threads_ = 1;
  double real_time_factor_ = 1.0;
  bool publish_clock_ = false;
  bool follow_clock_ = false;  // somebody else's
  bool lockstep_ = false;      // wanted
  int lockstep_tools_ = 1;
  double lockstep_timeout_s_ = 5.0;
  double stop_after_s_ = 0.0;

  core::Scene scene_;
  core::SceneVolumes volumes_;
  std::unique_ptr<core::Session> session_;
  std::unique_ptr<Journal> journal_;
  std::unique_ptr<ResumeFile> resume_file_;  ///< null when the run is not kept
  std::string resumed_;                      ///< where this process went on; empty when it began from rest
  core::StateEncoder encoder_;
  TopologyEncoder topologies_;
  std::uint32_t published_revision_ = 0;
  std::uint64_t journaled_step_ = 0;
  ros::Time epoch_;
  bool begun_ = false;  // the session has an epoch
  Every state_every_, patch_every_, key_frame_every_, checkpoint_every_, journal_every_, clock_every_, keep_every_;

  ros::Publisher scene_publisher_, volume_publisher_, topology_publisher_, state_publisher_, patch_publisher_;
  ros::Publisher journal_publisher_, checkpoint_publisher_, stats_publisher_, clock_publisher_;
  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;

  std::mutex mutex_;  // guards the queues below
  std::condition_variable wake_;
  std::vector<Input> inputs_;
  std::map<std::string, PatchRequest> patch_requests_;
  std::vector<std::function<void()>> commands_;
  std::atomic<bool> in_lockstep_{false};
  core::LockstepGate gate_;
  core::LockstepInputs<Input> timed_inputs_;
  std::uint64_t lockstep_session_ = 0;
  std::string lockstep_end_;  // why it is to end
  Clock::time_point progress_heard_;

  std::multimap<std::uint64_t, Input> later_;  // inputs for a stated step
  bool paused_ = false;
  std::atomic<bool> key_frame_wanted_{true};
  std::atomic<bool> running_{true};

  // For stats; in the simulation's thread.
  Clock::time_point due_;
  Clock::time_point stats_time_;
  std::vector<float> step_ms_;
  std::uint32_t active_cells_max_ = 0;
  double max_displacement_ever_m_ = 0.0;
  double cut_opening_max_m_ = 0.0;
  std::uint64_t states_published_ = 0;
  std::mutex stats_mutex_;
  SimulationStats stats_;

  std::thread thread_;
};

}  // namespace soft_volume
