#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <utility>

#include "scene_reading.h"
#include "soft_volume/common/error.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/simulation/presets.h"
#include "soft_volume/simulation/setting_names.h"
#include "soft_volume/volume/volume_reader.h"

namespace soft_volume::core {
namespace {

/// Also what an automatic step of very stiff or very slow tissue may come to.
constexpr Range kTimeStepRange{1e-9, 10.0, "s"};
constexpr Range kIndex{0.0, 65535.0};

/// Replaces ${NAME} by the environment variable.
std::string expand(const YamlMap& map, const std::string& key, const std::string& text) {
  std::string result;
  std::size_t from = 0;
  for (std::size_t open = text.find("${"); open != std::string::npos; open = text.find("${", from)) {
    const std::size_t close = text.find('}', open);
    if (close == std::string::npos)
      map.fail(key, "has ${ without }");
    const std::string variable = text.substr(open + 2, close - open - 2);
    const char* value = std::getenv(variable.c_str());
    if (value == nullptr) {
      map.fail(key,
               "needs the environment variable " + variable +
                   (variable == "SOFT_VOLUME_CACHE" ? "; scripts/sample_data makes the sample volumes and says what "
                                                      "to set"
                                                    : ""));
    }
    result += text.substr(from, open - from) + value;
    from = close + 1;
  }
  return result + text.substr(from);
}

VolumeSource readSource(YamlMap map, const std::string& folder) {
  VolumeSource source;
  source.file = resolvePath(map, "file", map.text("file"), folder);
  source.labels = resolvePath(map, "labels", map.text("labels", ""), folder);
  source.begin = map.indices("begin", kIndex, source.begin);
  source.end = map.indices("end", kIndex, source.end);
  source.stride = map.indices("stride", {1.0, 64.0}, source.stride);
  map.finish();
  return source;
}

void readVoxels(YamlMap& map, Material& material) {
  if (map.has("labels") == map.has("intensity")) {
    map.fail("intensity", "or labels is needed, and only one of them, to say which voxels are this material");
  }
  if (map.has("labels")) {
    for (const double label : map.numbers("labels", 0, {-2147483648.0, 2147483647.0})) {
      material.labels.push_back(static_cast<std::int64_t>(label));
    }
    if (material.labels.empty())
      map.fail("labels", "must name at least one label");
    return;
  }
  const std::vector<double> interval = map.numbers("intensity", 2, kFinite);
  material.intensity_min = interval[0];
  material.intensity_max = interval[1];
  if (interval[0] >= interval[1])
    map.fail("intensity", "must be [from, to) with from < to");
}

Material readMaterial(YamlMap& map) {
  Material material;
  material.name = map.text("name");
  readVoxels(map, material);
  material.density_kg_m3 = map.number("density_kg_m3", {1.0, 30000.0, "kg/m^3"});
  material.youngs_modulus_pa = map.number("youngs_modulus_pa", {1.0, 1e12, "Pa"});
  material.poisson_ratio = map.number("poisson_ratio", {0.25, 0.49}, material.poisson_ratio);
  material.damping_ratio = map.number("damping_ratio", {0.0, 10.0}, material.damping_ratio);
  material.prestretch = map.number("prestretch", {1.0, 1.5}, material.prestretch);
  material.cut_resistance_j_m2 = map.number("cut_resistance_j_m2", {0.0, 1e6, "J/m^2"}, material.cut_resistance_j_m2);
  material.fixed = map.flag("fixed", material.fixed);
  material.colour = map.vector("colour", kFraction, Vector3::Ones()).cast<float>();
  material.opacity = static_cast<float>(map.number("opacity", kFraction, material.opacity));
  map.finish();
  return material;
}

std::vector<Material> readMaterials(YamlMap& top) {
  std::vector<Material> materials;
  std::set<std::string> names;
  for (YamlMap& map : top.maps("materials")) {
    materials.push_back(readMaterial(map));
    if (!names.insert(materials.back().name).second)
      map.fail("name", "is used by another material already");
  }
  if (materials.empty())
    top.fail("materials", "must list at least one material");
  if (materials.size() > 65535)
    top.fail("materials", "lists more than 65535 materials");
  return materials;
}

Box3 readBox(YamlMap& map) {
  const Box3 box(map.vector("min", kMetres), map.vector("max", kMetres));
  if (box.isEmpty())
    map.fail("min", "must not exceed max");
  return box;
}

LatticeSettings readLattice(YamlMap map) {
  LatticeSettings lattice;
  lattice.spacing_m = map.numberOrVector("spacing_m", {0.0002, 0.1, "m"});
  const double aspect = lattice.spacing_m.maxCoeff() / lattice.spacing_m.minCoeff();
  if (aspect > kMaxSpacingAspect) {
    map.fail("spacing_m", "has edges in a ratio of " + std::to_string(aspect) +
                              ", for which no springs exist; it must " + "be at most " +
                              std::to_string(kMaxSpacingAspect));
  }
  lattice.stiff_fraction = map.number("stiff_fraction", kFraction, lattice.stiff_fraction);
  lattice.keep_largest_part = map.flag("keep_largest_part", lattice.keep_largest_part);
  for (YamlMap& region : map.maps("fixed_regions_m")) {
    lattice.fixed_regions_m.push_back(readBox(region));
    region.finish();
  }
  map.finish();
  return lattice;
}

std::vector<SurfacePressure> readPressures(YamlMap& map) {
  std::vector<SurfacePressure> pressures;
  for (YamlMap& item : map.maps("pressures")) {
    SurfacePressure pressure;
    pressure.region_m = readBox(item);
    pressure.pressure_pa = item.number("pressure_pa", {-1e9, 1e9, "Pa"});
    item.finish();
    pressures.push_back(pressure);
  }
  return pressures;
}

void readMethod(YamlMap& map, SimulationSettings& s) {
  readChoice(map, "integrator", s.integrator);
  readChoice(map, "safe_move", s.safe_move);
  readChoice(map, "active_set", s.active_set);
  readChoice(map, "spring_rule", s.spring_rule);
  readChoice(map, "precision", s.precision);
}

/// The keys of the preset first, so that the others override it.
SimulationSettings readSimulation(YamlMap map, double& max_tool_force_n) {
  SimulationSettings s = simulationPreset(map.choice("preset", simulationPresetNames(), "balanced"));
  readMethod(map, s);
  s.dt_s = map.numberOrAuto("dt_s", kTimeStepRange, s.dt_s);
  s.dt_fraction = map.number("dt_fraction", {0.01, 1.0}, s.dt_fraction);
  s.substeps = map.flag("substeps", s.substeps);
  s.activation_radius_m = map.number("activation_radius_m", {0.0, 10.0, "m"}, s.activation_radius_m);
  s.activation_threshold = map.number("activation_threshold", {1e-9, 1.0}, s.activation_threshold);
  s.lifetime_s = map.number("lifetime_s", {1e-6, 1e6, "s"}, s.lifetime_s);
  s.error_tolerance = map.number("error_tolerance", {1e-12, 0.1}, s.error_tolerance);
  s.gravity_m_s2 = map.vector("gravity_m_s2", {-1000.0, 1000.0, "m/s^2"}, s.gravity_m_s2);
  s.pressures = readPressures(map);
  max_tool_force_n = map.number("max_tool_force_n", {0.001, 10000.0, "N"}, max_tool_force_n);
  map.finish();
  return s;
}

SimulationOutput readOutput(YamlMap map) {
  SimulationOutput output;
  output.state_rate_hz = map.number("state_rate_hz", {0.1, 1000.0, "Hz"}, output.state_rate_hz);
  output.patch_rate_hz = map.number("patch_rate_hz", {1.0, 10000.0, "Hz"}, output.patch_rate_hz);
  output.key_frame_interval_s = map.number("key_frame_interval_s", {0.01, 60.0, "s"}, output.key_frame_interval_s);
  output.checkpoint_interval_s = map.number("checkpoint_interval_s", {0.1, 3600.0, "s"}, output.checkpoint_interval_s);
  map.finish();
  return output;
}

/// Runs a config's own validation and gives its error the place in the file.
template <typename Check>
void validated(const YamlMap& map, const std::string& key, const Check& check) {
  try {
    check();
  } catch (const SceneError& error) {
    map.fail(key, std::string("cannot be used: ") + error.what());
  }
}

void readCoupling(YamlMap& map, CouplingConfig& c) {
  c.stiffness_n_m = map.number("stiffness_n_m", kFinite, c.stiffness_n_m);
  c.damping_n_s_m = map.number("damping_n_s_m", kFinite, c.damping_n_s_m);
  c.device_damping_n_s_m = map.number("device_damping_n_s_m", kFinite, c.device_damping_n_s_m);
  c.sample_period_s = map.number("sample_period_s", kFinite, c.sample_period_s);
  c.delay_s = map.number("delay_s", kFinite, c.delay_s);
}

void readSafety(YamlMap& map, SafetyConfig& s) {
  s.max_growth_n_s = map.number("max_growth_n_s", kFinite, s.max_growth_n_s);
  s.ramp_in_s = map.number("ramp_in_s", kFinite, s.ramp_in_s);
  s.stale_after_s = map.number("stale_after_s", kFinite, s.stale_after_s);
  s.drop_s = map.number("drop_s", kFinite, s.drop_s);
  s.max_speed_m_s = map.number("max_speed_m_s", kFinite, s.max_speed_m_s);
}

ToolConfig readTool(YamlMap& map, const DeviceLimits& limits) {
  ToolConfig tool;
  tool.id = map.text("id");
  readChoice(map, "kind", tool.kind);
  tool.tissue_threshold = map.number("tissue_threshold", kFinite);
  tool.tip_radius_m = map.number("tip_radius_m", kFinite, tool.tip_radius_m);
  tool.footprint_radius_m = map.number("footprint_radius_m", kFinite, tool.footprint_radius_m);
  tool.patch_radius_m = map.number("patch_radius_m", kFinite, tool.patch_radius_m);
  tool.friction_coefficient = map.number("friction_coefficient", kFinite, tool.friction_coefficient);
  tool.hold_steps = static_cast<std::uint32_t>(map.integer("hold_steps", {1.0, 10000.0}, tool.hold_steps));
  readCoupling(map, tool.coupling);
  readSafety(map, tool.safety);
  tool.device = limits;
  tool.blade_length_m = map.number("blade_length_m", kFinite, tool.blade_length_m);
  tool.blade_min_move_m = map.number("blade_min_move_m", kFinite, tool.blade_min_move_m);
  tool.cutting_drag_n_s_m = map.number("cutting_drag_n_s_m", kFinite, tool.cutting_drag_n_s_m);
  tool.cut_button = static_cast<std::uint32_t>(map.integer("cut_button", {0.0, 31.0}, tool.cut_button));
  tool.grasp_reach_m = map.number("grasp_reach_m", kFinite, tool.grasp_reach_m);
  tool.slip_force_n = map.number("slip_force_n", kFinite, tool.slip_force_n);
  tool.grasp_button = static_cast<std::uint32_t>(map.integer("grasp_button", {0.0, 31.0}, tool.grasp_button));
  validated(map, "id", [&tool] { tool.validate(); });
  map.finish();
  return tool;
}

DeviceLimits readLimits(YamlMap& device) {
  DeviceLimits limits;
  if (!device.has("limits")) {
    const std::string model = device.text("model", "touch");
    validated(device, "model", [&] { limits = deviceLimits(model); });
    return limits;
  }
  YamlMap map = device.map("limits");
  limits.max_force_n = map.number("max_force_n", kFinite);
  limits.max_stiffness_n_m = map.number("max_stiffness_n_m", kFinite);
  limits.max_damping_n_s_m = map.number("max_damping_n_s_m", kFinite);
  limits.workspace_radius_m = map.number("workspace_radius_m", kFinite);
  map.finish();
  return limits;
}

WayPoint readWayPoint(YamlMap& map) {
  WayPoint point;
  point.time_s = map.number("time_s", {0.0, 86400.0, "s"});
  point.position_m = map.vector("position_m", kMetres);
  if (map.has("orientation_xyzw"))
    point.orientation = readOrientation(map, "orientation_xyzw");
  if (map.has("buttons")) {
    for (const double b : map.numbers("buttons", 0, {0.0, 31.0}))
      point.buttons.set(static_cast<std::size_t>(b));
  }
  point.pass = map.flag("pass", point.pass);
  map.finish();
  return point;
}

VirtualDeviceConfig readDevice(YamlMap& map, const DeviceLimits& limits) {
  VirtualDeviceConfig device;
  device.limits = limits;
  device.mass_kg = map.number("mass_kg", kFinite, device.mass_kg);
  device.damping_n_s_m = map.number("damping_n_s_m", kFinite, device.damping_n_s_m);
  device.hand_stiffness_n_m = map.number("hand_stiffness_n_m", kFinite, device.hand_stiffness_n_m);
  device.hand_damping_n_s_m = map.number("hand_damping_n_s_m", kFinite, device.hand_damping_n_s_m);
  device.position_resolution_m = map.number("position_resolution_m", kFinite, device.position_resolution_m);
  device.workspace_centre_m = map.vector("workspace_centre_m", kMetres, device.workspace_centre_m);
  for (YamlMap& point : map.maps("way_points"))
    device.way_points.push_back(readWayPoint(point));
  if (device.way_points.empty()) {
    WayPoint rest;
    rest.position_m = device.workspace_centre_m;
    device.way_points.push_back(rest);
  }
  validated(map, "way_points", [&device] { device.validate(); });
  return device;
}

void readToolsAndDevice(YamlMap& top, Scene& scene) {
  YamlMap device = top.map("device");
  const DeviceLimits limits = readLimits(device);
  std::set<std::string> ids;
  for (YamlMap& tool : top.maps("tools")) {
    scene.tools.push_back(readTool(tool, limits));
    if (!ids.insert(scene.tools.back().id).second)
      tool.fail("id", "is used by another tool already");
  }
  scene.swap_button = static_cast<std::uint32_t>(device.integer("swap_button", {0.0, 31.0}, scene.swap_button));
  scene.device = readDevice(device, limits);
  device.finish();
}

void checkFootprints(const Scene& scene, const YamlMap& top) {
  for (const ToolConfig& tool : scene.tools) {
    if (tool.footprint_radius_m >= scene.lattice.spacing_m.maxCoeff())
      continue;
    top.fail("tools", "has the tool '" + tool.id + "' with a footprint_radius_m below lattice.spacing_m: a load on " +
                          "one vertex depends on the lattice and not on the tissue; make it larger");
  }
}

}  // namespace

std::string resolvePath(const YamlMap& map, const std::string& key, const std::string& text,
                        const std::string& folder) {
  if (text.empty())
    return text;
  const std::filesystem::path path(expand(map, key, text));
  return (path.is_absolute() ? path : std::filesystem::path(folder) / path).lexically_normal().string();
}

Quaternion readOrientation(YamlMap& map, const std::string& key) {
  const std::vector<double> q = map.numbers(key, 4, {-1.001, 1.001});
  const Quaternion orientation(q[3], q[0], q[1], q[2]);
  if (std::abs(orientation.norm() - 1.0) > 0.01)
    map.fail(key, "must be a unit quaternion [x, y, z, w]");
  // One that is a unit already stays as it is, so that a resolved scene reads back bit for bit.
  return std::abs(orientation.norm() - 1.0) < 1e-12 ? orientation : orientation.normalized();
}

YAML::Node parseYaml(const std::string& yaml, const std::string& origin) {
  try {
    return YAML::Load(yaml);
  } catch (const YAML::Exception& error) {
    throw SceneError(origin + ":" + std::to_string(error.mark.line + 1) + ": not valid YAML: " + error.msg);
  }
}

const ToolConfig* Scene::findTool(const std::string& id) const {
  const auto found = std::find_if(tools.begin(), tools.end(), [&id](const ToolConfig& t) { return t.id == id; });
  return found == tools.end() ? nullptr : &*found;
}

Scene parseScene(const std::string& yaml, const std::string& origin, const std::string& folder) {
  YamlMap top(parseYaml(yaml, origin), "", origin);
  top.integer("format", {1.0, 1.0});
  Scene scene;
  scene.name = top.text("name");
  scene.volume = readSource(top.map("volume"), folder);
  scene.materials = readMaterials(top);
  scene.lattice = readLattice(top.map("lattice"));
  scene.simulation = readSimulation(top.map("simulation"), scene.max_tool_force_n);
  YamlMap incision = top.map("incision");
  readChoice(incision, "method", scene.incision.method);
  scene.incision.rest_fraction = incision.number("rest_fraction", {0.3, 1.0}, scene.incision.rest_fraction);
  scene.incision.opening_pressure_pa =
      incision.number("opening_pressure_pa", {0.0, 1e6, "Pa"}, scene.incision.opening_pressure_pa);
  incision.finish();
  scene.output = readOutput(top.map("output"));
  scene.rendering = readRendering(top.map("rendering"), scene.materials, folder);
  readToolsAndDevice(top, scene);
  top.finish();
  checkFootprints(scene, top);
  return scene;
}

Scene loadScene(const std::string& path) {
  std::ifstream file(path);
  std::ostringstream text;
  if (!file || !(text << file.rdbuf()))
    throw SceneError(path + ": the scene file cannot be read");
  return parseScene(text.str(), path, std::filesystem::absolute(path).parent_path().string());
}

SceneVolumes readVolumes(const Scene& scene) {
  const auto read = [&scene](const std::string& file) {
    const Volume whole = readVolume(file);
    const VolumeSource& source = scene.volume;
    Vector3i end = source.end;
    for (int d = 0; d < 3; ++d)
      end[d] = end[d] == 0 ? whole.geometry().dims[d] : end[d];
    try {
      return std::make_shared<const Volume>(whole.region(source.begin, end, source.stride));
    } catch (const InputError& error) {
      throw SceneError(file + ": " + error.what());
    }
  };
  SceneVolumes volumes;
  volumes.volume = read(scene.volume.file);
  if (!scene.volume.labels.empty())
    volumes.labels = read(scene.volume.labels);
  return volumes;
}

}  // namespace soft_volume::core
