#pragma once

#include <std_msgs/Header.h>

#include <cstdint>
#include <string>
#include <vector>

namespace soft_volume {

/// How our messages begin, and what some types say next.
struct MessageStart {
  std_msgs::Header header;
  std::uint64_t session = 0;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;
  std::uint64_t first_step = 0;  ///< of a journal
  std::uint64_t base_step = 0;   ///< of a state
  double time_s = 0.0;           ///< of a state: simulated time
  bool key_frame = false;        ///< of a state
  bool delta = false;            ///< of a topology
};

/// `type` is "package/Name". Throws ros::serialization::StreamOverrunException when the message is too short.
MessageStart readMessageStart(const std::string& type, std::vector<std::uint8_t>& bytes);

}  // namespace soft_volume
