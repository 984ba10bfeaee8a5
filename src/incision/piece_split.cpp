#include "piece_split.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <utility>

#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {
namespace {

using Loop = std::vector<std::uint32_t>;

/// A dent may be this share of the piece's least width.
constexpr double kDentOfWidth = 0.35;
/// Of a face, in squares of the least edge: a chord along a straight edge leaves none.
constexpr double kLeastArea = 1e-2;
/// Distance of a vertex from an edge that it seems to lie on, in least edges.
constexpr double kTouching = 1e-3;
constexpr double kNoTriangles = -std::numeric_limits<double>::infinity();

Loop wayAround(const Loop& loop, std::uint32_t from, std::uint32_t to) {
  auto i = static_cast<std::size_t>(std::find(loop.begin(), loop.end(), from) - loop.begin());
  Loop way = {from};
  while (way.back() != to)
    way.push_back(loop[i = (i + 1) % loop.size()]);
  return way;
}

/// Least altitude of a triangle in the plane of `normal`, negative where it turns the other way.
double leastAltitude(const Vector3& a, const Vector3& b, const Vector3& c, const Vector3& normal) {
  const double longest = std::max({(a - b).norm(), (b - c).norm(), (c - a).norm()});
  return normal.dot((b - a).cross(c - a)) / longest;
}

/// Triangles of a polygon whose least altitude, seen along the normal, is the greatest possible. Dynamic programming
/// over the chains i..j of its corners; none when every choice folds or has a triangle that is not allowed.
class PolygonTriangles {
 public:
  using IsAllowed = std::function<bool(std::size_t, std::size_t, std::size_t)>;

  PolygonTriangles(const std::vector<Vector3>& corners, const Vector3& normal, IsAllowed is_allowed)
      : is_allowed_(std::move(is_allowed)),
        size_(corners.size()),
        best_(size_ * size_, std::numeric_limits<double>::infinity()),
        apex_(size_ * size_, 0) {
    for (std::size_t length = 2; length < size_; ++length) {
      for (std::size_t i = 0; i + length < size_; ++i)
        solve(corners, normal, i, i + length);
    }
  }
  double leastAltitude() const { return best_[size_ - 1]; }
  std::vector<std::array<std::size_t, 3>> triangles() const {
    std::vector<std::array<std::size_t, 3>> all;
    collect(0, size_ - 1, all);
    return all;
  }

 private:
  void solve(const std::vector<Vector3>& corners, const Vector3& normal, std::size_t i, std::size_t j) {
    double& best = best_[i * size_ + j];
    best = kNoTriangles;
    for (std::size_t k = i + 1; k < j; ++k) {
      const double altitude = std::min({best_[i * size_ + k], best_[k * size_ + j],
                                        core::leastAltitude(corners[i], corners[k], corners[j], normal)});
      if (altitude > best && is_allowed_(i, k, j)) {
        best = altitude;
        apex_[i * size_ + j] = k;
      }
    }
  }
  void collect(std::size_t i, std::size_t j, std::vector<std::array<std::size_t, 3>>& all) const {
    if (j < i + 2)
      return;
    const std::size_t k = apex_[i * size_ + j];
    all.push_back({i, k, j});
    collect(i, k, all);
    collect(k, j, all);
  }

  IsAllowed is_allowed_;
  std::size_t size_;
  std::vector<double> best_;
  std::vector<std::size_t> apex_;
};

/// A split in the making.
class SplitPlan {
 public:
  SplitPlan(const CutMesh& mesh, std::uint32_t piece, PlaneSides& sides, const ShapeLimits& limits)
      : mesh_(mesh), piece_(piece), sides_(sides), limits_(limits) {}

  std::optional<PieceSplit> make() {
    for (const std::uint32_t f : mesh_.pieces()[piece_].faces) {
      if (!addFace(f))
        return std::nullopt;
    }
    if (behind_.empty() || front_.empty())
      return std::nullopt;
    const Loop around = sectionLoop();
    if (around.size() < 3 || !addSection(around) || !isGood(behind_) || !isGood(front_))
      return std::nullopt;
    return split_;
  }

 private:
  Vector3 place(std::uint32_t vertex) const {
    const std::size_t count = mesh_.vertexCount();
    if (vertex < count)
      return mesh_.restPositions()[vertex];
    const CutMesh::Source& point = split_.points[vertex - count];
    const Vector3& a = mesh_.restPositions()[point.a];
    return a + point.share * (mesh_.restPositions()[point.b] - a);
  }
  int sign(std::uint32_t vertex) { return vertex < mesh_.vertexCount() ? sides_.sign(vertex) : 0; }
  double farness(std::uint32_t vertex) {
    return vertex < mesh_.vertexCount() ? std::abs(sides_.distance(vertex)) : 0.0;
  }

  std::uint32_t pointOn(std::uint32_t a, std::uint32_t b) {
    const auto key = std::minmax(a, b);
    const auto next = static_cast<std::uint32_t>(mesh_.vertexCount() + split_.points.size());
    const auto [place, is_new] = points_.insert({key, next});
    if (is_new) {
      const double at_a = sides_.distance(key.first);
      const double at_b = sides_.distance(key.second);
      split_.points.push_back({key.first, key.second, at_a / (at_a - at_b)});
    }
    return place->second;
  }

  Loop withPoints(const Loop& loop) {
    Loop more;
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const std::uint32_t next = loop[(i + 1) % loop.size()];
      more.push_back(loop[i]);
      if (sign(loop[i]) * sign(next) < 0)
        more.push_back(pointOn(loop[i], next));
    }
    return more;
  }

  struct Crossing {
    std::uint32_t vertex;
    int towards;
  };
  /// Where a loop changes sides: of several vertices on the plane the nearest to it.
  std::vector<Crossing> crossingsOf(const Loop& loop) {
    std::vector<Crossing> crossings;
    const auto first =
        std::find_if(loop.begin(), loop.end(), [this](std::uint32_t v) { return sign(v) != 0; }) - loop.begin();
    if (static_cast<std::size_t>(first) == loop.size())
      return crossings;
    int side = sign(loop[static_cast<std::size_t>(first)]);
    std::int64_t nearest = -1;
    for (std::size_t n = 1; n <= loop.size(); ++n) {
      const std::uint32_t v = loop[(static_cast<std::size_t>(first) + n) % loop.size()];
      const int s = sign(v);
      if (s == 0) {
        if (nearest < 0 || farness(v) < farness(static_cast<std::uint32_t>(nearest)))
          nearest = v;
        continue;
      }
      if (s != side)
        crossings.push_back({static_cast<std::uint32_t>(nearest), s});
      side = s;
      nearest = -1;
    }
    return crossings;
  }

  void addLoop(std::uint32_t face, Loop loop, bool behind) {
    if (mesh_.faces()[face].pieces[0] != static_cast<std::int32_t>(piece_))
      std::reverse(loop.begin(), loop.end());
    (behind ? behind_ : front_).push_back(std::move(loop));
  }

  /// A dented neighbour may have an edge where the chord through a common face would be: it would not stay closed.
  bool hasEdge(std::int32_t neighbour, std::uint32_t a, std::uint32_t b) const {
    if (neighbour == CutMesh::kNone)
      return false;
    for (const std::uint32_t f : mesh_.pieces()[static_cast<std::size_t>(neighbour)].faces) {
      const Loop& loop = mesh_.faces()[f].loop;
      for (std::size_t i = 0; i < loop.size(); ++i) {
        const std::uint32_t next = loop[(i + 1) % loop.size()];
        if ((loop[i] == a && next == b) || (loop[i] == b && next == a))
          return true;
      }
    }
    return false;
  }

  bool addFace(std::uint32_t face) {
    const Loop loop = withPoints(mesh_.faces()[face].loop);
    const std::vector<Crossing> crossings = crossingsOf(loop);
    if (crossings.empty()) {
      addLoop(face, loop, std::any_of(loop.begin(), loop.end(), [this](std::uint32_t v) { return sign(v) < 0; }));
      return true;
    }
    if (crossings.size() != 2)
      return false;
    const bool down_first = crossings[0].towards < 0;
    const std::uint32_t from = crossings[down_first ? 0 : 1].vertex;
    const std::uint32_t to = crossings[down_first ? 1 : 0].vertex;
    if (hasEdge(mesh_.across(face, piece_), from, to))
      return false;
    split_.chords.push_back({face, from, to});
    addLoop(face, wayAround(loop, from, to), true);
    addLoop(face, wayAround(loop, to, from), false);
    return true;
  }

  /// The border of the faces behind, run through so that it closes them; empty when it is not one simple loop.
  Loop sectionLoop() const {
    using Edge = std::pair<std::uint32_t, std::uint32_t>;
    std::vector<Edge> edges;
    for (const Loop& loop : behind_) {
      for (std::size_t i = 0; i < loop.size(); ++i)
        edges.emplace_back(loop[i], loop[(i + 1) % loop.size()]);
    }
    std::sort(edges.begin(), edges.end());
    std::vector<Edge> border;
    for (const auto& [a, b] : edges) {
      if (!std::binary_search(edges.begin(), edges.end(), Edge(b, a)))
        border.emplace_back(b, a);
    }
    std::sort(border.begin(), border.end());
    const auto forks = [](const Edge& a, const Edge& b) { return a.first == b.first; };
    if (border.empty() || std::adjacent_find(border.begin(), border.end(), forks) != border.end())
      return {};
    Loop loop = {border[0].first};
    while (loop.size() <= border.size()) {
      const auto next = std::lower_bound(border.begin(), border.end(), Edge(loop.back(), 0));
      if (next == border.end() || next->first != loop.back())
        return {};
      if (next->second == loop[0])
        break;
      loop.push_back(next->second);
    }
    return loop.size() == border.size() ? loop : Loop();
  }

  /// One polygon where it is planar. Snapped vertices make it warped; then triangles, the same for both parts.
  bool addSection(const Loop& loop) {
    std::vector<Vector3> corners;
    Loop numbers;
    for (const std::uint32_t v : loop) {
      numbers.push_back(static_cast<std::uint32_t>(corners.size()));
      corners.push_back(place(v));
    }
    const Vector3 normal = areaVector(corners, numbers).normalized();
    double warp = 0.0;
    for (const Vector3& p : corners)
      warp = std::max(warp, std::abs(normal.dot(p - corners[0])));
    if (warp <= limits_.flat_m) {
      addFaceBetween(loop);
      return true;
    }
    // One that lies in a face of the piece would fold a part onto it.
    const auto is_allowed = [&](std::size_t i, std::size_t j, std::size_t k) {
      return !isInOneFace(loop[i], loop[j], loop[k]);
    };
    const PolygonTriangles best(corners, normal, is_allowed);
    if (best.leastAltitude() < limits_.flat_m)
      return false;
    for (const auto& t : best.triangles())
      addFaceBetween({loop[t[0]], loop[t[1]], loop[t[2]]});
    return true;
  }

  bool isInOneFace(std::uint32_t a, std::uint32_t b, std::uint32_t c) const {
    const auto has_all = [&](const Loop& loop) {
      const auto has = [&](std::uint32_t v) { return std::find(loop.begin(), loop.end(), v) != loop.end(); };
      return has(a) && has(b) && has(c);
    };
    return std::any_of(behind_.begin(), behind_.end(), has_all) || std::any_of(front_.begin(), front_.end(), has_all);
  }

  void addFaceBetween(const Loop& loop) {
    split_.section.push_back(loop);
    behind_.push_back(loop);
    front_.emplace_back(loop.rbegin(), loop.rend());
  }

  bool isGood(const std::vector<Loop>& loops) const {
    Polyhedron solid;
    Loop vertices;
    for (const Loop& loop : loops) {
      solid.loops.emplace_back();
      for (const std::uint32_t v : loop) {
        const auto number = std::find(vertices.begin(), vertices.end(), v) - vertices.begin();
        solid.loops.back().push_back(static_cast<std::uint32_t>(number));
        if (static_cast<std::size_t>(number) < vertices.size())
          continue;
        vertices.push_back(v);
        solid.points_m.push_back(place(v));
      }
    }
    const double least_area_m2 = kLeastArea * limits_.least_edge_m * limits_.least_edge_m;
    const bool flat = std::any_of(solid.loops.begin(), solid.loops.end(), [&](const Loop& loop) {
      return areaVector(solid.points_m, loop).norm() < least_area_m2;
    });
    if (flat || !isClosed(solid) || shortestEdge(solid) < limits_.least_edge_m || volumeOf(solid) <= 0.0 ||
        touchesOwnEdge(solid, kTouching * limits_.least_edge_m))
      return false;
    const double dent = deepestDent(solid);
    const double width = std::max(limits_.least_width_m, dent / kDentOfWidth);
    return dent <= limits_.deepest_dent_m && isWide(solid, width);
  }

  const CutMesh& mesh_;
  std::uint32_t piece_;
  PlaneSides& sides_;
  const ShapeLimits& limits_;
  PieceSplit split_;
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> points_;
  std::vector<Loop> behind_;
  std::vector<Loop> front_;
};

}  // namespace

std::vector<std::uint32_t> PlaneSides::snap(const std::vector<std::uint32_t>& vertices, double snap_m) {
  std::vector<std::uint32_t> snapped;
  for (const std::uint32_t v : vertices) {
    if (sign(v) == 0 || std::abs(distance(v)) > snap_m)
      continue;
    put_on_[v] = distance(v);
    snapped.push_back(v);
  }
  farthest_snap_m_ = std::max(farthest_snap_m_, snap_m);
  return snapped;
}

void PlaneSides::release(const std::vector<std::uint32_t>& vertices) {
  for (const std::uint32_t v : vertices)
    put_on_.erase(v);
}

std::optional<PieceSplit> planSplit(const CutMesh& mesh, std::uint32_t piece, PlaneSides& sides,
                                    const ShapeLimits& limits) {
  return SplitPlan(mesh, piece, sides, limits).make();
}

std::uint32_t applySplit(const PieceSplit& split, std::uint32_t piece, CutMesh& mesh, PlaneSides& sides,
                         std::vector<Vector3>& positions_m) {
  for (const CutMesh::Source& point : split.points) {
    sides.putOn(mesh.splitEdge(point.a, point.b, point.share));
    positions_m.push_back(positions_m[point.a] + point.share * (positions_m[point.b] - positions_m[point.a]));
  }
  for (const PieceSplit::Chord& chord : split.chords)
    mesh.splitFace(chord.face, chord.from, chord.to);
  std::vector<std::uint32_t> moved;
  for (const std::uint32_t f : mesh.pieces()[piece].faces) {
    const Loop& loop = mesh.faces()[f].loop;
    if (std::none_of(loop.begin(), loop.end(), [&](std::uint32_t v) { return sides.sign(v) < 0; }))
      moved.push_back(f);
  }
  return mesh.splitPiece(piece, moved, split.section);
}

}  // namespace soft_volume::core
