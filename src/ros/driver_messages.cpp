#include "soft_volume/ros/driver_messages.h"

#include <geometry_msgs/Pose.h>
#include <geometry_msgs/Vector3.h>
#include <std_msgs/Header.h>

namespace soft_volume {
namespace {

/// The definition of a type that a message contains, as a connection header lists it.
template <typename Message>
std::string contained() {
  return std::string(80, '=') + "\nMSG: " + ros::message_traits::datatype<Message>() + "\n" +
         ros::message_traits::definition<Message>() + "\n";
}

}  // namespace

const DriverType& omniStateType() {
  static const DriverType type{"omni_msgs/OmniState", "89c2a741de66e9e904f59a02b171dd6e",
                               "std_msgs/Header header\nbool locked\nbool close_gripper\ngeometry_msgs/Pose pose\n"
                               "geometry_msgs/Vector3 current\ngeometry_msgs/Vector3 velocity\n" +
                                   contained<std_msgs::Header>() + contained<geometry_msgs::Pose>() +
                                   contained<geometry_msgs::Vector3>()};
  return type;
}

const DriverType& omniFeedbackType() {
  static const DriverType type{
      "omni_msgs/OmniFeedback", "e9083ac4fd95494e94fbb0c0f90b6c00",
      "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 position\n" + contained<geometry_msgs::Vector3>()};
  return type;
}

const DriverType& omniButtonType() {
  static const DriverType type{"omni_msgs/OmniButtonEvent", "fb77877e6b639935c3360838062f05f0",
                               "int32 grey_button\nint32 white_button\n"};
  return type;
}

const DriverType& operatingStateType() {
  static const DriverType type{
      "crtk_msgs/operating_state", "b1bd4021639d9d9c5fbfff78d6ff3158",
      "std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy\n" + contained<std_msgs::Header>()};
  return type;
}

const DriverType& stringStampedType() {
  static const DriverType type{"crtk_msgs/StringStamped", "5e3e46086181199270f1ac3a28a5977f",
                               "std_msgs/Header header\nstring string\n" + contained<std_msgs::Header>()};
  return type;
}

ros::Publisher advertise(ros::NodeHandle& node, const DriverType& type, const std::string& topic,
                         std::uint32_t queue_size, bool latch) {
  ros::AdvertiseOptions options(topic, queue_size, type.md5, type.name, type.definition);
  options.latch = latch;
  return node.advertise(options);
}

RuntimeFields DriverReader::read(const topic_tools::ShapeShifter& message) {
  if (!layout_ || md5_ != message.getMD5Sum()) {
    layout_.emplace(message.getDataType(), message.getMessageDefinition());
    md5_ = message.getMD5Sum();
  }
  std::vector<std::uint8_t> bytes(message.size());
  ros::serialization::OStream out(bytes.data(), message.size());
  message.write(out);
  return layout_->read(bytes.data(), bytes.size());
}

}  // namespace soft_volume
