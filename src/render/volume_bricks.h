#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// Half-open.
struct VoxelBox {
  Vector3i begin = Vector3i::Zero();
  Vector3i end = Vector3i::Zero();
  Vector3i sizes() const { return end - begin; }
  bool operator==(const VoxelBox& other) const { return begin == other.begin && end == other.end; }
};

/// The part of the volume, and of the segmentation over the same box, that one texture each holds.
struct Brick {
  VoxelBox volume;
  VoxelBox labels;
  bool operator==(const Brick& other) const { return volume == other.volume && labels == other.labels; }
};

struct BrickLayout {
  std::vector<Brick> bricks;
  std::vector<std::uint32_t> brick_of_cell;  ///< empty where all cells are in the only brick
  int max_level = 0;                         ///< coarsest mipmap level that is right up to the bricks' borders
};

/// Shares out the cells of a grid, given by their boxes of texture coordinates {low, high}, to bricks of at most
/// `limit` (at least 16) voxels along each side. A volume that fits is one brick. Otherwise a brick reaches a margin of
/// a 32nd of the limit, at least 4 voxels, beyond its cells, for filtering, light and slabs that are thicker than a
/// cell. Boxes start and end at multiples of a power of two, so that bricks agree on the voxels of their mipmaps.
/// `label_dims` is zero where there is no segmentation. Throws InputError when a cell alone is too large.
BrickLayout layoutBricks(const std::vector<std::array<Vector3f, 2>>& cell_boxes, const Vector3i& volume_dims,
                         const Vector3i& label_dims, int limit);

}  // namespace soft_volume::core
