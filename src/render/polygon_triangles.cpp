#include "polygon_triangles.h"

#include <algorithm>
#include <numeric>

namespace soft_volume::core {
namespace {

/// The corners of one polygon in the image.
class Corners {
 public:
  Corners(const SliceMesh& mesh, const SlicePolygon& polygon)
      : vertices_(mesh.vertices.data()), corners_(&mesh.corners[polygon.first]), size_(polygon.size) {}
  std::uint32_t size() const { return size_; }
  const SliceVertex& operator[](std::uint32_t i) const { return vertices_[corners_[i]]; }

 private:
  const SliceVertex* vertices_;
  const std::uint32_t* corners_;
  std::uint32_t size_;
};

/// Twice the signed area of a triangle.
double cross(const SliceVertex& a, const SliceVertex& b, const SliceVertex& c) {
  return (double(b.u) - a.u) * (double(c.v) - a.v) - (double(b.v) - a.v) * (double(c.u) - a.u);
}

bool isConvex(const Corners& corners) {
  bool left = false;
  bool right = false;
  const std::uint32_t size = corners.size();
  const SliceVertex* a = &corners[size - 2];
  const SliceVertex* b = &corners[size - 1];
  for (std::uint32_t i = 0; i < size; ++i) {
    const SliceVertex* c = &corners[i];
    const double turn = cross(*a, *b, *c);
    left |= turn > 0.0;
    right |= turn < 0.0;
    a = b;
    b = c;
  }
  return !(left && right);
}

double signedArea(const Corners& corners) {
  double area = 0.0;
  for (std::uint32_t i = 2; i < corners.size(); ++i)
    area += cross(corners[0], corners[i - 1], corners[i]);
  return 0.5 * area;
}

/// What is left of a polygon while its ears are clipped, as places in counter-clockwise order.
class Ears {
 public:
  explicit Ears(const Corners& corners) : corners_(corners), left_(corners.size()) {
    std::iota(left_.begin(), left_.end(), 0U);
    if (signedArea(corners) < 0.0)
      std::reverse(left_.begin(), left_.end());
  }

  std::size_t size() const { return left_.size(); }
  std::uint32_t at(std::size_t i) const { return left_[i % left_.size()]; }

  /// The corner whose triangle turns left and holds no other corner; 0 when the loop crosses itself and has none.
  std::size_t findEar() const {
    for (std::size_t i = 0; i < size(); ++i) {
      if (isEar(i))
        return i;
    }
    return 0;
  }

  void clip(std::size_t i) { left_.erase(left_.begin() + std::ptrdiff_t(i)); }

 private:
  bool isEar(std::size_t i) const {
    const SliceVertex& a = corners_[at(i + size() - 1)];
    const SliceVertex& b = corners_[at(i)];
    const SliceVertex& c = corners_[at(i + 1)];
    if (cross(a, b, c) <= 0.0)
      return false;
    for (std::size_t j = 2; j < size() - 1; ++j) {
      const SliceVertex& p = corners_[at(i + j)];
      if (cross(a, b, p) >= 0.0 && cross(b, c, p) >= 0.0 && cross(c, a, p) >= 0.0)
        return false;
    }
    return true;
  }

  const Corners& corners_;
  std::vector<std::uint32_t> left_;
};

}  // namespace

void triangulate(const SliceMesh& mesh, const SlicePolygon& polygon, std::uint32_t tip, std::uint32_t* triangles) {
  const Corners corners(mesh, polygon);
  if (corners.size() == 3 || isConvex(corners)) {
    const auto place = [&](std::uint32_t i) { return i < corners.size() ? i : i - corners.size(); };
    for (std::uint32_t i = 2; i < corners.size(); ++i) {
      *triangles++ = tip;
      *triangles++ = place(tip + i - 1);
      *triangles++ = place(tip + i);
    }
    return;
  }
  Ears ears(corners);
  while (ears.size() > 2) {
    const std::size_t ear = ears.findEar();
    for (const std::size_t i : {ear + ears.size() - 1, ear, ear + 1})
      *triangles++ = ears.at(i);
    ears.clip(ear);
  }
}

}  // namespace soft_volume::core
