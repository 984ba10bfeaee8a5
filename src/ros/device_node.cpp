#include "soft_volume/ros/device_node.h"

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>
#include <ros/init.h>
#include <sensor_msgs/Joy.h>

#include <chrono>
#include <cmath>

#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/parameters.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {
namespace {

/// More missed ticks than this are a stall, not jitter (real time only).
constexpr std::int64_t kStallTicks = 100;
constexpr std::size_t kPublishedButtons = 8;

}  // namespace

DeviceNode::DeviceNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node), diagnostics_(node, private_node) {
  const auto scene_file =
      requiredParameter<std::string>(private_node, "scene", "the scene file whose device section is played");
  frame_id_ = parameter<std::string>(private_node, "frame_id", "volume");
  device_ = std::make_unique<core::VirtualDevice>(core::loadScene(scene_file).device);
  pose_publisher_ = node_.advertise<geometry_msgs::PoseStamped>(topics::kMeasuredPose, 1000);
  velocity_publisher_ = node_.advertise<geometry_msgs::TwistStamped>(topics::kMeasuredVelocity, 1000);
  button_publisher_ = node_.advertise<sensor_msgs::Joy>(topics::kButtons, 1000);
  servo_subscriber_ =
      node_.subscribe(topics::kServoForce, 10, &DeviceNode::hearServo, this, ros::TransportHints().tcpNoDelay());
  diagnostics_.setHardwareID("virtual haptic device");
  diagnostics_.add("device", this, &DeviceNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
  thread_ = std::thread([this] { run(); });
}

DeviceNode::~DeviceNode() {
  running_ = false;
  thread_.join();
}

void DeviceNode::hearServo(const geometry_msgs::WrenchStamped::ConstPtr& message) {
  const core::Vector3 force = fromVector(message->wrench.force);
  if (!core::isFinite(force))
    incidents_.report(topics::kServoForce, "the force is not finite; it is taken as zero");
  const std::lock_guard<std::mutex> lock(mutex_);
  device_->setServoForce(force);
}

void DeviceNode::run() {
  ros::Time start;
  std::int64_t ticks = 0;
  while (running_ && ros::ok()) {
    const ros::Time now = ros::Time::now();
    if (start.isZero())
      start = now;  // simulated time is zero until its first clock message
    std::int64_t due =
        start.isZero()
            ? 0
            : static_cast<std::int64_t>(std::floor((now - start).toSec() / core::VirtualDevice::kStep_s + 1e-6));
    if (ros::Time::useSystemTime() && due - ticks > kStallTicks) {
      skipped_ticks_ += static_cast<std::uint64_t>(due - ticks - 1);
      start += ros::Duration(static_cast<double>(due - ticks - 1) * core::VirtualDevice::kStep_s);
      due = ticks + 1;
    }
    for (; ticks < due && running_; ++ticks) {
      tick(start + ros::Duration(static_cast<double>(ticks + 1) * core::VirtualDevice::kStep_s));
    }
    std::this_thread::sleep_for(std::chrono::microseconds(200));
  }
}

void DeviceNode::tick(const ros::Time& stamp) {
  geometry_msgs::PoseStamped pose;
  geometry_msgs::TwistStamped velocity;
  sensor_msgs::Joy joy;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    device_->step();
    pose.pose = toPose(device_->pose());
    velocity.twist.linear = toVector(device_->velocity_m_s());
    const core::Buttons buttons = device_->buttons();
    for (std::size_t b = 0; b < kPublishedButtons; ++b)
      joy.buttons.push_back(buttons[b] ? 1 : 0);
  }
  pose.header.stamp = velocity.header.stamp = joy.header.stamp = stamp;
  pose.header.frame_id = velocity.header.frame_id = frame_id_;
  button_publisher_.publish(joy);
  velocity_publisher_.publish(velocity);
  pose_publisher_.publish(pose);  // last: it is what makes the tool act
}

void DeviceNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const std::lock_guard<std::mutex> lock(mutex_);
  status.summary(diagnostic_msgs::DiagnosticStatus::OK, device_->scriptEnded() ? "the script has ended" : "playing");
  status.add("script time [s]", device_->time_s());
  status.add("force on the hand [N]", device_->handForce_n().norm());
  status.add("rendered force [N]", device_->renderedForce_n().norm());
  status.add("ticks skipped in stalls", skipped_ticks_);
  incidents_.addTo(status);
}

}  // namespace soft_volume
