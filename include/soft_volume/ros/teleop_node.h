#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <ros/node_handle.h>
#include <sensor_msgs/Joy.h>

#include <atomic>
#include <mutex>
#include <optional>
#include <thread>

#include "soft_volume/ros/incident_log.h"
#include "soft_volume/ros/pose_publisher.h"
#include "soft_volume/ros/terminal_keys.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/tool/teleoperation.h"

namespace soft_volume {

/// A device for who has none: a 6-axis mouse (sensor_msgs/Joy) or the keys of the terminal that it runs in become
/// measured_cp and measured_cv at the file's rate, within its speed and workspace. Poses are in its base frame, around
/// mapping.device_centre_m. A mouse that falls silent for 0.2 s has let go.
///
/// Private parameters: ~device (device file; required), ~stay (false). Leaves at once when the file's style is neither
/// joy nor keyboard, unless it is to stay.
class TeleopNode {
 public:
  TeleopNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  ~TeleopNode();
  TeleopNode(const TeleopNode&) = delete;
  TeleopNode& operator=(const TeleopNode&) = delete;

 private:
  void start();
  void hearJoy(const sensor_msgs::Joy& message);
  void run();
  void tick(const ros::Time& now, double dt_s);
  core::Deflection deflection();
  void readKeys();
  void publishButtons(const core::Buttons& buttons);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  core::DeviceProfile profile_;
  core::Teleoperation teleoperation_;
  PosePublisher pose_publisher_;
  ros::Publisher button_publisher_;
  ros::Subscriber joy_subscriber_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_;
  IncidentLog incidents_;

  std::mutex mutex_;  // guards the mouse
  core::Deflection mouse_;
  ros::SteadyTime mouse_heard_;

  // Of the thread.
  std::optional<TerminalKeys> terminal_;
  core::Keyboard keyboard_;
  std::optional<core::Buttons> published_buttons_;

  std::atomic<bool> running_{true};
  std::thread thread_;
};

}  // namespace soft_volume
