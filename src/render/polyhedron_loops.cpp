#include "polyhedron_loops.h"

#include <algorithm>
#include <limits>

#include "loop_holes.h"

namespace soft_volume::core {

void PolyhedronLoops::begin(const std::vector<SliceVertex>& vertices) {
  vertices_ = &vertices;
  segments_.clear();
  corners_.clear();
  loop_begin_.assign(1, 0);
}

void PolyhedronLoops::beginFace(std::size_t corners) {
  face_corners_ = corners;
  cuts_.clear();
}

void PolyhedronLoops::endFace() {
  if (cuts_.size() <= 2 || face_corners_ == 4) {
    pairRuns();
    return;
  }
  sortAlongLine();
  if (!pairSorted())
    pairRuns();
}

/// From where a run of positive corners is left to where it was entered.
void PolyhedronLoops::pairRuns() {
  for (std::size_t i = 0; i < cuts_.size(); ++i) {
    if (cuts_[i].leaves)
      segments_.push_back({cuts_[i].vertex, cuts_[(i + cuts_.size() - 1) % cuts_.size()].vertex, false});
  }
}

/// Along u or v, whichever the cut edges span more of. Both cells at the face get the same order.
void PolyhedronLoops::sortAlongLine() {
  float low_u = std::numeric_limits<float>::max(), high_u = std::numeric_limits<float>::lowest();
  float low_v = low_u, high_v = high_u;
  for (const Cut& cut : cuts_) {
    const SliceVertex& vertex = (*vertices_)[cut.vertex];
    low_u = std::min(low_u, vertex.u);
    high_u = std::max(high_u, vertex.u);
    low_v = std::min(low_v, vertex.v);
    high_v = std::max(high_v, vertex.v);
  }
  const bool along_u = high_u - low_u >= high_v - low_v;
  const auto place = [&](const Cut& cut) {
    const SliceVertex& vertex = (*vertices_)[cut.vertex];
    return along_u ? vertex.u : vertex.v;
  };
  sorted_ = cuts_;
  std::sort(sorted_.begin(), sorted_.end(), [&](const Cut& a, const Cut& b) {
    return place(a) != place(b) ? place(a) < place(b) : a.vertex < b.vertex;
  });
}

bool PolyhedronLoops::pairSorted() {
  for (std::size_t i = 0; i < sorted_.size(); i += 2) {
    if (sorted_[i].leaves == sorted_[i + 1].leaves)
      return false;
  }
  for (std::size_t i = 0; i < sorted_.size(); i += 2) {
    const std::size_t from = sorted_[i].leaves ? i : i + 1;
    segments_.push_back({sorted_[from].vertex, sorted_[from == i ? i + 1 : i].vertex, false});
  }
  return true;
}

PolyhedronLoops::Segment* PolyhedronLoops::unusedFrom(std::uint32_t vertex) {
  auto segment = std::lower_bound(segments_.begin(), segments_.end(), vertex,
                                  [](const Segment& s, std::uint32_t v) { return s.from < v; });
  while (segment != segments_.end() && segment->from == vertex && segment->used)
    ++segment;
  return segment != segments_.end() && segment->from == vertex ? &*segment : nullptr;
}

/// Faces that do not close the polyhedron leave a loop open; it is closed by a straight line.
void PolyhedronLoops::walkFrom(Segment& start) {
  for (Segment* segment = &start; segment != nullptr; segment = unusedFrom(segment->to)) {
    segment->used = true;
    corners_.push_back(segment->from);
    if (segment->to == start.from)
      break;
  }
  if (corners_.size() - loop_begin_.back() >= 3)
    loop_begin_.push_back(corners_.size());
  else
    corners_.resize(loop_begin_.back());
}

void PolyhedronLoops::finish() {
  std::sort(segments_.begin(), segments_.end(),
            [](const Segment& a, const Segment& b) { return a.from != b.from ? a.from < b.from : a.to < b.to; });
  for (Segment& segment : segments_) {
    if (!segment.used)
      walkFrom(segment);
  }
  if (loopCount() > 1)
    splitHoles();
}

void PolyhedronLoops::splitHoles() {
  Loops loops;
  for (std::size_t i = 0; i < loopCount(); ++i)
    loops.emplace_back(loop(i), loop(i) + loopSize(i));
  splitAtHoles(*vertices_, loops);
  corners_.clear();
  loop_begin_.assign(1, 0);
  for (const auto& loop : loops) {
    corners_.insert(corners_.end(), loop.begin(), loop.end());
    loop_begin_.push_back(corners_.size());
  }
}

}  // namespace soft_volume::core
