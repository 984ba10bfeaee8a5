#include "soft_volume/ros/recorder_node.h"

#include <ros/init.h>

#include <csignal>
#include <exception>

namespace {

volatile std::sig_atomic_t received_signal = 0;

void remember(int number) {
  received_signal = number;
}

}  // namespace

// roscpp's own handler would close the connections before what they hold is recorded.
int main(int argc, char** argv) {
  ros::init(argc, argv, "recorder", ros::init_options::NoSigintHandler);
  std::signal(SIGINT, remember);
  std::signal(SIGTERM, remember);
  // With its last handle ROS shuts down, and the reason for a failed start would not be logged.
  const ros::NodeHandle keep_alive;
  try {
    soft_volume::RecorderNode node(keep_alive, ros::NodeHandle("~"));
    return node.run(received_signal);
  } catch (const std::exception& error) {
    ROS_FATAL("%s", error.what());
    return 1;
  }
}
