#pragma once

#include <cstdint>

#include "drawn_grid.h"
#include "soft_volume/common/geometry.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// How scalars are lit, the same in every back end (Renderer describes the light).
///
/// A gradient g of the scalar (camera frame, per metre) makes a surface of strength min(1, |g| step / edge), where
/// `step` is shadingStep() and `edge` the range of the transfer function over kEdgesPerRange; where it is weaker there
/// is only a mean brightness. With d = |g . light| / |g| and h = highlightDirection() the colour is
///   colour * mix(1, mix(kMeanLight, kAmbient + kDiffuse d, strength), shading)
///   + shading * specular * strength * (|g . h| / |g|)^kShininess.
/// Both sides of a surface are lit.
constexpr float kEdgesPerRange = 20.0F;
constexpr float kMeanLight = 0.7F;
constexpr float kAmbient = 0.2F;
constexpr float kDiffuse = 0.9F;
constexpr int kShininess = 32;

/// Towards the light, camera frame.
inline Vector3f lightDirection() {
  return Vector3f(-0.4F, -0.6F, -1.0F).normalized();
}

/// Half way between the light and a viewer far away on the camera's axis.
inline Vector3f highlightDirection() {
  return (lightDirection() - Vector3f::UnitZ()).normalized();
}

/// Metres over which a scalar has to change to make a surface: the mean distance of a volume's voxels in the grid at
/// rest, and the mean size of the cells where the grid has scalars of its own (`volume` is null).
double shadingStep(const DrawnGrid& grid, const VolumeGeometry* volume);

/// How far the samples of pixel (x, y) are moved along the ray under RenderOptions::jitter, as a part of the slab's
/// thickness in [-0.5, 0.5). "Interleaved gradient noise" (Jimenez, SIGGRAPH 2014) in fixed point, so that it is the
/// same bits everywhere: neighbours differ much, and every 3 by 3 pixels cover the range evenly.
inline float jitterAt(std::uint32_t x, std::uint32_t y) {
  const std::uint32_t inner = x * 288237660U + y * 25070368U;  // 0.06711056 and 0.00583715, 32 bits behind the point
  const std::uint32_t outer = inner * 52U + (inner >> 16) * 64417U;  // times 52.98292
  return float(outer >> 8) * (1.0F / 16777216.0F) - 0.5F;
}

}  // namespace soft_volume::core
