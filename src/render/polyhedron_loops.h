#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "soft_volume/render/slice_mesh.h"

namespace soft_volume::core {

/// Closes the loops of a plane through one polyhedron from the segments that the plane leaves on its faces. Buffers are
/// kept between cells.
///
/// Each face is decided alone, alike by both cells at it. A face of four corners follows the rule of the slice tables.
/// Where the plane leaves several segments on a larger face, which then is not convex, the cut edges are paired in the
/// order in which they lie along the plane's line through the face; if the face is so warped that such pairs do not
/// lead from where it is left to where it is entered, the rule of the slice tables decides.
class PolyhedronLoops {
 public:
  void begin(const std::vector<SliceVertex>& vertices);
  /// A face is walked around side by side; addCut is for a side that the plane cuts at `vertex`: it leaves the positive
  /// side or enters it.
  void beginFace(std::size_t corners);
  void addCut(std::uint32_t vertex, bool leaves) { cuts_.push_back({vertex, leaves}); }
  void endFace();
  /// Makes the loops: each has three corners or more, and none lies in a hole of another.
  void finish();

  std::size_t loopCount() const { return loop_begin_.size() - 1; }
  std::size_t loopSize(std::size_t loop) const { return loop_begin_[loop + 1] - loop_begin_[loop]; }
  const std::uint32_t* loop(std::size_t loop) const { return corners_.data() + loop_begin_[loop]; }

 private:
  struct Cut {
    std::uint32_t vertex;
    bool leaves;
  };
  struct Segment {
    std::uint32_t from;
    std::uint32_t to;
    bool used;
  };

  void sortAlongLine();
  bool pairSorted();
  void pairRuns();
  Segment* unusedFrom(std::uint32_t vertex);
  void walkFrom(Segment& start);
  void splitHoles();

  const std::vector<SliceVertex>* vertices_ = nullptr;
  std::size_t face_corners_ = 0;
  std::vector<Cut> cuts_;  ///< of the face
  std::vector<Cut> sorted_;
  std::vector<Segment> segments_;
  std::vector<std::uint32_t> corners_;
  std::vector<std::size_t> loop_begin_;
};

}  // namespace soft_volume::core
