#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "drawn_grid.h"
#include "piece_mesh.h"
#include "soft_volume/render/renderer.h"
#include "transfer_integral.h"
#include "vertex_gradients.h"

namespace soft_volume::core {

/// Backend::kExact: for every pixel the faces of all cells in order, and between them the integral of emission and
/// absorption along the ray, attenuation within the cell included.
///
/// Geometry and interpolants are those of the isoparametric cells of VTK's documentation, without any approximation but
/// the stated tolerances: hexahedra and voxels trilinear with bilinear faces, wedges linear over their triangle and
/// along it, pyramids as hexahedra with one face drawn together, tetrahedra linear, polyhedra as PieceMesh says. Where
/// cells overlap, both absorb.
///
/// From one thread at a time. Nothing is drawn before grid, transfer function and, for a textured grid, volume are set.
class ExactTracer {
 public:
  /// Stays alive until the next call.
  void setGrid(const DrawnGrid& grid);
  /// Stays alive until the next call.
  void setVolume(const Volume& volume) { volume_ = &volume; }
  /// Null for none; stays alive until the next call.
  void setLabels(const Volume* labels) { labels_ = labels; }
  /// Throws SceneError when it is not valid.
  void setTransferFunction(const TransferFunction& function);

  /// Draws the pixels of `rect` into the frame, whose images have their sizes already, and counts its polygons and
  /// fragments. `positions`: per vertex, camera frame; `skip`: per cell, nonzero where it shows nothing. Slices, jitter
  /// and adaptive slicing have no meaning here.
  void draw(const Camera& camera, const RenderOptions& options, const std::vector<Vector3f>& positions,
            const std::vector<std::uint8_t>& skip, const PixelRect& rect, Frame& frame) const;

 private:
  struct Job;
  template <typename Medium>
  class TileDrawer;

  void drawTexture(const Job& job, Frame& frame) const;
  void drawPointScalars(const Job& job, Frame& frame) const;
  void drawCellScalars(const Job& job, Frame& frame) const;
  template <typename Medium>
  void drawTiles(const Job& job, const Medium& medium, Frame& frame) const;

  const DrawnGrid* grid_ = nullptr;
  const Volume* volume_ = nullptr;
  const Volume* labels_ = nullptr;
  std::unique_ptr<const TransferIntegral> function_;
  PieceMesh mesh_;
  VertexGradients gradients_;
};

}  // namespace soft_volume::core
