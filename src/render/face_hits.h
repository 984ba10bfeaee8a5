#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "piece_mesh.h"
#include "soft_volume/common/geometry.h"
#include "soft_volume/render/camera.h"

namespace soft_volume::core {

/// The line of sight of a pixel's centre in the camera frame.
struct Ray {
  double x = 0.0;  ///< where it is at z = 0
  double y = 0.0;
  double slope_x = 0.0;  ///< change of x per metre of z
  double slope_y = 0.0;
  double stretch = 1.0;  ///< its length per metre of z

  static Ray through(const Camera& camera, int u, int v) {
    if (camera.projection == Projection::kParallel)
      return {(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0.0, 0.0, 1.0};
    const Eigen::Vector2d slope = camera.raySlope(u, v);
    return {0.0, 0.0, slope.x(), slope.y(), std::sqrt(1.0 + slope.squaredNorm())};
  }
  Vector3 at(double z) const { return {x + slope_x * z, y + slope_y * z, z}; }
};

/// Where a line of sight goes through a face.
struct FaceHit {
  double z;
  float u, v;  ///< place on the face: from corner 0 to 1 and from corner 0 to the last
  std::uint32_t face;
  std::int32_t winding;  ///< +1 or -1: from which side
};

/// Adds the places where the whole line of sight, also behind the camera, goes through the face. For any closed surface
/// of faces the windings add up to zero, however the faces are warped and wherever the line meets edges and vertices:
/// they are counted from the edges, which neighbours share bit by bit. `may_fold`: the face may cover itself.
/// `positions`: camera frame.
void intersect(const Ray& ray, const std::vector<Vector3>& positions, const PieceFace& face, std::uint32_t number,
               bool may_fold, std::vector<FaceHit>& hits);

}  // namespace soft_volume::core
