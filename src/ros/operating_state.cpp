#include "soft_volume/ros/operating_state.h"

#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

constexpr double kLookInterval_s = 0.05;

}  // namespace

OperatingStateListener::OperatingStateListener(ros::NodeHandle& node, const std::string& topic, bool needs_homing,
                                               IncidentLog& incidents)
    : topic_(topic), needs_homing_(needs_homing), incidents_(&incidents) {
  if (topic.empty()) {
    set("");
    return;
  }
  set("the driver has not said that it is enabled");
  subscriber_ = node.subscribe(topic, 10, &OperatingStateListener::hear, this);
  timer_ = node.createWallTimer(ros::WallDuration(kLookInterval_s),
                                [this](const ros::WallTimerEvent&) { lookForPublisher(); });
}

void OperatingStateListener::hear(const topic_tools::ShapeShifter& message) {
  try {
    const RuntimeFields fields = reader_.read(message);
    const std::string& state = fields.text("state");
    if (state != "ENABLED")
      set("the driver is " + state);
    else if (needs_homing_ && fields.number("is_homed") == 0.0)
      set("the device is not homed");
    else
      set("");
  } catch (const core::Error& error) {
    incidents_->report(topic_, error.what());
    set("the driver's state cannot be read");
  }
}

void OperatingStateListener::lookForPublisher() {
  if (allowed_ && subscriber_.getNumPublishers() == 0)
    set("the driver has gone");
}

void OperatingStateListener::set(const std::string& reason) {
  const std::lock_guard<std::mutex> lock(mutex_);
  reason_ = reason;
  allowed_ = reason.empty();
}

std::string OperatingStateListener::reason() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return reason_;
}

}  // namespace soft_volume
