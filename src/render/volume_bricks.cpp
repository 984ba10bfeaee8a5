#include "volume_bricks.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

using TextureBox = std::array<Vector3f, 2>;
using Cells = std::vector<std::uint32_t>;

class Layout {
 public:
  Layout(const std::vector<TextureBox>& boxes, const Vector3i& volume_dims, const Vector3i& label_dims, int limit)
      : boxes_(boxes),
        volume_dims_(volume_dims),
        label_dims_(label_dims),
        limit_(limit),
        margin_(std::max(4, limit / 32)),
        level_(int(std::log2(margin_))) {}

  BrickLayout make() {
    if (fits({Vector3i::Zero(), volume_dims_}) && fits({Vector3i::Zero(), label_dims_})) {
      layout_.bricks = {{{Vector3i::Zero(), volume_dims_}, {Vector3i::Zero(), label_dims_}}};
      layout_.max_level = 31;
      return layout_;
    }
    layout_.brick_of_cell.resize(boxes_.size());
    layout_.max_level = level_;
    Cells all(boxes_.size());
    std::iota(all.begin(), all.end(), 0U);
    if (!all.empty())
      place(std::move(all));
    return layout_;
  }

 private:
  bool fits(const VoxelBox& box) const { return box.sizes().maxCoeff() <= limit_; }

  /// The voxels around a box of texture coordinates.
  VoxelBox voxels(const TextureBox& box, const Vector3i& dims) const {
    const int grain = 1 << level_;
    VoxelBox result;
    for (int axis = 0; axis < 3; ++axis) {
      const double low = std::clamp(std::floor(double(box[0][axis]) * dims[axis]), 0.0, double(dims[axis]));
      const double high = std::clamp(std::ceil(double(box[1][axis]) * dims[axis]), 0.0, double(dims[axis]));
      result.begin[axis] = std::max(0, int(low) - margin_) / grain * grain;
      result.end[axis] = std::min(dims[axis], (int(high) + margin_ + grain - 1) / grain * grain);
    }
    return result;
  }

  TextureBox boxAround(const Cells& cells) const {
    Eigen::AlignedBox3f box;
    for (const std::uint32_t cell : cells)
      box.extend(boxes_[cell][0]).extend(boxes_[cell][1]);
    return {box.min(), box.max()};
  }

  /// Makes a brick of the cells, or of each half of them.
  void place(Cells cells) {
    const TextureBox box = boxAround(cells);
    const Brick brick = {voxels(box, volume_dims_), voxels(box, label_dims_)};
    if (fits(brick.volume) && fits(brick.labels)) {
      for (const std::uint32_t cell : cells)
        layout_.brick_of_cell[cell] = std::uint32_t(layout_.bricks.size());
      layout_.bricks.push_back(brick);
      return;
    }
    if (cells.size() == 1)
      refuse(brick);
    Eigen::Index axis = 0;
    (box[1] - box[0]).cwiseProduct(volume_dims_.cast<float>()).maxCoeff(&axis);
    const auto centre = [&](std::uint32_t cell) { return boxes_[cell][0][axis] + boxes_[cell][1][axis]; };
    const auto middle = cells.begin() + std::ptrdiff_t(cells.size() / 2);
    std::nth_element(cells.begin(), middle, cells.end(), [&](std::uint32_t a, std::uint32_t b) {
      return centre(a) != centre(b) ? centre(a) < centre(b) : a < b;
    });
    place(Cells(cells.begin(), middle));
    place(Cells(middle, cells.end()));
  }

  [[noreturn]] void refuse(const Brick& brick) const {
    const int needed = std::max(brick.volume.sizes().maxCoeff(), brick.labels.sizes().maxCoeff());
    throw InputError("a cell needs a texture of " + std::to_string(needed) +
                     " voxels along one side, its margins included, and the driver takes " + std::to_string(limit_) +
                     "; cut the grid into smaller cells, or read the volume with a stride or a region of interest");
  }

  const std::vector<TextureBox>& boxes_;
  const Vector3i volume_dims_;
  const Vector3i label_dims_;
  const int limit_;
  const int margin_;
  const int level_;  ///< boxes are multiples of 2^level_ voxels
  BrickLayout layout_;
};

}  // namespace

BrickLayout layoutBricks(const std::vector<TextureBox>& cell_boxes, const Vector3i& volume_dims,
                         const Vector3i& label_dims, int limit) {
  return Layout(cell_boxes, volume_dims, label_dims, limit).make();
}

}  // namespace soft_volume::core
