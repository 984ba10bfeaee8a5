#include "soft_volume/scene/scene.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "small_scene.h"
#include "soft_volume/common/error.h"
#include "soft_volume/simulation/presets.h"
#include "soft_volume/simulation/setting_names.h"
#include "soft_volume/volume/volume_reader.h"

namespace soft_volume::core {
namespace {

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return text.replace(at, from.size(), to);
}

std::string errorOf(const std::string& yaml) {
  try {
    parseScene(yaml, "scene.yaml", "/data");
  } catch (const SceneError& error) {
    return error.what();
  }
  return "";
}

std::string errorWith(const std::string& from, const std::string& to) {
  return errorOf(replaced(smallSceneText(), from, to));
}

TEST(Scene, ReadsWhatIsThereAndFillsInDefaults) {
  const Scene scene = smallScene();
  EXPECT_EQ(scene.name, "block");
  EXPECT_EQ(scene.volume.file, "/data/block.mha");
  ASSERT_EQ(scene.materials.size(), 1U);
  EXPECT_EQ(scene.materials[0].youngs_modulus_pa, 5000.0);
  EXPECT_EQ(scene.materials[0].poisson_ratio, 0.25);
  EXPECT_EQ(scene.materials[0].damping_ratio, 0.5);
  EXPECT_EQ(scene.lattice.spacing_m, Vector3::Constant(0.008));
  EXPECT_EQ(scene.lattice.stiff_fraction, LatticeSettings().stiff_fraction);
  EXPECT_EQ(scene.simulation.lifetime_s, 0.5);
  EXPECT_EQ(scene.simulation.dt_s, 0.001);
  EXPECT_EQ(scene.simulation.integrator, SimulationSettings().integrator);
  EXPECT_EQ(scene.simulation.activation_threshold, SimulationSettings().activation_threshold);
  ASSERT_EQ(scene.tools.size(), 2U);
  EXPECT_EQ(scene.tools[1].kind, ToolKind::kScalpel);
  EXPECT_EQ(scene.tools[0].device.max_force_n, deviceLimits("touch").max_force_n);
  ASSERT_EQ(scene.device.way_points.size(), 2U);
  EXPECT_TRUE(scene.device.way_points[1].buttons[3]);
  EXPECT_FALSE(scene.device.way_points[0].pass);
  EXPECT_TRUE(scene.device.way_points[1].pass);
  EXPECT_NE(scene.findTool("probe"), nullptr);
  EXPECT_EQ(scene.findTool("spoon"), nullptr);
}

TEST(Scene, ResolvedTextReadsBackAsTheSameScene) {
  const std::string once = writeScene(smallScene());
  const Scene again = parseScene(once, "resolved", "/elsewhere");
  EXPECT_EQ(writeScene(again), once);
  EXPECT_EQ(again.volume.file, "/data/block.mha");
  const Camera& camera = again.rendering.cameras[0].camera;
  EXPECT_EQ(camera.fx, smallScene().rendering.cameras[0].camera.fx);
  EXPECT_EQ(camera.T_volume_camera.orientation.coeffs(),
            smallScene().rendering.cameras[0].camera.T_volume_camera.orientation.coeffs());
}

/// The simulation with the keys of the small scene replaced.
SimulationSettings simulationWith(const std::string& keys) {
  return parseScene(replaced(smallSceneText(), "  dt_s: 0.001\n  activation_radius_m: 0.03\n  lifetime_s: 0.5\n", keys),
                    "scene.yaml", "/data")
      .simulation;
}

void expectEqual(const SimulationSettings& a, const SimulationSettings& b) {
  EXPECT_EQ(a.integrator, b.integrator);
  EXPECT_EQ(a.safe_move, b.safe_move);
  EXPECT_EQ(a.active_set, b.active_set);
  EXPECT_EQ(a.spring_rule, b.spring_rule);
  EXPECT_EQ(a.precision, b.precision);
  EXPECT_EQ(a.dt_s, b.dt_s);
  EXPECT_EQ(a.dt_fraction, b.dt_fraction);
  EXPECT_EQ(a.substeps, b.substeps);
  EXPECT_EQ(a.activation_radius_m, b.activation_radius_m);
  EXPECT_EQ(a.activation_threshold, b.activation_threshold);
  EXPECT_EQ(a.lifetime_s, b.lifetime_s);
  EXPECT_EQ(a.error_tolerance, b.error_tolerance);
  EXPECT_EQ(a.gravity_m_s2, b.gravity_m_s2);
  ASSERT_EQ(a.pressures.size(), b.pressures.size());
  for (std::size_t n = 0; n < a.pressures.size(); ++n) {
    EXPECT_EQ(a.pressures[n].region_m.min(), b.pressures[n].region_m.min());
    EXPECT_EQ(a.pressures[n].region_m.max(), b.pressures[n].region_m.max());
    EXPECT_EQ(a.pressures[n].pressure_pa, b.pressures[n].pressure_pa);
  }
}

/// Every key with a value that is not its default.
constexpr char kUnusualSimulation[] = R"(  integrator: backward_euler
  safe_move: none
  active_set: all
  spring_rule: dissertation
  precision: double
  dt_s: 0.3333333333333333
  dt_fraction: 0.7
  substeps: true
  activation_radius_m: 0.0123
  activation_threshold: 0.0021
  lifetime_s: 0.7777777777777777
  error_tolerance: 3e-7
  gravity_m_s2: [0.1, -9.81, 1e-3]
  pressures:
    - {min: [-1, -1, 0.03], max: [1, 1, 1], pressure_pa: 120.5}
    - {min: [0, 0, 0], max: [0, 0, 0], pressure_pa: -3}
)";

TEST(Scene, ReadsEveryKeyOfTheSimulation) {
  SimulationSettings expected;
  expected.integrator = Integrator::kBackwardEuler;
  expected.safe_move = SafeMove::kNone;
  expected.active_set = ActiveSet::kAll;
  expected.spring_rule = SpringRule::kDissertation;
  expected.precision = Precision::kDouble;
  expected.dt_s = 1.0 / 3.0;
  expected.dt_fraction = 0.7;
  expected.substeps = true;
  expected.activation_radius_m = 0.0123;
  expected.activation_threshold = 0.0021;
  expected.lifetime_s = 0.7777777777777777;
  expected.error_tolerance = 3e-7;
  expected.gravity_m_s2 = {0.1, -9.81, 1e-3};
  expected.pressures = {{Box3(Vector3(-1, -1, 0.03), Vector3(1, 1, 1)), 120.5},
                        {Box3(Vector3(0, 0, 0), Vector3(0, 0, 0)), -3.0}};
  expectEqual(simulationWith(kUnusualSimulation), expected);
}

TEST(Scene, EveryChoiceOfTheSimulationHasAName) {
  for (const auto& named : kChoices<Integrator>)
    EXPECT_EQ(simulationWith(std::string("  integrator: ") + named.name + "\n").integrator, named.choice);
  for (const auto& named : kChoices<SafeMove>)
    EXPECT_EQ(simulationWith(std::string("  safe_move: ") + named.name + "\n").safe_move, named.choice);
  for (const auto& named : kChoices<ActiveSet>)
    EXPECT_EQ(simulationWith(std::string("  active_set: ") + named.name + "\n").active_set, named.choice);
  EXPECT_EQ(choiceNames<Integrator>().size(), static_cast<std::size_t>(Integrator::kQuasiStatic) + 1);
  EXPECT_FALSE(choiceNamed<Precision>("half"));
}

TEST(Scene, ATimeStepMayBeAutomatic) {
  EXPECT_EQ(simulationWith("  dt_s: auto\n").dt_s, 0.0);
  EXPECT_EQ(simulationWith("  dt_fraction: 0.5\n").dt_s, 0.0);
  const std::string text = writeScene(parseScene(replaced(smallSceneText(), "dt_s: 0.001", "dt_s: auto"), "a", "/"));
  EXPECT_EQ(parseScene(text, "resolved", "/").simulation.dt_s, 0.0);
}

TEST(Scene, PresetsGiveWhatOtherKeysDoNot) {
  for (const std::string& name : simulationPresetNames())
    expectEqual(simulationWith("  preset: " + name + "\n"), simulationPreset(name));
  expectEqual(simulationWith("  gravity_m_s2: [0, 0, 0]\n"), simulationPreset("balanced"));
  expectEqual(simulationPreset("balanced"), SimulationSettings());
  SimulationSettings expected = simulationPreset("reed1997");
  expected.dt_s = 0.0005;
  expected.active_set = ActiveSet::kAll;
  expectEqual(simulationWith("  active_set: all\n  preset: reed1997\n  dt_s: 0.0005\n"), expected);
  EXPECT_EQ(expected.integrator, Integrator::kDissertation);
  EXPECT_EQ(expected.safe_move, SafeMove::kDissertation);
  EXPECT_EQ(expected.spring_rule, SpringRule::kDissertation);
  EXPECT_EQ(expected.precision, Precision::kDouble);
  EXPECT_THROW(simulationPreset("quick"), SceneError);
}

TEST(Scene, EveryKeyOfTheSimulationSurvivesTheResolvedText) {
  Scene scene = smallScene();
  scene.simulation = simulationWith(kUnusualSimulation);
  scene.materials[0].poisson_ratio = 0.49;
  scene.materials[0].damping_ratio = 1.0 / 3.0;
  scene.materials[0].prestretch = 1.15;
  scene.incision.opening_pressure_pa = 250.0;
  scene.lattice.spacing_m = {0.008, 0.01, 0.0095};
  const Scene again = parseScene(writeScene(scene), "resolved", "/");
  expectEqual(again.simulation, scene.simulation);
  EXPECT_EQ(again.materials[0].poisson_ratio, 0.49);
  EXPECT_EQ(again.materials[0].damping_ratio, 1.0 / 3.0);
  EXPECT_EQ(again.materials[0].prestretch, 1.15);
  EXPECT_EQ(again.incision.opening_pressure_pa, 250.0);
  EXPECT_EQ(again.lattice.spacing_m, scene.lattice.spacing_m);
}

/// Every key of the rendering but its cameras, with a value that is not its default.
constexpr char kUnusualRendering[] = R"(transfer_function:
  unit_distance_m: 0.0007
  points: [[-5.5, 0, 0.1, 0.2, 0], [1000, 1, 0.9, 0.3333333333333333, 1]]
backend: exact
slices: 4096
step_m: 0.00123
shading: 0.3
specular: 0.9
exact_boundary: true
adaptive: true
jitter: true
depth_threshold: 0.25
clip_planes: [[1, 0, 0, 0.04], [3, 0, -4, -0.01]]
incremental: false
progressive: true
background: [0.1, 0.2, 0.3]
rate_hz: 33.3
jpeg_quality: 42
)";

RenderSettings unusualRendering() {
  RenderSettings r;
  r.transfer_function.unit_distance_m = 0.0007;
  r.transfer_function.points = {{-5.5, Vector3f(0.0F, 0.1F, 0.2F), 0.0F},
                                {1000.0, Vector3f(1.0F, 0.9F, 1 / 3.0F), 1.0F}};
  r.backend = Backend::kExact;
  r.options.slices = 4096;
  r.options.step_m = 0.00123;
  r.options.shading = 0.3;
  r.options.specular = 0.9;
  r.options.exact_boundary = true;
  r.options.adaptive = true;
  r.options.jitter = true;
  r.options.depth_threshold = 0.25;
  r.options.clip_planes = {{Vector3(1, 0, 0), 0.04}, {Vector3(0.6, 0, -0.8), -0.01}};
  r.incremental = false;
  r.progressive = true;
  r.background = {0.1F, 0.2F, 0.3F};
  r.rate_hz = 33.3;
  r.jpeg_quality = 42;
  return r;
}

void expectEqual(const TransferFunction& a, const TransferFunction& b) {
  EXPECT_EQ(a.unit_distance_m, b.unit_distance_m);
  ASSERT_EQ(a.points.size(), b.points.size());
  for (std::size_t n = 0; n < a.points.size(); ++n) {
    EXPECT_EQ(a.points[n].value, b.points[n].value);
    EXPECT_EQ(a.points[n].colour, b.points[n].colour);
    EXPECT_EQ(a.points[n].opacity, b.points[n].opacity);
  }
}

void expectEqual(const RenderOptions& a, const RenderOptions& b) {
  EXPECT_EQ(a.slices, b.slices);
  EXPECT_EQ(a.step_m, b.step_m);
  EXPECT_EQ(a.shading, b.shading);
  EXPECT_EQ(a.specular, b.specular);
  EXPECT_EQ(a.exact_boundary, b.exact_boundary);
  EXPECT_EQ(a.adaptive, b.adaptive);
  EXPECT_EQ(a.jitter, b.jitter);
  EXPECT_EQ(a.depth_threshold, b.depth_threshold);
  ASSERT_EQ(a.clip_planes.size(), b.clip_planes.size());
  for (std::size_t n = 0; n < a.clip_planes.size(); ++n) {
    EXPECT_EQ(a.clip_planes[n].normal, b.clip_planes[n].normal);
    EXPECT_EQ(a.clip_planes[n].offset_m, b.clip_planes[n].offset_m);
  }
}

void expectEqual(const RenderSettings& a, const RenderSettings& b) {
  expectEqual(a.transfer_function, b.transfer_function);
  EXPECT_EQ(a.backend, b.backend);
  expectEqual(a.options, b.options);
  EXPECT_EQ(a.incremental, b.incremental);
  EXPECT_EQ(a.progressive, b.progressive);
  EXPECT_EQ(a.background, b.background);
  EXPECT_EQ(a.rate_hz, b.rate_hz);
  EXPECT_EQ(a.jpeg_quality, b.jpeg_quality);
}

TEST(Scene, ReadsEveryKeyOfTheRendering) {
  const RenderSettings read = overrideRendering(smallScene(), kUnusualRendering, "text");
  expectEqual(read, unusualRendering());
  EXPECT_EQ(read.cameras.size(), 1U);
}

TEST(Scene, EveryKeyOfTheRenderingSurvivesTheResolvedText) {
  Scene scene = smallScene();
  const std::vector<CameraSettings> cameras = scene.rendering.cameras;
  scene.rendering = unusualRendering();
  scene.rendering.options.clip_planes[1].normal = Vector3(1, 2, 3).normalized();
  scene.rendering.cameras = cameras;
  expectEqual(parseScene(writeScene(scene), "resolved", "/").rendering, scene.rendering);
  expectEqual(overrideRendering(smallScene(), writeRendering(scene.rendering), "resolved"), scene.rendering);
}

TEST(Scene, KeysOfTheRenderingAreOverriddenOneByOne) {
  const Scene scene = smallScene();
  RenderSettings expected = scene.rendering;
  expectEqual(overrideRendering(scene, "{}", "text"), expected);
  expected.backend = Backend::kGl;
  expected.options.slices = 7;
  expectEqual(overrideRendering(scene, "{slices: 7, backend: gl}", "text"), expected);
  // As a node does before it has a scene.
  EXPECT_EQ(overrideRendering(Scene(), "{slices: 7}", "text").options.slices, 7);
  const auto refused = [&scene](const std::string& yaml, const std::string& part) {
    try {
      overrideRendering(scene, yaml, "the parameters");
      ADD_FAILURE() << yaml << " was accepted";
    } catch (const SceneError& error) {
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    }
  };
  refused("{slices: 0}", "the parameters:1: slices is 0; it must be within [1, 4096]");
  refused("{slice: 7}", "unknown key slice");
  refused("{cameras: []}", "unknown key cameras");
  refused("{transfer_function: {points: [[0, 0, 0, 0, 0]]}}", "transfer_function.points");
  refused("slices: [", "not valid YAML");
  refused("", "mapping");
}

/// A camera in a file of its own, for grids in any unit of length.
TEST(Scene, LoadsACameraOfItsOwn) {
  const std::string path = testing::TempDir() + "soft_volume_camera.yaml";
  const auto load = [&path](const std::string& text) {
    std::ofstream(path) << text;
    return loadCamera(path, 2.0, 30000.0);
  };
  const std::string view = "width: 80\nheight: 60\neye_m: [0, 0, 9000]\ntarget_m: [0, 0, 0]\nup: [0, 1, 0]\n";
  const Camera camera = load(view + "projection: parallel\nview_height_m: 600\n");
  EXPECT_EQ(camera.projection, Projection::kParallel);
  EXPECT_DOUBLE_EQ(camera.fx, 0.1);
  EXPECT_EQ(camera.near_m, 2.0);
  EXPECT_EQ(camera.far_m, 30000.0);
  EXPECT_EQ(load(view + "near_m: 7\n").near_m, 7.0);
  const auto refused = [&](const std::string& text, const std::string& part) {
    try {
      load(text);
      ADD_FAILURE() << text;
    } catch (const SceneError& error) {
      EXPECT_EQ(std::string(error.what()).compare(0, path.size(), path), 0) << error.what();
      EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what();
    }
  };
  refused(view + "fov: 1\n", "unknown key fov");
  refused(replaced(view, "9000", ".inf"), "eye_m");
  refused(replaced(view, "9000", "0"), "same point");
  refused(replaced(view, "[0, 1, 0]", "[0, 0, 1]"), "along the view direction");
  refused("fx: 100\nfy: 100\ncx: 0\ncy: 0\nposition_m: [0, 0, 0]\norientation_xyzw: [0, 0, 0, 0]\n", "quaternion");
  refused("width: 0\n" + view.substr(view.find('h')), "width");
  EXPECT_THROW(loadCamera(path + ".missing", 1.0, 2.0), SceneError);
}

constexpr char kFunctionOfMaterials[] = "transfer_function:\n    from_materials: true";

RenderSettings withFunction(const std::string& source) {
  return parseScene(replaced(smallSceneText(), kFunctionOfMaterials, "transfer_function: " + source), "scene",
                    SOFT_VOLUME_SOURCE_DIR "/config/scenes")
      .rendering;
}

TEST(Scene, ATransferFunctionMayBeAPresetOrAFile) {
  const RenderSettings preset = withFunction("ct_skin");
  EXPECT_FALSE(preset.transfer_file);
  EXPECT_EQ(preset.transfer_function.points.front().value, -1024.0);
  expectEqual(withFunction("../transfer_functions/ct_skin.yaml").transfer_function, preset.transfer_function);
  setenv("SOFT_VOLUME_TEST_FUNCTIONS", SOFT_VOLUME_SOURCE_DIR "/config/transfer_functions", 1);
  expectEqual(withFunction("${SOFT_VOLUME_TEST_FUNCTIONS}/ct_skin.yaml").transfer_function, preset.transfer_function);
}

TEST(Scene, ATransferFunctionOfPartsOfTheRangeWaitsForTheVolume) {
  RenderSettings settings = withFunction("viridis");
  ASSERT_TRUE(settings.transfer_file);
  fitTransferFunction(settings, *smallVolume());  // 0 to 100
  EXPECT_FALSE(settings.transfer_file);
  EXPECT_EQ(settings.transfer_function.points.front().value, 0.0);
  EXPECT_EQ(settings.transfer_function.points.back().value, 100.0);
  const double diagonal_m = Vector3::Constant(0.048).norm();
  EXPECT_NEAR(settings.transfer_function.unit_distance_m, 0.01 * diagonal_m, 1e-12);
  // Points of the scene's own take the place of the file.
  Scene scene = smallScene();
  scene.rendering = withFunction("viridis");
  EXPECT_FALSE(overrideRendering(scene, kUnusualRendering, "text").transfer_file);
  EXPECT_TRUE(overrideRendering(scene, "{slices: 3}", "text").transfer_file);
}

TEST(Scene, CamerasMayBeParallel) {
  const std::string text = replaced(smallSceneText(), "up: [0, 0, 1]",
                                    "up: [0, 0, 1]\n      projection: parallel\n      view_height_m: 0.12");
  const Scene scene = parseScene(text, "scene", "/");
  const Camera& camera = scene.rendering.cameras[0].camera;
  EXPECT_EQ(camera.projection, Projection::kParallel);
  EXPECT_DOUBLE_EQ(camera.fx, 60 / 0.12);  // pixels per metre
  EXPECT_EQ(smallScene().rendering.cameras[0].camera.projection, Projection::kPerspective);
  const Camera again = parseScene(writeScene(scene), "resolved", "/").rendering.cameras[0].camera;
  EXPECT_EQ(again.projection, Projection::kParallel);
  EXPECT_EQ(again.fx, camera.fx);
}

TEST(Scene, CellsMayBeBoxes) {
  const auto spacing = [](const std::string& text) {
    return parseScene(replaced(smallSceneText(), "spacing_m: 0.008", "spacing_m: " + text), "a", "/").lattice.spacing_m;
  };
  EXPECT_EQ(spacing("[0.008, 0.006, 0.01]"), Vector3(0.008, 0.006, 0.01));
  EXPECT_EQ(spacing("[0.006, 0.006, 0.010]"), Vector3(0.006, 0.006, 0.010));
  const std::string error = errorWith("spacing_m: 0.008", "spacing_m: [0.005, 0.005, 0.01]");
  EXPECT_NE(error.find("scene.yaml:14: lattice.spacing_m has edges in a ratio of 2"), std::string::npos) << error;
}

TEST(Scene, ErrorsNameFileLineKeyValueAndRange) {
  const std::string error = errorWith("spacing_m: 0.008", "spacing_m: -0.008");
  EXPECT_NE(error.find("scene.yaml:14: lattice.spacing_m is -0.008"), std::string::npos) << error;
  EXPECT_NE(error.find("[0.0002, 0.1] m"), std::string::npos) << error;
}

TEST(Scene, RefusesUnknownAndDuplicateKeys) {
  EXPECT_NE(errorWith("dt_s: 0.001", "dt: 0.001").find("scene.yaml:19: unknown key simulation.dt"), std::string::npos);
  EXPECT_NE(errorWith("  lifetime_s: 0.5", "  lifetime_s: 0.5\n  lifetime_s: 0.6")
                .find("simulation.lifetime_s is there twice"),
            std::string::npos);
  EXPECT_NE(errorWith("name: block", "name: block\nshape: round").find("unknown key shape"), std::string::npos);
  EXPECT_NE(errorWith("    density_kg_m3", "    weight: 1\n    density_kg_m3").find("unknown key materials[0].weight"),
            std::string::npos);
}

/// One bad value per field; every one must be refused with the field's name in the error.
TEST(Scene, RejectsOneBadValuePerField) {
  struct Case {
    const char* from;
    const char* to;
    const char* field;
  };
  const Case cases[] = {
      {"format: 1", "format: 2", "format"},
      {"name: block", "colour: red", "name"},
      {"  file: block.mha", "  labels: x", "volume.file"},
      {"  file: block.mha", "  file: block.mha\n  stride: [0, 1, 1]", "volume.stride"},
      {"  file: block.mha", "  file: block.mha\n  begin: [1, 2]", "volume.begin"},
      {"  file: block.mha", "  file: block.mha\n  end: [1.5, 2, 3]", "volume.end"},
      {"  file: block.mha", "  file: ${SOFT_VOLUME_NO_SUCH_VARIABLE}/x", "volume.file"},
      {"intensity: [50, 200]", "intensity: [200, 50]", "intensity"},
      {"intensity: [50, 200]", "intensity: [50, 200]\n    labels: [1]", "intensity"},
      {"intensity: [50, 200]", "labels: []", "labels"},
      {"density_kg_m3: 1000", "density_kg_m3: 0", "density_kg_m3"},
      {"youngs_modulus_pa: 5000", "youngs_modulus_pa: .nan", "youngs_modulus_pa"},
      {"youngs_modulus_pa: 5000", "youngs_modulus_pa: stiff", "youngs_modulus_pa"},
      {"damping_ratio: 0.5", "damping_ratio: -1", "damping_ratio"},
      {"damping_ratio: 0.5", "damping_ratio: 10.5", "damping_ratio"},
      {"damping_ratio: 0.5", "poisson_ratio: 0.5", "poisson_ratio"},
      {"damping_ratio: 0.5", "poisson_ratio: 0.24", "poisson_ratio"},
      {"damping_ratio: 0.5", "prestretch: 0.95", "prestretch"},
      {"damping_ratio: 0.5", "prestretch: 1.6", "prestretch"},
      {"damping_ratio: 0.5", "fixed: maybe", "fixed"},
      {"damping_ratio: 0.5", "cut_resistance_j_m2: -1", "cut_resistance_j_m2"},
      {"colour: [0.9, 0.6, 0.5]", "colour: [2, 0, 0]", "colour"},
      {"opacity: 0.5", "opacity: 1.5", "opacity"},
      {"spacing_m: 0.008", "spacing_m: 0.008\n  stiff_fraction: 2", "stiff_fraction"},
      {"spacing_m: 0.008", "spacing_m: 0.008\n  keep_largest_part: 7", "keep_largest_part"},
      {"max: [1, 1, 0.001]", "max: [-2, 1, 0.001]", "fixed_regions_m[0]"},
      {"spacing_m: 0.008", "spacing_m: [0.008, 0.008]", "lattice.spacing_m"},
      {"spacing_m: 0.008", "spacing_m: [0.008, 0.008, 1]", "lattice.spacing_m"},
      {"spacing_m: 0.008", "spacing_m: [0.008, 0.008, 0.02]", "lattice.spacing_m"},
      {"dt_s: 0.001", "preset: quick", "simulation.preset"},
      {"dt_s: 0.001", "dt_s: 0", "simulation.dt_s"},
      {"dt_s: 0.001", "dt_s: 11", "simulation.dt_s"},
      {"dt_s: 0.001", "dt_s: soon", "simulation.dt_s is neither auto nor a number"},
      {"dt_s: 0.001", "dt_s: [0.001]", "simulation.dt_s"},
      {"dt_s: 0.001", "dt_fraction: 1.1", "simulation.dt_fraction"},
      {"dt_s: 0.001", "substeps: 4", "simulation.substeps"},
      {"dt_s: 0.001", "integrator: magic", "simulation.integrator"},
      {"dt_s: 0.001", "safe_move: magic", "simulation.safe_move"},
      {"dt_s: 0.001", "active_set: magic", "simulation.active_set"},
      {"dt_s: 0.001", "spring_rule: magic", "simulation.spring_rule"},
      {"dt_s: 0.001", "precision: half", "simulation.precision"},
      {"dt_s: 0.001", "safe_move_fraction: 0.4", "unknown key simulation.safe_move_fraction"},
      {"dt_s: 0.001", "activation_threshold: 0", "simulation.activation_threshold"},
      {"dt_s: 0.001", "error_tolerance: 1", "simulation.error_tolerance"},
      {"dt_s: 0.001", "gravity_m_s2: -9.81", "simulation.gravity_m_s2"},
      {"dt_s: 0.001", "gravity_m_s2: [0, 0, -9810]", "simulation.gravity_m_s2"},
      {"dt_s: 0.001", "pressures: [{min: [0, 0, 0], max: [1, 1, 1]}]", "simulation.pressures[0].pressure_pa"},
      {"dt_s: 0.001", "pressures: [{min: [0, 0, 0], max: [1, 1, 1], pressure_pa: .inf}]", "pressures[0].pressure_pa"},
      {"dt_s: 0.001", "pressures: [{min: [0, 0, 0], max: [1, 1, -1], pressure_pa: 1}]", "simulation.pressures[0].min"},
      {"activation_radius_m: 0.03", "activation_radius_m: -1", "simulation.activation_radius_m"},
      {"lifetime_s: 0.5", "lifetime_s: -1", "simulation.lifetime_s"},
      {"lifetime_s: 0.5", "lifetime_s: for ever", "simulation.lifetime_s"},
      {"lifetime_s: 0.5", "max_tool_force_n: 0", "simulation.max_tool_force_n"},
      {"rendering:", "incision: {rest_fraction: 0.1}\nrendering:", "incision.rest_fraction"},
      {"rendering:", "incision: {opening_pressure_pa: -1}\nrendering:", "incision.opening_pressure_pa"},
      {"rendering:", "output: {state_rate_hz: 0}\nrendering:", "output.state_rate_hz"},
      {"rendering:", "output: {patch_rate_hz: 0}\nrendering:", "output.patch_rate_hz"},
      {"rendering:", "output: {key_frame_interval_s: 0}\nrendering:", "output.key_frame_interval_s"},
      {"rendering:", "output: {checkpoint_interval_s: 0}\nrendering:", "output.checkpoint_interval_s"},
      {"from_materials: true", "points: [[0, 0, 0, 0, 0]]", "transfer_function.points"},
      {"from_materials: true", "points: [[1, 0, 0, 0, 0], [0, 0, 0, 0, 0]]", "transfer_function.points"},
      {"from_materials: true", "points: [[1, 0, 0, 0]]", "transfer_function.points"},
      {"from_materials: true", "from_materials: true\n    unit_distance_m: 0", "unit_distance_m"},
      {kFunctionOfMaterials, "transfer_function: rainbow", "rendering.transfer_function cannot be used: rainbow"},
      {kFunctionOfMaterials, "transfer_function: none.yaml", "/data/none.yaml"},
      {kFunctionOfMaterials, "transfer_function: [ct_skin]", "transfer_function must be a mapping"},
      {"slices: 40", "slices: 0", "rendering.slices"},
      {"slices: 40", "slices: 2.5", "rendering.slices"},
      {"slices: 40", "backend: cuda", "rendering.backend"},
      {"slices: 40", "step_m: -0.001", "rendering.step_m"},
      {"slices: 40", "step_m: 2", "rendering.step_m"},
      {"slices: 40", "shading: 2", "rendering.shading"},
      {"slices: 40", "specular: 1.1", "rendering.specular"},
      {"slices: 40", "exact_boundary: 2", "rendering.exact_boundary"},
      {"slices: 40", "adaptive: often", "rendering.adaptive"},
      {"slices: 40", "jitter: 0.5", "rendering.jitter"},
      {"slices: 40", "clip_planes: [[1, 0, 0]]", "rendering.clip_planes"},
      {"slices: 40", "clip_planes: [[0, 0, 0, 0.1]]", "rendering.clip_planes"},
      {"slices: 40", "clip_planes: [[1, 0, 0, .nan]]", "rendering.clip_planes"},
      {"slices: 40", "clip_planes: 0.1", "rendering.clip_planes"},
      {"slices: 40",
       "clip_planes: [[1, 0, 0, 1], [1, 0, 0, 1], [1, 0, 0, 1], [1, 0, 0, 1], [1, 0, 0, 1], [1, 0, 0, 1], "
       "[1, 0, 0, 1], [1, 0, 0, 1], [1, 0, 0, 1]]",
       "lists more than 8 planes"},
      {"slices: 40", "incremental: 7", "rendering.incremental"},
      {"slices: 40", "progressive: 7", "rendering.progressive"},
      {"slices: 40", "depth_threshold: 1", "rendering.depth_threshold"},
      {"slices: 40", "background: [0, 0, 7]", "rendering.background"},
      {"slices: 40", "rate_hz: 0", "rendering.rate_hz"},
      {"slices: 40", "jpeg_quality: 101", "rendering.jpeg_quality"},
      {"name: camera", "name: my camera", "cameras[0].name"},
      {"width: 80", "width: 0", "cameras[0].width"},
      {"height: 60", "height: 1000000", "cameras[0].height"},
      {"up: [0, 0, 1]", "up: [0, 0, 0]", "cameras[0]"},
      {"up: [0, 0, 1]", "up: [0, 0, 1]\n      vertical_fov_rad: 4", "vertical_fov_rad"},
      {"up: [0, 0, 1]", "up: [0, 0, 1]\n      near_m: 20", "near_m"},
      {"up: [0, 0, 1]", "up: [0, 0, 1]\n      projection: fisheye", "cameras[0].projection"},
      {"up: [0, 0, 1]", "up: [0, 0, 1]\n      projection: parallel", "cameras[0].view_height_m is missing"},
      {"up: [0, 0, 1]", "up: [0, 0, 1]\n      projection: parallel\n      view_height_m: 0", "view_height_m"},
      {"up: [0, 0, 1]", "up: [0, 0, 1]\n      view_height_m: 0.1", "unknown key rendering.cameras[0].view_height_m"},
      {"eye_m: [0.024, -0.2, 0.06]", "eye_m: [0.024, .inf, 0.06]", "eye_m"},
      {"- id: scalpel", "- id: probe", "tools[1].id"},
      {"kind: scalpel", "kind: spoon", "tools[1].kind"},
      {"kind: scalpel\n    tissue_threshold: 75", "kind: scalpel", "tools[1].tissue_threshold"},
      {"kind: scalpel", "tip_radius_m: 1", "tools[1]"},
      {"kind: scalpel", "footprint_radius_m: 0.002", "footprint_radius_m"},
      {"kind: scalpel", "hold_steps: 0", "hold_steps"},
      {"kind: scalpel", "stiffness_n_m: -1", "tools[1]"},
      {"kind: scalpel", "ramp_in_s: 0", "tools[1]"},
      {"kind: scalpel", "cut_button: 32", "cut_button"},
      {"kind: scalpel", "friction_coefficient: -0.1", "friction_coefficient"},
      {"kind: scalpel", "kind: grasper\n    grasp_reach_m: 0.1", "grasp_reach_m"},
      {"kind: scalpel", "kind: grasper\n    slip_force_n: 0", "slip_force_n"},
      {"kind: scalpel", "kind: grasper\n    grasp_button: 32", "grasp_button"},
      {"device:", "device:\n  model: hammer", "device.model"},
      {"device:", "device:\n  mass_kg: 0", "device"},
      {"device:", "device:\n  swap_button: 40", "swap_button"},
      {"{time_s: 1,", "{time_s: 0,", "device"},
      {"[0.024, 0.024, 0.03]", "[0.024, 0.024, 3]", "device"},
      {"buttons: [0, 3]", "buttons: [77]", "buttons"},
      {"buttons: [0, 3]", "orientation_xyzw: [0, 0, 0, 0]", "orientation_xyzw"}};
  for (const Case& c : cases) {
    const std::string error = errorWith(c.from, c.to);
    EXPECT_NE(error.find(c.field), std::string::npos) << c.to << " gave: " << error;
  }
}

TEST(Scene, RefusesTextThatIsNoScene) {
  EXPECT_NE(errorOf("a: [1, 2").find("scene.yaml:"), std::string::npos);
  EXPECT_NE(errorOf("- 1\n- 2\n").find("mapping"), std::string::npos);
  EXPECT_NE(errorOf("").find("mapping"), std::string::npos);
  EXPECT_THROW(loadScene("/no/such/scene.yaml"), SceneError);
}

TEST(Scene, ShippedScenesLoad) {
  setenv("SOFT_VOLUME_CACHE", "/cache", 1);
  int loaded = 0;
  for (const auto& entry : std::filesystem::directory_iterator(SOFT_VOLUME_SOURCE_DIR "/config/scenes")) {
    const Scene scene = loadScene(entry.path().string());
    EXPECT_EQ(scene.volume.file.find("${"), std::string::npos);
    EXPECT_FALSE(scene.rendering.cameras.empty());
    ++loaded;
  }
  EXPECT_GE(loaded, 2);
}

TEST(Scene, ReadsItsVolumesWithRegionAndStride) {
  const std::filesystem::path folder = std::filesystem::temp_directory_path() / "soft_volume scene test";
  std::filesystem::create_directories(folder);
  writeMetaImage(*smallVolume(), (folder / "block.mha").string());
  const std::string text = replaced(smallSceneText(), "file: block.mha",
                                    "file: block.mha\n  labels: block.mha\n  begin: [4, 0, 0]\n  stride: [2, 1, 1]");
  const SceneVolumes volumes = readVolumes(parseScene(text, "scene", folder.string()));
  EXPECT_EQ(volumes.volume->geometry().dims, Vector3i(10, 24, 24));
  ASSERT_NE(volumes.labels, nullptr);
  const std::string outside = replaced(smallSceneText(), "file: block.mha", "file: block.mha\n  begin: [24, 0, 0]");
  EXPECT_THROW(readVolumes(parseScene(outside, "scene", folder.string())), SceneError);
  std::filesystem::remove_all(folder);
  EXPECT_THROW(readVolumes(smallScene()), FileError);
}

}  // namespace
}  // namespace soft_volume::core
