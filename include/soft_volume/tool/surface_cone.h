#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// Part of a cell that is not a hexahedron: what lies between the cell's centre, its apex, and a triangle or a bilinear
/// quadrilateral of the cell's surface, its base. The cones over a closed surface fill what it encloses, whatever the
/// cell's shape; two cells that have the same bases in common leave no gap, and a bilinear base fits a face of a
/// trilinear hexahedron exactly.
///
/// Local coordinates (a, b, c): a from 0 at the apex to 1 at the base; b / a and c / a run along the base's edges from
/// its first corner, [0, 1] each and b + c <= a for a triangle. Fields are interpolated linearly (bilinearly along a
/// quadrilateral). Pure and without allocation; safe from any thread. Cheap enough to be made for one query.
class SurfaceCone {
 public:
  /// Numbers of points: apex, then the base's corners along its border; triangles repeat the last one.
  using Points = std::array<std::uint32_t, 5>;

  /// `tolerance_m` is how far outside a point still counts as inside.
  SurfaceCone(const std::vector<Vector3>& positions_m, const Points& points, double tolerance_m);

  /// False only where a cone of these would not contain the point: a test that is cheaper than making one.
  static bool mayContain(const std::vector<Vector3>& positions_m, const Points& points, double tolerance_m,
                         const Vector3& point_m);
  /// Local coordinates of a point, on the border where it is outside within the tolerance; nothing when it is outside.
  /// A cone without volume contains nothing.
  std::optional<Vector3> invert(const Vector3& point_m) const;
  /// Whether a point is no farther than this from a base that is a triangle.
  bool isAtBase(const Vector3& point_m, double distance_m) const;
  /// A field with one value per point.
  Vector3 value(const std::vector<Vector3>& field, const Vector3& local) const { return value(field, points_, local); }
  static Vector3 value(const std::vector<Vector3>& field, const Points& points, const Vector3& local);
  /// Columns are its derivatives by the local coordinates.
  Matrix3 jacobian(const std::vector<Vector3>& field, const Vector3& local) const;

 private:
  static bool isQuadrilateral(const Points& points) { return points[3] != points[4]; }
  bool isQuadrilateral() const { return isQuadrilateral(points_); }
  std::optional<Vector3> invertTriangle(const Vector3& local) const;
  std::optional<Vector3> invertQuadrilateral(const Vector3& linear) const;

  Points points_;
  Vector3 apex_m_;
  Matrix3 inverse_ = Matrix3::Zero();                // of the linear part
  Vector3 warp_ = Vector3::Zero();                   // the bilinear term of the base, in local coordinates
  Eigen::Vector4d per_m_ = Eigen::Vector4d::Zero();  // slopes of a, b, c and a - b - c
  double tolerance_m_;
  bool has_volume_ = false;
};

}  // namespace soft_volume::core
