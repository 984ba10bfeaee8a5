#pragma once

#include <algorithm>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "canvas.h"
#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/render/grid_slicer.h"
#include "soft_volume/volume/transfer_function.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

inline DrawnGrid drawnGrid(const Topology& topology) {
  DrawnGrid grid;
  grid.cell_types = topology.cell_types;
  grid.cell_offsets = topology.cell_offsets;
  grid.connectivity = topology.connectivity;
  grid.rest_positions = topology.rest_positions;
  grid.texture = topology.texture_coordinates;
  return grid;
}

inline DrawnGrid drawnGrid(const IrregularGrid& irregular) {
  DrawnGrid grid;
  grid.cell_types = irregular.cell_types;
  grid.cell_offsets = irregular.cell_offsets;
  grid.connectivity = irregular.connectivity;
  grid.rest_positions = irregular.points;
  grid.point_scalars = irregular.point_scalars;
  grid.cell_scalars = irregular.cell_scalars;
  return grid;
}

inline PixelRect wholeImage(const Camera& camera) {
  return {0, 0, camera.width, camera.height};
}

inline const float* pixelOf(const Frame& frame, int u, int v) {
  return &frame.rgba[4 * (std::size_t(v) * std::size_t(frame.width) + std::size_t(u))];
}

/// A canvas with a grid, a slicer and the steps between them, without the renderer's choices: everything is drawn, on
/// planes over the depth of the grid at rest.
class CanvasScene {
 public:
  CanvasScene(std::unique_ptr<Canvas> canvas, DrawnGrid grid, const TransferFunction& function)
      : grid_(std::move(grid)), table_(function), canvas_(std::move(canvas)) {
    canvas_->setTable(table_);
    canvas_->setGrid(grid_);
    slicer_.setCells(grid_.cell_types, grid_.cell_offsets, grid_.connectivity, grid_.vertexCount());
  }
  CanvasScene(std::unique_ptr<Canvas> canvas, const Topology& topology, std::shared_ptr<const Volume> volume,
              const TransferFunction& function)
      : CanvasScene(std::move(canvas), drawnGrid(topology), function) {
    setVolume(std::move(volume));
  }

  void setVolume(std::shared_ptr<const Volume> volume) {
    canvas_->setVolume(*volume);
    volume_ = std::move(volume);
  }
  void setLabels(std::shared_ptr<const Volume> labels) {
    canvas_->setLabels(labels.get());
    labels_ = std::move(labels);
  }

  const std::vector<Vector3f>& rest() const { return grid_.rest_positions; }
  Canvas& canvas() { return *canvas_; }
  SliceMesh& mesh() { return mesh_; }

  Frame render(const Camera& camera, const RenderOptions& options) { return render(camera, rest(), options); }
  Frame render(const Camera& camera, const std::vector<Vector3f>& positions, const RenderOptions& options) {
    Frame frame = blankFrame(camera, options);
    renderInto(frame, camera, positions, options, wholeImage(camera));
    return frame;
  }

  /// Draws a rectangle into a frame that has the camera's size, in runs of `run` planes.
  void renderInto(Frame& frame, const Camera& camera, const std::vector<Vector3f>& positions,
                  const RenderOptions& options, const PixelRect& rect, int run = 4096) {
    const SlicePlanes planes = choosePlanes(camera, positions, options);
    if (planes.count == 0)
      return;
    const int threads = std::max(1, options.threads);
    slicer_.bucket(camera, planes, skip_, rect, options.adaptive, threads);
    const DrawJob job{camera, options, slicer_.positions(), skip_, rect, planes, false};
    canvas_->begin(job);
    for (int plane = 0, end = 0; plane < slicer_.planeCount(); plane = end) {
      end = std::min(plane + run, slicer_.planeCount());
      while (end < slicer_.planeCount() && slicer_.isExtra(end - 1))
        ++end;
      slicer_.slice(plane, end, threads, mesh_);
      canvas_->draw(mesh_);
    }
    canvas_->finish(frame);
  }

  Frame crossSection(const Camera& camera, double z_m, const RenderOptions& options) {
    Frame frame = blankFrame(camera, options);
    slicer_.transform(camera, rest(), 1);
    const SlicePlanes planes{z_m - 0.5e-3, 1e-3, 0, 1};
    slicer_.bucket(camera, planes, skip_, wholeImage(camera), false);
    slicer_.slice(0, 1, 1, mesh_);
    const DrawJob job{camera, options, slicer_.positions(), skip_, wholeImage(camera), planes, true};
    canvas_->begin(job);
    canvas_->draw(mesh_);
    canvas_->finish(frame);
    return frame;
  }

  static Frame blankFrame(const Camera& camera, const RenderOptions& options) {
    Frame frame;
    frame.width = camera.width;
    frame.height = camera.height;
    const std::size_t pixels = std::size_t(camera.width) * std::size_t(camera.height);
    frame.rgba.assign(pixels * 4, 0.0F);
    frame.depth_m.assign(options.depth ? pixels : 0, std::numeric_limits<float>::quiet_NaN());
    frame.labels.assign(options.labels ? pixels : 0, 0);
    return frame;
  }

 private:
  SlicePlanes choosePlanes(const Camera& camera, const std::vector<Vector3f>& positions, const RenderOptions& options) {
    const auto isEmpty = [](const std::array<double, 2>& range) { return !(range[1] > range[0]); };
    slicer_.transform(camera, rest(), 1);
    std::array<double, 2> at_rest = slicer_.depthRange(camera);
    slicer_.transform(camera, positions, 1);
    const std::array<double, 2> now = slicer_.depthRange(camera);
    if (isEmpty(now))
      return {};
    if (isEmpty(at_rest))
      at_rest = now;
    const double distance_m = options.step_m > 0.0 ? options.step_m : (at_rest[1] - at_rest[0]) / options.slices;
    return planesThrough(now, at_rest[0], distance_m, 4096);
  }

  DrawnGrid grid_;
  TransferTable table_;
  std::shared_ptr<const Volume> volume_;
  std::shared_ptr<const Volume> labels_;
  std::vector<std::uint8_t> skip_;
  GridSlicer slicer_;
  SliceMesh mesh_;
  std::unique_ptr<Canvas> canvas_;  ///< last: it refers to the others
};

}  // namespace soft_volume::core
