#include "soft_volume/simulation/corner_width.h"

#include <gtest/gtest.h>

#include <random>

#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {
namespace {

using Tetrahedron = std::array<Vector3, 4>;

class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}
  double in(double low, double high) { return std::uniform_real_distribution<double>(low, high)(engine_); }
  Vector3 inCube(double half) { return {in(-half, half), in(-half, half), in(-half, half)}; }
  Vector3 direction() {
    const Vector3 v(normal_(engine_), normal_(engine_), normal_(engine_));
    return v.normalized();
  }
  Tetrahedron tetrahedron() { return {inCube(1.0), inCube(1.0), inCube(1.0), inCube(1.0)}; }

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
};

CornerEdges edgesOf(const Tetrahedron& t) {
  return {t[1] - t[0], t[2] - t[0], t[3] - t[0]};
}

double widthOf(const Tetrahedron& t) {
  return cornerWidth(edgesOf(t));
}

CellCorners boxCorners(const Vector3& spacing_m) {
  CellCorners corners;
  for (int c = 0; c < 8; ++c) {
    const int* o = kHexahedronCorners[c];
    corners[c] = spacing_m.cwiseProduct(Vector3(o[0], o[1], o[2]));
  }
  return corners;
}

double distanceToPlane(const Vector3& p, const Vector3& a, const Vector3& b, const Vector3& c) {
  return std::abs((p - a).dot((b - a).cross(c - a).normalized()));
}

double distanceOfLines(const Vector3& a, const Vector3& b, const Vector3& c, const Vector3& d) {
  return std::abs((c - a).dot((b - a).cross(d - c).normalized()));
}

double leastDistance(const Tetrahedron& t) {
  return std::min({distanceToPlane(t[0], t[1], t[2], t[3]), distanceToPlane(t[1], t[0], t[2], t[3]),
                   distanceToPlane(t[2], t[0], t[1], t[3]), distanceToPlane(t[3], t[0], t[1], t[2]),
                   distanceOfLines(t[0], t[1], t[2], t[3]), distanceOfLines(t[0], t[2], t[1], t[3]),
                   distanceOfLines(t[0], t[3], t[1], t[2])});
}

double extent(const Tetrahedron& t, const Vector3& direction) {
  const auto [low, high] =
      std::minmax({t[0].dot(direction), t[1].dot(direction), t[2].dot(direction), t[3].dot(direction)});
  return high - low;
}

TEST(CornerWidth, IsTheLeastAltitudeOrDistanceOfOppositeEdges) {
  Random random(1);
  for (int n = 0; n < 20000; ++n) {
    const Tetrahedron t = random.tetrahedron();
    const double width = widthOf(t);
    EXPECT_NEAR(std::abs(width), leastDistance(t), 1e-9);
    EXPECT_EQ(width > 0.0, edgesOf(t).determinant() > 0.0);
    EXPECT_NEAR(widthOf({t[0], t[2], t[1], t[3]}), -width, 1e-12);
  }
}

TEST(CornerWidth, IsTheLeastExtentOverAllDirections) {
  Random random(2);
  for (int n = 0; n < 50; ++n) {
    const Tetrahedron t = random.tetrahedron();
    const double width = std::abs(widthOf(t));
    EXPECT_NEAR(extent(t, widthNormal(edgesOf(t)).sum_m2.normalized()), width, 1e-12);
    for (int d = 0; d < 2000; ++d)
      EXPECT_GE(extent(t, random.direction()), width);
  }
}

TEST(CornerWidth, OfABoxAtRestFollowsFromItsEdges) {
  EXPECT_NEAR(cellMinWidth(boxCorners(Vector3::Constant(0.005))), 0.005 / std::sqrt(3.0), 1e-15);
  const Vector3 spacing(0.005, 0.006, 0.008);
  EXPECT_NEAR(cellMinWidth(boxCorners(spacing)), 1.0 / spacing.cwiseInverse().norm(), 1e-15);
}

TEST(CornerWidth, EveryCornerOfACellCounts) {
  for (int t = 0; t < 8; ++t) {
    CellCorners corners = boxCorners(Vector3::Ones());
    EXPECT_NEAR(cornerEdges(corners, t).determinant(), 1.0, 1e-15) << "corner " << t;
    EXPECT_EQ(kCornerTetrahedra[t][0], t);
    // Pushed through the plane of its three neighbours, a corner inverts its own tetrahedron.
    corners[t] += 0.8 * (Vector3::Constant(0.5) - corners[t]);
    EXPECT_LT(cornerWidth(cornerEdges(corners, t)), 0.0);
    EXPECT_LT(cellMinWidth(corners), 0.0);
  }
}

TEST(CornerWidth, OfDegenerateTetrahedraIsZero) {
  const Vector3 x = Vector3::UnitX();
  EXPECT_EQ(cornerWidth({x, 2.0 * x, 3.0 * x}), 0.0);
  EXPECT_EQ(cornerWidth({Vector3::Zero(), Vector3::Zero(), Vector3::Zero()}), 0.0);
  const CornerWidth flat = cornerWidthGradient({x, 2.0 * x, 3.0 * x});
  EXPECT_EQ(flat.width_m, 0.0);
  for (const Vector3& g : flat.gradient)
    EXPECT_TRUE(g.isZero());
  EXPECT_EQ(cornerWidth({x, Vector3::UnitY(), x + Vector3::UnitY()}), 0.0);
}

/// Central differences; NaN-free everywhere, but wrong where two subsets tie: the caller leaves those out.
Vector3 differences(Tetrahedron t, int vertex) {
  constexpr double kStep = 1e-6;
  Vector3 gradient;
  for (int d = 0; d < 3; ++d) {
    const double at = t[vertex][d];
    t[vertex][d] = at + kStep;
    const double above = widthOf(t);
    t[vertex][d] = at - kStep;
    gradient[d] = (above - widthOf(t)) / (2.0 * kStep);
    t[vertex][d] = at;
  }
  return gradient;
}

/// Shortest distance, relative, between the longest and the second longest normal.
double tie(const CornerEdges& e) {
  const std::array<Vector3, 3> n = {e.b.cross(e.c), e.c.cross(e.a), e.a.cross(e.b)};
  double first = 0.0;
  double second = 0.0;
  for (const Vector3& sum : {n[0], n[1], n[2], Vector3(n[0] + n[1]), Vector3(n[1] + n[2]), Vector3(n[2] + n[0]),
                             Vector3(n[0] + n[1] + n[2])}) {
    second = std::max(second, std::min(first, sum.norm()));
    first = std::max(first, sum.norm());
  }
  return (first - second) / first;
}

TEST(CornerWidth, GradientIsThatOfTheWidth) {
  Random random(3);
  int tried = 0;
  for (int n = 0; n < 3000; ++n) {
    const Tetrahedron t = random.tetrahedron();
    const CornerEdges edges = edgesOf(t);
    // Near a tie, or where everything is tiny, differences see more than one subset or too much curvature.
    if (tie(edges) < 1e-3 || widthNormal(edges).sum_m2.norm() < 0.05)
      continue;
    ++tried;
    const CornerWidth width = cornerWidthGradient(edges);
    EXPECT_NEAR(width.width_m, cornerWidth(edges), 1e-12);
    for (int v = 0; v < 4; ++v)
      EXPECT_LT((width.gradient[v] - differences(t, v)).norm(), 1e-6);
  }
  EXPECT_GT(tried, 2500);
}

TEST(CornerWidth, GradientKeepsBothMomenta) {
  Random random(4);
  for (int n = 0; n < 2000; ++n) {
    const Tetrahedron t = random.tetrahedron();
    const CornerWidth width = cornerWidthGradient(edgesOf(t));
    Vector3 sum = Vector3::Zero();
    Vector3 torque = Vector3::Zero();
    double lengths = 0.0;
    for (int v = 0; v < 4; ++v) {
      sum += width.gradient[v];
      torque += t[v].cross(width.gradient[v]);
      lengths += width.gradient[v].norm();
    }
    EXPECT_LT(sum.norm(), 1e-10);
    EXPECT_LT(torque.norm(), 1e-9);
    // Both sides of the gap lie opposite each other, so the width changes by at most twice the longest move.
    EXPECT_NEAR(lengths, 2.0, 1e-6);
  }
}

TEST(CornerWidth, MovesBelowHalfTheWidthNeverInvert) {
  Random random(5);
  int tried = 0;
  for (int n = 0; n < 200000; ++n) {
    Tetrahedron t = random.tetrahedron();
    const CornerWidth width = cornerWidthGradient(edgesOf(t));
    if (width.width_m <= 0.0)
      continue;
    ++tried;
    for (int v = 0; v < 4; ++v) {
      const Vector3 direction =
          n % 2 == 0 ? random.direction() : Vector3(-(width.gradient[v] + 0.1 * random.inCube(1.0)).normalized());
      t[v] += 0.4999 * width.width_m * direction;
    }
    EXPECT_GT(widthOf(t), 0.0);
  }
  EXPECT_GT(tried, 90000);
}

TEST(CornerWidth, MovesBeyondHalfTheWidthCanInvert) {
  Random random(6);
  for (int n = 0; n < 2000; ++n) {
    Tetrahedron t = random.tetrahedron();
    const CornerWidth width = cornerWidthGradient(edgesOf(t));
    if (width.width_m <= 0.0)
      continue;
    // Along the normal, each side of the gap towards the other.
    const Vector3 normal = widthNormal(edgesOf(t)).sum_m2.normalized();
    const auto [low, high] = std::minmax({t[0].dot(normal), t[1].dot(normal), t[2].dot(normal), t[3].dot(normal)});
    const double middle = 0.5 * (low + high);
    for (Vector3& p : t)
      p += 0.501 * width.width_m * (p.dot(normal) < middle ? 1.0 : -1.0) * normal;
    EXPECT_LT(widthOf(t), 0.0);
  }
}

TEST(AltitudeSpring, ForceIsTheGradientOfTheEnergyAndZeroAboveTheLimit) {
  const AltitudeSpring spring{200.0, 0.3};
  for (const double width : {-0.4, 0.0, 0.1, 0.29}) {
    EXPECT_NEAR(spring.force(width), (spring.energy(width - 1e-6) - spring.energy(width + 1e-6)) / 2e-6, 1e-5);
    EXPECT_GT(spring.force(width), 0.0);
  }
  EXPECT_EQ(spring.force(0.31), 0.0);
  EXPECT_EQ(spring.energy(0.31), 0.0);
}

TEST(AltitudeSpring, ForcesOnTheVerticesAreTheNegativeGradientOfItsEnergy) {
  Random random(7);
  const AltitudeSpring spring{200.0, 1.0};
  constexpr double kStep = 1e-6;
  int tried = 0;
  for (int n = 0; n < 500; ++n) {
    Tetrahedron t = random.tetrahedron();
    const CornerEdges edges = edgesOf(t);
    if (tie(edges) < 1e-3 || widthNormal(edges).sum_m2.norm() < 0.05)
      continue;
    ++tried;
    const CornerWidth width = cornerWidthGradient(edges);
    for (int v = 0; v < 4; ++v) {
      for (int d = 0; d < 3; ++d) {
        const double at = t[v][d];
        t[v][d] = at + kStep;
        const double above = spring.energy(widthOf(t));
        t[v][d] = at - kStep;
        const double below = spring.energy(widthOf(t));
        t[v][d] = at;
        EXPECT_NEAR(spring.force(width.width_m) * width.gradient[v][d], (below - above) / (2.0 * kStep), 1e-3);
      }
    }
  }
  EXPECT_GT(tried, 400);
}

}  // namespace
}  // namespace soft_volume::core
