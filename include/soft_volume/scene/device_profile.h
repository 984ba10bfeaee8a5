#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/common/named_choice.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/tool/force_limiter.h"
#include "soft_volume/tool/teleoperation.h"
#include "soft_volume/tool/virtual_device.h"
#include "soft_volume/tool/workspace_mapping.h"

namespace soft_volume::core {

/// Buttons of one topic that become buttons of the tool: those of a sensor_msgs/Joy, or a gripper's joint
/// (sensor_msgs/JointState) that counts as pressed while it is closed.
struct ButtonSource {
  std::string topic;
  std::optional<double> closed_below;  ///< first position of the joint, rad or m; [-10, 10]; then count is 1
  std::uint32_t first = 0;             ///< first one in the message; [0, 255]
  std::uint32_t count = 1;             ///< this many, in order; [1, 32]
  std::uint32_t as = 0;                ///< the tool's button that the first one becomes; as + count <= 32
};

/// Topics of a driver with CRTK's messages, in the device's base frame; an empty name where there is none.
struct DeviceTopics {
  std::string measured_cp;      ///< geometry_msgs/PoseStamped; required
  std::string measured_cv;      ///< geometry_msgs/TwistStamped; may be empty
  std::string servo_cf;         ///< geometry_msgs/WrenchStamped; empty for a device without motors
  std::string operating_state;  ///< crtk_msgs/operating_state; empty where the driver has none
  std::vector<ButtonSource> buttons;
};

/// What stands behind the topics above.
enum class DeviceStyle {
  kCrtk,      ///< a driver that has them
  kOmni,      ///< a driver with omni_msgs, translated by adapter_node
  kJoy,       ///< a 6-axis mouse, integrated by teleop_node
  kKeyboard,  ///< a terminal, read by teleop_node
};

template <>
inline constexpr std::array<NamedChoice<DeviceStyle>, 4> kChoices<DeviceStyle>{{{"crtk", DeviceStyle::kCrtk},
                                                                                {"omni", DeviceStyle::kOmni},
                                                                                {"joy", DeviceStyle::kJoy},
                                                                                {"keyboard", DeviceStyle::kKeyboard}}};
template <>
inline constexpr std::array<NamedChoice<ForceFrame>, 2> kChoices<ForceFrame>{
    {{"base", ForceFrame::kBase}, {"body", ForceFrame::kBody}}};

/// A driver that speaks omni_msgs.
struct OmniTopics {
  std::string state;               ///< omni_msgs/OmniState
  std::string button;              ///< omni_msgs/OmniButtonEvent
  std::string force_feedback;      ///< omni_msgs/OmniFeedback
  double position_unit_m = 0.001;  ///< metres per unit of its positions; [1e-6, 10]
  /// Of the frame that its orientations are in, in the frame that its positions are in.
  Quaternion orientation_frame = Quaternion::Identity();
};

/// Everything that the nodes must know of a device and its driver: one file per device in config/devices, whose keys
/// doc/haptics.md lists.
struct DeviceProfile {
  std::string name;
  DeviceStyle style = DeviceStyle::kCrtk;
  DeviceLimits limits;                ///< at the device
  DeviceMechanics mechanics;          ///< what the virtual device pretends; its rate is rate_hz below
  double device_damping_n_s_m = 0.2;  ///< physical damping b of device and hand, a low estimate; (0, 100]
  SafetyConfig safety;                ///< at the device
  double rate_hz = 1000.0;            ///< of the poses, and of the loop; [20, 4000]
  /// From the arrival of a force at the driver to the motors, beyond one of its cycles; no message tells it; [0, 0.1].
  double output_delay_s = 0.0;
  std::string base_frame;  ///< frame_id that poses must have; empty: any
  DeviceTopics topics;
  bool needs_homing = false;  ///< operating_state must say is_homed, too, before there is any force
  OmniTopics omni;            ///< style omni only
  TeleopConfig teleop;        ///< styles joy and keyboard only
  WorkspaceMappingConfig mapping;
  bool align_with_camera = true;  ///< the user looks through the scene's first camera; else along the volume's +y

  /// Where the workspace lies in a scene: around its device.workspace_centre_m, and as the user sees it.
  WorkspacePlace placeIn(const Scene& scene) const;
};

/// Reads a device file. Unknown and duplicate keys, wrong types and values outside their range throw SceneError with
/// file, line, key, unit and range.
DeviceProfile loadDeviceProfile(const std::string& path);

/// The same from text; `origin` names it in errors.
DeviceProfile parseDeviceProfile(const std::string& yaml, const std::string& origin);

}  // namespace soft_volume::core
