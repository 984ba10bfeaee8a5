#include "soft_volume/render/camera.h"

#include <cmath>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

void require(bool good, const std::string& problem) {
  if (!good)
    throw SceneError("camera: " + problem);
}

void requirePixels(int pixels, const char* name) {
  require(pixels >= 1 && pixels <= 8192,
          std::string(name) + " is " + std::to_string(pixels) + ", use 1 to 8192 pixels");
}

void requirePositive(double value, const char* name) {
  require(std::isfinite(value) && value > 0.0,
          std::string(name) + " is " + std::to_string(value) + ", use a positive number");
}

}  // namespace

namespace {

/// Everything of a camera but its focal lengths.
Camera placeCamera(const Vector3& eye, const Vector3& target, const Vector3& up, int width, int height) {
  const Vector3 view = target - eye;
  const Vector3 right = view.cross(up);
  require(isFinite(view) && view.norm() > 0.0, "eye and target are not finite or are the same point");
  require(isFinite(right) && right.norm() > 1e-9 * view.norm() * up.norm(), "'up' is zero or along the view direction");
  Camera camera;
  camera.width = width;
  camera.height = height;
  camera.cx = 0.5 * (width - 1);
  camera.cy = 0.5 * (height - 1);
  Matrix3 axes;
  axes.col(0) = right.normalized();
  axes.col(2) = view.normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  camera.T_volume_camera = {eye, Quaternion(axes).normalized()};
  return camera;
}

}  // namespace

Camera Camera::lookAt(const Vector3& eye, const Vector3& target, const Vector3& up, double vertical_fov_rad, int width,
                      int height) {
  require(
      vertical_fov_rad > 0.0 && vertical_fov_rad < M_PI,
      "the vertical field of view is " + std::to_string(vertical_fov_rad) + " rad, use more than 0 and less than pi");
  Camera camera = placeCamera(eye, target, up, width, height);
  camera.fx = camera.fy = 0.5 * height / std::tan(0.5 * vertical_fov_rad);
  camera.validate();
  return camera;
}

Camera Camera::lookAtParallel(const Vector3& eye, const Vector3& target, const Vector3& up, double height_m, int width,
                              int height) {
  requirePositive(height_m, "the height of the view");
  Camera camera = placeCamera(eye, target, up, width, height);
  camera.projection = Projection::kParallel;
  camera.fx = camera.fy = height / height_m;
  camera.validate();
  return camera;
}

void Camera::validate() const {
  requirePixels(width, "width");
  requirePixels(height, "height");
  requirePositive(fx, "fx");
  requirePositive(fy, "fy");
  require(std::isfinite(cx), "cx is not finite");
  require(std::isfinite(cy), "cy is not finite");
  requirePositive(near_m, "near_m");
  require(std::isfinite(far_m) && far_m > near_m, "far_m is " + std::to_string(far_m) + ", use more than near_m");
  require(isFinite(T_volume_camera.position_m), "the position is not finite");
  require(isUsable(T_volume_camera), "the orientation is not a unit quaternion");
}

}  // namespace soft_volume::core
