#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "canvas.h"
#include "native_kernel.h"
#include "soft_volume/grid/cell_shape.h"
#include "volume_texels.h"

namespace soft_volume::core {

/// Fills and composites slices on the processor, tile by tile: the polygons of a run of planes are filled with samples
/// (scalars, or places in the volume), then every pixel goes through its samples from front to back with its colour in
/// registers. Tiles are independent, so threads share nothing and the image does not depend on their number.
class NativeCanvas : public Canvas {
 public:
  explicit NativeCanvas(const NativeKernel& kernel = bestNativeKernel());
  ~NativeCanvas() override;

  void setVolume(const Volume& volume) override;
  void setLabels(const Volume* labels) override;
  void setTable(const TransferTable& table) override;
  void setGrid(const DrawnGrid& grid) override;
  void begin(const DrawJob& job) override;
  void draw(const SliceMesh& mesh) override;
  void finish(Frame& frame) override;
  std::string driver() const override;

 private:
  struct Tile;
  struct Scratch;
  struct ScreenFace;
  struct FaceCorner;

  SampleKind kind() const;
  void prepareTiles();
  bool isWanted(const Tile& tile, int block) const;
  void startTile(Tile& tile) const;
  void prepareJob();
  void prepareColours();
  void findVisibleBricks();
  void prepareMipmap();
  template <typename Texel>
  void makeMipmap(const Texel* texels);
  void prepareValues(const SliceMesh& mesh);
  int apron() const;
  void binPolygons(const SliceMesh& mesh, std::size_t first_slice, std::size_t end_slice);
  void drawRun(const SliceMesh& mesh, std::size_t first_slice, std::size_t end_slice, bool last);
  void drawTile(const SliceMesh& mesh, Tile& tile, const std::uint32_t* polygons, std::size_t count,
                std::size_t first_slice, std::size_t end_slice, bool last, Scratch& scratch) const;
  void fillPolygon(const SliceMesh& mesh, std::uint32_t polygon, const FillTarget& target, Scratch& scratch) const;
  bool isTrilinear(const std::array<float, 8>& coefficients) const;
  void setTrilinearCorners(const SliceMesh& mesh, const SlicePolygon& polygon, FillCorner* corners) const;
  FillCorner cornerAt(const SliceMesh& mesh, const SlicePolygon& polygon, std::size_t corner) const;
  void composite(Tile& tile, CompositeJob& job, const Scratch& scratch) const;
  void setWindow(const Tile& tile, FillTarget& target) const;
  void copyTile(Tile& tile, Frame& frame) const;
  void valuesAtVertex(std::uint32_t vertex, float* values) const;
  std::size_t tileCount() const { return std::size_t(tiles_x_) * std::size_t(tiles_y_); }

  // native_boundary.cpp
  void findBoundary();
  void prepareEvents();
  void addScreenFaces(const GridFace& face, std::vector<ScreenFace>& faces) const;
  FaceCorner faceCorner(std::uint32_t vertex, std::uint32_t cell) const;
  void addScreenTriangle(const std::array<FaceCorner, 3>& triangle, const Vector3f& cell_centre,
                         std::vector<ScreenFace>& faces) const;
  FillCorner screenCorner(const Vector3f& position, const float* values) const;
  void placeEvents(Tile& tile, const std::vector<ScreenFace>& faces, const std::uint32_t* numbers, std::size_t count,
                   Scratch& scratch) const;

  const NativeKernel& kernel_;
  const DrawnGrid* grid_ = nullptr;
  const TransferTable* table_ = nullptr;
  std::optional<VolumeTexels> texels_;
  std::vector<std::uint8_t> padded_texels_;  ///< where the volume is one voxel thin
  TexelView volume_view_{};
  std::vector<TexelView> mipmap_;  ///< of volume_view_ but the finest level; empty until a frame needs it
  std::vector<std::vector<std::uint8_t>> mipmap_texels_;
  std::optional<Matrix3> texture_per_m_;  ///< mean over the grid at rest, as pixelWidth() takes it; made when needed
  VolumeGeometry volume_geometry_;
  std::vector<std::uint16_t> labels_;
  LabelView label_view_{};
  std::vector<std::array<float, 2>> brick_ranges_;  ///< smallest and largest scalar of every brick
  std::array<int, 3> bricks_{};
  std::vector<std::uint8_t> brick_visible_;   ///< as TexelView::visible; empty when the table has changed since
  std::vector<std::uint8_t> around_visible_;  ///< the same, and the bricks around them
  std::vector<float> colours_;                ///< per vertex or cell of the grid, four each: kColour
  std::vector<GridFace> boundary_;            ///< of the cells that are drawn
  std::vector<std::uint8_t> boundary_skip_;   ///< what boundary_ was made for
  bool boundary_known_ = false;

  // Of the image that is drawn.
  const DrawJob* job_ = nullptr;
  SampleKind kind_ = SampleKind::kScalar;
  CompositeJob base_{};  ///< what all tiles share
  int threads_ = 1;
  int first_tile_x_ = 0, first_tile_y_ = 0, tiles_x_ = 0, tiles_y_ = 0;
  std::vector<Tile> tiles_;
  std::vector<Scratch> scratch_;                            ///< per thread
  std::vector<float> values_;                               ///< per vertex of the mesh
  std::vector<std::array<std::int16_t, 4>> polygon_tiles_;  ///< per polygon of the run: tiles it touches
  std::vector<std::uint32_t> bin_begin_, bin_next_, bins_;
  std::size_t polygons_ = 0;
  int slices_ = 0;
};

}  // namespace soft_volume::core
