#include "soft_volume/ros/device_node.h"

#include <ros/console.h>
#include <ros/init.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <string>

#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/parameters.h"
#include "virtual_driver.h"

namespace soft_volume {
namespace {

/// More missed ticks than this are a stall, not jitter (real time only).
constexpr std::int64_t kStallTicks = 100;
constexpr std::uint32_t kPublishedButtons = 8;

/// A driver in the volume frame with the names of topics.h.
core::DeviceProfile plainProfile(const core::Scene& scene, const std::string& frame_id) {
  core::DeviceProfile profile;
  profile.name = "virtual haptic device";
  profile.limits = scene.device.limits;
  profile.base_frame = frame_id;
  profile.topics.measured_cp = topics::kMeasuredPose;
  profile.topics.measured_cv = topics::kMeasuredVelocity;
  profile.topics.servo_cf = topics::kServoForce;
  core::ButtonSource buttons;
  buttons.topic = topics::kButtons;
  buttons.count = kPublishedButtons;
  profile.topics.buttons.push_back(buttons);
  return profile;
}

/// The scene's device and hand as the device of a file, with the script in its base frame.
core::VirtualDeviceConfig playedBy(const core::DeviceProfile& profile, const core::Scene& scene) {
  core::VirtualDeviceConfig config = scene.device;
  config.limits = profile.limits;
  config.mass_kg = profile.mechanics.mass_kg;
  config.friction_n = profile.mechanics.friction_n;
  config.position_resolution_m = profile.mechanics.position_resolution_m;
  config.damping_n_s_m = profile.device_damping_n_s_m;
  config.workspace_centre_m = profile.mapping.device_centre_m;
  const core::WorkspaceMapping mapping(profile.mapping, profile.placeIn(scene));
  core::Pose tip;
  for (core::WayPoint& point : config.way_points) {
    tip.position_m = point.position_m;
    tip.orientation = point.orientation.value_or(tip.orientation);
    const core::Pose device = mapping.toDevice(tip);
    point.position_m = device.position_m;
    point.orientation = device.orientation;
  }
  return config;
}

}  // namespace

DeviceNode::DeviceNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node), diagnostics_(node, private_node) {
  const core::Scene scene = core::loadScene(
      requiredParameter<std::string>(private_node, "scene", "the scene file whose device section is played"));
  const auto file = parameter<std::string>(private_node, "device", "");
  if (file.empty()) {
    device_ = std::make_unique<core::VirtualDevice>(scene.device);
    start(plainProfile(scene, parameter<std::string>(private_node, "frame_id", "volume")), true);
    return;
  }
  const core::DeviceProfile profile = core::loadDeviceProfile(file);
  if (profile.style == core::DeviceStyle::kKeyboard) {
    ROS_INFO("%s: somebody has to press the keys, there is nothing to play", profile.name.c_str());
    return;
  }
  device_ = std::make_unique<core::VirtualDevice>(playedBy(profile, scene));
  start(profile, false);
}

void DeviceNode::start(const core::DeviceProfile& profile, bool every_tick) {
  publish_every_ = std::max<std::int64_t>(1, std::llround(1.0 / (profile.rate_hz * core::VirtualDevice::kStep_s)));
  driver_ = makeVirtualDriver(node_, profile, every_tick, incidents_, [this](const core::Vector3& force_n) {
    const std::lock_guard<std::mutex> lock(mutex_);
    device_->setServoForce(force_n);
  });
  diagnostics_.setHardwareID(profile.name);
  diagnostics_.add("device", this, &DeviceNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
  thread_ = std::thread([this] { run(); });
}

DeviceNode::~DeviceNode() {
  running_ = false;
  if (thread_.joinable())
    thread_.join();
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
  DeviceSample sample;
  sample.stamp = stamp;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    device_->step();
    sample.pose = device_->pose();
    sample.velocity_m_s = device_->velocity_m_s();
    sample.buttons = device_->buttons();
  }
  if (++ticks_ % publish_every_ == 0)
    driver_->publish(sample);
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
