#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <sstream>

#include "scene_reading.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/option_names.h"
#include "volume/transfer_function_yaml.h"

namespace soft_volume::core {
namespace {

TransferFunction::Point pointOf(double value, const Vector3f& colour, float opacity) {
  TransferFunction::Point point;
  point.value = value;
  point.colour = colour;
  point.opacity = opacity;
  return point;
}

/// Steps at the intervals' ends: each material in its colour, nothing between them.
std::vector<TransferFunction::Point> pointsOfMaterials(const std::vector<Material>& materials) {
  std::vector<Material> by_intensity;
  std::copy_if(materials.begin(), materials.end(), std::back_inserter(by_intensity),
               [](const Material& m) { return !m.byLabel(); });
  std::sort(by_intensity.begin(), by_intensity.end(),
            [](const Material& a, const Material& b) { return a.intensity_min < b.intensity_min; });
  std::vector<TransferFunction::Point> points;
  for (const Material& m : by_intensity) {
    const double ramp = 1e-3 * (m.intensity_max - m.intensity_min);
    if (points.empty() || points.back().value < m.intensity_min - ramp) {
      points.push_back(pointOf(m.intensity_min - ramp, m.colour, 0.0F));
    }
    points.push_back(pointOf(m.intensity_min, m.colour, m.opacity));
    points.push_back(pointOf(m.intensity_max - ramp, m.colour, m.opacity));
    points.push_back(pointOf(m.intensity_max - 0.5 * ramp, m.colour, 0.0F));
  }
  return points;
}

TransferFunction readFunction(YamlMap map, const std::vector<Material>& materials) {
  TransferFunction function;
  function.unit_distance_m = map.number("unit_distance_m", {1e-6, 1.0, "m"}, function.unit_distance_m);
  function.points = map.flag("from_materials", false) ? pointsOfMaterials(materials) : readPoints(map);
  finishTransferFunction(map, function);
  return function;
}

constexpr char kTransferFunction[] = "transfer_function";

/// A preset's name has no folder and no suffix.
bool isPreset(const std::string& source) {
  return source.find_first_of("/.$") == std::string::npos;
}

TransferFunctionFile readFile(YamlMap& map, const char* key, const std::string& folder) {
  const std::string source = map.text(key);
  try {
    return readTransferFunction(isPreset(source) ? source : resolvePath(map, key, source, folder));
  } catch (const FileError& error) {
    map.fail(key, std::string("cannot be used: ") + error.what());
  }
}

/// A mapping, or the name of a preset or file.
void readTransfer(YamlMap& map, const std::vector<Material>& materials, const std::string& folder, RenderSettings& r) {
  r.transfer_file.reset();
  if (!map.isText(kTransferFunction)) {
    r.transfer_function = readFunction(map.map(kTransferFunction), materials);
    return;
  }
  const TransferFunctionFile file = readFile(map, kTransferFunction, folder);
  r.transfer_function = file.function;
  if (file.relative || !file.states_distance)
    r.transfer_file = file;
}

/// What a camera's lengths may be. Scenes are of people's size; a file of a grid has any unit of length.
struct CameraRanges {
  Range place;
  Range view_height;
  Range near;
  Range far;
};
constexpr CameraRanges kSceneRanges{kMetres, {1e-4, 100.0, "m"}, {1e-4, 10.0, "m"}, {1e-3, 100.0, "m"}};
constexpr Range kAnyLength{1e-12, 1e12};
constexpr CameraRanges kAnyRanges{{-1e12, 1e12}, kAnyLength, kAnyLength, kAnyLength};

Camera readLookAt(YamlMap& map, const CameraRanges& ranges, Projection projection, int width, int height) {
  const Vector3 eye = map.vector("eye_m", ranges.place);
  const Vector3 target = map.vector("target_m", ranges.place);
  const Vector3 up = map.vector("up", kFinite);
  if (projection == Projection::kParallel) {
    const double height_m = map.number("view_height_m", ranges.view_height);
    return Camera::lookAtParallel(eye, target, up, height_m, width, height);
  }
  const double fov_rad = map.number("vertical_fov_rad", {0.01, 3.0, "rad"}, 0.6);
  return Camera::lookAt(eye, target, up, fov_rad, width, height);
}

/// A camera by where it is and what it looks at, or, as writeScene() does, by its intrinsics and pose.
Camera readView(YamlMap& map, const CameraRanges& ranges) {
  constexpr Range kPixels{1.0, 8192.0, "pixels"};
  const int width = static_cast<int>(map.integer("width", kPixels, 640));
  const int height = static_cast<int>(map.integer("height", kPixels, 480));
  Camera camera;
  readChoice(map, "projection", camera.projection);
  if (map.has("eye_m"))
    return readLookAt(map, ranges, camera.projection, width, height);
  camera.width = width;
  camera.height = height;
  camera.fx = map.number("fx", {1e-3, 1e6, "pixels"});
  camera.fy = map.number("fy", {1e-3, 1e6, "pixels"});
  camera.cx = map.number("cx", {-1e6, 1e6, "pixels"});
  camera.cy = map.number("cy", {-1e6, 1e6, "pixels"});
  camera.T_volume_camera.position_m = map.vector("position_m", ranges.place);
  camera.T_volume_camera.orientation = readOrientation(map, "orientation_xyzw");
  return camera;
}

/// `fallback` has what is used where near_m and far_m are not there.
Camera readCamera(YamlMap& map, const CameraRanges& ranges, const Camera& fallback) {
  Camera camera = readView(map, ranges);
  camera.near_m = map.number("near_m", ranges.near, fallback.near_m);
  camera.far_m = map.number("far_m", ranges.far, fallback.far_m);
  camera.validate();
  return camera;
}

CameraSettings readNamedCamera(YamlMap& map) {
  CameraSettings settings;
  settings.name = map.text("name");
  const auto allowed = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; };
  if (settings.name.empty() || std::isdigit(static_cast<unsigned char>(settings.name[0])) != 0 ||
      !std::all_of(settings.name.begin(), settings.name.end(), allowed)) {
    map.fail("name", "must be a topic name: letters, digits and _, not starting with a digit");
  }
  try {
    settings.camera = readCamera(map, kSceneRanges, {});
  } catch (const SceneError& error) {
    const std::string message = error.what();
    if (message.find(": rendering.cameras") != std::string::npos)
      throw;
    map.fail("name", "'" + settings.name + "' names a camera that cannot be used: " + message);
  }
  map.finish();
  return settings;
}

std::vector<CameraSettings> readCameras(YamlMap& map) {
  std::vector<CameraSettings> cameras;
  std::set<std::string> names;
  for (YamlMap& camera : map.maps("cameras")) {
    cameras.push_back(readNamedCamera(camera));
    if (!names.insert(cameras.back().name).second)
      camera.fail("name", "is used by another camera already");
  }
  return cameras;
}

/// Rows [normal x, y, z, offset_m]. The normal may have any length, the offset counts along its direction.
std::vector<ClipPlane> readClipPlanes(YamlMap& map) {
  std::vector<ClipPlane> planes;
  for (const std::vector<double>& row : map.rows("clip_planes", 4)) {
    ClipPlane plane;
    plane.normal = {row[0], row[1], row[2]};
    plane.offset_m = row[3];
    const double length = plane.normal.norm();
    if (!(length > 1e-9 && length < 1e9))
      map.fail("clip_planes", "has a plane whose normal has no direction");
    if (std::abs(length - 1.0) > 1e-12)
      plane.normal /= length;
    planes.push_back(plane);
  }
  if (planes.size() > RenderOptions::kMaxClipPlanes) {
    map.fail("clip_planes", "lists more than " + std::to_string(RenderOptions::kMaxClipPlanes) + " planes");
  }
  return planes;
}

void readOptions(YamlMap& map, RenderOptions& options) {
  options.slices = static_cast<int>(map.integer("slices", {1.0, 4096.0}, options.slices));
  options.step_m = map.number("step_m", {0.0, 1.0, "m"}, options.step_m);
  options.shading = map.number("shading", kFraction, options.shading);
  options.specular = map.number("specular", kFraction, options.specular);
  options.exact_boundary = map.flag("exact_boundary", options.exact_boundary);
  options.adaptive = map.flag("adaptive", options.adaptive);
  options.jitter = map.flag("jitter", options.jitter);
  options.depth_threshold = map.number("depth_threshold", {0.01, 0.99}, options.depth_threshold);
  if (map.has("clip_planes"))
    options.clip_planes = readClipPlanes(map);
}

/// Every key but transfer function and cameras; what is not there stays as it is in `r`.
void readSettings(YamlMap& map, RenderSettings& r) {
  readChoice(map, "backend", r.backend);
  readOptions(map, r.options);
  r.incremental = map.flag("incremental", r.incremental);
  r.progressive = map.flag("progressive", r.progressive);
  r.background = map.vector("background", kFraction, r.background.cast<double>()).cast<float>();
  r.rate_hz = map.number("rate_hz", {0.01, 1000.0, "Hz"}, r.rate_hz);
  r.jpeg_quality = static_cast<int>(map.integer("jpeg_quality", {1.0, 100.0}, r.jpeg_quality));
}

}  // namespace

RenderSettings readRendering(YamlMap map, const std::vector<Material>& materials, const std::string& folder) {
  RenderSettings rendering;
  readTransfer(map, materials, folder, rendering);
  readSettings(map, rendering);
  rendering.cameras = readCameras(map);
  map.finish();
  return rendering;
}

RenderOptions RenderSettings::coarser(std::uint32_t times) const {
  RenderOptions coarse = options;
  coarse.slices = std::max(1, options.slices / static_cast<int>(std::max(1U, std::min(times, 4096U))));
  coarse.step_m = options.step_m * times;
  return coarse;
}

void fitTransferFunction(RenderSettings& settings, const Volume& volume) {
  if (!settings.transfer_file)
    return;
  const double diagonal_m = volume.geometry().bounds().diagonal().norm();
  settings.transfer_function = fitTo(*settings.transfer_file, volume.range(), diagonal_m);
  settings.transfer_file.reset();
}

Camera loadCamera(const std::string& path, double near_m, double far_m) {
  std::ifstream file(path);
  std::ostringstream text;
  if (!file || !(text << file.rdbuf()))
    throw SceneError(path + ": the camera's file cannot be read");
  YamlMap map(parseYaml(text.str(), path), "", path);
  map.text("name", "");
  Camera fallback;
  fallback.near_m = near_m;
  fallback.far_m = far_m;
  try {
    const Camera camera = readCamera(map, kAnyRanges, fallback);
    map.finish();
    return camera;
  } catch (const SceneError& error) {
    const std::string message = error.what();
    throw SceneError(message.compare(0, path.size(), path) == 0 ? message : path + ": " + message);
  }
}

RenderSettings overrideRendering(const Scene& scene, const std::string& yaml, const std::string& origin) {
  YamlMap map(parseYaml(yaml, origin), "", origin);
  RenderSettings rendering = scene.rendering;
  if (map.has(kTransferFunction))
    readTransfer(map, scene.materials, "/", rendering);
  readSettings(map, rendering);
  map.finish();
  return rendering;
}

}  // namespace soft_volume::core
