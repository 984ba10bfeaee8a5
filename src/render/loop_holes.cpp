#include "loop_holes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace soft_volume::core {
namespace {

using Loop = std::vector<std::uint32_t>;

/// Places in an outer loop and in a hole.
struct Bridge {
  std::size_t outer;
  std::size_t hole;
};

class HoleSplitter {
 public:
  explicit HoleSplitter(const std::vector<SliceVertex>& vertices) : vertices_(vertices) {}

  void split(Loops& loops) {
    sortByTurn(loops);
    loops.clear();
    while (!holes_.empty()) {
      const Loop hole = std::move(holes_.back());
      holes_.pop_back();
      if (!merge(hole))
        loops.push_back(hole);
    }
    loops.insert(loops.end(), outers_.begin(), outers_.end());
  }

 private:
  const SliceVertex& at(std::uint32_t vertex) const { return vertices_[vertex]; }

  bool areSame(std::uint32_t a, std::uint32_t b) const { return at(a).u == at(b).u && at(a).v == at(b).v; }

  /// Twice the signed area of a triangle.
  double cross(std::uint32_t a, std::uint32_t b, std::uint32_t c) const {
    return (double(at(b).u) - at(a).u) * (double(at(c).v) - at(a).v) -
           (double(at(b).v) - at(a).v) * (double(at(c).u) - at(a).u);
  }
  double areaOf(const Loop& loop) const {
    double area = 0.0;
    for (std::size_t i = 2; i < loop.size(); ++i)
      area += cross(loop[0], loop[i - 1], loop[i]);
    return area;
  }

  /// What runs around the cell encloses more than the holes in it do.
  void sortByTurn(const Loops& loops) {
    double whole = 0.0;
    for (const Loop& loop : loops)
      whole += areaOf(loop);
    for (const Loop& loop : loops)
      (areaOf(loop) * whole < 0.0 ? holes_ : outers_).push_back(loop);
  }

  bool isInside(double u, double v, const Loop& loop) const {
    bool inside = false;
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const SliceVertex& a = at(loop[i]);
      const SliceVertex& b = at(loop[(i + 1) % loop.size()]);
      if ((a.v > v) != (b.v > v) && u < (double(b.u) - a.u) * (v - a.v) / (double(b.v) - a.v) + a.u)
        inside = !inside;
    }
    return inside;
  }

  /// The loops may touch where the plane goes through a vertex, so the majority of the hole's vertices decides.
  bool isAround(const Loop& outer, const Loop& hole) const {
    const auto inside = std::count_if(
        hole.begin(), hole.end(), [&](std::uint32_t vertex) { return isInside(at(vertex).u, at(vertex).v, outer); });
    return 2 * std::size_t(inside) > hole.size();
  }

  /// Joins the hole to the smallest loop around it.
  bool merge(const Loop& hole) {
    const Loop* smallest = nullptr;
    for (const Loop& outer : outers_) {
      if (isAround(outer, hole) && (smallest == nullptr || std::abs(areaOf(outer)) < std::abs(areaOf(*smallest)))) {
        smallest = &outer;
      }
    }
    std::array<Bridge, 2> bridges{};
    if (smallest == nullptr || !findBridges(*smallest, hole, bridges))
      return false;
    const Loop outer = *smallest;
    outers_.erase(outers_.begin() + (smallest - outers_.data()));
    outers_.push_back(halfBetween(outer, hole, bridges[0], bridges[1]));
    outers_.push_back(halfBetween(outer, hole, bridges[1], bridges[0]));
    return true;
  }

  static void appendPath(const Loop& loop, std::size_t from, std::size_t to, Loop& path) {
    for (std::size_t i = from; i != to; i = (i + 1) % loop.size())
      path.push_back(loop[i]);
    path.push_back(loop[to]);
  }

  /// Along the outer loop from one bridge to the other, and back along the hole.
  static Loop halfBetween(const Loop& outer, const Loop& hole, const Bridge& from, const Bridge& to) {
    Loop half;
    appendPath(outer, from.outer, to.outer, half);
    appendPath(hole, to.hole, from.hole, half);
    return half;
  }

  bool findBridges(const Loop& outer, const Loop& hole, std::array<Bridge, 2>& bridges) const {
    std::size_t found = 0;
    for (const Bridge& bridge : bridgesByLength(outer, hole)) {
      const std::uint32_t a = outer[bridge.outer];
      const std::uint32_t b = hole[bridge.hole];
      if (!isFree(a, b, outer, hole))
        continue;
      const Bridge& first = bridges[0];
      if (found == 1 && (first.outer == bridge.outer || first.hole == bridge.hole ||
                         touch(outer[first.outer], hole[first.hole], a, b))) {
        continue;
      }
      bridges[found++] = bridge;
      if (found == 2)
        return true;
    }
    return false;
  }

  std::vector<Bridge> bridgesByLength(const Loop& outer, const Loop& hole) const {
    std::vector<Bridge> all;
    for (std::size_t o = 0; o < outer.size(); ++o) {
      for (std::size_t h = 0; h < hole.size(); ++h)
        all.push_back({o, h});
    }
    const auto length = [&](const Bridge& bridge) {
      const SliceVertex& a = at(outer[bridge.outer]);
      const SliceVertex& b = at(hole[bridge.hole]);
      return std::hypot(double(b.u) - a.u, double(b.v) - a.v);
    };
    std::stable_sort(all.begin(), all.end(), [&](const Bridge& l, const Bridge& r) { return length(l) < length(r); });
    return all;
  }

  /// Whether the bridge from a to b runs through the cell and meets no loop but at its ends. It may have no length.
  bool isFree(std::uint32_t a, std::uint32_t b, const Loop& outer, const Loop& hole) const {
    if (areSame(a, b))
      return true;
    const double u = 0.5 * (double(at(a).u) + at(b).u);
    const double v = 0.5 * (double(at(a).v) + at(b).v);
    if (!isInside(u, v, outer) || isInside(u, v, hole) || meets(a, b, outer) || meets(a, b, hole))
      return false;
    return std::none_of(holes_.begin(), holes_.end(),
                        [&](const Loop& other) { return isInside(u, v, other) || meets(a, b, other); });
  }

  bool meets(std::uint32_t a, std::uint32_t b, const Loop& loop) const {
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const std::uint32_t c = loop[i];
      const std::uint32_t d = loop[(i + 1) % loop.size()];
      if (c != a && c != b && d != a && d != b && touch(a, b, c, d))
        return true;
    }
    return false;
  }

  /// Whether the ranges from a to b and from c to d have no number in common.
  static bool areApart(float a, float b, float c, float d) {
    return std::max(a, b) < std::min(c, d) || std::max(c, d) < std::min(a, b);
  }

  /// Whether the lines from a to b and from c to d have a point in common.
  bool touch(std::uint32_t a, std::uint32_t b, std::uint32_t c, std::uint32_t d) const {
    if (areApart(at(a).u, at(b).u, at(c).u, at(d).u) || areApart(at(a).v, at(b).v, at(c).v, at(d).v))
      return false;
    const double c_side = cross(a, b, c);
    const double d_side = cross(a, b, d);
    const double a_side = cross(c, d, a);
    const double b_side = cross(c, d, b);
    return c_side * d_side <= 0.0 && a_side * b_side <= 0.0;
  }

  const std::vector<SliceVertex>& vertices_;
  Loops outers_;
  Loops holes_;
};

}  // namespace

void splitAtHoles(const std::vector<SliceVertex>& vertices, Loops& loops) {
  HoleSplitter(vertices).split(loops);
}

}  // namespace soft_volume::core
