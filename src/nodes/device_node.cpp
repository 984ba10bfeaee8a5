#include "soft_volume/ros/device_node.h"
#include "soft_volume/ros/run_node.h"

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::DeviceNode>(argc, argv, "device_node");
}
