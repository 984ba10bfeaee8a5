#pragma once

#include <memory>
#include <string>

#include "analytic_volumes.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/session/session.h"

namespace soft_volume::core {

/// A complete scene around a block of 48 x 48 x 32 mm that stands on z = 0: two tools, one camera, 8 mm cells.
inline std::string smallSceneText() {
  return R"(format: 1
name: block
volume:
  file: block.mha
materials:
  - name: tissue
    intensity: [50, 200]
    density_kg_m3: 1000
    youngs_modulus_pa: 5000
    damping_ratio: 0.5
    colour: [0.9, 0.6, 0.5]
    opacity: 0.5
lattice:
  spacing_m: 0.008
  fixed_regions_m:
    - min: [-1, -1, -1]
      max: [1, 1, 0.001]
simulation:
  dt_s: 0.001
  activation_radius_m: 0.03
  lifetime_s: 0.5
rendering:
  transfer_function:
    from_materials: true
  slices: 40
  cameras:
    - name: camera
      width: 80
      height: 60
      eye_m: [0.024, -0.2, 0.06]
      target_m: [0.024, 0.024, 0.016]
      up: [0, 0, 1]
tools:
  - id: probe
    tissue_threshold: 75
  - id: scalpel
    kind: scalpel
    tissue_threshold: 75
device:
  workspace_centre_m: [0.024, 0.024, 0.05]
  way_points:
    - {time_s: 0, position_m: [0.024, 0.024, 0.05]}
    - {time_s: 1, position_m: [0.024, 0.024, 0.03], buttons: [0, 3], pass: true}
)";
}

/// Its cuts open by themselves.
inline Scene smallScene() {
  Scene scene = parseScene(smallSceneText(), "small scene", "/data");
  scene.incision.rest_fraction = 0.75;
  return scene;
}

/// The block of the scene above: 100 inside, voxels of 2 mm, tissue up to z = 31 mm and air above it.
inline std::shared_ptr<const Volume> smallVolume() {
  return std::make_shared<const Volume>(
      makeVolume({24, 24, 24}, 0.002, [](const Vector3& p) { return p.z() < 0.0311 ? 100.0 : 0.0; }));
}

}  // namespace soft_volume::core
