#include "virtual_driver.h"

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/WrenchStamped.h>
#include <sensor_msgs/JointState.h>
#include <sensor_msgs/Joy.h>
#include <std_msgs/Header.h>

#include <algorithm>
#include <atomic>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/driver_messages.h"
#include "soft_volume/ros/pose_publisher.h"

namespace soft_volume {
namespace {

std_msgs::Header headerOf(const DeviceSample& sample, const std::string& frame) {
  std_msgs::Header header;
  header.stamp = sample.stamp;
  header.frame_id = frame;
  return header;
}

/// A driver with CRTK's topics. A gripper is a joint that opens to 1 beyond its threshold.
class CrtkDriver : public VirtualDriver {
 public:
  CrtkDriver(const ros::NodeHandle& node, const core::DeviceProfile& profile, bool every_tick, IncidentLog& incidents,
             ForceCallback take_force)
      : node_(node),
        profile_(profile),
        every_tick_(every_tick),
        incidents_(&incidents),
        take_force_(std::move(take_force)) {
    const core::DeviceTopics& topics = profile.topics;
    pose_publisher_ = PosePublisher(node_, topics, 1000);
    for (const core::ButtonSource& source : topics.buttons) {
      button_publishers_.push_back(source.closed_below
                                       ? node_.advertise<sensor_msgs::JointState>(source.topic, 1000, !every_tick)
                                       : node_.advertise<sensor_msgs::Joy>(source.topic, 1000, !every_tick));
    }
    if (!topics.servo_cf.empty()) {
      servo_subscriber_ = subscribeChecked<geometry_msgs::WrenchStamped>(
          node_, topics.servo_cf, 10, [this](const geometry_msgs::WrenchStamped::ConstPtr& m) { hearServo(*m); },
          *incidents_);
    }
    if (!topics.operating_state.empty())
      openState();
  }

  void publish(const DeviceSample& sample) override {
    orientation_.store(sample.pose.orientation);
    if (every_tick_ || sample.buttons != published_buttons_)
      publishButtons(sample);
    pose_publisher_.publish(headerOf(sample, profile_.base_frame), sample.pose, sample.velocity_m_s);
  }

 private:
  /// An orientation that two threads share.
  class SharedOrientation {
   public:
    void store(const core::Quaternion& q) {
      const std::lock_guard<std::mutex> lock(mutex_);
      q_ = q;
    }
    core::Quaternion load() const {
      const std::lock_guard<std::mutex> lock(mutex_);
      return q_;
    }

   private:
    mutable std::mutex mutex_;
    core::Quaternion q_ = core::Quaternion::Identity();
  };

  /// `state_command` lies beside `operating_state` and takes enable and disable.
  void openState() {
    const std::string& topic = profile_.topics.operating_state;
    state_publisher_ = advertise(node_, operatingStateType(), topic, 10, true);
    const std::size_t slash = topic.rfind('/');
    const std::string folder = slash == std::string::npos ? "" : topic.substr(0, slash + 1);
    command_subscriber_ = node_.subscribe(folder + "state_command", 10, &CrtkDriver::hearCommand, this);
    publishState();
  }

  void publishState() {
    std_msgs::Header header;
    header.stamp = ros::Time::now();
    const std::string state = enabled_ ? "ENABLED" : "DISABLED";
    state_publisher_.publish(makeMessage(operatingStateType(), header, state, std::uint8_t(1), std::uint8_t(0)));
  }

  void hearCommand(const topic_tools::ShapeShifter& message) {
    try {
      const std::string command = command_reader_.read(message).text("string");
      if (command != "enable" && command != "disable")
        throw core::InputError("the command is '" + command + "'; use enable or disable");
      enabled_ = command == "enable";
      if (!enabled_)
        take_force_(core::Vector3::Zero());
      publishState();
    } catch (const core::Error& error) {
      incidents_->report("state_command", error.what());
    }
  }

  void hearServo(const geometry_msgs::WrenchStamped& message) {
    core::Vector3 force = fromVector(message.wrench.force);
    if (!core::isFinite(force)) {
      incidents_->report(profile_.topics.servo_cf, "the force is not finite; it is taken as zero");
      force.setZero();
    }
    if (profile_.mapping.force_frame == core::ForceFrame::kBody)
      force = orientation_.load() * force;
    take_force_(enabled_ ? force : core::Vector3::Zero());
  }

  void publishButtons(const DeviceSample& sample) {
    for (std::size_t n = 0; n < button_publishers_.size(); ++n) {
      const core::ButtonSource& source = profile_.topics.buttons[n];
      if (source.closed_below)
        publishJoint(sample, source, button_publishers_[n]);
      else
        publishJoy(sample, source, button_publishers_[n]);
    }
    published_buttons_ = sample.buttons;
  }

  static void publishJoy(const DeviceSample& sample, const core::ButtonSource& source, ros::Publisher& publisher) {
    sensor_msgs::Joy joy;
    joy.header.stamp = sample.stamp;
    joy.buttons.resize(source.first + source.count, 0);
    for (std::uint32_t b = 0; b < source.count; ++b)
      joy.buttons[source.first + b] = sample.buttons[source.as + b] ? 1 : 0;
    publisher.publish(joy);
  }

  static void publishJoint(const DeviceSample& sample, const core::ButtonSource& source, ros::Publisher& publisher) {
    sensor_msgs::JointState joint;
    joint.header.stamp = sample.stamp;
    joint.name = {"gripper"};
    joint.position = {*source.closed_below + (sample.buttons[source.as] ? -1.0 : 1.0)};
    publisher.publish(joint);
  }

  ros::NodeHandle node_;
  core::DeviceProfile profile_;
  bool every_tick_;
  IncidentLog* incidents_;
  ForceCallback take_force_;
  PosePublisher pose_publisher_;
  ros::Publisher state_publisher_;
  std::vector<ros::Publisher> button_publishers_;
  ros::Subscriber servo_subscriber_, command_subscriber_;
  DriverReader command_reader_;
  std::optional<core::Buttons> published_buttons_;
  SharedOrientation orientation_;
  std::atomic<bool> enabled_{true};
};

/// A driver with omni_msgs: its own units, no frame, forces without a header, buttons when they change.
class OmniDriver : public VirtualDriver {
 public:
  OmniDriver(const ros::NodeHandle& node, const core::DeviceProfile& profile, IncidentLog& incidents,
             ForceCallback take_force)
      : node_(node), profile_(profile), incidents_(&incidents), take_force_(std::move(take_force)) {
    state_publisher_ = advertise(node_, omniStateType(), profile.omni.state, 1000);
    button_publisher_ = advertise(node_, omniButtonType(), profile.omni.button, 100, true);
    force_subscriber_ = node_.subscribe(profile.omni.force_feedback, 10, &OmniDriver::hearForce, this,
                                        ros::TransportHints().tcpNoDelay());
  }

  void publish(const DeviceSample& sample) override {
    if (sample.buttons != published_buttons_) {
      button_publisher_.publish(makeMessage(omniButtonType(), std::int32_t(sample.buttons[0] ? 1 : 0),
                                            std::int32_t(sample.buttons[1] ? 1 : 0)));
      published_buttons_ = sample.buttons;
    }
    const double unit_m = profile_.omni.position_unit_m;
    const core::Pose pose{sample.pose.position_m / unit_m,
                          profile_.omni.orientation_frame.conjugate() * sample.pose.orientation};
    const std::uint8_t no = 0;
    state_publisher_.publish(makeMessage(omniStateType(), headerOf(sample, ""), no, no, toPose(pose),
                                         geometry_msgs::Vector3(), toVector(sample.velocity_m_s / unit_m)));
  }

 private:
  void hearForce(const topic_tools::ShapeShifter& message) {
    try {
      const RuntimeFields fields = reader_.read(message);
      const core::Vector3 force(fields.number("force.x"), fields.number("force.y"), fields.number("force.z"));
      if (!core::isFinite(force))
        throw core::InputError("the force is not finite");
      take_force_(force);
    } catch (const core::Error& error) {
      incidents_->report(profile_.omni.force_feedback, error.what());
      take_force_(core::Vector3::Zero());
    }
  }

  ros::NodeHandle node_;
  core::DeviceProfile profile_;
  IncidentLog* incidents_;
  ForceCallback take_force_;
  ros::Publisher state_publisher_, button_publisher_;
  ros::Subscriber force_subscriber_;
  DriverReader reader_;
  std::optional<core::Buttons> published_buttons_;
};

/// A 6-axis mouse in the hand of somebody who sees where the tool is and pushes it to where the sample is.
class MouseDriver : public VirtualDriver {
 public:
  MouseDriver(const ros::NodeHandle& node, const core::DeviceProfile& profile) : node_(node), profile_(profile) {
    joy_publisher_ = node_.advertise<sensor_msgs::Joy>(profile.teleop.joy, 100);
    tool_subscriber_ = node_.subscribe(profile.topics.measured_cp, 10, &MouseDriver::hearTool, this);
  }

  void publish(const DeviceSample& sample) override {
    const core::Pose tool = seenTool();
    const core::Quaternion turn = sample.pose.orientation * tool.orientation.conjugate();
    const Eigen::AngleAxisd angle_axis(turn.w() < 0.0 ? core::Quaternion(-turn.coeffs()) : turn);
    sensor_msgs::Joy joy;
    joy.header.stamp = sample.stamp;
    push(sample.pose.position_m - tool.position_m, profile_.teleop.max_speed_m_s, joy);
    push(angle_axis.angle() * angle_axis.axis(), profile_.teleop.max_turn_rad_s, joy);
    for (std::size_t b = 0; b < 2; ++b)
      joy.buttons.push_back(sample.buttons[b] ? 1 : 0);
    joy_publisher_.publish(joy);
  }

 private:
  static constexpr double kReach_s = 0.2;  ///< in which the hand wants to be there

  static void push(const core::Vector3& way, double full_speed, sensor_msgs::Joy& joy) {
    for (const double along : way)
      joy.axes.push_back(static_cast<float>(std::clamp(along / (full_speed * kReach_s), -1.0, 1.0)));
  }

  void hearTool(const geometry_msgs::PoseStamped& message) {
    const std::lock_guard<std::mutex> lock(mutex_);
    tool_ = fromPose(message.pose);
  }
  core::Pose seenTool() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return tool_;
  }

  ros::NodeHandle node_;
  core::DeviceProfile profile_;
  ros::Publisher joy_publisher_;
  ros::Subscriber tool_subscriber_;
  mutable std::mutex mutex_;
  core::Pose tool_;
};

}  // namespace

std::unique_ptr<VirtualDriver> makeVirtualDriver(const ros::NodeHandle& node, const core::DeviceProfile& profile,
                                                 bool every_tick, IncidentLog& incidents,
                                                 const VirtualDriver::ForceCallback& take_force) {
  switch (profile.style) {
    case core::DeviceStyle::kCrtk:
      return std::make_unique<CrtkDriver>(node, profile, every_tick, incidents, take_force);
    case core::DeviceStyle::kOmni:
      return std::make_unique<OmniDriver>(node, profile, incidents, take_force);
    case core::DeviceStyle::kJoy:
      return std::make_unique<MouseDriver>(node, profile);
    case core::DeviceStyle::kKeyboard:
      break;
  }
  throw core::InputError(profile.name + " cannot be played: a keyboard is pressed by somebody");
}

}  // namespace soft_volume
