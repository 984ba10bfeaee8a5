#include "soft_volume/ros/device_buttons.h"

#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/ros/checked_subscription.h"

namespace soft_volume {

DeviceButtons::DeviceButtons(ros::NodeHandle& node, const std::vector<core::ButtonSource>& sources,
                             IncidentLog& incidents, std::uint32_t queue, Heard heard)
    : incidents_(&incidents), heard_(std::move(heard)) {
  for (const core::ButtonSource& source : sources) {
    if (source.closed_below)
      subscribe<sensor_msgs::JointState>(node, source, queue);
    else
      subscribe<sensor_msgs::Joy>(node, source, queue);
  }
}

template <typename Message>
void DeviceButtons::subscribe(ros::NodeHandle& node, const core::ButtonSource& source, std::uint32_t queue) {
  const std::size_t topic = subscribers_.size();
  subscribers_.push_back(subscribeChecked<Message>(
      node, source.topic, queue, [this, source, topic](const auto& message) { hear(source, topic, *message); },
      *incidents_));
}

template <typename Message>
void DeviceButtons::hear(const core::ButtonSource& source, std::size_t topic, const Message& message) {
  try {
    const ButtonChange change = readButtons(source, message);
    const auto mask = static_cast<std::uint32_t>(change.mask.to_ulong());
    bits_ = (bits_ & ~mask) | (static_cast<std::uint32_t>(change.pressed.to_ulong()) & mask);
    if (heard_)
      heard_(topic, message.header.stamp, change);
  } catch (const core::InputError& error) {
    incidents_->report(source.topic, error.what());
  }
}

}  // namespace soft_volume
