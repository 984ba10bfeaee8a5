#pragma once

#include <ros/message_traits.h>

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/messages/checked_stream.h"
#include "soft_volume/replay/replay_bag.h"

namespace soft_volume {

/// Deserialises the whole of `bytes`. Throws ReplayError when they are not exactly one message.
template <typename Message>
Message parseMessage(std::vector<std::uint8_t> bytes) {
  Message message;
  CheckedStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  try {
    stream.next(message);
  } catch (const std::exception& error) {
    stream = CheckedStream(bytes.data(), 1);
  }
  if (stream.getLength() != 0) {
    throw ReplayError(std::string("the bag is damaged: a ") + ros::message_traits::datatype<Message>() +
                      " in it cannot be read");
  }
  return message;
}

}  // namespace soft_volume
