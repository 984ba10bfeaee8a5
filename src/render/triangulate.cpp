#include "soft_volume/render/slicer.h"

namespace soft_volume::core {
namespace {

constexpr int kMaxCorners = 12;

/// Twice the signed area of a triangle.
double cross(const LegacySliceVertex& a, const LegacySliceVertex& b, const LegacySliceVertex& c) {
  return (double(b.u) - a.u) * (double(c.v) - a.v) - (double(b.v) - a.v) * (double(c.u) - a.u);
}

double signedArea(const LegacySliceVertex* corners, int size) {
  double area = 0.0;
  for (int i = 2; i < size; ++i)
    area += cross(corners[0], corners[i - 1], corners[i]);
  return 0.5 * area;
}

bool isConvex(const LegacySliceVertex* corners, int size) {
  bool left = false;
  bool right = false;
  for (int i = 0; i < size; ++i) {
    const double turn = cross(corners[i], corners[(i + 1) % size], corners[(i + 2) % size]);
    left |= turn > 0.0;
    right |= turn < 0.0;
  }
  return !(left && right);
}

/// What is left of a polygon while its ears are clipped, as corner numbers in counter-clockwise order.
class Ears {
 public:
  Ears(const LegacySliceVertex* corners, int size) : corners_(corners), size_(size) {
    const bool reverse = signedArea(corners, size) < 0.0;
    for (int i = 0; i < size; ++i)
      left_[std::size_t(i)] = reverse ? size - 1 - i : i;
  }

  int size() const { return size_; }
  int at(int i) const { return left_[std::size_t((i + size_) % size_)]; }

  /// The corner whose triangle turns left and holds no other corner; 0 when the loop crosses itself and has none.
  int findEar() const {
    for (int i = 0; i < size_; ++i) {
      if (isEar(i))
        return i;
    }
    return 0;
  }

  void clip(int i) {
    for (int j = i + 1; j < size_; ++j)
      left_[std::size_t(j - 1)] = left_[std::size_t(j)];
    --size_;
  }

 private:
  bool isEar(int i) const {
    const LegacySliceVertex& a = corners_[at(i - 1)];
    const LegacySliceVertex& b = corners_[at(i)];
    const LegacySliceVertex& c = corners_[at(i + 1)];
    if (cross(a, b, c) <= 0.0)
      return false;
    for (int j = 2; j < size_ - 1; ++j) {
      const LegacySliceVertex& p = corners_[at(i + j)];
      if (cross(a, b, p) >= 0.0 && cross(b, c, p) >= 0.0 && cross(c, a, p) >= 0.0)
        return false;
    }
    return true;
  }

  const LegacySliceVertex* corners_;
  int size_;
  std::array<int, kMaxCorners> left_{};
};

void addTriangle(std::uint32_t first, int a, int b, int c, std::vector<std::uint32_t>& indices) {
  for (const int corner : {a, b, c})
    indices.push_back(first + std::uint32_t(corner));
}

}  // namespace

void triangulate(const LegacySliceVertex* corners, int size, std::uint32_t first, std::vector<std::uint32_t>& indices) {
  if (size == 3 || isConvex(corners, size)) {
    for (int i = 2; i < size; ++i)
      addTriangle(first, 0, i - 1, i, indices);
    return;
  }
  Ears ears(corners, size);
  while (ears.size() > 2) {
    const int ear = ears.findEar();
    addTriangle(first, ears.at(ear - 1), ears.at(ear), ears.at(ear + 1), indices);
    ears.clip(ear);
  }
}

}  // namespace soft_volume::core
