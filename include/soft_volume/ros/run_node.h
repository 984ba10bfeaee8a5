#pragma once

#include <ros/callback_queue.h>
#include <ros/ros.h>

#include <csignal>
#include <cstdio>
#include <cstring>
#include <exception>

#include "soft_volume/ros/master_watch.h"

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

/// Set by SIGINT and SIGTERM.
inline volatile std::sig_atomic_t& stopRequested() {
  static volatile std::sig_atomic_t requested = 0;
  return requested;
}

/// Serves callbacks until the program is to stop, or ROS is shut down.
inline void spinUntilStopped() {
  const ros::WallDuration look_interval(0.05);
  while (ros::ok() && stopRequested() == 0)
    ros::getGlobalCallbackQueue()->callAvailable(look_interval);
}

/// The main of every node: constructs `Node(node, private_node)` and spins until it is to stop. Returns 1 when the node
/// cannot start, with the reason in the log. `help` is what --help prints.
///
/// Stopped by a signal, the node is destroyed before ROS is shut down, so that it can still send what must be sent
/// last: drivers of haptic devices hold a force until another one comes.
template <typename Node>
int runNode(int argc, char** argv, const char* name, const char* help) {
  if (printHelp(argc, argv, help))
    return 0;
  ros::init(argc, argv, name, ros::init_options::NoSigintHandler);
  for (const int signal : {SIGINT, SIGTERM})
    std::signal(signal, [](int) { stopRequested() = 1; });
  // When the last handle goes, ROS shuts down and nothing is logged any more: the reason below needs these two.
  const ros::NodeHandle public_handle;
  const ros::NodeHandle private_handle("~");
  const MasterWatch watch;
  try {
    Node node(public_handle, private_handle);
    spinUntilStopped();
  } catch (const std::exception& error) {
    ROS_FATAL("%s", error.what());
    return 1;
  }
  return 0;
}

}  // namespace soft_volume
