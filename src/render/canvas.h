#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "changed_pixels.h"
#include "drawn_grid.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/render/renderer.h"
#include "soft_volume/render/slice_mesh.h"
#include "soft_volume/render/slice_planes.h"
#include "transfer_table.h"

namespace soft_volume::core {

/// One image to draw.
struct DrawJob {
  const Camera& camera;
  const RenderOptions& options;
  const std::vector<Vector3f>& positions;  ///< per vertex, camera frame
  const std::vector<std::uint8_t>& skip;   ///< per cell, nonzero where it shows nothing
  PixelRect rect;                          ///< only these pixels are drawn
  SlicePlanes planes;                      ///< all but the extra ones
  bool cross_section;                      ///< one slice, colours without transparency
  const ChangedPixels* changed = nullptr;  ///< pixels of the rectangle that need be drawn; null for all
};

/// On which rung of the planes' ladder a slice lies; of an extra one, a rung beside it.
inline double rungOf(const SlicePlanes& planes, const Slice& slice) {
  return std::round((double(slice.z_m) - planes.anchor_m) / planes.distance_m - 0.5);
}

/// What fills and composites the polygons of slices. Renderer calls setGrid, setTable and, for a textured grid,
/// setVolume at least once, then for each frame begin, draw for one or more consecutive runs of planes from front to
/// back, and finish. Throws as Renderer says.
class Canvas {
 public:
  virtual ~Canvas() = default;
  virtual void setVolume(const Volume& volume) = 0;  ///< stays alive until the next call
  virtual void setLabels(const Volume* labels) = 0;  ///< null for none; stays alive until the next call
  virtual void setTable(const TransferTable& table) = 0;
  virtual void setGrid(const DrawnGrid& grid) = 0;  ///< stays alive until the next call
  virtual void begin(const DrawJob& job) = 0;       ///< what the job refers to stays alive until finish()
  /// The mesh is needed only during the call. Behind its last extra plane a plane follows, unless it is the frame's
  /// last.
  virtual void draw(const SliceMesh& mesh) = 0;
  /// Writes the pixels of the job's rectangle into the frame, whose images have their sizes already, and counts. Those
  /// that did not change may be written again or be left.
  virtual void finish(Frame& frame) = 0;
  virtual std::string driver() const = 0;
  /// Threads that may slice for it; `wanted` as in RenderOptions.
  virtual int slicingThreads(int wanted) const { return threadsFor(wanted); }
};

}  // namespace soft_volume::core
