#pragma once

#include <ros/node_handle.h>
#include <topic_tools/shape_shifter.h>

#include <atomic>
#include <mutex>
#include <string>

#include "soft_volume/ros/driver_messages.h"
#include "soft_volume/ros/incident_log.h"

namespace soft_volume {

/// Whether a driver lets forces through, as its crtk_msgs/operating_state says: ENABLED, and homed where that is asked
/// for. The message's type is read at run time, because crtk_msgs is not in Debian.
///
/// No, until the driver has said so, after a message that cannot be read, and from when its publisher has gone (looked
/// at 20 times a second) until it speaks again. Thread-safe; allowed() takes no lock.
class OperatingStateListener {
 public:
  /// An empty topic means that the driver has no such state: always yes.
  OperatingStateListener(ros::NodeHandle& node, const std::string& topic, bool needs_homing, IncidentLog& incidents);
  OperatingStateListener(const OperatingStateListener&) = delete;
  OperatingStateListener& operator=(const OperatingStateListener&) = delete;

  bool allowed() const { return allowed_; }
  /// Why not, for people; empty while allowed.
  std::string reason() const;

 private:
  void hear(const topic_tools::ShapeShifter& message);
  void lookForPublisher();
  void set(const std::string& reason);

  std::string topic_;
  bool needs_homing_;
  IncidentLog* incidents_;
  DriverReader reader_;
  std::atomic<bool> allowed_{false};
  mutable std::mutex mutex_;  // guards the reason
  std::string reason_;
  ros::Subscriber subscriber_;
  ros::WallTimer timer_;
};

}  // namespace soft_volume
