#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <ros/callback_queue.h>
#include <ros/node_handle.h>
#include <ros/spinner.h>
#include <sensor_msgs/Joy.h>
#include <soft_volume/GridPatch.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/Scene.h>
#include <soft_volume/Volume.h>
#include <std_msgs/Header.h>
#include <std_srvs/Trigger.h>

#include <atomic>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "soft_volume/grid/topology_delta.h"
#include "soft_volume/ros/device_buttons.h"
#include "soft_volume/ros/haptic_loop.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/ros/lockstep_loop.h"
#include "soft_volume/ros/operating_state.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/tool/patch_intake.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume {

/// The tools of the scene in the hand of one haptic device (CRTK names): turns measured_cp, measured_cv and joy into
/// tool/force, tool/cut, tool/state and servo_cf. One tool is in the hand at a time; the scene's swap button puts the
/// next one there. Service tool/reset ends a safety trip.
///
/// Private parameters: ~device (empty: a file of config/devices with limits, topics and the mapping of the workspace;
/// without one poses are in the volume frame and the scene says what the device may render); ~rate_hz (the device's, or
/// 1000); ~priority (50; of SCHED_FIFO); ~wall_timeout_s (0.25; with use_sim_time: a pose older than this by the wall
/// clock is stale even though simulated time stands still); ~lockstep (false: for repeatable runs, a tick for every
/// sample in the order of stamps, see session/lockstep.h; the simulation needs it too); ~lockstep_timeout_s (2; wall
/// time after which a silent device or simulation ends the lockstep).
///
/// Threads: the haptic loop (haptic_loop.h) computes forces and waits for nothing; callbacks, from any threads, prepare
/// what it needs, those of the device in a thread of their own; another one publishes what it gives. Poses age by the
/// monotonic clock from when they were heard; in simulated time, from their stamps.
class ToolNode {
 public:
  ToolNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  ~ToolNode();
  ToolNode(const ToolNode&) = delete;
  ToolNode& operator=(const ToolNode&) = delete;

 private:
  /// What the publishing thread must know of a rig.
  struct RigNotes {
    std::uint64_t generation = 0;
    std::string frame_id;
    std::vector<core::ToolConfig> tools;
  };

  void startLoop(const ros::NodeHandle& private_node);
  void startLockstep(const ros::NodeHandle& private_node);
  void subscribe();
  void advertise();
  core::DeviceTopics device() const;
  bool forcesAllowed() const;
  void hearScene(const Scene::ConstPtr& message);
  void hearVolume(const Volume::ConstPtr& message);
  void hearTopology(const GridTopology::ConstPtr& message);
  void hearPatch(const GridPatch::ConstPtr& message);
  void hearPose(const geometry_msgs::PoseStamped::ConstPtr& message);
  void hearVelocity(const geometry_msgs::TwistStamped::ConstPtr& message);

  // Need the lock of the scene.
  void makeRig();
  void giveHand();
  void forgetPatches();
  PatchParcel emptyParcel(std::size_t tool);
  void prepare(const core::GridPatch& patch, std::size_t tool);

  double poseDelay(const ros::Time& stamp) const;
  std::string volumeFrame() const;
  std::string expectedFrame() const;

  // The publishing thread's.
  void publishTicks();
  void publish(const LoopTick& tick);
  void publishServo(const core::Vector3& force_n, std_msgs::Header header);
  void publishState(const LoopTick& tick, const RigNotes& notes, const std_msgs::Header& header);
  std::shared_ptr<const RigNotes> notesOf(std::uint64_t generation);

  // The lockstep's thread's.
  void publishProgress(const core::ToolNotice& notice);
  void leaveLockstep(std::uint64_t session, const std::string& reason);

  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);
  void summarize(diagnostic_updater::DiagnosticStatusWrapper& status, const LoopTick& tick) const;
  void addLockstep(diagnostic_updater::DiagnosticStatusWrapper& status) const;
  void addLoop(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  std::optional<core::DeviceProfile> profile_;
  double rate_hz_ = 1000.0;
  ros::Publisher force_publisher_, cut_publisher_, state_publisher_, servo_publisher_, progress_publisher_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;
  ros::CallbackQueue device_queue_;  // of its own, so that no volume or patch holds a pose up
  ros::AsyncSpinner device_spinner_{1, &device_queue_};
  ros::NodeHandle device_handle_;
  std::unique_ptr<OperatingStateListener> operating_state_;
  std::unique_ptr<DeviceButtons> device_buttons_;
  std::unique_ptr<HapticLoop> loop_;  // one of these two
  std::unique_ptr<LockstepLoop> lockstep_;

  std::mutex mutex_;  // guards what the scene made, below, and serialises what goes to the loop
  std::shared_ptr<const core::Scene> scene_;
  std::uint64_t session_ = 0;  // of the scene
  std::uint64_t volume_session_ = 0;
  std::uint64_t hand_session_ = 0;  // that the lockstep's hand works in
  std::shared_ptr<const core::Volume> volume_;
  core::TopologyDecoder topologies_;
  std::uint64_t generation_ = 0;
  std::vector<core::PatchIntake> intakes_;  // of the newest rig's tools
  std::vector<PatchParcel> spare_;

  mutable std::mutex frame_mutex_;  // guards frame_id_
  std::string frame_id_ = "volume";
  std::int64_t last_stamp_ns_ = 0;  // of the poses; their callbacks come one by one

  std::mutex notes_mutex_;  // guards notes_ and newest_
  std::deque<std::shared_ptr<const RigNotes>> notes_;
  std::optional<LoopTick> newest_;

  // The publishing thread's.
  std::uint64_t state_sequence_ = 0;
  std::atomic<bool> running_{true};
  std::thread publisher_;

  /// Counts at the last diagnostics, so that percentiles are of the last seconds.
  struct Looked {
    TimeCounts::Counts periods{};
    TimeCounts::Counts work{};
  };
  std::deque<Looked> looked_;

  std::vector<ros::Subscriber> subscribers_;  // last: nothing is heard before all else is there, or after it has gone
  ros::ServiceServer reset_service_;
};

}  // namespace soft_volume
