#pragma once

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

enum class Projection { kPerspective, kParallel };

/// A camera without distortion. The camera frame is optical: x right, y down, z forward. Pixel (0, 0) is the centre of
/// the upper left pixel, so the image spans [-0.5, width - 0.5] x [-0.5, height - 0.5]. A point (x, y, z) in the camera
/// frame appears at u = fx x / z + cx, v = fy y / z + cy under perspective (as in sensor_msgs/CameraInfo), and at
/// u = fx x + cx, v = fy y + cy under parallel projection, where fx and fy are pixels per metre.
struct Camera {
  Projection projection = Projection::kPerspective;
  int width = 640;
  int height = 480;
  double fx = 600.0;
  double fy = 600.0;
  double cx = 319.5;
  double cy = 239.5;
  double near_m = 0.01;  ///< nearer than this nothing is drawn
  double far_m = 10.0;   ///< farther than this nothing is drawn
  Pose T_volume_camera;  ///< maps camera-frame points to the volume frame

  /// A camera at `eye` that looks at `target` with `up` upwards in the image, all in the volume frame, and the given
  /// vertical field of view in radians.
  static Camera lookAt(const Vector3& eye, const Vector3& target, const Vector3& up, double vertical_fov_rad, int width,
                       int height);
  /// The same view in parallel projection; `height_m` is how much the image shows from top to bottom.
  static Camera lookAtParallel(const Vector3& eye, const Vector3& target, const Vector3& up, double height_m, int width,
                               int height);

  /// Where a point of the camera frame appears, pixels.
  Eigen::Vector2d project(const Vector3& p_camera) const {
    const double scale = projection == Projection::kPerspective ? 1.0 / p_camera.z() : 1.0;
    return {fx * p_camera.x() * scale + cx, fy * p_camera.y() * scale + cy};
  }
  /// How x and y of the camera frame change per metre of z along the ray of a pixel; zero in parallel projection.
  Eigen::Vector2d raySlope(double u, double v) const {
    if (projection == Projection::kParallel)
      return Eigen::Vector2d::Zero();
    return {(u - cx) / fx, (v - cy) / fy};
  }

  /// Throws SceneError when a number is not finite or out of range (1..8192 pixels, positive focal lengths,
  /// 0 < near < far, a unit quaternion).
  void validate() const;
};

}  // namespace soft_volume::core
