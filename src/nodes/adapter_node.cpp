#include "soft_volume/ros/adapter_node.h"
#include "soft_volume/ros/run_node.h"

namespace {

constexpr char kHelp[] = R"(adapter_node _device:=FILE

Makes a CRTK device of a driver that speaks omni_msgs, with the topics of the device file. Leaves at once when the file
is of a device that needs no adapter.

  _device:=FILE             device file, as those in config/devices; required
  _stay:=true               do not leave, for launch files that start again what has ended (false)
)";

}  // namespace

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::AdapterNode>(argc, argv, "adapter_node", kHelp);
}
