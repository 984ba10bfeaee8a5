#include "soft_volume/ros/teleop_node.h"

#include <ros/console.h>
#include <ros/init.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>

#include "soft_volume/messages/conversions.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/parameters.h"

namespace soft_volume {
namespace {

constexpr double kMouseTimeout_s = 0.2;
/// A longer pause (a stall, or a clock that stood still) moves the tool no farther than this.
constexpr double kLongestStep_s = 0.02;
constexpr std::size_t kKeyboardButtons = 2;

}  // namespace

TeleopNode::TeleopNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node),
      profile_(core::loadDeviceProfile(
          requiredParameter<std::string>(private_node, "device", "the device file of the mouse or the keyboard"))),
      teleoperation_(profile_.teleop, profile_.mapping.device_centre_m, profile_.limits.workspace_radius_m),
      diagnostics_(node, private_node) {
  if (profile_.style == core::DeviceStyle::kJoy || profile_.style == core::DeviceStyle::kKeyboard) {
    start();
  } else {
    ROS_INFO("%s is neither a 6-axis mouse nor a keyboard: there is nothing to do here", profile_.name.c_str());
    if (!parameter<bool>(private_node, "stay", false))
      ros::requestShutdown();
  }
}

TeleopNode::~TeleopNode() {
  running_ = false;
  if (thread_.joinable())
    thread_.join();
}

void TeleopNode::start() {
  pose_publisher_ = PosePublisher(node_, profile_.topics, 100);
  if (profile_.style == core::DeviceStyle::kJoy) {
    joy_subscriber_ = subscribeChecked<sensor_msgs::Joy>(
        node_, profile_.teleop.joy, 10, [this](const sensor_msgs::Joy::ConstPtr& m) { hearJoy(*m); }, incidents_);
  } else {
    terminal_.emplace();
    if (!profile_.topics.buttons.empty())
      button_publisher_ = node_.advertise<sensor_msgs::Joy>(profile_.topics.buttons.front().topic, 100, true);
    std::printf("%s", core::Keyboard::kHelp);
    std::fflush(stdout);
  }
  diagnostics_.setHardwareID(profile_.name);
  diagnostics_.add("teleop", this, &TeleopNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
  thread_ = std::thread([this] { run(); });
}

void TeleopNode::hearJoy(const sensor_msgs::Joy& message) {
  if (message.axes.size() < 6)
    return incidents_.report(profile_.teleop.joy, "the mouse has " + std::to_string(message.axes.size()) +
                                                      " axes, but 6 are needed: x, y, z and about x, y, z");
  const auto& axes = message.axes;
  const std::lock_guard<std::mutex> lock(mutex_);
  mouse_ = {core::Vector3(axes[0], axes[1], axes[2]), core::Vector3(axes[3], axes[4], axes[5])};
  mouse_heard_ = ros::SteadyTime::now();
}

void TeleopNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  status.summary(diagnostic_msgs::DiagnosticStatus::OK, terminal_ ? "keyboard" : "mouse");
  incidents_.addTo(status);
}

/// Poses are stamped with ROS time, which may be simulated and stand still: then there is nothing to publish.
void TeleopNode::run() {
  ros::WallRate rate(profile_.rate_hz);
  ros::Time last;
  while (running_ && ros::ok()) {
    const ros::Time now = ros::Time::now();
    if (!now.isZero() && now != last) {
      const double dt_s = last.isZero() ? 0.0 : (now - last).toSec();
      tick(now, std::clamp(dt_s, 0.0, kLongestStep_s));
      last = now;
    }
    rate.sleep();
  }
}

core::Deflection TeleopNode::deflection() {
  if (terminal_)
    return keyboard_.deflection(ros::SteadyTime::now().toSec());
  const std::lock_guard<std::mutex> lock(mutex_);
  return (ros::SteadyTime::now() - mouse_heard_).toSec() <= kMouseTimeout_s ? mouse_ : core::Deflection();
}

void TeleopNode::readKeys() {
  const double now_s = ros::SteadyTime::now().toSec();
  for (const char key : terminal_->read())
    keyboard_.press(key, now_s);
  publishButtons(keyboard_.buttons(now_s));
}

void TeleopNode::publishButtons(const core::Buttons& buttons) {
  if (!button_publisher_ || buttons == published_buttons_)
    return;
  sensor_msgs::Joy joy;
  joy.header.stamp = ros::Time::now();
  for (std::size_t b = 0; b < kKeyboardButtons; ++b)
    joy.buttons.push_back(buttons[b] ? 1 : 0);
  button_publisher_.publish(joy);
  published_buttons_ = buttons;
}

void TeleopNode::tick(const ros::Time& now, double dt_s) {
  if (terminal_)
    readKeys();
  teleoperation_.step(deflection(), dt_s);
  std_msgs::Header header;
  header.stamp = now;
  header.frame_id = profile_.base_frame;
  pose_publisher_.publish(header, teleoperation_.pose(), teleoperation_.velocity_m_s(), teleoperation_.turn_rad_s());
}

}  // namespace soft_volume
