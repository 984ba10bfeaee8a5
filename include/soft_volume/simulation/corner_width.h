#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// How thin a cell has become, in the clear form: double precision, one tetrahedron at a time. The fast kernels follow
/// these definitions.
///
/// Each corner of a hexahedron spans a corner tetrahedron with the three edges a, b, c that meet there. With
/// n1 = b x c, n2 = c x a, n3 = a x b its signed width is
///
///   w = det(a, b, c) / max over the 7 non-empty subsets S of {1, 2, 3} of |sum of n_i, i in S|,
///
/// which is the least of its 4 altitudes and the 3 distances between opposite edges: negative where it is inverted, and
/// h / sqrt(3) in a cube. Vertices that move by less than half of w each cannot invert it, whatever their directions,
/// because w changes by at most twice the longest move.
///
/// Everything here is a pure function: thread-safe, no allocation.

/// Positions of a cell's corners in VTK's order, in metres, or anything else that each corner has.
using CellCorners = std::array<Vector3, 8>;

/// The corner tetrahedra of a hexahedron: each corner and the ends of a, b, c, so that det(a, b, c) > 0 at rest.
constexpr std::uint8_t kCornerTetrahedra[8][4] = {{0, 1, 3, 4}, {1, 2, 0, 5}, {2, 3, 1, 6}, {3, 0, 2, 7},
                                                  {4, 7, 5, 0}, {5, 4, 6, 1}, {6, 5, 7, 2}, {7, 6, 4, 3}};

/// Edges of a tetrahedron from its corner, metres.
struct CornerEdges {
  Vector3 a;
  Vector3 b;
  Vector3 c;

  double determinant() const { return a.dot(b.cross(c)); }
};

inline CornerEdges cornerEdges(const CellCorners& corners, int tetrahedron) {
  const std::uint8_t* t = kCornerTetrahedra[tetrahedron];
  const Vector3& p = corners[t[0]];
  return {corners[t[1]] - p, corners[t[2]] - p, corners[t[3]] - p};
}

/// The subset that decides the width: its members as 0 or 1, and the sum of their normals.
struct WidthNormal {
  std::array<double, 3> members;
  Vector3 sum_m2;
};

/// The subset with the longest sum; the first of equals.
inline WidthNormal widthNormal(const CornerEdges& e) {
  const std::array<Vector3, 3> n = {e.b.cross(e.c), e.c.cross(e.a), e.a.cross(e.b)};
  WidthNormal longest{{0.0, 0.0, 0.0}, Vector3::Zero()};
  double longest_squared = -1.0;
  for (int subset = 1; subset < 8; ++subset) {
    const std::array<double, 3> members = {double(subset & 1), double(subset >> 1 & 1), double(subset >> 2)};
    const Vector3 sum = members[0] * n[0] + members[1] * n[1] + members[2] * n[2];
    if (sum.squaredNorm() > longest_squared) {
      longest_squared = sum.squaredNorm();
      longest = {members, sum};
    }
  }
  return longest;
}

/// Signed width of a corner tetrahedron, metres; 0 when all its vertices lie on one line.
inline double cornerWidth(const CornerEdges& e) {
  const Vector3 n1 = e.b.cross(e.c);
  const Vector3 n2 = e.c.cross(e.a);
  const Vector3 n3 = e.a.cross(e.b);
  const Vector3 n12 = n1 + n2;
  const double squared = std::max({n1.squaredNorm(), n2.squaredNorm(), n3.squaredNorm(), n12.squaredNorm(),
                                   (n2 + n3).squaredNorm(), (n3 + n1).squaredNorm(), (n12 + n3).squaredNorm()});
  return squared > 0.0 ? e.a.dot(n1) / std::sqrt(squared) : 0.0;
}

/// Width and how it changes with the four vertices: the corner, and the ends of a, b and c. The gradients sum to zero
/// and exert no torque, so that forces along them keep both momenta.
struct CornerWidth {
  double width_m;
  std::array<Vector3, 4> gradient;
};

/// w = det / |n| with n of the deciding subset: dw = (d det - w d|n|) / |n|.
inline CornerWidth cornerWidthGradient(const CornerEdges& e) {
  const WidthNormal normal = widthNormal(e);
  const double length = normal.sum_m2.norm();
  if (length <= 0.0)
    return {0.0, {Vector3::Zero(), Vector3::Zero(), Vector3::Zero(), Vector3::Zero()}};
  const double width = e.determinant() / length;
  const Vector3 u = normal.sum_m2 / length;
  const std::array<double, 3>& s = normal.members;
  const Vector3 da = (e.b.cross(e.c) - width * u.cross(s[1] * e.c - s[2] * e.b)) / length;
  const Vector3 db = (e.c.cross(e.a) - width * u.cross(s[2] * e.a - s[0] * e.c)) / length;
  const Vector3 dc = (e.a.cross(e.b) - width * u.cross(s[0] * e.b - s[1] * e.a)) / length;
  return {width, {-(da + db + dc), da, db, dc}};
}

/// Least width of a cell's corner tetrahedra, metres.
inline double cellMinWidth(const CellCorners& corners) {
  double least = cornerWidth(cornerEdges(corners, 0));
  for (int t = 1; t < 8; ++t)
    least = std::min(least, cornerWidth(cornerEdges(corners, t)));
  return least;
}

/// A spring that acts on the width itself once it falls below a limit (Selle, Lentine, Fedkiw: A mass spring model for
/// hair simulation, 2008: altitude springs). It keeps pushing apart what has collapsed, where ordinary springs do not
/// know the inside from the outside.
struct AltitudeSpring {
  double stiffness_n_m;
  double limit_m;

  /// (1/2) k (limit - w)^2 below the limit, joule.
  double energy(double width_m) const {
    const double lack_m = std::max(0.0, limit_m - width_m);
    return 0.5 * stiffness_n_m * lack_m * lack_m;
  }
  /// Along the gradient of the width, newton.
  double force(double width_m) const { return stiffness_n_m * std::max(0.0, limit_m - width_m); }
};

}  // namespace soft_volume::core
