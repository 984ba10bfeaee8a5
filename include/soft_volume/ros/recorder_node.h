#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>
#include <soft_volume/RecorderStatus.h>

#include <csignal>
#include <map>
#include <string>
#include <vector>

#include "soft_volume/replay/bag_recorder.h"

namespace soft_volume {

/// Records topics of any type into a bag (see BagRecorder). Publishes recorder/status and diagnostics once a second.
///
/// Private parameters:
/// - file (string, required): the bag; FILE.active until it is closed
/// - topics (list of strings): names, and patterns "*/NAME" for every topic that ends so and has a publisher; default:
///   all that a replay needs, the device's topics, images, camera_info, view and stats
/// - compression (string, lz4): lz4 or none
/// - reserve_mib (int, 256): recording stops when less is free on the disk
/// - queue_mib (int, 256): most that waits for the disk before messages are dropped
class RecorderNode {
 public:
  /// Starts to record. Throws core::Error when a parameter or the file cannot be used.
  RecorderNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  RecorderNode(const RecorderNode&) = delete;
  RecorderNode& operator=(const RecorderNode&) = delete;

  /// Records until `signal` is not 0 or ROS shuts down, takes what has arrived by then and closes the bag. Returns the
  /// exit code: 0, or 1 when recording had to stop earlier or the bag could not be closed.
  int run(const volatile std::sig_atomic_t& signal);

 private:
  void subscribe(const std::string& topic);
  /// Publishers of topics that match a pattern may come at any time.
  void findTopics();
  void hear(const std::string& topic, const ros::MessageEvent<const AnyMessage>& event);
  void readProgress(const AnyMessage& journal);
  void takeArrived();
  void publishStatus();
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  std::string file_;
  std::vector<std::string> endings_;  ///< of the patterns
  BagRecorder recorder_;
  std::map<std::string, ros::Subscriber> subscribers_;  ///< by resolved topic
  ros::Publisher status_publisher_;
  diagnostic_updater::Updater diagnostics_;
  std::vector<ros::WallTimer> timers_;
  RecorderStatus progress_;  ///< newest session, revision and step
  std::uint64_t diagnosed_drops_ = 0;
};

}  // namespace soft_volume
