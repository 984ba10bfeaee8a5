#include "soft_volume/ros/adapter_node.h"

#include <ros/console.h>
#include <ros/init.h>
#include <sensor_msgs/Joy.h>

#include <algorithm>
#include <string>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/parameters.h"

namespace soft_volume {
namespace {

constexpr double kWatchInterval_s = 0.002;

core::Vector3 vectorOf(const RuntimeFields& fields, const std::string& name) {
  return {fields.number(name + ".x"), fields.number(name + ".y"), fields.number(name + ".z")};
}

ros::Time stampOf(const RuntimeFields& fields) {
  return {static_cast<std::uint32_t>(fields.number("header.stamp.secs")),
          static_cast<std::uint32_t>(fields.number("header.stamp.nsecs"))};
}

}  // namespace

AdapterNode::AdapterNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node),
      profile_(core::loadDeviceProfile(
          requiredParameter<std::string>(private_node, "device", "the device file of the driver"))),
      diagnostics_(node, private_node) {
  if (profile_.style == core::DeviceStyle::kOmni) {
    start();
  } else {
    ROS_INFO("%s does not speak omni_msgs: there is nothing to adapt", profile_.name.c_str());
    if (!parameter<bool>(private_node, "stay", false))
      ros::requestShutdown();
  }
}

AdapterNode::~AdapterNode() {
  if (driving_)
    sendForce(core::Vector3::Zero());
}

void AdapterNode::start() {
  pose_publisher_ = PosePublisher(node_, profile_.topics, 100);
  if (!profile_.topics.buttons.empty())
    button_publisher_ = node_.advertise<sensor_msgs::Joy>(profile_.topics.buttons.front().topic, 100, true);
  force_publisher_ = advertise(node_, omniFeedbackType(), profile_.omni.force_feedback, 1);
  const ros::TransportHints hints = ros::TransportHints().tcpNoDelay();
  state_subscriber_ = node_.subscribe(profile_.omni.state, 10, &AdapterNode::hearState, this, hints);
  button_subscriber_ = node_.subscribe(profile_.omni.button, 100, &AdapterNode::hearButtons, this, hints);
  if (!profile_.topics.servo_cf.empty()) {
    servo_subscriber_ = subscribeChecked<geometry_msgs::WrenchStamped>(
        node_, profile_.topics.servo_cf, 1, [this](const geometry_msgs::WrenchStamped::ConstPtr& m) { hearServo(*m); },
        incidents_);
    watch_timer_ =
        node_.createWallTimer(ros::WallDuration(kWatchInterval_s), [this](const ros::WallTimerEvent&) { watch(); });
  }
  diagnostics_.setHardwareID(profile_.name);
  diagnostics_.add("adapter", this, &AdapterNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
}

/// A state that cannot be read is as good as none: no pose goes out, and the tool takes the force to zero.
void AdapterNode::hearState(const topic_tools::ShapeShifter& message) {
  try {
    publishState(state_reader_.read(message));
    ++states_;
  } catch (const core::Error& error) {
    incidents_.report(profile_.omni.state, error.what());
  }
}

void AdapterNode::publishState(const RuntimeFields& fields) {
  lock_position_ = vectorOf(fields, "pose.position");
  std_msgs::Header header;
  header.stamp = stampOf(fields);
  header.frame_id = profile_.base_frame;
  const std::string q = "pose.orientation.";
  const core::Quaternion orientation(fields.number(q + "w"), fields.number(q + "x"), fields.number(q + "y"),
                                     fields.number(q + "z"));
  const double unit_m = profile_.omni.position_unit_m;
  const core::Vector3 velocity =
      profile_.topics.measured_cv.empty() ? core::Vector3(core::Vector3::Zero()) : vectorOf(fields, "velocity");
  pose_publisher_.publish(header, {unit_m * lock_position_, profile_.omni.orientation_frame * orientation},
                          unit_m * velocity);
}

void AdapterNode::hearButtons(const topic_tools::ShapeShifter& message) {
  try {
    const RuntimeFields fields = button_reader_.read(message);
    sensor_msgs::Joy joy;
    joy.header.stamp = ros::Time::now();
    for (const char* button : {"grey_button", "white_button"})
      joy.buttons.push_back(fields.number(button) != 0.0 ? 1 : 0);
    if (button_publisher_)
      button_publisher_.publish(joy);
  } catch (const core::Error& error) {
    incidents_.report(profile_.omni.button, error.what());
  }
}

void AdapterNode::hearServo(const geometry_msgs::WrenchStamped& message) {
  servo_heard_ = ros::SteadyTime::now();
  servo_force_n_ = fromVector(message.wrench.force);
  if (!core::isFinite(servo_force_n_)) {
    incidents_.report(profile_.topics.servo_cf, "the force is not finite; it is taken as zero");
    servo_force_n_.setZero();
  }
  sendForce(servo_force_n_);
}

/// The wall clock's job even under simulated time: the motor does not know of it.
void AdapterNode::watch() {
  if (!driving_)
    return;
  const double silence_s = (ros::SteadyTime::now() - servo_heard_).toSec();
  if (silence_s <= profile_.safety.stale_after_s)
    return;
  const double left = 1.0 - (silence_s - profile_.safety.stale_after_s) / profile_.safety.drop_s;
  sendForce(std::max(0.0, left) * servo_force_n_);
}

void AdapterNode::sendForce(const core::Vector3& force_n) {
  driving_ = !force_n.isZero(0.0);
  force_publisher_.publish(makeMessage(omniFeedbackType(), toVector(force_n), toVector(lock_position_)));
}

void AdapterNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  using diagnostic_msgs::DiagnosticStatus;
  if (states_ == 0)
    status.summary(DiagnosticStatus::OK, "waiting for " + profile_.omni.state);
  else
    status.summary(DiagnosticStatus::OK, driving_ ? "driving" : "no force");
  status.add("states", states_);
  status.add("force [N]", driving_ ? servo_force_n_.norm() : 0.0);
  incidents_.addTo(status);
}

}  // namespace soft_volume
