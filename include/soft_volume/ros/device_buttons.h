#pragma once

#include <ros/node_handle.h>

#include <atomic>
#include <cstdint>
#include <functional>
#include <vector>

#include "soft_volume/messages/button_messages.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume {

/// The tool's buttons from the topics of a device file. Thread-safe; buttons() takes no lock.
class DeviceButtons {
 public:
  /// Called with every message, beside what buttons() says.
  using Heard = std::function<void(std::size_t topic, const ros::Time& stamp, const ButtonChange& change)>;

  /// `queue`: messages that may wait in a subscriber, 0 for any number.
  DeviceButtons(ros::NodeHandle& node, const std::vector<core::ButtonSource>& sources, IncidentLog& incidents,
                std::uint32_t queue = 100, Heard heard = nullptr);
  DeviceButtons(const DeviceButtons&) = delete;
  DeviceButtons& operator=(const DeviceButtons&) = delete;

  core::Buttons buttons() const { return core::Buttons(bits_.load()); }

 private:
  template <typename Message>
  void subscribe(ros::NodeHandle& node, const core::ButtonSource& source, std::uint32_t queue);
  template <typename Message>
  void hear(const core::ButtonSource& source, std::size_t topic, const Message& message);

  IncidentLog* incidents_;
  std::atomic<std::uint32_t> bits_{0};
  Heard heard_;
  std::vector<ros::Subscriber> subscribers_;
};

}  // namespace soft_volume
