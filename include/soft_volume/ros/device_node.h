#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <thread>

#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/tool/virtual_device.h"

namespace soft_volume {

class VirtualDriver;

/// A virtual haptic device that behaves like a driver. Its hand follows the script of the scene's device section.
///
/// Private parameters: ~scene (file; only its device section and its first camera are used), ~device (device file;
/// none by default), ~frame_id ("volume"; without a device file only).
///
/// Without a device file it publishes measured_cp, measured_cv and joy at 1 kHz of ROS time in the volume frame and
/// obeys servo_cf. With one it is that device: its limits and mechanics, its topics and messages, in its base frame, at
/// its rate. A driver with an operating_state obeys `state_command` (enable, disable). A keyboard cannot be played: the
/// node then does nothing.
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
  void start(const core::DeviceProfile& profile, bool every_tick);
  void run();
  void tick(const ros::Time& stamp);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  std::int64_t publish_every_ = 1;  ///< ticks
  std::unique_ptr<core::VirtualDevice> device_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;
  std::mutex mutex_;  // guards the device
  std::unique_ptr<VirtualDriver> driver_;
  std::uint64_t skipped_ticks_ = 0;
  std::int64_t ticks_ = 0;
  std::atomic<bool> running_{true};
  std::thread thread_;
};

}  // namespace soft_volume
