#include "soft_volume/tool/surface_cone.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {
namespace {

constexpr double kWider = 1.001;         // for rounding
constexpr double kBaseTolerance = 1e-6;  // of a quadrilateral's edges, as of a hexahedron's

/// The bilinear term's share b c / a; finite and 0 at the apex, where b = c = 0.
double mixed(const Vector3& local) {
  return local[0] > 0.0 ? local[1] * local[2] / local[0] : 0.0;
}

}  // namespace

SurfaceCone::SurfaceCone(const std::vector<Vector3>& positions_m, const Points& points, double tolerance_m)
    : points_(points), apex_m_(positions_m[points[0]]), tolerance_m_(tolerance_m) {
  const auto& p = positions_m;
  const std::uint32_t along_c = isQuadrilateral() ? points_[4] : points_[3];
  Matrix3 linear;
  linear << p[points_[1]] - apex_m_, p[points_[2]] - p[points_[1]], p[along_c] - p[points_[1]];
  linear.computeInverseWithCheck(inverse_, has_volume_, 0.0);
  has_volume_ = has_volume_ && inverse_.allFinite();
  if (!has_volume_)
    return;
  if (isQuadrilateral())
    warp_ = inverse_ * (p[points_[1]] - p[points_[2]] + p[points_[3]] - p[points_[4]]);
  per_m_ << inverse_.rowwise().norm(), (inverse_.row(0) - inverse_.row(1) - inverse_.row(2)).norm();
}

// The conditions of invertTriangle(), times the determinant, with a slack that is a little wider.
bool SurfaceCone::mayContain(const std::vector<Vector3>& positions_m, const Points& points, double tolerance_m,
                             const Vector3& point_m) {
  if (isQuadrilateral(points))
    return true;
  const Vector3& apex = positions_m[points[0]];
  const Vector3& first = positions_m[points[1]];
  const Vector3 from_apex = first - apex;
  const Vector3 along_b = positions_m[points[2]] - first;
  const Vector3 along_c = positions_m[points[3]] - first;
  const Vector3 base = along_b.cross(along_c);
  const double determinant = from_apex.dot(base);
  const double sign = determinant < 0.0 ? -1.0 : 1.0;
  const Vector3 there = point_m - apex;
  const auto slack = [=](const Vector3& normal) { return kWider * tolerance_m * normal.cwiseAbs().sum(); };
  const double a = sign * base.dot(there);
  if (a > sign * determinant + slack(base))
    return false;
  const Vector3 normal_b = along_c.cross(from_apex);
  const double b = sign * normal_b.dot(there);
  if (b < -slack(normal_b))
    return false;
  const Vector3 normal_c = from_apex.cross(along_b);
  const double c = sign * normal_c.dot(there);
  return c >= -slack(normal_c) && a - b - c >= -slack(base - normal_b - normal_c);
}

std::optional<Vector3> SurfaceCone::invert(const Vector3& point_m) const {
  if (!has_volume_)
    return std::nullopt;
  const Vector3 linear = inverse_ * (point_m - apex_m_);
  return isQuadrilateral() ? invertQuadrilateral(linear) : invertTriangle(linear);
}

std::optional<Vector3> SurfaceCone::invertTriangle(const Vector3& local) const {
  const double rest = local[0] - local[1] - local[2];
  const Eigen::Vector4d slack = tolerance_m_ * per_m_;
  if (local[0] > 1.0 + slack[0] || local[1] < -slack[1] || local[2] < -slack[2] || rest < -slack[3])
    return std::nullopt;
  const double b = std::max(local[1], 0.0);
  const double c = std::max(local[2], 0.0);
  const double a = std::max(rest, 0.0) + b + c;
  return Vector3(Vector3(a, b, c) / std::max(1.0, a));
}

// The point is at (a, b, c) + k warp with k = b c / a, which makes k the root of a quadratic; a mild warp has a small
// k.
std::optional<Vector3> SurfaceCone::invertQuadrilateral(const Vector3& linear) const {
  const double square = warp_[0] + warp_[1] * warp_[2];
  const double slope = linear[0] + linear[1] * warp_[2] + linear[2] * warp_[1];
  const double constant = linear[1] * linear[2];
  const double discriminant = slope * slope - 4.0 * square * constant;
  if (discriminant < 0.0)
    return std::nullopt;
  const double divisor = slope + std::copysign(std::sqrt(discriminant), slope);
  const double roots[2] = {divisor != 0.0 ? 2.0 * constant / divisor : 0.0,
                           square != 0.0 ? divisor / (2.0 * square) : 0.0};
  for (const double k : roots) {
    const Vector3 local = linear - k * warp_;
    const double a = local[0];
    const double least = -kBaseTolerance * std::max(a, kBaseTolerance);
    if (a < -kBaseTolerance || a > 1.0 + kBaseTolerance || local[1] < least || local[2] < least ||
        local[1] > a - least || local[2] > a - least)
      continue;
    const double clamped = std::clamp(a, 0.0, 1.0);
    return Vector3(clamped, std::clamp(local[1], 0.0, clamped), std::clamp(local[2], 0.0, clamped));
  }
  return std::nullopt;
}

bool SurfaceCone::isAtBase(const Vector3& point_m, double distance_m) const {
  if (!has_volume_ || isQuadrilateral())
    return false;
  const Vector3 local = inverse_ * (point_m - apex_m_);
  const Eigen::Vector4d inside(-std::abs(local[0] - 1.0), local[1], local[2], local[0] - local[1] - local[2]);
  return (inside + distance_m * per_m_).minCoeff() >= 0.0;
}

Vector3 SurfaceCone::value(const std::vector<Vector3>& field, const Points& points, const Vector3& local) {
  const auto [a, b, c] = std::array<double, 3>{local[0], local[1], local[2]};
  if (!isQuadrilateral(points)) {
    return (1.0 - a) * field[points[0]] + (a - b - c) * field[points[1]] + b * field[points[2]] + c * field[points[3]];
  }
  const double k = mixed(local);
  return (1.0 - a) * field[points[0]] + (a - b - c + k) * field[points[1]] + (b - k) * field[points[2]] +
         k * field[points[3]] + (c - k) * field[points[4]];
}

Matrix3 SurfaceCone::jacobian(const std::vector<Vector3>& field, const Vector3& local) const {
  const auto& f = field;
  const std::uint32_t along_c = isQuadrilateral() ? points_[4] : points_[3];
  Matrix3 jacobian;
  jacobian << f[points_[1]] - f[points_[0]], f[points_[2]] - f[points_[1]], f[along_c] - f[points_[1]];
  if (isQuadrilateral() && local[0] > 0.0) {
    const Vector3 warp = f[points_[1]] - f[points_[2]] + f[points_[3]] - f[points_[4]];
    const double u = local[1] / local[0];
    const double v = local[2] / local[0];
    jacobian += warp * Eigen::RowVector3d(-u * v, v, u);
  }
  return jacobian;
}

}  // namespace soft_volume::core
