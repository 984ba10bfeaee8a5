#pragma once

#include <ros/node_handle.h>

#include <functional>
#include <memory>

#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume {

/// What a device does at one time; base frame.
struct DeviceSample {
  ros::Time stamp;
  core::Pose pose;
  core::Vector3 velocity_m_s;
  core::Buttons buttons;
};

/// Speaks and listens as a driver of some style does. publish() and the callback may be in different threads.
class VirtualDriver {
 public:
  /// A force on the device, base frame; zero while the driver is disabled.
  using ForceCallback = std::function<void(const core::Vector3&)>;

  virtual ~VirtualDriver() = default;
  virtual void publish(const DeviceSample& sample) = 0;
};

/// The driver that a device file describes; a mouse is moved so that the tool follows the samples. `every_tick`
/// publishes the buttons with every sample instead of when they change. `incidents` must outlive it.
std::unique_ptr<VirtualDriver> makeVirtualDriver(const ros::NodeHandle& node, const core::DeviceProfile& profile,
                                                 bool every_tick, IncidentLog& incidents,
                                                 const VirtualDriver::ForceCallback& take_force);

}  // namespace soft_volume
