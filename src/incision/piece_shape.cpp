#include "soft_volume/incision/piece_shape.h"

#include <algorithm>
#include <limits>
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

std::vector<Vector3> normalsOf(const Polyhedron& solid) {
  std::vector<Vector3> normals;
  for (const auto& loop : solid.loops)
    normals.push_back(areaVector(solid.points_m, loop).normalized());
  return normals;
}

/// How far a face rises over a plane.
double heightOver(const Polyhedron& solid, const Vector3& normal, const Vector3& point_m, std::size_t face) {
  double highest = 0.0;
  for (const std::uint32_t v : solid.loops[face])
    highest = std::max(highest, normal.dot(solid.points_m[v] - point_m));
  return highest;
}

/// Of a ball around the middle of the vertices that no face's plane enters; negative where there is none. What lies
/// behind all these planes is a part of the polyhedron, convex or not.
double radiusInside(const Polyhedron& solid) {
  Vector3 middle = Vector3::Zero();
  for (const Vector3& p : solid.points_m)
    middle += p / static_cast<double>(solid.points_m.size());
  double radius = std::numeric_limits<double>::infinity();
  for (const auto& loop : solid.loops) {
    const Vector3 normal = areaVector(solid.points_m, loop).normalized();
    radius = std::min(radius, normal.dot(solid.points_m[loop[0]] - middle));
  }
  return radius;
}

}  // namespace

Vector3 areaVector(const std::vector<Vector3>& points_m, const std::vector<std::uint32_t>& loop) {
  Vector3 sum = Vector3::Zero();
  const Vector3& origin = points_m[loop[0]];
  for (std::size_t i = 2; i < loop.size(); ++i)
    sum += (points_m[loop[i - 1]] - origin).cross(points_m[loop[i]] - origin);
  return sum;
}

Polyhedron solidOf(const CutMesh& mesh, std::uint32_t piece) {
  const std::vector<std::uint32_t> vertices = mesh.verticesOf(piece);
  Polyhedron solid;
  for (const std::uint32_t v : vertices)
    solid.points_m.push_back(mesh.restPositions()[v]);
  for (std::vector<std::uint32_t> loop : mesh.loopsOf(piece)) {
    for (std::uint32_t& v : loop)
      v = static_cast<std::uint32_t>(std::lower_bound(vertices.begin(), vertices.end(), v) - vertices.begin());
    solid.loops.push_back(std::move(loop));
  }
  return solid;
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
  std::vector<std::pair<Edge, std::size_t>> face_of;
  for (std::size_t f = 0; f < solid.loops.size(); ++f) {
    const auto& loop = solid.loops[f];
    for (std::size_t i = 0; i < loop.size(); ++i)
      face_of.push_back({{loop[i], loop[(i + 1) % loop.size()]}, f});
  }
  std::sort(face_of.begin(), face_of.end());
  const std::vector<Vector3> normals = normalsOf(solid);
  const auto heightOverFace = [&](std::size_t plane, std::size_t face) {
    return heightOver(solid, normals[plane], solid.points_m[solid.loops[plane][0]], face);
  };
  double deepest = 0.0;
  for (const auto& [edge, face] : face_of) {
    if (edge.first > edge.second)
      continue;
    const Edge back(edge.second, edge.first);
    const auto other = std::lower_bound(face_of.begin(), face_of.end(), std::pair(back, std::size_t{0}));
    if (other == face_of.end() || other->first != back)
      continue;
    if (normals[face].dot(normals[other->second]) < kFolded)
      return std::numeric_limits<double>::infinity();
    deepest = std::max(deepest, std::min(heightOverFace(face, other->second), heightOverFace(other->second, face)));
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

bool isWide(const Polyhedron& solid, double width_m) {
  // The hair's breadth is for rounding.
  return 2.0 * radiusInside(solid) > (1.0 + 1e-9) * width_m || leastWidth(solid, width_m) >= width_m;
}

}  // namespace soft_volume::core
