#pragma once

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <ros/node_handle.h>
#include <std_msgs/Header.h>

#include "soft_volume/messages/conversions.h"
#include "soft_volume/scene/device_profile.h"

namespace soft_volume {

/// Publishes where a device is, as a CRTK driver does: measured_cp and, where it has the topic, measured_cv.
class PosePublisher {
 public:
  PosePublisher() = default;  ///< of nothing
  PosePublisher(ros::NodeHandle& node, const core::DeviceTopics& topics, std::uint32_t queue_size)
      : pose_(node.advertise<geometry_msgs::PoseStamped>(topics.measured_cp, queue_size)) {
    if (!topics.measured_cv.empty())
      velocity_ = node.advertise<geometry_msgs::TwistStamped>(topics.measured_cv, queue_size);
  }

  void publish(const std_msgs::Header& header, const core::Pose& pose, const core::Vector3& velocity_m_s,
               const core::Vector3& turn_rad_s = core::Vector3::Zero()) {
    if (velocity_) {
      geometry_msgs::TwistStamped message;
      message.header = header;
      message.twist.linear = toVector(velocity_m_s);
      message.twist.angular = toVector(turn_rad_s);
      velocity_.publish(message);
    }
    geometry_msgs::PoseStamped message;
    message.header = header;
    message.pose = toPose(pose);
    pose_.publish(message);  // last: it is what makes the tool act
  }

 private:
  ros::Publisher pose_, velocity_;
};

}  // namespace soft_volume
