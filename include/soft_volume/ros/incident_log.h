#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/console.h>

#include <cstdint>
#include <map>
#include <mutex>
#include <string>

namespace soft_volume {

/// Counts bad inputs by topic, logs them at most once a second per topic, and shows them in diagnostics: a warning
/// while any came in the last period, with totals and the last reason. Thread-safe.
class IncidentLog {
 public:
  void report(const std::string& topic, const std::string& reason) {
    const std::lock_guard<std::mutex> lock(mutex_);
    Incident& incident = incidents_[topic];
    ++incident.total;
    ++incident.recent;
    incident.reason = reason;
    const ros::WallTime now = ros::WallTime::now();
    if (now - incident.logged < ros::WallDuration(1.0))
      return;
    incident.logged = now;
    ROS_WARN("%s: %s (%llu so far)", topic.c_str(), reason.c_str(), static_cast<unsigned long long>(incident.total));
  }

  /// Adds one line per topic to a diagnostics status and raises it to a warning when something came since the last
  /// call.
  void addTo(diagnostic_updater::DiagnosticStatusWrapper& status) {
    const std::lock_guard<std::mutex> lock(mutex_);
    for (auto& entry : incidents_) {
      Incident& incident = entry.second;
      status.add("refused on " + entry.first, incident.total);
      status.add("last reason on " + entry.first, incident.reason);
      if (incident.recent > 0) {
        status.mergeSummary(diagnostic_msgs::DiagnosticStatus::WARN, entry.first + ": " + incident.reason);
      }
      incident.recent = 0;
    }
  }

  std::uint64_t total() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    std::uint64_t sum = 0;
    for (const auto& entry : incidents_)
      sum += entry.second.total;
    return sum;
  }

 private:
  struct Incident {
    std::uint64_t total = 0;
    std::uint64_t recent = 0;
    std::string reason;
    ros::WallTime logged;
  };
  mutable std::mutex mutex_;
  std::map<std::string, Incident> incidents_;
};

}  // namespace soft_volume
