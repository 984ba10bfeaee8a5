#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include <cmath>

namespace soft_volume::core {

/// Vectors are column vectors in metres unless a name says otherwise. `p_A` is a point in frame A, `T_A_B` maps points
/// in B to A (doc/frames.md).
using Vector3 = Eigen::Vector3d;
using Vector3f = Eigen::Vector3f;
using Vector3i = Eigen::Vector3i;
using Matrix3 = Eigen::Matrix3d;
using Quaternion = Eigen::Quaterniond;

/// A rigid pose: position in metres and unit orientation.
struct Pose {
  Vector3 position_m = Vector3::Zero();
  Quaternion orientation = Quaternion::Identity();

  Vector3 operator*(const Vector3& p_B) const { return position_m + orientation * p_B; }
  Pose operator*(const Pose& other) const { return {*this * other.position_m, orientation * other.orientation}; }
  Pose inverse() const {
    const Quaternion q = orientation.conjugate();
    return {-(q * position_m), q};
  }
};

inline bool isFinite(const Vector3& v) {
  return std::isfinite(v.x()) && std::isfinite(v.y()) && std::isfinite(v.z());
}

/// Finite, with a quaternion whose norm is 1 within 1 % (drivers round). The caller normalises it afterwards.
inline bool isUsable(const Pose& pose) {
  const double norm = pose.orientation.norm();
  return isFinite(pose.position_m) && std::isfinite(norm) && std::abs(norm - 1.0) < 0.01;
}

/// An axis-aligned box in metres; empty until something was added.
using Box3 = Eigen::AlignedBox3d;

}  // namespace soft_volume::core
