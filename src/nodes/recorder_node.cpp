#include "soft_volume/ros/recorder_node.h"

#include <ros/init.h>

#include <csignal>
#include <exception>

#include "soft_volume/ros/master_watch.h"
#include "soft_volume/ros/run_node.h"

namespace {

constexpr char kHelp[] = R"(recorder_node _file:=BAG [_NAME:=VALUE ...]

Records everything that a replay needs; after a kill, 'rosbag reindex' brings back all but the last second.

  _file:=BAG                bag to write; required
  _topics:="[a, b]"         topics instead of the default ones; */NAME takes every topic that ends so
  _compression:=none        lz4 or none (lz4)
  _split_mib:=N             begin another part at this size: NAME_0.bag, NAME_1.bag... (0: one file)
  _reserve_mib:=N           stop when less than this is free on the disk (256)
  _queue_mib:=N             most that waits for the disk; more is dropped and counted (256)
)";

volatile std::sig_atomic_t received_signal = 0;

void remember(int number) {
  received_signal = number;
}

}  // namespace

// roscpp's own handler would close the connections before what they hold is recorded.
int main(int argc, char** argv) {
  if (soft_volume::printHelp(argc, argv, kHelp))
    return 0;
  ros::init(argc, argv, "recorder", ros::init_options::NoSigintHandler);
  std::signal(SIGINT, remember);
  std::signal(SIGTERM, remember);
  // With its last handle ROS shuts down, and the reason for a failed start would not be logged.
  const ros::NodeHandle keep_alive;
  const soft_volume::MasterWatch watch;
  try {
    soft_volume::RecorderNode node(keep_alive, ros::NodeHandle("~"));
    return node.run(received_signal);
  } catch (const std::exception& error) {
    ROS_FATAL("%s", error.what());
    return 1;
  }
}
