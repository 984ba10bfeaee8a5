#pragma once

#include <diagnostic_updater/diagnostic_updater.h>
#include <geometry_msgs/WrenchStamped.h>
#include <ros/node_handle.h>
#include <topic_tools/shape_shifter.h>

#include <cstdint>

#include "soft_volume/ros/driver_messages.h"
#include "soft_volume/ros/incident_log.h"
#include "soft_volume/ros/pose_publisher.h"
#include "soft_volume/scene/device_profile.h"

namespace soft_volume {

/// Makes a CRTK device of a driver with omni_msgs, whose messages are read by name at run time: OmniState (units of the
/// driver, mostly millimetres) becomes measured_cp and measured_cv, OmniButtonEvent becomes a Joy, servo_cf becomes
/// OmniFeedback.
///
/// Such a driver holds a force until the next one comes. When servo_cf falls silent for 20 ms, the force is therefore
/// taken to zero, within 25 ms.
///
/// Private parameters: ~device (device file; required), ~stay (false). Leaves at once when the file's style is not omni,
/// unless it is to stay.
class AdapterNode {
 public:
  AdapterNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node);
  AdapterNode(const AdapterNode&) = delete;
  AdapterNode& operator=(const AdapterNode&) = delete;
  /// Takes the force to zero.
  ~AdapterNode();

 private:
  void start();
  void hearState(const topic_tools::ShapeShifter& message);
  void publishState(const RuntimeFields& fields);
  void hearButtons(const topic_tools::ShapeShifter& message);
  void hearServo(const geometry_msgs::WrenchStamped& message);
  void watch();
  void sendForce(const core::Vector3& force_n);
  void diagnose(diagnostic_updater::DiagnosticStatusWrapper& status);

  ros::NodeHandle node_;
  core::DeviceProfile profile_;
  PosePublisher pose_publisher_;
  ros::Publisher button_publisher_, force_publisher_;
  ros::Subscriber state_subscriber_, button_subscriber_, servo_subscriber_;
  diagnostic_updater::Updater diagnostics_;
  ros::WallTimer diagnostics_timer_, watch_timer_;
  IncidentLog incidents_;
  DriverReader state_reader_, button_reader_;
  core::Vector3 lock_position_ = core::Vector3::Zero();  // newest, in the driver's units
  core::Vector3 servo_force_n_ = core::Vector3::Zero();  // asked for last
  ros::SteadyTime servo_heard_;
  bool driving_ = false;  // the driver holds a force that is not zero
  std::uint64_t states_ = 0;
};

}  // namespace soft_volume
