#include <cmath>
#include <fstream>
#include <set>
#include <sstream>

#include "scene_reading.h"
#include "soft_volume/common/error.h"
#include "soft_volume/scene/device_profile.h"

namespace soft_volume::core {
namespace {

constexpr double kTiny = 1e-9;
constexpr Range kButton{0.0, 31.0};

DeviceLimits readLimits(YamlMap map) {
  DeviceLimits limits;
  limits.max_force_n = map.number("max_force_n", {kTiny, 100.0, "N"});
  limits.max_stiffness_n_m = map.number("max_stiffness_n_m", {kTiny, 20000.0, "N/m"});
  limits.max_damping_n_s_m = map.number("max_damping_n_s_m", {0.0, 100.0, "N s/m"});
  limits.workspace_radius_m = map.number("workspace_radius_m", {kTiny, 2.0, "m"});
  map.finish();
  return limits;
}

void readMechanics(YamlMap map, DeviceProfile& profile) {
  DeviceMechanics& m = profile.mechanics;
  m.mass_kg = map.number("mass_kg", {0.005, 5.0, "kg"});
  m.friction_n = map.number("friction_n", {0.0, 10.0, "N"});
  m.position_resolution_m = map.number("position_resolution_m", {0.0, 0.001, "m"});
  profile.device_damping_n_s_m = map.number("damping_n_s_m", {kTiny, 100.0, "N s/m"});
  map.finish();
}

/// The ranges are the rules that no device may loosen.
SafetyConfig readSafety(YamlMap map) {
  SafetyConfig safety;
  safety.max_growth_n_s = map.number("max_growth_n_s", {kTiny, 100.0, "N/s"}, safety.max_growth_n_s);
  safety.ramp_in_s = map.number("ramp_in_s", {0.2, 10.0, "s"}, safety.ramp_in_s);
  safety.stale_after_s = map.number("stale_after_s", {0.001, 0.02, "s"}, safety.stale_after_s);
  safety.drop_s = map.number("drop_s", {kTiny, 0.025, "s"}, safety.drop_s);
  safety.max_speed_m_s = map.number("max_speed_m_s", {0.01, 1.0, "m/s"}, safety.max_speed_m_s);
  map.finish();
  return safety;
}

ButtonSource readButtons(YamlMap& map) {
  ButtonSource source;
  source.topic = map.text("topic");
  if (map.has("closed_below")) {
    source.closed_below = map.number("closed_below", {-10.0, 10.0, "rad or m"});
    source.as = static_cast<std::uint32_t>(map.integer("as", kButton, source.as));
    map.finish();
    return source;
  }
  source.first = static_cast<std::uint32_t>(map.integer("first", {0.0, 255.0}, source.first));
  source.count = static_cast<std::uint32_t>(map.integer("count", {1.0, 32.0}, source.count));
  source.as = static_cast<std::uint32_t>(map.integer("as", kButton, source.as));
  if (source.as + source.count > 32)
    map.fail("as", "and count go beyond the tool's last button, which is 31");
  map.finish();
  return source;
}

DeviceTopics readTopics(YamlMap map) {
  DeviceTopics topics;
  topics.measured_cp = map.text("measured_cp");
  if (topics.measured_cp.empty())
    map.fail("measured_cp", "is empty; without poses there is nothing to feel");
  topics.measured_cv = map.text("measured_cv", "");
  topics.servo_cf = map.text("servo_cf", "");
  topics.operating_state = map.text("operating_state", "");
  std::set<std::uint32_t> taken;
  for (YamlMap& item : map.maps("buttons")) {
    const ButtonSource source = readButtons(item);
    for (std::uint32_t b = source.as; b < source.as + source.count; ++b) {
      if (!taken.insert(b).second)
        item.fail("as", "gives the tool's button " + std::to_string(b) + " a second source");
    }
    topics.buttons.push_back(source);
  }
  map.finish();
  return topics;
}

OmniTopics readOmni(YamlMap map) {
  OmniTopics omni;
  omni.state = map.text("state");
  omni.button = map.text("button");
  omni.force_feedback = map.text("force_feedback");
  omni.position_unit_m = map.number("position_unit_m", {1e-6, 10.0, "m"}, omni.position_unit_m);
  if (map.has("orientation_frame_xyzw"))
    omni.orientation_frame = readOrientation(map, "orientation_frame_xyzw");
  map.finish();
  return omni;
}

TeleopConfig readTeleop(YamlMap map, DeviceStyle style) {
  TeleopConfig teleop;
  if (style == DeviceStyle::kJoy)
    teleop.joy = map.text("joy");
  teleop.max_speed_m_s = map.number("max_speed_m_s", {1e-4, 0.5, "m/s"}, teleop.max_speed_m_s);
  teleop.max_turn_rad_s = map.number("max_turn_rad_s", {1e-3, 10.0, "rad/s"}, teleop.max_turn_rad_s);
  teleop.dead_zone = map.number("dead_zone", {0.0, 0.9}, teleop.dead_zone);
  map.finish();
  return teleop;
}

void readMapping(YamlMap map, DeviceProfile& profile) {
  WorkspaceMappingConfig& m = profile.mapping;
  profile.align_with_camera = map.choice("align_with", {"camera", "volume"}, "camera") == "camera";
  m.scale = map.number("scale", {0.01, 100.0}, m.scale);
  m.force_scale = map.number("force_scale", {0.01, 100.0}, m.force_scale);
  m.device_centre_m = map.vector("device_centre_m", kMetres, m.device_centre_m);
  m.offset_m = map.vector("offset_m", kMetres, m.offset_m);
  if (map.has("orientation_xyzw"))
    m.orientation = readOrientation(map, "orientation_xyzw");
  if (map.has("handle_orientation_xyzw"))
    m.handle_orientation = readOrientation(map, "handle_orientation_xyzw");
  readChoice(map, "force_frame", m.force_frame);
  if (map.has("clutch_button"))
    m.clutch_button = static_cast<std::uint32_t>(map.integer("clutch_button", kButton));
  map.finish();
}

/// Sections of other styles are refused: they would have no effect.
void readStyle(YamlMap& top, DeviceProfile& profile) {
  readChoice(top, "style", profile.style);
  const bool teleop = profile.style == DeviceStyle::kJoy || profile.style == DeviceStyle::kKeyboard;
  if (profile.style == DeviceStyle::kOmni)
    profile.omni = readOmni(top.map("omni"));
  else if (top.has("omni"))
    top.fail("omni", "is for the style omni; remove it");
  if (teleop)
    profile.teleop = readTeleop(top.map("teleop"), profile.style);
  else if (top.has("teleop"))
    top.fail("teleop", "is for the styles joy and keyboard; remove it");
}

/// The user's frame (x right, y away, z up) in an optical one (x right, y down, z forward).
Quaternion userInCamera() {
  Matrix3 axes;
  axes << Vector3::UnitX(), Vector3::UnitZ(), -Vector3::UnitY();
  return Quaternion(axes);
}

}  // namespace

WorkspacePlace DeviceProfile::placeIn(const Scene& scene) const {
  WorkspacePlace place;
  place.centre_m = scene.device.workspace_centre_m;
  if (align_with_camera && !scene.rendering.cameras.empty()) {
    place.orientation = scene.rendering.cameras.front().camera.T_volume_camera.orientation * userInCamera();
    place.orientation.normalize();
  }
  return place;
}

DeviceProfile parseDeviceProfile(const std::string& yaml, const std::string& origin) {
  YamlMap top(parseYaml(yaml, origin), "", origin);
  top.integer("format", {1.0, 1.0});
  DeviceProfile profile;
  profile.name = top.text("name");
  readStyle(top, profile);
  profile.limits = readLimits(top.map("limits"));
  readMechanics(top.map("mechanics"), profile);
  profile.safety = readSafety(top.map("safety"));
  profile.rate_hz = top.number("rate_hz", {20.0, 4000.0, "Hz"}, profile.rate_hz);
  profile.mechanics.rate_hz = profile.rate_hz;
  profile.output_delay_s = top.number("output_delay_s", {0.0, 0.1, "s"}, profile.output_delay_s);
  profile.base_frame = top.text("base_frame", "");
  profile.topics = readTopics(top.map("topics"));
  profile.needs_homing = top.flag("needs_homing", profile.needs_homing);
  if (profile.needs_homing && profile.topics.operating_state.empty())
    top.fail("needs_homing", "needs topics.operating_state, which says whether the device is homed");
  readMapping(top.map("mapping"), profile);
  top.finish();
  return profile;
}

DeviceProfile loadDeviceProfile(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  if (!file || !(text << file.rdbuf()))
    throw SceneError(path + ": the device file cannot be read; config/devices has one for each known driver");
  return parseDeviceProfile(text.str(), path);
}

}  // namespace soft_volume::core
