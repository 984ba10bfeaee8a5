#pragma once

#include <ros/ros.h>

#include <exception>

namespace soft_volume {

/// The main of every node: constructs `Node(node, private_node)` and spins until shutdown. Returns 1 when the node
/// cannot start, with the reason in the log.
template <typename Node>
int runNode(int argc, char** argv, const char* name) {
  ros::init(argc, argv, name);
  // When the last handle goes, ROS shuts down and nothing is logged any more: the reason below needs these two.
  const ros::NodeHandle public_handle;
  const ros::NodeHandle private_handle("~");
  try {
    Node node(public_handle, private_handle);
    ros::spin();
  } catch (const std::exception& error) {
    ROS_FATAL("%s", error.what());
    return 1;
  }
  return 0;
}

}  // namespace soft_volume
