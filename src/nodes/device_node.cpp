#include "soft_volume/ros/device_node.h"
#include "soft_volume/ros/run_node.h"

namespace {

constexpr char kHelp[] = R"(device_node _scene:=FILE [_device:=FILE] [_frame_id:=NAME]

A virtual haptic device: publishes measured_cp, measured_cv and joy at 1 kHz in the volume frame and obeys servo_cf, or
plays the driver of a device file, with its topics, messages, base frame and rate.

  _scene:=FILE              scene file whose device section is played; required
  _device:=FILE             device file, as those in config/devices (none)
  _frame_id:=NAME           name of the volume frame, without a device file (volume)
)";

}  // namespace

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::DeviceNode>(argc, argv, "device_node", kHelp);
}
