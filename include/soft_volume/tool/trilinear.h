#pragma once

#include <array>
#include <optional>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// A vector field inside a hexahedron, trilinear in the local coordinates [0, 1]^3: position, place in the volume or
/// velocity, from the values at the eight corners. Pure and without allocation; safe from any thread.
class Trilinear {
 public:
  using Corners = std::array<Vector3, 8>;  ///< in VTK's order of a hexahedron

  Trilinear() { coefficients_.fill(Vector3::Zero()); }
  explicit Trilinear(const Corners& corners);

  Vector3 value(const Vector3& local) const;
  /// Columns are the derivatives by the three local coordinates.
  Matrix3 jacobian(const Vector3& local) const;
  /// Local coordinates of `value` by Newton's method, each in [-tolerance, 1 + tolerance]; nothing when the value is
  /// not taken inside the cell. Strongly warped cells are tried from several starts, because a start at the centre can
  /// end in a second solution outside the cell. A cell without volume never contains anything.
  std::optional<Vector3> invert(const Vector3& value, double tolerance) const;

 private:
  enum class Newton { kInside, kOutside, kFailed };
  Newton newton(const Vector3& value, double tolerance, Vector3& local) const;
  bool isWarped() const;

  // Monomials 1, x, y, z, xy, yz, zx, xyz: cheaper to evaluate than the eight shape functions.
  std::array<Vector3, 8> coefficients_;
};

}  // namespace soft_volume::core
