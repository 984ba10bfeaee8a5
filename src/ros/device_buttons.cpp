#include "soft_volume/ros/device_buttons.h"

#include <algorithm>
#include <cmath>

#include "soft_volume/ros/checked_subscription.h"

namespace soft_volume {

DeviceButtons::DeviceButtons(ros::NodeHandle& node, const std::vector<core::ButtonSource>& sources,
                             IncidentLog& incidents)
    : incidents_(&incidents) {
  for (const core::ButtonSource& source : sources) {
    if (source.closed_below) {
      subscribers_.push_back(subscribeChecked<sensor_msgs::JointState>(
          node, source.topic, 10, [this, source](const auto& message) { hearJoint(source, *message); }, incidents));
    } else {
      subscribers_.push_back(subscribeChecked<sensor_msgs::Joy>(
          node, source.topic, 100, [this, source](const auto& message) { hearJoy(source, *message); }, incidents));
    }
  }
}

void DeviceButtons::hearJoy(const core::ButtonSource& source, const sensor_msgs::Joy& message) {
  for (std::uint32_t b = 0; b < source.count; ++b) {
    const std::size_t index = source.first + b;
    set(source.as + b, index < message.buttons.size() && message.buttons[index] == 1);
  }
}

void DeviceButtons::hearJoint(const core::ButtonSource& source, const sensor_msgs::JointState& message) {
  if (message.position.empty() || !std::isfinite(message.position.front()))
    return incidents_->report(source.topic, "the joint has no position");
  set(source.as, message.position.front() < *source.closed_below);
}

void DeviceButtons::set(std::uint32_t button, bool pressed) {
  const std::uint32_t bit = std::uint32_t(1) << button;
  if (pressed)
    bits_ |= bit;
  else
    bits_ &= ~bit;
}

}  // namespace soft_volume
