#include "soft_volume/messages/button_messages.h"

#include <cmath>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {

ButtonChange readButtons(const core::ButtonSource& source, const sensor_msgs::Joy& message) {
  ButtonChange change;
  for (std::uint32_t b = 0; b < source.count; ++b) {
    const std::size_t index = source.first + b;
    change.mask.set(source.as + b);
    change.pressed.set(source.as + b, index < message.buttons.size() && message.buttons[index] == 1);
  }
  return change;
}

ButtonChange readButtons(const core::ButtonSource& source, const sensor_msgs::JointState& message) {
  if (message.position.empty() || !std::isfinite(message.position.front()))
    throw core::InputError("the joint has no position");
  ButtonChange change;
  change.mask.set(source.as);
  change.pressed.set(source.as, message.position.front() < *source.closed_below);
  return change;
}

core::DeviceTopics deviceTopics(const core::DeviceProfile* profile) {
  if (profile != nullptr)
    return profile->topics;
  core::DeviceTopics topics;
  topics.measured_cp = topics::kMeasuredPose;
  topics.measured_cv = topics::kMeasuredVelocity;
  topics.servo_cf = topics::kServoForce;
  topics.buttons = {{topics::kButtons, std::nullopt, 0, static_cast<std::uint32_t>(core::Buttons().size()), 0}};
  return topics;
}

}  // namespace soft_volume
