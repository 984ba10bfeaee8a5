#include "soft_volume/tool/trilinear.h"

#include <algorithm>

namespace soft_volume::core {
namespace {

constexpr int kMaxIterations = 20;
constexpr double kConverged = 1e-10;     // in local coordinates
constexpr double kWarpedFraction = 0.2;  // of the shortest edge; below it Newton from the centre cannot go astray

bool isInside(const Vector3& local, double tolerance) {
  return local.minCoeff() >= -tolerance && local.maxCoeff() <= 1.0 + tolerance;
}

}  // namespace

Trilinear::Trilinear(const Corners& c)
    : coefficients_{c[0],
                    c[1] - c[0],
                    c[3] - c[0],
                    c[4] - c[0],
                    c[0] - c[1] + c[2] - c[3],
                    c[0] - c[3] - c[4] + c[7],
                    c[0] - c[1] - c[4] + c[5],
                    c[1] - c[0] + c[3] - c[2] + c[4] - c[5] + c[6] - c[7]} {}

bool Trilinear::isWarped() const {
  const double edge = std::min({coefficients_[1].norm(), coefficients_[2].norm(), coefficients_[3].norm()});
  double warp = 0.0;
  for (int i = 4; i < 8; ++i)
    warp += coefficients_[i].norm();
  return warp > kWarpedFraction * edge;
}

Vector3 Trilinear::value(const Vector3& p) const {
  const auto& a = coefficients_;
  return a[0] + p.x() * (a[1] + p.y() * a[4] + p.z() * a[6]) + p.y() * (a[2] + p.z() * (a[5] + p.x() * a[7])) +
         p.z() * a[3];
}

Matrix3 Trilinear::jacobian(const Vector3& p) const {
  const auto& a = coefficients_;
  Matrix3 jacobian;
  jacobian.col(0) = a[1] + p.y() * a[4] + p.z() * (a[6] + p.y() * a[7]);
  jacobian.col(1) = a[2] + p.x() * a[4] + p.z() * (a[5] + p.x() * a[7]);
  jacobian.col(2) = a[3] + p.y() * a[5] + p.x() * (a[6] + p.y() * a[7]);
  return jacobian;
}

Trilinear::Newton Trilinear::newton(const Vector3& wanted, double tolerance, Vector3& local) const {
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const Matrix3 j = jacobian(local);
    const Vector3 n0 = j.col(1).cross(j.col(2));
    const double det = j.col(0).dot(n0);
    const double scale = j.col(0).norm() * j.col(1).norm() * j.col(2).norm();
    if (!(std::abs(det) > 1e-9 * scale))
      return Newton::kFailed;
    const Vector3 residual = wanted - value(local);
    const Vector3 move(n0.dot(residual), j.col(2).cross(j.col(0)).dot(residual),
                       j.col(0).cross(j.col(1)).dot(residual));
    local += move / det;
    if (move.norm() < kConverged * std::abs(det))
      return isInside(local, tolerance) ? Newton::kInside : Newton::kOutside;
    local = local.cwiseMax(-1.0).cwiseMin(2.0);
  }
  return Newton::kFailed;
}

std::optional<Vector3> Trilinear::invert(const Vector3& wanted, double tolerance) const {
  Vector3 local = Vector3::Constant(0.5);
  const Newton first = newton(wanted, tolerance, local);
  if (first == Newton::kInside)
    return local;
  if (first == Newton::kOutside && !isWarped())
    return std::nullopt;
  for (int start = 0; start < 8; ++start) {
    local = Vector3(start & 1 ? 0.85 : 0.15, start & 2 ? 0.85 : 0.15, start & 4 ? 0.85 : 0.15);
    if (newton(wanted, tolerance, local) == Newton::kInside)
      return local;
  }
  return std::nullopt;
}

}  // namespace soft_volume::core
