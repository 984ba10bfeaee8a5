#pragma once

#include <ros/node_handle.h>
#include <ros/serialization.h>
#include <topic_tools/shape_shifter.h>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/messages/runtime_message.h"

namespace soft_volume {

/// A message type of a driver's package that is not installed here.
struct DriverType {
  const char* name;        ///< package/Type
  const char* md5;         ///< of the definition, as genmsg computes it; a receiver refuses another one
  std::string definition;  ///< with those of the types in it
};

/// omni_msgs and crtk_msgs, as their drivers define them.
const DriverType& omniStateType();       ///< header, locked, close_gripper, pose, current, velocity
const DriverType& omniFeedbackType();    ///< force, position
const DriverType& omniButtonType();      ///< grey_button, white_button
const DriverType& operatingStateType();  ///< header, state, is_homed, is_busy
const DriverType& stringStampedType();   ///< header, string

ros::Publisher advertise(ros::NodeHandle& node, const DriverType& type, const std::string& topic,
                         std::uint32_t queue_size, bool latch = false);

/// A message made of its fields in order, each of which is a ROS type or a primitive.
template <typename... Fields>
topic_tools::ShapeShifter makeMessage(const DriverType& type, const Fields&... fields) {
  std::vector<std::uint8_t> bytes((0 + ... + ros::serialization::serializationLength(fields)));
  ros::serialization::OStream out(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  (ros::serialization::serialize(out, fields), ...);
  topic_tools::ShapeShifter message;
  message.morph(type.md5, type.name, type.definition, "");
  ros::serialization::IStream in(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  message.read(in);
  return message;
}

/// Reads messages of a topic by the names of their fields; remembers the type between them.
class DriverReader {
 public:
  /// Throws core::InputError when the message cannot be read.
  RuntimeFields read(const topic_tools::ShapeShifter& message);

 private:
  std::string md5_;
  std::optional<RuntimeLayout> layout_;
};

}  // namespace soft_volume
