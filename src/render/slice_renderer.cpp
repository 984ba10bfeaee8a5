#include "soft_volume/render/slice_renderer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <optional>
#include <string>

#include "slice_canvas.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/slicer.h"
#include "transfer_table.h"
#include "volume_texels.h"

namespace soft_volume::core {
namespace {

/// A grid that was pulled deeper gets at most this many times the asked planes.
constexpr int kMaxSliceFactor = 4;

/// Times its diagonal at rest that a grid may grow. Beyond that it has exploded, and its cells, each as large as the
/// image, would take minutes to draw.
constexpr double kMaxGrowth = 10.0;

double diagonal(const std::vector<Vector3f>& points) {
  Eigen::AlignedBox3f box;
  for (const Vector3f& p : points)
    box.extend(p);
  return box.isEmpty() ? 0.0 : double(box.diagonal().norm());
}

std::vector<std::array<Vector3f, 2>> textureBoxes(const Topology& topology) {
  std::vector<std::array<Vector3f, 2>> boxes;
  boxes.reserve(topology.cellCount());
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    Eigen::AlignedBox3f box;
    for (std::uint32_t i = topology.cell_offsets[cell]; i < topology.cell_offsets[cell + 1]; ++i) {
      box.extend(topology.texture_coordinates[topology.connectivity[i]]);
    }
    boxes.push_back({box.min(), box.max()});
  }
  return boxes;
}

void requireOption(bool good, const char* name, double value, const char* range) {
  if (!good)
    throw SceneError(std::string(name) + " is " + std::to_string(value) + ", use " + range);
}

class Stopwatch {
 public:
  /// Milliseconds since the last lap or the start.
  double lap() {
    const auto now = std::chrono::steady_clock::now();
    const double elapsed_ms = std::chrono::duration<double, std::milli>(now - start_).count();
    start_ = now;
    return elapsed_ms;
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

std::uint8_t toLevel(float colour) {
  return std::uint8_t(std::lround(std::clamp(colour, 0.0F, 1.0F) * 255.0F));
}

}  // namespace

void LegacyRenderOptions::validate() const {
  requireOption(slices >= 1 && slices <= 4096, "slices", slices, "1 to 4096");
  requireOption(shading >= 0.0 && shading <= 1.0, "shading", shading, "0 to 1");
  requireOption(depth_threshold > 0.0 && depth_threshold < 1.0, "depth_threshold", depth_threshold,
                "more than 0 and less than 1");
}

Image LegacyFrame::toRgb8(const Vector3f& background) const {
  Image image{width, height, std::vector<std::uint8_t>(std::size_t(width) * std::size_t(height) * 3)};
  for (std::size_t pixel = 0; pixel < image.rgb.size() / 3; ++pixel) {
    const float* colour = &rgba[pixel * 4];
    for (int channel = 0; channel < 3; ++channel) {
      image.rgb[pixel * 3 + std::size_t(channel)] = toLevel(colour[channel] + (1.0F - colour[3]) * background[channel]);
    }
  }
  return image;
}

class SliceRenderer::Impl {
 public:
  void setVolume(std::shared_ptr<const Volume> volume) {
    if (!volume || volume->empty())
      throw InputError("there is no volume to draw");
    canvas_.setVolume(*volume);
    volume_ = std::move(volume);
    updateRanges();
  }

  void setTransferFunction(const TransferFunction& function) {
    TransferTable table(function);
    canvas_.setTable(table);
    table_ = std::move(table);
    updateSkipped();
  }

  void setTopology(const Topology& topology) {
    topology.validate();
    slicer_.setTopology(topology);
    rest_positions_ = topology.rest_positions;
    boxes_ = textureBoxes(topology);
    updateRanges();
  }

  LegacyFrame render(const Camera& camera, const std::vector<Vector3f>& positions, const LegacyRenderOptions& options) {
    camera.validate();
    options.validate();
    requireScene();
    Stopwatch watch;
    const SlicePlanes planes = choosePlanes(camera, positions, options.slices);
    const double transform_ms = watch.lap();
    const LegacySliceMesh& mesh = slicer_.slice(camera, planes, skipped_);
    const double slice_ms = watch.lap();
    LegacyFrame frame = canvas_.draw(camera, mesh, planes, options);
    frame.render_ms = watch.lap();
    frame.slice_ms = slice_ms;
    frame.transform_ms = transform_ms;
    frame.cells = std::size_t(std::count(skipped_.begin(), skipped_.end(), 0));
    return frame;
  }

  std::string driver() { return canvas_.driver(); }

 private:
  void requireScene() const {
    if (!volume_)
      throw InputError("set a volume before rendering");
    if (!table_)
      throw InputError("set a transfer function before rendering");
    if (slicer_.cellCount() == 0)
      throw InputError("set a topology with cells before rendering");
  }

  void requireSaneSize(const std::vector<Vector3f>& positions) const {
    const double now_m = diagonal(positions);
    if (now_m <= kMaxGrowth * diagonal(rest_positions_))
      return;
    throw InputError(
        "the grid has grown to " + std::to_string(now_m) +
        " m, more than ten times its size at rest: the simulation is unstable or these are not its positions");
  }

  /// Planes at distances that only the grid at rest decides, unless that is out of sight; leaves the slicer with the
  /// deformed grid.
  SlicePlanes choosePlanes(const Camera& camera, const std::vector<Vector3f>& positions, int slices) {
    const auto isEmpty = [](const std::array<double, 2>& range) { return !(range[1] > range[0]); };
    slicer_.transform(camera, rest_positions_);
    std::array<double, 2> rest = slicer_.depthRange(camera);
    slicer_.transform(camera, positions);
    requireSaneSize(positions);
    const std::array<double, 2> deformed = slicer_.depthRange(camera);
    if (isEmpty(deformed))
      return {};
    if (isEmpty(rest))
      rest = deformed;
    return planesThrough(deformed, rest[0], (rest[1] - rest[0]) / slices, kMaxSliceFactor * slices);
  }

  void updateRanges() {
    if (!volume_)
      return;
    ranges_ = scalarRanges(*volume_, boxes_);
    updateSkipped();
  }

  /// A slab reaches beyond its cell, so a transparent cell next to one with opacity is drawn too.
  void updateSkipped() {
    if (!table_)
      return;
    std::vector<std::uint8_t> visible(slicer_.vertexCount(), 0);
    for (std::size_t cell = 0; cell < ranges_.size(); ++cell) {
      if (table_->isTransparent(ranges_[cell][0], ranges_[cell][1]))
        continue;
      for (const std::uint32_t corner : slicer_.corners(cell))
        visible[corner] = 1;
    }
    skipped_.resize(ranges_.size());
    for (std::size_t cell = 0; cell < ranges_.size(); ++cell) {
      const auto& corners = slicer_.corners(cell);
      skipped_[cell] = std::none_of(corners.begin(), corners.end(), [&](auto corner) { return visible[corner] != 0; });
    }
  }

  SliceCanvas canvas_;
  Slicer slicer_;
  std::shared_ptr<const Volume> volume_;
  std::optional<TransferTable> table_;
  std::vector<Vector3f> rest_positions_;
  std::vector<std::array<Vector3f, 2>> boxes_;  ///< per cell, texture coordinates
  std::vector<std::array<double, 2>> ranges_;   ///< per cell, scalars
  std::vector<std::uint8_t> skipped_;           ///< per cell, 1 where the transfer function shows nothing
};

SliceRenderer::SliceRenderer() : impl_(std::make_unique<Impl>()) {}
SliceRenderer::~SliceRenderer() = default;
void SliceRenderer::setVolume(std::shared_ptr<const Volume> volume) {
  impl_->setVolume(std::move(volume));
}
void SliceRenderer::setTransferFunction(const TransferFunction& function) {
  impl_->setTransferFunction(function);
}
void SliceRenderer::setTopology(const Topology& topology) {
  impl_->setTopology(topology);
}
LegacyFrame SliceRenderer::render(const Camera& camera, const std::vector<Vector3f>& positions,
                                  const LegacyRenderOptions& options) {
  return impl_->render(camera, positions, options);
}
std::string SliceRenderer::driver() const {
  return impl_->driver();
}

}  // namespace soft_volume::core
