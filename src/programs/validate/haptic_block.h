#pragma once

#include <memory>
#include <string>

#include "soft_volume/common/geometry.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core::validate {

/// What lies under the tip.
enum class TissueKind { kFat, kMuscle, kPrestressed, kBone };
std::string nameOf(TissueKind tissue);

/// Energy that it takes to cut the tissue of the cutting scene.
constexpr double kToughness_j_m2 = 76.0;

/// Of the block: height of its top and where its middle is, along x and y; intensity between air and tissue.
constexpr double kBlockTop_m = 0.035;
constexpr double kBlockMiddle_m = 0.029;
constexpr double kBlockThreshold = 50.0;

/// The block that the suite presses and cuts: 60 x 60 x 36 mm in cells of 6 mm, its bottom held.
struct HapticBlock {
  Scene scene;
  std::shared_ptr<const Volume> volume;
  double threshold = 0.0;           ///< between air and tissue
  Vector3 top_m = Vector3::Zero();  ///< a vertex in the middle of its top
};
HapticBlock makeHapticBlock(TissueKind tissue, double damping_ratio = 0.5, double cut_resistance_j_m2 = 0.0);

}  // namespace soft_volume::core::validate
