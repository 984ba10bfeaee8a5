#pragma once

#include <ros/ros.h>

#include <cstdio>
#include <cstring>
#include <exception>

namespace soft_volume {

/// Prints `help` and returns true when an argument asks for it. A node would otherwise wait for a master instead.
inline bool printHelp(int argc, char** argv, const char* help) {
  for (int n = 1; n < argc; ++n) {
    if (std::strcmp(argv[n], "--help") != 0 && std::strcmp(argv[n], "-h") != 0)
      continue;
    std::printf("%s\nTopics are listed in README.md and can be remapped as NAME:=OTHER. Needs a running roscore.\n",
                help);
    return true;
  }
  return false;
}

/// The main of every node: constructs `Node(node, private_node)` and spins until shutdown. Returns 1 when the node
/// cannot start, with the reason in the log. `help` is what --help prints.
template <typename Node>
int runNode(int argc, char** argv, const char* name, const char* help) {
  if (printHelp(argc, argv, help))
    return 0;
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
