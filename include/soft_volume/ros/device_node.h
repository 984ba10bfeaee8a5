#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <geometry_msgs/WrenchStamped.h>
#include <ros/node_handle.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "soft_volume/ros/incident_log.h"
#include "soft_volume/tool/virtual_device.h"

namespace soft_volume {

/// A virtual haptic device that behaves like a driver (CRTK names): publishes measured_cp, measured_cv and joy at 1 kHz
/// of ROS time and obeys servo_cf. Its hand follows the script of the scene's device section.
///
/// Private parameters: ~scene (file; only its device section is used), ~frame_id ("volume").
///
/// One tick per millisecond of ROS time: ticks that the machine missed are made up for, so that no sample of the script
/// is lost under use_sim_time. In real time a stall of more than 100 ms is skipped instead, as a driver would.
class DeviceNode {
 public:
  DeviceNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  ~DeviceNode();
  DeviceNode(const DeviceNode&) = delete;
  DeviceNode& operator=(const DeviceNode&) = delete;

 private:
  void hearServo(const geometry_msgs::WrenchStamped::ConstPtr& message);
  void run();
  void tick(const ros::Time& stamp);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  std::string frame_id_;
  std::unique_ptr<core::VirtualDevice> device_;
  ros::Publisher pose_publisher_, velocity_publisher_, button_publisher_;
  ros::Subscriber servo_subscriber_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;
  std::mutex mutex_;  // guards the device
  std::uint64_t skipped_ticks_ = 0;
  std::atomic<bool> running_{true};
  std::thread thread_;
};

}  // namespace soft_volume
