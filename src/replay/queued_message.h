#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/replay/bag_recorder.h"

namespace soft_volume {

/// A message on its way into a bag.
struct QueuedMessage {
  std::string topic;
  ros::Time receipt;
  boost::shared_ptr<const AnyMessage> message;  ///< null: the next part begins here
  boost::shared_ptr<ros::M_string> header;
  bool latched = false;
  std::size_t start_messages = 0;  ///< without a message: so many that follow are what the part begins with

  /// What it takes in memory.
  std::uint64_t bytes() const {
    constexpr std::uint64_t kOverhead = 256;
    return (message ? message->size() : 0) + kOverhead;
  }
};

inline std::vector<std::uint8_t> contentOf(const AnyMessage& message) {
  std::vector<std::uint8_t> bytes(message.size());
  ros::serialization::OStream stream(bytes.data(), message.size());
  message.write(stream);
  return bytes;
}

}  // namespace soft_volume
