#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>
#include <soft_volume/RecorderStatus.h>

#include <csignal>
#include <future>
#include <map>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "soft_volume/replay/bag_recorder.h"
#include "soft_volume/replay/recording_watch.h"

namespace soft_volume {

/// Records topics of any type into a bag (see BagRecorder). Publishes recorder/status and diagnostics once a second.
/// The bag holds recorder/status, with what happened to the recording, and recorder/info, with what made it.
///
/// Private parameters:
/// - file (string, required): the bag; FILE.active until it is closed
/// - topics (list of strings): names, and patterns "*/NAME" for every topic that ends so and has a publisher; default:
///   all that a replay needs, the device's topics, images, camera_info, view, stats, diagnostics and rosout
/// - compression (string, lz4): lz4 or none
/// - reserve_mib (int, 256): recording stops when less is free on the disk
/// - queue_mib (int, 256): most that waits for the disk before messages are dropped
/// - split_mib (int, 0): size at which another part is begun, NAME_0.bag, NAME_1.bag...; 0: one file. A size below what
///   every part begins with ends the node, with the size needed
class RecorderNode {
 public:
  /// Starts to record. Throws core::Error when a parameter or the file cannot be used.
  RecorderNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  RecorderNode(const RecorderNode&) = delete;
  RecorderNode& operator=(const RecorderNode&) = delete;

  /// Records until `signal` is not 0 or ROS shuts down, takes what has arrived by then and closes the bag. Returns the
  /// exit code: 0, or 1 when recording had to stop earlier or the bag could not be closed. Ends by itself when the
  /// settings cannot be met.
  int run(const volatile std::sig_atomic_t& signal);

 private:
  void subscribe(const std::string& topic);
  /// Publishers of topics that match a pattern may come at any time.
  void findTopics();
  void subscribeMatching(const std::set<std::string>& topics);
  void hear(const std::string& topic, const ros::MessageEvent<const AnyMessage>& event);
  void takeArrived();
  void writeInfo();
  void watch();
  RecorderStatus makeStatus();
  void publishStatus();
  void tellDrops(const BagRecorder::Status& status);
  boost::shared_ptr<AnyMessage> lastMessage(const std::string& next_file, const std::string& reason);
  std::uint64_t lostOnTheWay();
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  std::string file_;
  std::vector<std::string> endings_;  ///< of the patterns
  std::future<std::set<std::string>> search_;
  std::mutex watch_mutex_;  ///< the recorder's thread takes the last events
  RecordingWatch watch_;
  BagRecorder recorder_;
  std::map<std::string, ros::Subscriber> subscribers_;  ///< by resolved topic
  ros::Publisher status_publisher_;
  diagnostic_updater::Updater diagnostics_;
  std::vector<ros::WallTimer> timers_;
  std::uint64_t diagnosed_drops_ = 0;
  std::uint64_t diagnosed_lost_ = 0;
  std::uint64_t told_drops_ = 0;
  std::uint64_t informed_session_ = 0;
};

}  // namespace soft_volume
