#pragma once

#include <ros/node_handle.h>
#include <sensor_msgs/JointState.h>
#include <sensor_msgs/Joy.h>

#include <atomic>
#include <cstdint>
#include <vector>

#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume {

/// The tool's buttons from the topics of a device file. A button is pressed while its value is 1: drivers of the cisst
/// family send 2 for a click that is over. Thread-safe; buttons() takes no lock.
class DeviceButtons {
 public:
  DeviceButtons(ros::NodeHandle& node, const std::vector<core::ButtonSource>& sources, IncidentLog& incidents);
  DeviceButtons(const DeviceButtons&) = delete;
  DeviceButtons& operator=(const DeviceButtons&) = delete;

  core::Buttons buttons() const { return core::Buttons(bits_.load()); }

 private:
  void hearJoy(const core::ButtonSource& source, const sensor_msgs::Joy& message);
  void hearJoint(const core::ButtonSource& source, const sensor_msgs::JointState& message);
  void set(std::uint32_t button, bool pressed);

  IncidentLog* incidents_;
  std::atomic<std::uint32_t> bits_{0};
  std::vector<ros::Subscriber> subscribers_;
};

}  // namespace soft_volume
