#pragma once

#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <vector>

#include "render/render_scenes.h"
#include "render/warped_grids.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {

/// What the back ends draw in ways of their own: scalars at vertices, their colours, scalars of cells, a volume.
enum class Kind { kScalar, kColour, kCells, kTexture };

inline std::string nameOf(Kind kind) {
  const std::array<const char*, 4> names = {"scalar", "colour", "cells", "texture"};
  return names[std::size_t(kind)];
}

/// Two narrow peaks of opacity in a haze, for scalars in [0, 1] and grids a few metres wide.
inline TransferFunction makePeaks() {
  TransferFunction function;
  const Vector3f blue(0.2F, 0.4F, 1.0F);
  const Vector3f yellow(1.0F, 0.9F, 0.2F);
  function.points = {{0.0, blue, 0.05F},   {0.32, blue, 0.05F},    {0.35, blue, 0.95F}, {0.38, blue, 0.1F},
                     {0.62, yellow, 0.1F}, {0.65, yellow, 0.999F}, {0.68, yellow, 0.0F}};
  function.unit_distance_m = 1.0;
  return function;
}

/// Sees all of a grid from -2 to 2 along each axis, from a corner.
inline Camera obliqueCamera(Projection projection, int width, int height) {
  const Vector3 eye(2.5, -3.0, -8.0);
  const Vector3 up(0.1, -1.0, 0.0);
  Camera camera = projection == Projection::kPerspective
                      ? Camera::lookAt(eye, Vector3::Zero(), up, 0.55, width, height)
                      : Camera::lookAtParallel(eye, Vector3::Zero(), up, 5.0, width, height);
  camera.near_m = 0.1;
  camera.far_m = 100.0;
  return camera;
}

inline Topology makeLatticeOfKind(int side) {
  return makeBlock(Box3(Vector3::Constant(-2.0), Vector3::Constant(2.0)), Vector3i::Constant(side));
}

/// Any kind but kTexture: a warped grid of mixed cells from -2 to 2 along each axis.
inline IrregularGrid makeGridOfKind(Kind kind, unsigned seed) {
  IrregularGrid grid = makeWarpedGrid(CubeParts::kMixed, 4, 0.2F, seed);
  if (kind != Kind::kCells)
    return grid;
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> scalar(0.0F, 1.0F);
  grid.point_scalars.clear();
  for (std::size_t i = 0; i < grid.cellCount(); ++i)
    grid.cell_scalars.push_back(scalar(random));
  return grid;
}

inline std::shared_ptr<const Volume> makeWavyVolume() {
  return makeVolume(Vector3i(17, 13, 11), Vector3::Constant(4.0), [](const Vector3& t) {
    return 0.5 + 0.3 * std::sin(9.0 * t.x()) * std::cos(7.0 * t.y()) + 0.2 * std::sin(11.0 * t.z() + 4.0 * t.x());
  });
}

inline std::shared_ptr<const Volume> makeManyLabels() {
  return makeVolume(Vector3i(5, 6, 7), Vector3::Constant(4.0),
                    [](const Vector3& t) { return std::floor(20.0 * t.sum()) + 1.0; });
}

template <typename T>
bool sameBits(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

/// NaN is equal to NaN here, whatever its bits.
inline bool sameDepths(const std::vector<float>& a, const std::vector<float>& b) {
  const auto same = [](float x, float y) { return x == y || (std::isnan(x) && std::isnan(y)); };
  return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(), same);
}

inline bool sameFrames(const Frame& a, const Frame& b) {
  return sameBits(a.rgba, b.rgba) && sameDepths(a.depth_m, b.depth_m) && sameBits(a.labels, b.labels);
}

/// More than 5 % of the pixels are not transparent.
inline bool showsSomething(const Frame& frame) {
  std::size_t hits = 0;
  for (std::size_t i = 3; i < frame.rgba.size(); i += 4)
    hits += frame.rgba[i] > 0.05F;
  return hits > frame.rgba.size() / 4 / 20;
}

}  // namespace soft_volume::core
