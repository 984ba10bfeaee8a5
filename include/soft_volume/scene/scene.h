#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/incision/incision.h"
#include "soft_volume/material/lattice_setup.h"
#include "soft_volume/material/material.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/renderer.h"
#include "soft_volume/simulation/simulation.h"
#include "soft_volume/tool/tool.h"
#include "soft_volume/tool/virtual_device.h"
#include "soft_volume/volume/transfer_function.h"
#include "soft_volume/volume/transfer_function_file.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// Where the voxels come from.
struct VolumeSource {
  std::string file;                    ///< absolute, or relative to the scene file
  std::string labels;                  ///< empty without labels; the same grid as `file`
  Vector3i begin = Vector3i::Zero();   ///< first voxel of the region of interest
  Vector3i end = Vector3i::Zero();     ///< one past the last voxel; 0 means the volume's end
  Vector3i stride = Vector3i::Ones();  ///< every how many voxels one is kept, per axis
};

/// How often the simulation publishes, in simulated time, and what it accepts.
struct SimulationOutput {
  double state_rate_hz = 30.0;
  double patch_rate_hz = 250.0;
  double key_frame_interval_s = 1.0;
  double checkpoint_interval_s = 10.0;
};

struct CameraSettings {
  std::string name;
  Camera camera;
};

/// How frames are made; what a frame shows besides (depth, labels) and the threads are its receivers' business.
struct RenderSettings {
  TransferFunction transfer_function;
  /// What is to become transfer_function once the volume is known: see fitTransferFunction().
  std::optional<TransferFunctionFile> transfer_file;
  Backend backend = Backend::kNative;
  RenderOptions options;                   ///< without lookup, depth, labels and threads
  bool incremental = true;                 ///< draw only what positions changed; the frames are the same without
  bool progressive = false;                ///< after a change of view first coarse frames, then finer ones
  Vector3f background = Vector3f::Zero();  ///< RGB in [0, 1]
  double rate_hz = 10.0;                   ///< most frames per second of simulated time and camera
  int jpeg_quality = 90;
  std::vector<CameraSettings> cameras;

  /// The options of a frame whose planes are `times` as far apart: what a frame that is still refined is drawn with.
  RenderOptions coarser(std::uint32_t times) const;
};

/// A run: what is simulated, touched and seen. Everything is validated when it is loaded, so code that gets a Scene
/// checks nothing again. Field names are those of the YAML keys; doc/scene.md lists ranges and defaults.
struct Scene {
  std::string name;
  VolumeSource volume;
  std::vector<Material> materials;
  LatticeSettings lattice;
  SimulationSettings simulation;
  IncisionSettings incision;
  double max_tool_force_n = 50.0;  ///< a tool's force beyond this is refused
  SimulationOutput output;
  RenderSettings rendering;
  std::vector<ToolConfig> tools;
  VirtualDeviceConfig device;
  std::uint32_t swap_button = 1;  ///< a press puts the next tool of the list into the hand

  const ToolConfig* findTool(const std::string& id) const;
};

/// Reads a scene file. Unknown and duplicate keys, wrong types and values outside their range throw SceneError with
/// file, line, key, unit and range. `${NAME}` in paths is replaced by the environment variable; relative paths are
/// resolved against the file's folder. Does not read the volume.
Scene loadScene(const std::string& path);

/// The same from text; `origin` names it in errors, relative paths are resolved against `folder`.
Scene parseScene(const std::string& yaml, const std::string& origin, const std::string& folder);

/// The resolved scene: every key with its value, so that parseScene(writeScene(s)) is s. Numbers are written with all
/// digits. This is what the Scene message and the bag hold.
std::string writeScene(const Scene& scene);

/// The scene's rendering with the keys of `yaml`, a mapping as under `rendering:` in a scene file but without cameras,
/// in place of its own. Throws SceneError as parseScene(); `origin` names the text in errors.
RenderSettings overrideRendering(const Scene& scene, const std::string& yaml, const std::string& origin);

/// The resolved settings as such a mapping: every key but the cameras.
std::string writeRendering(const RenderSettings& settings);

/// Makes the transfer function of a file that leaves open what depends on the volume (its range, its size). Nothing to
/// do where there is none. Throws InputError when the volume has no finite value.
void fitTransferFunction(RenderSettings& settings, const Volume& volume);

/// Reads a camera from a file of its own: the keys of one of a scene's cameras, `name` optional, with lengths of any
/// size; near and far are used where the file states none. Throws SceneError as loadScene().
Camera loadCamera(const std::string& path, double near_m, double far_m);

/// The volumes that a scene names, with region and stride applied.
struct SceneVolumes {
  std::shared_ptr<const Volume> volume;
  std::shared_ptr<const Volume> labels;  ///< null without labels
};
SceneVolumes readVolumes(const Scene& scene);

}  // namespace soft_volume::core
