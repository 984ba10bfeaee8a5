#include "soft_volume/incision/piece_shape.h"

#include <algorithm>
#include <limits>
#include <map>
#include <utility>

namespace soft_volume::core {
namespace {

using Edge = std::pair<std::uint32_t, std::uint32_t>;
/// Cross products below this share of the edges' lengths have no direction.
constexpr double kParallel = 1e-9;

/// Cosine between the normals of two faces at an edge, below which one is taken to be folded onto the other.
constexpr double kFolded = -0.998;

template <typename Visit>
void forEachEdge(const Polyhedron& solid, const Visit& visit) {
  for (const auto& loop : solid.loops) {
    for (std::size_t i = 0; i < loop.size(); ++i)
      visit(loop[i], loop[(i + 1) % loop.size()]);
  }
}

std::vector<Vector3> edgesOnce(const Polyhedron& solid) {
  std::vector<Vector3> edges;
  forEachEdge(solid, [&](std::uint32_t a, std::uint32_t b) {
    if (a < b)
      edges.push_back((solid.points_m[b] - solid.points_m[a]).normalized());
  });
  return edges;
}

double extentAlong(const Polyhedron& solid, const Vector3& direction) {
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  for (const Vector3& p : solid.points_m) {
    const double d = direction.dot(p);
    low = std::min(low, d);
    high = std::max(high, d);
  }
  return high - low;
}

/// How far a face rises over the plane of another one.
double heightOver(const Polyhedron& solid, std::size_t plane, std::size_t face) {
  const auto& loop = solid.loops[plane];
  const Vector3 normal = areaVector(solid.points_m, loop).normalized();
  double highest = 0.0;
  for (const std::uint32_t v : solid.loops[face])
    highest = std::max(highest, normal.dot(solid.points_m[v] - solid.points_m[loop[0]]));
  return highest;
}

bool areAntiparallel(const Polyhedron& solid, std::size_t a, std::size_t b) {
  const Vector3 normal = areaVector(solid.points_m, solid.loops[a]).normalized();
  return normal.dot(areaVector(solid.points_m, solid.loops[b]).normalized()) < kFolded;
}

}  // namespace

Vector3 areaVector(const std::vector<Vector3>& points_m, const std::vector<std::uint32_t>& loop) {
  Vector3 sum = Vector3::Zero();
  const Vector3& origin = points_m[loop[0]];
  for (std::size_t i = 2; i < loop.size(); ++i)
    sum += (points_m[loop[i - 1]] - origin).cross(points_m[loop[i]] - origin);
  return sum;
}

bool isClosed(const Polyhedron& solid) {
  std::vector<Edge> edges;
  forEachEdge(solid, [&](std::uint32_t a, std::uint32_t b) { edges.emplace_back(a, b); });
  std::sort(edges.begin(), edges.end());
  if (std::adjacent_find(edges.begin(), edges.end()) != edges.end())
    return false;
  return std::all_of(edges.begin(), edges.end(), [&](const Edge& e) {
    return e.first != e.second && std::binary_search(edges.begin(), edges.end(), Edge(e.second, e.first));
  });
}

bool touchesOwnEdge(const Polyhedron& solid, double distance_m) {
  bool touches = false;
  forEachEdge(solid, [&](std::uint32_t a, std::uint32_t b) {
    const Vector3 along = solid.points_m[b] - solid.points_m[a];
    for (std::uint32_t v = 0; a < b && v < solid.points_m.size(); ++v) {
      const Vector3 to = solid.points_m[v] - solid.points_m[a];
      const double t = along.dot(to) / along.squaredNorm();
      touches |= v != a && v != b && t > 0.0 && t < 1.0 && (to - t * along).squaredNorm() < distance_m * distance_m;
    }
  });
  return touches;
}

double volumeOf(const Polyhedron& solid) {
  double sum = 0.0;
  const Vector3& origin = solid.points_m[0];
  for (const auto& loop : solid.loops)
    sum += (solid.points_m[loop[0]] - origin).dot(areaVector(solid.points_m, loop));
  return sum / 6.0;
}

double shortestEdge(const Polyhedron& solid) {
  double shortest = std::numeric_limits<double>::infinity();
  forEachEdge(solid, [&](std::uint32_t a, std::uint32_t b) {
    shortest = std::min(shortest, (solid.points_m[a] - solid.points_m[b]).norm());
  });
  return shortest;
}

double deepestDent(const Polyhedron& solid) {
  std::map<Edge, std::size_t> face_of;
  for (std::size_t f = 0; f < solid.loops.size(); ++f) {
    const auto& loop = solid.loops[f];
    for (std::size_t i = 0; i < loop.size(); ++i)
      face_of[{loop[i], loop[(i + 1) % loop.size()]}] = f;
  }
  double deepest = 0.0;
  for (const auto& [edge, face] : face_of) {
    const auto other = face_of.find({edge.second, edge.first});
    if (edge.first > edge.second || other == face_of.end())
      continue;
    if (areAntiparallel(solid, face, other->second))
      return std::numeric_limits<double>::infinity();
    deepest =
        std::max(deepest, std::min(heightOver(solid, face, other->second), heightOver(solid, other->second, face)));
  }
  return deepest;
}

double leastWidth(const Polyhedron& solid, double enough_m) {
  double width = std::numeric_limits<double>::infinity();
  for (const auto& loop : solid.loops) {
    width = std::min(width, extentAlong(solid, areaVector(solid.points_m, loop).normalized()));
    if (width < enough_m)
      return width;
  }
  const std::vector<Vector3> edges = edgesOnce(solid);
  for (std::size_t a = 0; a < edges.size(); ++a) {
    for (std::size_t b = a + 1; b < edges.size(); ++b) {
      const Vector3 normal = edges[a].cross(edges[b]);
      const double length = normal.norm();
      if (length > kParallel)
        width = std::min(width, extentAlong(solid, normal / length));
    }
    if (width < enough_m)
      return width;
  }
  return width;
}

}  // namespace soft_volume::core
