#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include "piece_mesh.h"
#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// Coefficients of 1, r, s, t, rs, st, rt and rst: positions or other quantities of a Piece as a function of its
/// reference coordinates (r, s, t), which are VTK's parametric coordinates. Hexahedra are trilinear; wedges linear over
/// the triangle times linear along it; pyramids hexahedra with one face drawn together; tetrahedra linear.
template <int N>
struct CellPolynomial {
  using Value = Eigen::Matrix<double, N, 1>;
  std::array<Value, 8> c;

  /// `vertex(i)`: value at the piece's vertex i.
  template <typename Vertex>
  CellPolynomial(CellType type, const Vertex& vertex) {
    if (type == CellType::kTetrahedron || type == CellType::kWedge)
      fromPrism(type, vertex);
    else
      fromHexahedron(type, vertex);
  }

  Value at(const Vector3& r) const {
    return c[0] + r.x() * c[1] + r.y() * c[2] + r.z() * (c[3] + r.x() * c[6] + r.y() * c[5]) +
           r.x() * r.y() * (c[4] + r.z() * c[7]);
  }
  /// Derivatives by r, s and t.
  std::array<Value, 3> derivatives(const Vector3& r) const {
    return {c[1] + r.y() * c[4] + r.z() * (c[6] + r.y() * c[7]), c[2] + r.x() * c[4] + r.z() * (c[5] + r.x() * c[7]),
            c[3] + r.x() * c[6] + r.y() * (c[5] + r.x() * c[7])};
  }

 private:
  template <typename Vertex>
  void fromPrism(CellType type, const Vertex& vertex) {
    c[0] = vertex(0);
    for (int i = 1; i < 4; ++i)
      c[std::size_t(i)] = vertex(i) - c[0];
    c[4] = c[5] = c[6] = c[7] = Value::Zero();
    if (type == CellType::kTetrahedron)
      return;
    c[5] = vertex(5) - c[2] - c[3] - c[0];
    c[6] = vertex(4) - c[1] - c[3] - c[0];
  }

  template <typename Vertex>
  void fromHexahedron(CellType type, const Vertex& vertex) {
    const int top = type == CellType::kPyramid ? 0 : 1;
    const Value top_0 = vertex(4);
    const Value top_1 = vertex(4 + top);
    const Value top_2 = vertex(4 + 2 * top);
    const Value top_3 = vertex(4 + 3 * top);
    c[0] = vertex(0);
    c[1] = vertex(1) - c[0];
    c[2] = vertex(3) - c[0];
    c[3] = top_0 - c[0];
    c[4] = vertex(2) - c[2] - c[1] - c[0];
    c[5] = top_3 - c[3] - c[2] - c[0];
    c[6] = top_1 - c[3] - c[1] - c[0];
    c[7] = top_2 - c[6] - c[5] - c[4] - c[3] - c[2] - c[1] - c[0];
  }
};

/// Reference coordinates of a piece's corner.
inline Vector3 referenceCorner(CellType type, int corner) {
  constexpr int kHexahedron[8][3] = {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0},
                                     {0, 0, 1}, {1, 0, 1}, {1, 1, 1}, {0, 1, 1}};
  constexpr int kPrism[6][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}};
  if (type == CellType::kPyramid && corner == 4)
    return {0.5, 0.5, 1.0};
  const bool prism = type == CellType::kTetrahedron || type == CellType::kWedge;
  const int(&at)[3] = prism ? kPrism[corner] : kHexahedron[corner];
  return Vector3(at[0], at[1], at[2]);
}

/// Newton's method from a guess to the reference coordinates where the polynomial is p. In degenerate cells, where it
/// does not get there, the best that is known; always within [0, 1].
inline Vector3 invert(const CellPolynomial<3>& map, const Vector3& p, Vector3 r) {
  constexpr int kMaxSteps = 10;
  constexpr double kDone = 1e-4;  // the step after one of this length would be of its square
  constexpr double kFarthest = 0.5;
  for (int step = 0; step < kMaxSteps; ++step) {
    const Vector3 residual = p - map.at(r);
    const std::array<Vector3, 3> d = map.derivatives(r);
    const Vector3 cross = d[1].cross(d[2]);
    const double determinant = d[0].dot(cross);
    const Vector3 move =
        Vector3(residual.dot(cross), d[0].dot(residual.cross(d[2])), d[0].dot(d[1].cross(residual))) / determinant;
    if (!(std::abs(determinant) > 0.0) || !isFinite(move))
      break;
    r = (r + move).cwiseMax(-kFarthest).cwiseMin(1.0 + kFarthest);
    if (move.squaredNorm() < kDone * kDone)
      break;
  }
  return r.cwiseMax(0.0).cwiseMin(1.0);
}

}  // namespace soft_volume::core
