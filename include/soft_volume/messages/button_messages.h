#pragma once

#include <sensor_msgs/JointState.h>
#include <sensor_msgs/Joy.h>

#include "soft_volume/scene/device_profile.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume {

/// What a message says of the tool's buttons.
struct ButtonChange {
  core::Buttons mask;  ///< of which it speaks
  core::Buttons pressed;
};

/// A button is pressed while its value is 1: drivers of the cisst family send 2 for a click that is over. Buttons that
/// the message lacks are not pressed.
ButtonChange readButtons(const core::ButtonSource& source, const sensor_msgs::Joy& message);
/// Of a gripper's joint. Throws InputError when it has no position.
ButtonChange readButtons(const core::ButtonSource& source, const sensor_msgs::JointState& message);

/// The topics of a device with a file, or those of topics.h in the volume frame (null).
core::DeviceTopics deviceTopics(const core::DeviceProfile* profile);

}  // namespace soft_volume
