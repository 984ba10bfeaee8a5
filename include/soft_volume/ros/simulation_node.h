#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>
#include <soft_volume/RemovePart.h>
#include <soft_volume/RestoreCheckpoint.h>
#include <soft_volume/SaveCheckpoint.h>
#include <soft_volume/SetIntegrator.h>
#include <soft_volume/StepSimulation.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/resume_file.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/ros/real_time_pacer.h"
#include "soft_volume/ros/session_publisher.h"
#include "soft_volume/ros/simulation_inbox.h"
#include "soft_volume/ros/simulation_run.h"
#include "soft_volume/scene/scene.h"

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
  void makePublisher();
  void advertiseServices();
  /// A service whose work is done in the simulation's thread.
  template <typename Service>
  void serve(const std::string& name,
             void (SimulationNode::*work)(const typename Service::Request&, typename Service::Response&));
  void subscribe();
  std::optional<ResumedRun> keptRun();
  void refuseKeptRun(const core::Error& error);
  void startOrResume();
  void goOn(const ResumedRun& run);

  // In the simulation's thread.
  void run();
  void complete();
  bool readyForStep();
  bool waitForStart();
  void beginAt(const ros::Time& now);
  bool waitForClock();
  void startLockstep();
  bool readyInLockstep();
  void leaveLockstep(const std::string& reason);
  void applyInputs();
  void applyInput(const SimulationInput& input);
  void advance();
  void publishPatches();
  void publishLockstepPatches();
  void startSession(const SimulationCheckpoint* checkpoint, const std::string& resumed = "");
  void setPaused(bool paused);
  void step(const StepSimulation::Request& request, StepSimulation::Response& response);
  void restore(const RestoreCheckpoint::Request& request, RestoreCheckpoint::Response& response);
  void removePart(const RemovePart::Request& request, RemovePart::Response& response);
  void setIntegrator(const SetIntegrator::Request& request, SetIntegrator::Response& response);

  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  ros::NodeHandle private_node_;
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
  std::unique_ptr<ResumeFile> resume_file_;  ///< null when the run is not kept
  std::string resumed_;                      ///< where this process went on; empty when it began from rest
  IncidentLog incidents_;

  SimulationInbox inbox_;
  SimulationRun run_;
  std::unique_ptr<SessionPublisher> publisher_;
  RealTimePacer pacer_;

  std::vector<ros::Subscriber> subscribers_;
  std::vector<ros::ServiceServer> services_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  std::thread thread_;
};

}  // namespace soft_volume
