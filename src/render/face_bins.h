#pragma once

#include <cstdint>
#include <vector>

#include "piece_mesh.h"
#include "soft_volume/render/camera.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {

/// The faces that may be seen in each tile of a rectangle of pixels, nearest first.
class FaceBins {
 public:
  static constexpr int kTile = 16;  ///< pixels

  /// `positions`: per vertex of the mesh, camera frame; `hidden`: per cell. Faces between hidden cells are left out, as
  /// are those that lie in front of the near plane.
  FaceBins(const PieceMesh& mesh, const std::vector<Vector3>& positions, const std::vector<std::uint8_t>& hidden,
           const Camera& camera, const PixelRect& rect, int threads);

  struct Entry {
    std::uint32_t face;
    bool may_fold;     ///< it may cover itself
    PixelRect pixels;  ///< outside of these it is not seen
  };

  std::size_t tileCount() const { return std::size_t(columns_) * std::size_t(rows_); }
  PixelRect tile(std::size_t index) const;
  /// Indices of a tile's entries.
  const std::uint32_t* begin(std::size_t tile) const { return order_.data() + tile_begin_[tile]; }
  const std::uint32_t* end(std::size_t tile) const { return order_.data() + tile_begin_[tile + 1]; }
  const Entry& entry(std::uint32_t index) const { return entries_[index]; }
  /// Faces that reach into the rectangle.
  std::size_t faceCount() const { return entries_.size(); }

 private:
  template <typename Visit>
  void forTiles(const PixelRect& pixels, const Visit& visit) const;
  void fill();

  PixelRect rect_;
  int columns_ = 0;
  int rows_ = 0;
  std::vector<Entry> entries_;  ///< nearest first
  std::vector<std::size_t> tile_begin_;
  std::vector<std::uint32_t> order_;
};

}  // namespace soft_volume::core
