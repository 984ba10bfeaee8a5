#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "native_kernel.h"
#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// What bounds a set of points of the image: a rectangle whose corners are cut off diagonally.
class Octagon {
 public:
  void add(const Eigen::Vector2d& p) {
    x_.add(p.x());
    y_.add(p.y());
    sum_.add(p.x() + p.y());
    difference_.add(p.x() - p.y());
  }
  bool empty() const { return x_.low > x_.high; }
  Eigen::AlignedBox2d box() const { return {Eigen::Vector2d(x_.low, y_.low), Eigen::Vector2d(x_.high, y_.high)}; }
  /// The places of row y that are in it or at most `margin` away along each axis; none when the first is the larger.
  std::array<double, 2> row(double y, double margin) const {
    return {std::max({x_.low - margin, sum_.low - 2.0 * margin - y, difference_.low - 2.0 * margin + y}),
            std::min({x_.high + margin, sum_.high + 2.0 * margin - y, difference_.high + 2.0 * margin + y})};
  }

 private:
  struct Range {
    double low = std::numeric_limits<double>::max();
    double high = std::numeric_limits<double>::lowest();
    void add(double value) {
      low = std::min(low, value);
      high = std::max(high, value);
    }
  };
  Range x_, y_, sum_, difference_;
};

/// Which pixels of an image may differ from those of the last one, by blocks of kPixelLanes in a row. Two touches far
/// from each other leave what lies between them alone.
class ChangedPixels {
 public:
  /// Of an image of this size, none.
  void reset(int width, int height) {
    height_ = height;
    blocks_x_ = (width + kPixelLanes - 1) / kPixelLanes;
    blocks_.assign(std::size_t(blocks_x_) * std::size_t(height), 0);
  }

  /// All pixels in the octagon or within `margin` of it.
  void add(const Octagon& octagon, double margin) {
    const int begin_y = clamped(std::floor(octagon.box().min().y() - margin), height_);
    const int end_y = clamped(std::ceil(octagon.box().max().y() + margin) + 1.0, height_);
    for (int y = begin_y; y < end_y; ++y) {
      const std::array<double, 2> row = octagon.row(y, margin);
      const int begin = clamped(std::floor(row[0] / kPixelLanes), blocks_x_);
      const int end = clamped(std::floor(row[1] / kPixelLanes) + 1.0, blocks_x_);
      if (row[0] <= row[1] && begin < end)
        std::fill_n(blocks_.begin() + std::ptrdiff_t(indexOf(begin, y)), end - begin, std::uint8_t(1));
    }
  }

  /// The block of pixel (x, y), which may lie outside the image.
  bool has(int x, int y) const {
    return x >= 0 && y >= 0 && y < height_ && x / kPixelLanes < blocks_x_ && blocks_[indexOf(x / kPixelLanes, y)] != 0;
  }

 private:
  static int clamped(double place, int limit) { return int(std::clamp(place, 0.0, double(limit))); }
  std::size_t indexOf(int block, int y) const { return std::size_t(y) * std::size_t(blocks_x_) + std::size_t(block); }

  int height_ = 0;
  int blocks_x_ = 0;
  std::vector<std::uint8_t> blocks_;
};

}  // namespace soft_volume::core
