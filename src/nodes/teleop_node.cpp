#include <string>

#include "soft_volume/ros/run_node.h"
#include "soft_volume/ros/teleop_node.h"
#include "soft_volume/tool/teleoperation.h"

namespace {

constexpr char kHelp[] = R"(teleop_node _device:=FILE

Makes a device of a 6-axis mouse (sensor_msgs/Joy) or of the keys of this terminal, with the topics of the device file.
Leaves at once when the file is of another device.

  _device:=FILE             device file, config/devices/spacenav.yaml or keyboard.yaml; required
  _stay:=true               do not leave, for launch files that start again what has ended (false)

Keys:
)";

}  // namespace

int main(int argc, char** argv) {
  const std::string help = std::string(kHelp) + soft_volume::core::Keyboard::kHelp;
  return soft_volume::runNode<soft_volume::TeleopNode>(argc, argv, "teleop_node", help.c_str());
}
