#include "soft_volume/ros/tool_node.h"
#include "soft_volume/ros/run_node.h"

int main(int argc, char** argv) {
  return soft_volume::runNode<soft_volume::ToolNode>(argc, argv, "tool_node");
}
