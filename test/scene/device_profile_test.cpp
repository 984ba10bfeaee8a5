#include "soft_volume/scene/device_profile.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

/// A file that states every key of a motorised device.
std::string wholeFile() {
  return R"(format: 1
name: test device
style: crtk
limits: {max_force_n: 2.5, max_stiffness_n_m: 500, max_damping_n_s_m: 3, workspace_radius_m: 0.08}
mechanics: {mass_kg: 0.05, damping_n_s_m: 0.1, friction_n: 0.26, position_resolution_m: 0.00005}
safety: {max_growth_n_s: 80, ramp_in_s: 0.3, stale_after_s: 0.01, drop_s: 0.02, max_speed_m_s: 0.9}
rate_hz: 500
output_delay_s: 0.002
base_frame: arm_base
topics:
  measured_cp: arm/measured_cp
  measured_cv: arm/measured_cv
  servo_cf: arm/servo_cf
  operating_state: arm/operating_state
  buttons:
    - {topic: arm/button1, first: 0, count: 1, as: 0}
    - {topic: pedals, first: 2, count: 2, as: 3}
    - {topic: arm/gripper/measured_js, closed_below: 0.1, as: 6}
needs_homing: true
mapping:
  align_with: volume
  scale: 0.5
  force_scale: 2
  device_centre_m: [0.0, 0.1, 0.0]
  offset_m: [0.01, 0.0, 0.0]
  orientation_xyzw: [0.0, 0.0, 1.0, 0.0]
  handle_orientation_xyzw: [1.0, 0.0, 0.0, 0.0]
  force_frame: body
  clutch_button: 1
)";
}

DeviceProfile parse(const std::string& yaml) {
  return parseDeviceProfile(yaml, "device.yaml");
}

/// The whole file with one piece of text in place of another.
std::string with(const std::string& from, const std::string& to) {
  std::string yaml = wholeFile();
  const std::size_t at = yaml.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return yaml.replace(at, from.size(), to);
}

void expectRefused(const std::string& yaml, const std::string& place, const std::string& reason) {
  try {
    parse(yaml);
    ADD_FAILURE() << "taken, though: " << reason;
  } catch (const SceneError& error) {
    const std::string what = error.what();
    EXPECT_NE(what.find("device.yaml:"), std::string::npos) << what;
    EXPECT_NE(what.find(place), std::string::npos) << what;
    EXPECT_NE(what.find(reason), std::string::npos) << what;
  }
}

TEST(DeviceProfile, ReadsEveryKey) {
  const DeviceProfile p = parse(wholeFile());
  EXPECT_EQ(p.name, "test device");
  EXPECT_EQ(p.style, DeviceStyle::kCrtk);
  EXPECT_EQ(p.limits.max_force_n, 2.5);
  EXPECT_EQ(p.limits.max_stiffness_n_m, 500.0);
  EXPECT_EQ(p.limits.max_damping_n_s_m, 3.0);
  EXPECT_EQ(p.limits.workspace_radius_m, 0.08);
  EXPECT_EQ(p.mechanics.mass_kg, 0.05);
  EXPECT_EQ(p.device_damping_n_s_m, 0.1);
  EXPECT_EQ(p.mechanics.friction_n, 0.26);
  EXPECT_EQ(p.mechanics.position_resolution_m, 0.00005);
  EXPECT_EQ(p.safety.max_growth_n_s, 80.0);
  EXPECT_EQ(p.safety.ramp_in_s, 0.3);
  EXPECT_EQ(p.safety.stale_after_s, 0.01);
  EXPECT_EQ(p.safety.drop_s, 0.02);
  EXPECT_EQ(p.safety.max_speed_m_s, 0.9);
  EXPECT_EQ(p.rate_hz, 500.0);
  EXPECT_EQ(p.output_delay_s, 0.002);
  EXPECT_EQ(p.base_frame, "arm_base");
  EXPECT_EQ(p.topics.measured_cp, "arm/measured_cp");
  EXPECT_EQ(p.topics.measured_cv, "arm/measured_cv");
  EXPECT_EQ(p.topics.servo_cf, "arm/servo_cf");
  EXPECT_EQ(p.topics.operating_state, "arm/operating_state");
  ASSERT_EQ(p.topics.buttons.size(), 3u);
  EXPECT_FALSE(p.topics.buttons[1].closed_below);
  EXPECT_EQ(p.topics.buttons[2].closed_below, 0.1);
  EXPECT_EQ(p.topics.buttons[2].as, 6u);
  EXPECT_EQ(p.topics.buttons[1].topic, "pedals");
  EXPECT_EQ(p.topics.buttons[1].first, 2u);
  EXPECT_EQ(p.topics.buttons[1].count, 2u);
  EXPECT_EQ(p.topics.buttons[1].as, 3u);
  EXPECT_TRUE(p.needs_homing);
  EXPECT_FALSE(p.align_with_camera);
  EXPECT_EQ(p.mapping.scale, 0.5);
  EXPECT_EQ(p.mapping.force_scale, 2.0);
  EXPECT_EQ(p.mapping.device_centre_m, Vector3(0.0, 0.1, 0.0));
  EXPECT_EQ(p.mapping.offset_m, Vector3(0.01, 0.0, 0.0));
  EXPECT_EQ(p.mapping.orientation.z(), 1.0);
  EXPECT_EQ(p.mapping.handle_orientation.x(), 1.0);
  EXPECT_EQ(p.mapping.force_frame, ForceFrame::kBody);
  EXPECT_EQ(p.mapping.clutch_button, 1u);
}

TEST(DeviceProfile, NamesWhatIsWrongAndWhere) {
  expectRefused(with("rate_hz: 500", "rat_hz: 500"), ":7", "unknown key rat_hz");
  expectRefused(with("rate_hz: 500", "rate_hz: 500\nrate_hz: 400"), ":8", "twice");
  expectRefused(with("rate_hz: 500", "rate_hz: 5"), "rate_hz is 5", "[20, 4000] Hz");
  expectRefused(with("output_delay_s: 0.002", "output_delay_s: 0.2"), "output_delay_s", "[0, 0.1] s");
  expectRefused(with("max_force_n: 2.5", "max_force_n: 0"), "limits.max_force_n", "N");
  expectRefused(with("max_force_n: 2.5, ", ""), "limits.max_force_n", "is missing");
  expectRefused(with("max_stiffness_n_m: 500", "max_stiffness_n_m: 20001"), "limits.max_stiffness_n_m", "N/m");
  expectRefused(with("max_damping_n_s_m: 3", "max_damping_n_s_m: -1"), "limits.max_damping_n_s_m", "N s/m");
  expectRefused(with("workspace_radius_m: 0.08", "workspace_radius_m: 3"), "limits.workspace_radius_m", "m");
  expectRefused(with("mass_kg: 0.05", "mass_kg: 0.001"), "mechanics.mass_kg", "kg");
  expectRefused(with("damping_n_s_m: 0.1", "damping_n_s_m: 0"), "mechanics.damping_n_s_m", "N s/m");
  expectRefused(with("friction_n: 0.26", "friction_n: -1"), "mechanics.friction_n", "N");
  expectRefused(with("resolution_m: 0.00005", "resolution_m: 0.1"), "mechanics.position_resolution_m", "m");
  expectRefused(with("style: crtk", "style: ros"), "style is 'ros'", "crtk, omni, joy, keyboard");
  expectRefused(with("needs_homing: true", "needs_homing: maybe"), "needs_homing", "true or false");
  expectRefused(with("measured_cp: arm/measured_cp", "measured_cp: \"\""), "topics.measured_cp", "empty");
  expectRefused(with("  operating_state: arm/operating_state\n", ""), "needs_homing", "needs topics.operating_state");
  expectRefused(with("as: 3", "as: 31"), "topics.buttons[1].as", "go beyond");
  expectRefused(with("as: 3", "as: 0"), "topics.buttons[1].as", "second source");
  expectRefused(with("closed_below: 0.1", "closed_below: 11"), "topics.buttons[2].closed_below", "[-10, 10]");
  expectRefused(with("closed_below: 0.1", "closed_below: 0.1, count: 2"), ":", "unknown key topics.buttons[2].count");
  expectRefused(with("scale: 0.5", "scale: 0"), "mapping.scale", "[0.01, 100]");
  expectRefused(with("force_scale: 2", "force_scale: 101"), "mapping.force_scale", "[0.01, 100]");
  expectRefused(with("[0.0, 0.0, 1.0, 0.0]", "[0.0, 0.0, 0.5, 0.0]"), "mapping.orientation_xyzw", "unit quaternion");
  expectRefused(with("[1.0, 0.0, 0.0, 0.0]", "[1.0, 0.0, 0.0]"), "mapping.handle_orientation_xyzw", "4 numbers");
  expectRefused(with("force_frame: body", "force_frame: tip"), "mapping.force_frame", "base, body");
  expectRefused(with("clutch_button: 1", "clutch_button: 32"), "mapping.clutch_button", "[0, 31]");
  expectRefused(with("align_with: volume", "align_with: table"), "mapping.align_with", "camera, volume");
}

/// The rules that no file may loosen.
TEST(DeviceProfile, SafetyCanOnlyBeStricter) {
  expectRefused(with("max_growth_n_s: 80", "max_growth_n_s: 101"), "safety.max_growth_n_s", "N/s");
  expectRefused(with("ramp_in_s: 0.3", "ramp_in_s: 0.1"), "safety.ramp_in_s", "[0.2, 10] s");
  expectRefused(with("stale_after_s: 0.01", "stale_after_s: 0.03"), "safety.stale_after_s", "[0.001, 0.02] s");
  expectRefused(with("drop_s: 0.02", "drop_s: 0.03"), "safety.drop_s", "s");
  expectRefused(with("max_speed_m_s: 0.9", "max_speed_m_s: 1.1"), "safety.max_speed_m_s", "[0.01, 1] m/s");
}

TEST(DeviceProfile, SectionsOfOtherStylesAreRefused) {
  expectRefused(wholeFile() + "omni: {state: a, button: b, force_feedback: c}\n", "omni", "remove it");
  expectRefused(wholeFile() + "teleop: {max_speed_m_s: 0.1}\n", "teleop", "remove it");
  expectRefused(with("style: crtk", "style: omni"), "omni.state", "is missing");
  expectRefused(with("style: crtk", "style: joy"), "teleop.joy", "is missing");
}

TEST(DeviceProfile, ReadsTheSectionsOfItsStyle) {
  const OmniTopics omni = parse(with("style: crtk", R"(style: omni
omni:
  state: phantom/state
  button: phantom/button
  force_feedback: phantom/force_feedback
  position_unit_m: 0.01
  orientation_frame_xyzw: [1.0, 0.0, 0.0, 0.0])"))
                              .omni;
  EXPECT_EQ(omni.state, "phantom/state");
  EXPECT_EQ(omni.button, "phantom/button");
  EXPECT_EQ(omni.force_feedback, "phantom/force_feedback");
  EXPECT_EQ(omni.position_unit_m, 0.01);
  EXPECT_EQ(omni.orientation_frame.x(), 1.0);
  const TeleopConfig teleop = parse(with("style: crtk", R"(style: joy
teleop: {joy: spacenav/joy, max_speed_m_s: 0.1, max_turn_rad_s: 0.5, dead_zone: 0.1})"))
                                  .teleop;
  EXPECT_EQ(teleop.joy, "spacenav/joy");
  EXPECT_EQ(teleop.max_speed_m_s, 0.1);
  EXPECT_EQ(teleop.max_turn_rad_s, 0.5);
  EXPECT_EQ(teleop.dead_zone, 0.1);
}

/// What stands in the table of doc/haptics.md, which is that of the devices that are known by name.
TEST(DeviceProfile, EveryShippedFileLoadsWithTheLimitsOfItsDevice) {
  const std::map<std::string, std::string> models = {
      {"falcon", "falcon"},  {"force_dimension", "omega_7"}, {"keyboard", "touch"}, {"omni", "omni"},
      {"spacenav", "touch"}, {"sensable_phantom", "touch"},  {"virtual", "touch"}};
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(SOFT_VOLUME_SOURCE_DIR "/config/devices")) {
    SCOPED_TRACE(entry.path());
    ++files;
    const DeviceProfile profile = loadDeviceProfile(entry.path().string());
    EXPECT_NO_THROW(profile.mapping.validate(profile.name));
    EXPECT_NO_THROW(profile.limits.validate(profile.name));
    EXPECT_NO_THROW(profile.safety.validate(profile.name));
    EXPECT_FALSE(profile.topics.buttons.empty());
    const auto model = models.find(entry.path().stem().string());
    if (model == models.end())
      continue;
    const DeviceLimits known = deviceLimits(model->second);
    EXPECT_LE(profile.limits.max_force_n, known.max_force_n);  // a driver may allow less
    EXPECT_EQ(profile.limits.max_stiffness_n_m, known.max_stiffness_n_m);
    EXPECT_EQ(profile.limits.max_damping_n_s_m, known.max_damping_n_s_m);
    const bool motors = !profile.topics.servo_cf.empty();
    if (motors) {
      EXPECT_EQ(profile.limits.workspace_radius_m, known.workspace_radius_m);
      const DeviceMechanics mechanics = deviceMechanics(model->second);
      EXPECT_EQ(profile.mechanics.mass_kg, mechanics.mass_kg);
      EXPECT_EQ(profile.mechanics.friction_n, mechanics.friction_n);
      EXPECT_EQ(profile.mechanics.position_resolution_m, mechanics.position_resolution_m);
    }
  }
  EXPECT_EQ(files, 8u);
}

struct Directions {
  const char* file;
  Vector3 right, away, up;  // for the user, in the base frame
  Vector3 shaft;            // to the hand, in the handle's frame
};

/// As the drivers define their frames.
TEST(DeviceProfile, EveryShippedFileKnowsWhereTheUserIs) {
  const Vector3 x = Vector3::UnitX(), y = Vector3::UnitY(), z = Vector3::UnitZ();
  const Directions expected[] = {{"virtual", x, y, z, z},          {"sensable_phantom", x, -z, y, z},
                                 {"force_dimension", y, -x, z, x}, {"falcon", y, -x, z, x},
                                 {"dvrk_mtm", -x, z, y, -z},       {"omni", x, y, z, z}};
  for (const Directions& device : expected) {
    SCOPED_TRACE(device.file);
    const auto mapping =
        loadDeviceProfile(SOFT_VOLUME_SOURCE_DIR "/config/devices/" + std::string(device.file) + ".yaml").mapping;
    EXPECT_TRUE((mapping.orientation * device.right).isApprox(x, 1e-9));
    EXPECT_TRUE((mapping.orientation * device.away).isApprox(y, 1e-9));
    EXPECT_TRUE((mapping.orientation * device.up).isApprox(z, 1e-9));
    EXPECT_TRUE((mapping.handle_orientation * z).isApprox(device.shaft, 1e-9));
  }
  const auto mouse = loadDeviceProfile(SOFT_VOLUME_SOURCE_DIR "/config/devices/spacenav.yaml").mapping;
  EXPECT_TRUE((mouse.orientation * x).isApprox(y, 1e-9));   // forward is away
  EXPECT_TRUE((mouse.orientation * y).isApprox(-x, 1e-9));  // left
}

TEST(DeviceProfile, AMissingFileSaysWhereTheOthersAre) {
  try {
    loadDeviceProfile("no/such/file.yaml");
    ADD_FAILURE();
  } catch (const SceneError& error) {
    EXPECT_NE(std::string(error.what()).find("config/devices"), std::string::npos);
  }
}

/// What moves to the right in the image must do so in the hand: seen along the camera, up is up and away is away.
TEST(DeviceProfile, ComesToLieAsTheCameraSeesIt) {
  DeviceProfile profile;
  Scene scene;
  scene.device.workspace_centre_m = {0.1, 0.2, 0.3};
  EXPECT_TRUE(profile.placeIn(scene).orientation.isApprox(Quaternion::Identity()));
  CameraSettings camera;
  camera.camera = Camera::lookAt({-1.0, 2.0, 0.5}, {0.1, 0.2, 0.3}, Vector3::UnitZ(), 0.6, 640, 480);
  scene.rendering.cameras.push_back(camera);
  const WorkspacePlace place = profile.placeIn(scene);
  EXPECT_EQ(place.centre_m, scene.device.workspace_centre_m);
  const Pose& view = camera.camera.T_volume_camera;
  const auto in_image = [&](const Vector3& user) {
    return Vector3(view.orientation.conjugate() * (place.orientation * user));
  };
  EXPECT_TRUE(in_image(Vector3::UnitX()).isApprox(Vector3::UnitX(), 1e-9));   // right
  EXPECT_TRUE(in_image(Vector3::UnitY()).isApprox(Vector3::UnitZ(), 1e-9));   // away from the user: into the image
  EXPECT_TRUE(in_image(Vector3::UnitZ()).isApprox(-Vector3::UnitY(), 1e-9));  // up: an image's y points down
  profile.align_with_camera = false;
  EXPECT_TRUE(profile.placeIn(scene).orientation.isApprox(Quaternion::Identity()));
}

}  // namespace
}  // namespace soft_volume::core
