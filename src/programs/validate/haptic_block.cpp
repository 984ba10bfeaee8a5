#include "haptic_block.h"

#include <cstdint>
#include <cstring>
#include <sstream>
#include <utility>
#include <vector>

namespace soft_volume::core::validate {
namespace {

/// Intensities of the block's voxels.
constexpr double kSoft = 100.0;
constexpr double kHard = 300.0;

std::string number(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

/// Materials are those of the shipped scenes: fat and muscle of the CT head, its prestretch, its bone.
std::string sceneText(TissueKind tissue, double damping_ratio, double cut_resistance_j_m2) {
  const bool prestressed = tissue == TissueKind::kPrestressed;
  const std::string sides = R"(
    - min: [-1, -1, -1]
      max: [-0.0009, 1, 1]
    - min: [0.0589, -1, -1]
      max: [1, 1, 1]
    - min: [-1, -1, -1]
      max: [1, -0.0009, 1]
    - min: [-1, 0.0589, -1]
      max: [1, 1, 1])";
  return R"(format: 1
name: haptic block
volume: {file: block.mha}
materials:
  - name: soft
    intensity: [50, 200]
    density_kg_m3: 1050
    poisson_ratio: 0.45
    damping_ratio: )" +
         number(damping_ratio) + "\n    youngs_modulus_pa: " + number(tissue == TissueKind::kFat ? 3250 : 10700) +
         "\n    prestretch: " + number(prestressed ? 1.15 : 1.0) +
         "\n    cut_resistance_j_m2: " + number(cut_resistance_j_m2) + R"(
    colour: [0.9, 0.6, 0.5]
    opacity: 0.5
  - name: bone
    intensity: [200, 400]
    density_kg_m3: 1920
    youngs_modulus_pa: 1.7e+10
    fixed: true
    colour: [0.9, 0.9, 0.9]
    opacity: 0.9
lattice:
  spacing_m: 0.006
  fixed_regions_m:
    - min: [-1, -1, -1]
      max: [1, 1, -0.0005])" +
         (prestressed ? sides : "") + R"(
simulation: {preset: balanced}
rendering:
  transfer_function: {from_materials: true}
  cameras: []
tools:
  - {id: probe, tissue_threshold: 50}
  - {id: scalpel, kind: scalpel, tissue_threshold: 50}
device:
  workspace_centre_m: [0, 0, 0]
  way_points:
    - {time_s: 0, position_m: [0, 0, 0]}
)";
}

std::shared_ptr<const Volume> blockVolume(TissueKind tissue) {
  VolumeGeometry geometry;
  geometry.dims = {30, 30, 30};
  geometry.spacing_m = Vector3::Constant(0.002);
  std::vector<std::uint8_t> data(geometry.voxelCount() * sizeof(float));
  for (int k = 0; k < 18; ++k) {  // air above
    const auto value = float(tissue == TissueKind::kBone && k >= 12 ? kHard : kSoft);
    for (int j = 0; j < 30; ++j) {
      for (int i = 0; i < 30; ++i)
        std::memcpy(data.data() + geometry.index(i, j, k) * sizeof(float), &value, sizeof(float));
    }
  }
  return std::make_shared<const Volume>(geometry, ScalarType::kFloat32, std::move(data));
}

}  // namespace

HapticBlock makeHapticBlock(TissueKind tissue, double damping_ratio, double cut_resistance_j_m2) {
  return {parseScene(sceneText(tissue, damping_ratio, cut_resistance_j_m2), "haptic block", "/"), blockVolume(tissue),
          kBlockThreshold, Vector3(kBlockMiddle_m, kBlockMiddle_m, kBlockTop_m)};
}

std::string nameOf(TissueKind tissue) {
  constexpr const char* kNames[] = {"fat", "muscle", "prestressed muscle", "bone"};
  return kNames[int(tissue)];
}

}  // namespace soft_volume::core::validate
