#include "view.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "soft_volume/common/error.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume::core::render_program {
namespace {

/// Of the picture's width or height the box fills so much.
constexpr double kFilled = 0.95;
/// Distance of the eye from the middle of the box, in half diagonals: perspective as in a portrait.
constexpr double kDistance = 4.0;

std::array<Vector3, 8> cornersOf(const Box3& box) {
  std::array<Vector3, 8> corners;
  for (int c = 0; c < 8; ++c)
    corners[std::size_t(c)] = box.corner(static_cast<Box3::CornerType>(c));
  return corners;
}

double halfDiagonal(const Subject& subject) {
  const double radius = 0.5 * subject.bounds.diagonal().norm();
  if (!std::isfinite(radius) || radius <= 0.0)
    throw InputError("the grid has no extent, so there is nothing to see");
  return radius;
}

/// Columns: right, up and towards the viewer.
Matrix3 turned(const Matrix3& axes, double azimuth_deg, double elevation_deg) {
  const double azimuth = azimuth_deg * M_PI / 180.0;
  const double elevation = elevation_deg * M_PI / 180.0;
  Matrix3 result;
  result.col(0) = std::cos(azimuth) * axes.col(0) - std::sin(azimuth) * axes.col(2);
  const Vector3 level = std::sin(azimuth) * axes.col(0) + std::cos(azimuth) * axes.col(2);
  result.col(2) = std::cos(elevation) * level + std::sin(elevation) * axes.col(1);
  result.col(1) = result.col(2).cross(result.col(0));
  return result;
}

/// Looks against the normal of a plane, with that axis of the default view upwards that lies in the plane best.
Matrix3 axesAlong(const Vector3& normal, const Matrix3& axes) {
  const bool up_is_normal = std::abs(axes.col(1).dot(normal)) > 0.99;
  const Vector3 up = up_is_normal ? Vector3(-axes.col(2)) : Vector3(axes.col(1));
  Matrix3 result;
  result.col(2) = normal;
  result.col(0) = up.cross(normal).normalized();
  result.col(1) = normal.cross(result.col(0));
  return result;
}

/// Pixels per unit of slope (or of length in parallel projection) such that all corners are in the picture.
double fittingFocalLength(const Camera& camera, const Subject& subject) {
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  double focal = HUGE_VAL;
  for (const Vector3& corner : cornersOf(subject.bounds)) {
    const Vector3 p = T_camera_volume * corner;
    const double scale = camera.projection == Projection::kPerspective ? p.z() : 1.0;
    focal = std::min({focal, 0.5 * kFilled * camera.width * scale / std::max(std::abs(p.x()), 1e-300),
                      0.5 * kFilled * camera.height * scale / std::max(std::abs(p.y()), 1e-300)});
  }
  return focal;
}

Camera fittedCamera(const Arguments& arguments, const Subject& subject, const Matrix3& axes) {
  const double radius = halfDiagonal(subject);
  const Vector3 centre = subject.bounds.center();
  const Vector3 eye = centre + kDistance * radius * axes.col(2);
  Camera camera = Camera::lookAt(eye, centre, axes.col(1), 1.0, arguments.width, arguments.height);
  camera.projection = arguments.projection;
  camera.fx = camera.fy = arguments.zoom * fittingFocalLength(camera, subject);
  camera.near_m = (kDistance - 1.01) * radius;
  camera.far_m = (kDistance + 1.01) * radius;
  camera.validate();
  return camera;
}

void checkPlace(const Camera& camera, const Subject& subject) {
  const Vector3& eye = camera.T_volume_camera.position_m;
  if (camera.projection == Projection::kPerspective && subject.bounds.contains(eye)) {
    throw InputError("the camera is within the grid's box; move it out, or use a parallel projection");
  }
  const double distance = (eye - subject.bounds.center()).norm();
  if (!std::isfinite(distance) || distance > 1e6 * halfDiagonal(subject))
    throw InputError("the camera is more than a million times the grid's size away; move it nearer");
}

}  // namespace

/// The columns of `patient` are the patient's left, superior and anterior.
Matrix3 patientView(const VolumeGeometry& geometry) {
  Matrix3 patient;
  patient << -1, 0, 0, 0, 0, 1, 0, 1, 0;
  return geometry.direction.transpose() * patient;
}

Camera viewOf(const Arguments& arguments, const Subject& subject, double turn_deg) {
  if (!arguments.camera.empty()) {
    const double radius = halfDiagonal(subject);
    const Camera camera = loadCamera(arguments.camera, 1e-4 * radius, 1e7 * radius);
    checkPlace(camera, subject);
    return camera;
  }
  Matrix3 axes = subject.view;
  if (arguments.cross_section.size() == 4)
    axes = axesAlong(Vector3(arguments.cross_section[0], arguments.cross_section[1], arguments.cross_section[2]), axes);
  return fittedCamera(arguments, subject, turned(axes, arguments.azimuth_deg + turn_deg, arguments.elevation_deg));
}

double sectionDepth(const Arguments& arguments, const Subject& subject, const Camera& camera) {
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  if (arguments.cross_section.size() == 4) {
    const Vector3 normal(arguments.cross_section[0], arguments.cross_section[1], arguments.cross_section[2]);
    return (T_camera_volume * Vector3(arguments.cross_section[3] * normal)).z();
  }
  double nearest = HUGE_VAL;
  double farthest = -HUGE_VAL;
  for (const Vector3& corner : cornersOf(subject.bounds)) {
    const double z = (T_camera_volume * corner).z();
    nearest = std::min(nearest, z);
    farthest = std::max(farthest, z);
  }
  return nearest + arguments.cross_section[0] * (farthest - nearest);
}

}  // namespace soft_volume::core::render_program
