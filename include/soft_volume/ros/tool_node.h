#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <ros/node_handle.h>
#include <sensor_msgs/Joy.h>
#include <soft_volume/GridPatch.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/Scene.h>
#include <soft_volume/Volume.h>
#include <std_msgs/Header.h>
#include <std_srvs/Trigger.h>

#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/grid/topology_delta.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume {

/// The tools of the scene in the hand of one haptic device (CRTK names): turns measured_cp, measured_cv and joy into
/// tool/force, tool/cut, tool/state and servo_cf. One tool is in the hand at a time; the scene's swap button puts the
/// next one there. Service tool/reset ends a safety trip.
///
/// Private parameters: ~wall_timeout_s (0.25; with use_sim_time: a pose older than this by the wall clock is stale even
/// though simulated time stands still).
///
/// A force is computed at every pose, and every 5 ms without one, so that a device that falls silent is taken to zero.
/// Threads: all callbacks may come from several threads; one lock serialises them.
class ToolNode {
 public:
  ToolNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  ToolNode(const ToolNode&) = delete;
  ToolNode& operator=(const ToolNode&) = delete;

 private:
  void hearScene(const Scene::ConstPtr& message);
  void hearVolume(const Volume::ConstPtr& message);
  void hearTopology(const GridTopology::ConstPtr& message);
  void hearPatch(const GridPatch::ConstPtr& message);
  void hearPose(const geometry_msgs::PoseStamped::ConstPtr& message);
  void hearVelocity(const geometry_msgs::TwistStamped::ConstPtr& message);
  void hearButtons(const sensor_msgs::Joy::ConstPtr& message);
  void watch();

  // Need the lock.
  void makeTools();
  void swapTool();
  void update();
  double now() const;
  std_msgs::Header poseHeader() const;
  void publish(const core::ToolOutput& output);
  void publishCut(const std::optional<core::TissueCut>& command, const std_msgs::Header& header);
  void publishState(const core::ToolOutput& output, const std_msgs::Header& header);
  core::Tool& tool() { return *tools_[selected_]; }
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  double wall_timeout_s_;
  ros::Publisher force_publisher_, cut_publisher_, state_publisher_, servo_publisher_;
  std::vector<ros::Subscriber> subscribers_;
  ros::ServiceServer reset_service_;
  ros::WallTimer watchdog_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;

  std::mutex mutex_;  // guards everything below
  std::shared_ptr<const core::Scene> scene_;
  std::shared_ptr<const core::Volume> volume_;
  core::TopologyDecoder topologies_;
  std::string frame_id_ = "volume";
  std::vector<std::unique_ptr<core::Tool>> tools_;
  std::size_t selected_ = 0;

  core::ToolInput input_;
  bool has_pose_ = false;
  ros::WallTime pose_heard_;
  std::uint64_t state_sequence_ = 0;
  core::ToolOutput last_output_;
  std::uint64_t swaps_ = 0;
};

}  // namespace soft_volume
