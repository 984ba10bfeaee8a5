#include "soft_volume/render/renderer.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "canvas.h"
#include "changed_pixels.h"
#include "drawn_grid.h"
#include "exact_tracer.h"
#include "gl_canvas.h"
#include "native_canvas.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/cell_shape.h"
#include "soft_volume/render/grid_slicer.h"
#include "soft_volume/render/slice_planes.h"
#include "transfer_table.h"
#include "volume_texels.h"

namespace soft_volume::core {
namespace {

constexpr int kMaxPlanes = 4096;
/// A grid that was pulled deeper gets at most this many times the asked planes.
constexpr int kMaxSliceFactor = 4;
/// Times its diagonal at rest that a grid may grow. Beyond that it has exploded, and its cells, each as large as the
/// image, would take minutes to draw.
constexpr double kMaxGrowth = 10.0;
/// Planes that are cut at a time, so that the polygons of a large grid need little memory; more when the last one would
/// be an extra one.
constexpr int kPlanesPerMesh = 32;
/// Pixels around a changed cell that may change with it: rounding, and the neighbours that normals are made of.
constexpr int kDirtyMargin = 2;

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

bool equal(const Camera& a, const Camera& b) {
  return a.projection == b.projection && a.width == b.width && a.height == b.height && a.fx == b.fx && a.fy == b.fy &&
         a.cx == b.cx && a.cy == b.cy && a.near_m == b.near_m && a.far_m == b.far_m &&
         a.T_volume_camera.position_m == b.T_volume_camera.position_m &&
         a.T_volume_camera.orientation.coeffs() == b.T_volume_camera.orientation.coeffs();
}

/// All that the image depends on.
bool equal(const RenderOptions& a, const RenderOptions& b) {
  const auto equal_planes = [](const ClipPlane& p, const ClipPlane& q) {
    return p.normal == q.normal && p.offset_m == q.offset_m;
  };
  return a.slices == b.slices && a.step_m == b.step_m && a.lookup == b.lookup && a.shading == b.shading &&
         a.specular == b.specular && a.exact_boundary == b.exact_boundary && a.adaptive == b.adaptive &&
         a.jitter == b.jitter && a.depth == b.depth && a.depth_threshold == b.depth_threshold && a.labels == b.labels &&
         std::equal(a.clip_planes.begin(), a.clip_planes.end(), b.clip_planes.begin(), b.clip_planes.end(),
                    equal_planes);
}

bool isEmpty(const std::array<double, 2>& range) {
  return !(range[1] > range[0]);
}

PixelRect wholeImage(const Camera& camera) {
  return {0, 0, camera.width, camera.height};
}

DrawnGrid drawnGridOf(const Topology& topology) {
  DrawnGrid grid;
  grid.cell_types = topology.cell_types;
  grid.cell_offsets = topology.cell_offsets;
  grid.connectivity = topology.connectivity;
  grid.rest_positions = topology.rest_positions;
  grid.texture = topology.texture_coordinates;
  return grid;
}

DrawnGrid drawnGridOf(const IrregularGrid& irregular) {
  DrawnGrid grid;
  grid.cell_types = irregular.cell_types;
  grid.cell_offsets = irregular.cell_offsets;
  grid.connectivity = irregular.connectivity;
  grid.rest_positions = irregular.points;
  grid.point_scalars = irregular.point_scalars;
  grid.cell_scalars = irregular.cell_scalars;
  return grid;
}

/// The vertices of every cell, each once for a face stream as well: what `visit(cell, vertex)` is called with.
template <typename Visit>
void forEachCorner(const DrawnGrid& grid, std::size_t cell, const Visit& visit) {
  const std::uint32_t* begin = &grid.connectivity[grid.cell_offsets[cell]];
  if (grid.cell_types[cell] != CellType::kPolyhedron) {
    std::for_each(begin, &grid.connectivity[0] + grid.cell_offsets[cell + 1], visit);
    return;
  }
  forEachFace(grid.cell_types[cell], begin, [&](std::size_t, const std::uint32_t* vertices, std::size_t size) {
    std::for_each(vertices, vertices + size, visit);
  });
}

}  // namespace

void RenderOptions::validate() const {
  requireOption(slices >= 1 && slices <= kMaxPlanes, "slices", slices, "1 to 4096");
  requireOption(std::isfinite(step_m) && step_m >= 0.0, "step_m", step_m, "a positive distance, or 0 to use slices");
  requireOption(shading >= 0.0 && shading <= 1.0, "shading", shading, "0 to 1");
  requireOption(specular >= 0.0 && specular <= 1.0, "specular", specular, "0 to 1");
  requireOption(depth_threshold > 0.0 && depth_threshold < 1.0, "depth_threshold", depth_threshold,
                "more than 0 and less than 1");
  requireOption(threads >= 0 && threads <= 1024, "threads", threads, "0 (all cores) to 1024");
  requireOption(clip_planes.size() <= kMaxClipPlanes, "the number of clip planes", double(clip_planes.size()),
                "at most 8");
  for (const ClipPlane& plane : clip_planes) {
    requireOption(isFinite(plane.normal) && std::abs(plane.normal.norm() - 1.0) < 1e-6, "a clip plane's normal length",
                  plane.normal.norm(), "1");
    requireOption(std::isfinite(plane.offset_m), "a clip plane's offset", plane.offset_m, "a finite number");
  }
}

Image Frame::toRgb8(const Vector3f& background) const {
  Image image{width, height, std::vector<std::uint8_t>(std::size_t(width) * std::size_t(height) * 3)};
  for (std::size_t pixel = 0; pixel < image.rgb.size() / 3; ++pixel) {
    const float* colour = &rgba[pixel * 4];
    for (int channel = 0; channel < 3; ++channel) {
      image.rgb[pixel * 3 + std::size_t(channel)] = toLevel(colour[channel] + (1.0F - colour[3]) * background[channel]);
    }
  }
  return image;
}

Box3 boundsOf(const std::vector<Vector3f>& points) {
  Box3 box;
  for (const Vector3f& p : points)
    box.extend(p.cast<double>());
  return box;
}

class Renderer::Impl {
 public:
  explicit Impl(Backend backend) : backend_(backend) {
    if (backend == Backend::kGl)
      canvas_ = std::make_unique<GlCanvas>();
    else if (backend == Backend::kNative)
      canvas_ = std::make_unique<NativeCanvas>();
  }

  void setVolume(std::shared_ptr<const Volume> volume) {
    if (!volume || volume->empty())
      throw InputError("there is no volume to draw");
    if (canvas_)
      canvas_->setVolume(*volume);
    else
      tracer_.setVolume(*volume);
    volume_ = std::move(volume);
    updateRanges();
  }

  void setLabels(std::shared_ptr<const Volume> labels) {
    if (labels && labels->empty())
      throw InputError("the segmentation is empty");
    if (canvas_)
      canvas_->setLabels(labels.get());
    else
      tracer_.setLabels(labels.get());
    labels_ = std::move(labels);
    forgetFrame();
  }

  void setTransferFunction(const TransferFunction& function) {
    TransferTable table(function);
    table_ = std::move(table);
    if (canvas_)
      canvas_->setTable(*table_);
    else
      tracer_.setTransferFunction(function);
    updateSkipped();
  }

  void setTopology(const Topology& topology) {
    topology.validate();
    setGrid(drawnGridOf(topology));
  }

  void setGrid(const IrregularGrid& grid) {
    grid.validate();
    if (grid.cellCount() == 0)
      throw InputError("the grid has no cells to draw");
    setGrid(drawnGridOf(grid));
  }

  const Frame& render(const Camera& camera, const std::vector<Vector3f>& positions, const RenderOptions& options) {
    camera.validate();
    options.validate();
    requireScene();
    if (options.labels && !labels_)
      throw InputError("set a segmentation before asking for the label image");
    Stopwatch watch;
    const View view = choosePlanes(camera, positions, options);
    const PixelRect rect = changedRect(camera, positions, options, view);
    startFrame(camera, options, rect);
    frame_.transform_ms = watch.lap();
    if (canvas_)
      drawSlices(camera, options, view, rect);
    else
      drawExactly(camera, options, rect);
    remember(camera, positions, options, view);
    return frame_;
  }

  const Frame& render(const Camera& camera, const RenderOptions& options) {
    return render(camera, grid_.rest_positions, options);
  }

  const Frame& renderCrossSection(const Camera& camera, const std::vector<Vector3f>& positions, double z_m) {
    camera.validate();
    requireScene();
    if (!canvas_)
      throw InputError("the exact back end draws no slices; use native or gl for a cross-section");
    if (!(z_m >= camera.near_m && z_m <= camera.far_m))
      throw InputError("the cross-section lies at depth " + std::to_string(z_m) +
                       " m, outside the camera's near and far");
    RenderOptions options;
    options.shading = 0.0;
    slicer_.transform(camera, positions, threadsFor(0));
    if (&positions != &grid_.rest_positions)
      requireSaneSize(positions);
    const View view{{z_m - 0.5, 1.0, 0, 1}};
    forgetFrame();
    is_update_ = false;
    startFrame(camera, options, wholeImage(camera));
    drawSlices(camera, options, view, wholeImage(camera), true);
    return frame_;
  }

  const Frame& renderCrossSection(const Camera& camera, double z_m) {
    return renderCrossSection(camera, grid_.rest_positions, z_m);
  }

  const Frame& renderStored(const Camera& camera) {
    camera.validate();
    if (!canvas_)
      throw InputError("the exact back end has no slices that another camera could look at; use native or gl");
    if (!last_)
      throw InputError("draw a frame before looking at its slices from another camera");
    Stopwatch watch;
    if (!stored_)
      storeSlices();
    const SliceMesh mesh = seenFrom(camera);
    is_update_ = false;
    startFrame(camera, last_->options, wholeImage(camera));
    frame_.transform_ms = watch.lap();
    canvas_->begin(jobFor(camera, last_->options, wholeImage(camera), last_->view.planes, false));
    canvas_->draw(mesh);
    canvas_->finish(frame_);
    frame_.render_ms = watch.lap();
    job_.reset();
    return frame_;
  }

  void forgetFrame() {
    last_.reset();
    stored_.reset();
  }

  std::string driver() const { return canvas_ ? canvas_->driver() : "exact"; }

 private:
  struct View {
    SlicePlanes planes;
    bool all_planes = true;  ///< false where the grid is deeper than the most planes that are drawn
  };

  /// What the last frame was drawn from.
  struct Last {
    Camera camera;
    RenderOptions options;
    std::vector<Vector3f> positions;  ///< volume frame
    std::vector<Vector3f> camera_positions;
    View view;
    std::vector<float> extra_planes;
  };

  void setGrid(DrawnGrid grid) {
    slicer_.setCells(grid.cell_types, grid.cell_offsets, grid.connectivity, grid.vertexCount());
    grid_ = std::move(grid);
    rest_diagonal_m_ = diagonal(grid_.rest_positions);
    if (canvas_)
      canvas_->setGrid(grid_);
    else
      tracer_.setGrid(grid_);
    updateRanges();
  }

  static double diagonal(const std::vector<Vector3f>& points) {
    const Box3 box = boundsOf(points);
    return box.isEmpty() ? 0.0 : box.diagonal().norm();
  }

  void requireScene() const {
    if (grid_.cellCount() == 0)
      throw InputError("set a grid with cells before rendering");
    if (grid_.isTextured() && !volume_)
      throw InputError("set a volume before rendering");
    if (!table_)
      throw InputError("set a transfer function before rendering");
  }

  void requireSaneSize(const std::vector<Vector3f>& positions) const {
    const double now_m = diagonal(positions);
    if (now_m <= kMaxGrowth * rest_diagonal_m_)
      return;
    throw InputError(
        "the grid has grown to " + std::to_string(now_m) +
        " m, more than ten times its size at rest: the simulation is unstable or these are not its positions");
  }

  /// Planes at distances that only the grid at rest decides, unless that is out of sight; leaves the slicer with the
  /// deformed grid.
  View choosePlanes(const Camera& camera, const std::vector<Vector3f>& positions, const RenderOptions& options) {
    const int threads = threadsOf(options);
    if (!last_ || !equal(last_->camera, camera) || !rest_range_) {
      slicer_.transform(camera, grid_.rest_positions, threads);
      rest_range_ = slicer_.depthRange(camera);
    }
    slicer_.transform(camera, positions, threads);
    if (&positions != &grid_.rest_positions)
      requireSaneSize(positions);
    const std::array<double, 2> deformed = slicer_.depthRange(camera);
    if (isEmpty(deformed))
      return {};
    const std::array<double, 2>& rest = isEmpty(*rest_range_) ? deformed : *rest_range_;
    const double distance_m = options.step_m > 0.0 ? options.step_m : (rest[1] - rest[0]) / options.slices;
    const int wanted = options.step_m > 0.0 ? kMaxPlanes : kMaxSliceFactor * options.slices;
    const SlicePlanes planes = planesThrough(deformed, rest[0], distance_m, wanted);
    return {planes, planes.count < wanted};
  }

  int threadsOf(const RenderOptions& options) const {
    return canvas_ ? canvas_->slicingThreads(options.threads) : threadsFor(options.threads);
  }

  /// True when pixels in which nothing moved may have other planes than in the last frame: those of another ladder, or
  /// because the hindmost were left out.
  bool changesOtherPlanes(const View& view) const {
    const SlicePlanes& before = last_->view.planes;
    const SlicePlanes& now = view.planes;
    return now.anchor_m != before.anchor_m || now.distance_m != before.distance_m ||
           (now.first_number != before.first_number && !(view.all_planes && last_->view.all_planes));
  }

  /// Whether another image than the last one has to be drawn, rather than the last one with other positions.
  bool isAnother(const Camera& camera, const RenderOptions& options, const View& view) const {
    return !last_ || !shows_last_ || !equal(last_->camera, camera) || !equal(last_->options, options) ||
           (canvas_ && changesOtherPlanes(view));
  }

  /// Where the image may differ from the last one; sets changed_ when there is one to go on with.
  PixelRect changedRect(const Camera& camera, const std::vector<Vector3f>& positions, const RenderOptions& options,
                        const View& view) {
    is_update_ = false;
    if (isAnother(camera, options, view))
      return wholeImage(camera);
    std::vector<std::uint8_t> changed(positions.size());
    for (std::size_t i = 0; i < positions.size(); ++i)
      changed[i] = positions[i] != last_->positions[i];
    // Normals are averaged over the cells around a vertex.
    if (backend_ != Backend::kNative)
      spread(changed);
    changed_.reset(camera.width, camera.height);
    Eigen::AlignedBox2d box;
    for (std::size_t cell = 0; cell < grid_.cellCount(); ++cell) {
      bool is_changed = false;
      forEachCorner(grid_, cell, [&](std::uint32_t v) { is_changed = is_changed || changed[v] != 0; });
      if (!is_changed || skippedWith(options)[cell] != 0)
        continue;
      const std::optional<Octagon> image = imageOf(camera, cell);
      if (!image)
        return wholeImage(camera);
      changed_.add(*image, kDirtyMargin);
      box.extend(image->box());
    }
    is_update_ = true;
    return rectAround(camera, box);
  }

  /// What a cell covers in the image now or did in the last one; none where it reaches behind the eye.
  std::optional<Octagon> imageOf(const Camera& camera, std::size_t cell) const {
    Octagon image;
    bool is_behind = false;
    forEachCorner(grid_, cell, [&](std::uint32_t v) {
      for (const Vector3f& p : {slicer_.positions()[v], last_->camera_positions[v]}) {
        is_behind = is_behind || (camera.projection == Projection::kPerspective && p.z() < camera.near_m);
        if (!is_behind)
          image.add(camera.project(p.cast<double>()));
      }
    });
    return is_behind ? std::nullopt : std::make_optional(image);
  }

  static PixelRect rectAround(const Camera& camera, const Eigen::AlignedBox2d& box) {
    if (box.isEmpty())
      return {};
    const auto pixel = [](double place, int limit) { return int(std::clamp(place, 0.0, double(limit))); };
    return {pixel(std::floor(box.min().x()) - kDirtyMargin, camera.width),
            pixel(std::floor(box.min().y()) - kDirtyMargin, camera.height),
            pixel(std::ceil(box.max().x()) + kDirtyMargin + 1, camera.width),
            pixel(std::ceil(box.max().y()) + kDirtyMargin + 1, camera.height)};
  }

  /// From vertices to all vertices of their cells.
  void spread(std::vector<std::uint8_t>& changed) const {
    const std::vector<std::uint8_t> before = changed;
    for (std::size_t cell = 0; cell < grid_.cellCount(); ++cell) {
      bool is_changed = false;
      forEachCorner(grid_, cell, [&](std::uint32_t v) { is_changed = is_changed || before[v] != 0; });
      if (is_changed)
        forEachCorner(grid_, cell, [&](std::uint32_t v) { changed[v] = 1; });
    }
  }

  /// A frame of the right size, of which the rectangle is to be drawn.
  void startFrame(const Camera& camera, const RenderOptions& options, const PixelRect& rect) {
    const std::size_t pixels = std::size_t(camera.width) * std::size_t(camera.height);
    shows_last_ = false;
    frame_.rgba.resize(pixels * 4);
    frame_.depth_m.resize(options.depth ? pixels : 0);
    frame_.labels.resize(options.labels ? pixels : 0);
    frame_.width = camera.width;
    frame_.height = camera.height;
    frame_.updated = rect;
    frame_.slices = 0;
    frame_.polygons = frame_.fragments = 0;
    const std::vector<std::uint8_t>& skipped = skippedWith(options);
    frame_.cells = std::size_t(std::count(skipped.begin(), skipped.end(), 0));
    frame_.transform_ms = frame_.bucket_ms = frame_.slice_ms = frame_.render_ms = 0.0;
  }

  const DrawJob& jobFor(const Camera& camera, const RenderOptions& options, const PixelRect& rect,
                        const SlicePlanes& planes, bool cross_section) {
    return job_.emplace(DrawJob{camera, options, slicer_.positions(), cross_section ? empty_ : skippedWith(options),
                                rect, planes, cross_section, is_update_ ? &changed_ : nullptr});
  }

  void drawSlices(const Camera& camera, const RenderOptions& options, const View& view, PixelRect rect,
                  bool cross_section = false) {
    const int threads = threadsOf(options);
    const std::vector<std::uint8_t>& skipped = cross_section ? empty_ : skippedWith(options);
    Stopwatch watch;
    if (rect.empty() || view.planes.count == 0) {
      planes_extra_.clear();
      if (!rect.empty())
        clear(rect);
      return;
    }
    slicer_.bucket(camera, view.planes, skipped, rect, options.adaptive, threads);
    planes_extra_ = slicer_.extraPlanes();
    if (is_update_ && planes_extra_ != last_->extra_planes) {
      // Planes that come or go change the whole image.
      is_update_ = false;
      rect = wholeImage(camera);
      startFrame(camera, options, rect);
      slicer_.bucket(camera, view.planes, skipped, rect, options.adaptive, threads);
    }
    frame_.bucket_ms = watch.lap();
    canvas_->begin(jobFor(camera, options, rect, view.planes, cross_section));
    frame_.render_ms += watch.lap();
    for (int plane = 0, end = 0; plane < slicer_.planeCount(); plane = end) {
      end = std::min(plane + kPlanesPerMesh, slicer_.planeCount());
      while (end < slicer_.planeCount() && slicer_.isExtra(end - 1))
        ++end;
      slicer_.slice(plane, end, threads, mesh_);
      frame_.slice_ms += watch.lap();
      canvas_->draw(mesh_);
      frame_.render_ms += watch.lap();
    }
    canvas_->finish(frame_);
    frame_.render_ms += watch.lap();
    job_.reset();
  }

  void clear(const PixelRect& rect) {
    for (int y = rect.begin_y; y < rect.end_y; ++y) {
      const std::size_t begin = std::size_t(y) * std::size_t(frame_.width) + std::size_t(rect.begin_x);
      const std::size_t count = std::size_t(rect.end_x - rect.begin_x);
      std::fill_n(frame_.rgba.begin() + std::ptrdiff_t(begin * 4), count * 4, 0.0F);
      if (!frame_.depth_m.empty())
        std::fill_n(frame_.depth_m.begin() + std::ptrdiff_t(begin), count, std::numeric_limits<float>::quiet_NaN());
      if (!frame_.labels.empty())
        std::fill_n(frame_.labels.begin() + std::ptrdiff_t(begin), count, std::uint16_t(0));
    }
  }

  void drawExactly(const Camera& camera, const RenderOptions& options, const PixelRect& rect) {
    Stopwatch watch;
    if (!rect.empty()) {
      clear(rect);
      tracer_.draw(camera, options, slicer_.positions(), skippedWith(options), rect, frame_);
    }
    frame_.render_ms = watch.lap();
  }

  void remember(const Camera& camera, const std::vector<Vector3f>& positions, const RenderOptions& options,
                const View& view) {
    last_ = Last{camera, options, positions, slicer_.positions(), view, planes_extra_};
    stored_.reset();
    shows_last_ = true;
  }

  void storeSlices() {
    slicer_.transform(last_->camera, last_->positions, threadsOf(last_->options));
    slicer_.bucket(last_->camera, last_->view.planes, skippedWith(last_->options), wholeImage(last_->camera),
                   last_->options.adaptive);
    stored_.emplace();
    slicer_.slice(0, slicer_.planeCount(), threadsOf(last_->options), *stored_);
  }

  /// The stored slices as another camera sees them. Their planes get the depths at which its axis meets them.
  SliceMesh seenFrom(const Camera& camera) const {
    SliceMesh mesh = *stored_;
    const Pose T_camera_volume = camera.T_volume_camera.inverse();
    parallelFor(std::ptrdiff_t(mesh.vertices.size()), threadsOf(last_->options), [&](std::ptrdiff_t i) {
      SliceVertex& vertex = mesh.vertices[std::size_t(i)];
      const Vector3 a = last_->positions[vertex.a].cast<double>();
      const Vector3 b = last_->positions[vertex.b].cast<double>();
      Vector3 p = T_camera_volume * Vector3(a + double(vertex.t) * (b - a));
      p.z() = std::max(p.z(), camera.near_m);
      const Eigen::Vector2d pixel = camera.project(p);
      vertex.u = float(pixel.x());
      vertex.v = float(pixel.y());
    });
    const Pose T_old_new = last_->camera.T_volume_camera.inverse() * camera.T_volume_camera;
    const double origin = T_old_new.position_m.z();
    const double along = (T_old_new.orientation * Vector3::UnitZ()).z();
    if (std::abs(along) < 0.1)
      return {};
    for (Slice& slice : mesh.slices) {
      slice.z_m = float((slice.z_m - origin) / along);
      slice.front_m = float((slice.front_m - origin) / along);
      slice.back_m = float((slice.back_m - origin) / along);
      if (along < 0.0)
        std::swap(slice.front_m, slice.back_m);
    }
    return along > 0.0 ? mesh : reversed(mesh);
  }

  static SliceMesh reversed(const SliceMesh& mesh) {
    SliceMesh turned = mesh;
    turned.polygons.clear();
    std::reverse(turned.slices.begin(), turned.slices.end());
    for (Slice& slice : turned.slices) {
      const auto begin = mesh.polygons.begin() + slice.first_polygon;
      slice.first_polygon = std::uint32_t(turned.polygons.size());
      turned.polygons.insert(turned.polygons.end(), begin, begin + slice.polygon_count);
    }
    return turned;
  }

  void updateRanges() {
    forgetFrame();
    rest_range_.reset();
    if (grid_.isTextured() && !volume_)
      return;
    ranges_ = grid_.isTextured() ? scalarRanges(*volume_, textureBoxes()) : ownRanges();
    updateSkipped();
  }

  std::vector<std::array<Vector3f, 2>> textureBoxes() const {
    std::vector<std::array<Vector3f, 2>> boxes;
    boxes.reserve(grid_.cellCount());
    for (std::size_t cell = 0; cell < grid_.cellCount(); ++cell) {
      Eigen::AlignedBox3f box;
      forEachCorner(grid_, cell, [&](std::uint32_t v) { box.extend(grid_.texture[v]); });
      boxes.push_back({box.min(), box.max()});
    }
    return boxes;
  }

  /// Of the grid's own scalars; NaN where one of them is.
  std::vector<std::array<double, 2>> ownRanges() const {
    std::vector<std::array<double, 2>> ranges(grid_.cellCount());
    for (std::size_t cell = 0; cell < ranges.size(); ++cell) {
      std::array<double, 2> range = {std::numeric_limits<double>::max(), std::numeric_limits<double>::lowest()};
      const auto add = [&](double scalar) {
        if (std::isnan(scalar) || std::isnan(range[0]))
          range = {scalar + range[0], scalar + range[0]};
        else
          range = {std::min(range[0], scalar), std::max(range[1], scalar)};
      };
      if (!grid_.cell_scalars.empty())
        add(grid_.cell_scalars[cell]);
      else
        forEachCorner(grid_, cell, [&](std::uint32_t v) { add(grid_.point_scalars[v]); });
      ranges[cell] = range;
    }
    return ranges;
  }

  /// Cells without a scalar are never drawn, those that the transfer function makes transparent only where a slab that
  /// reaches beyond its cell needs them: next to one with opacity, when boundaries are not exact.
  void updateSkipped() {
    forgetFrame();
    if (!table_ || ranges_.size() != grid_.cellCount())
      return;
    std::vector<std::uint8_t> visible(grid_.vertexCount(), 0);
    empty_.resize(ranges_.size());
    transparent_.resize(ranges_.size());
    for (std::size_t cell = 0; cell < ranges_.size(); ++cell) {
      empty_[cell] = std::uint8_t(std::isnan(ranges_[cell][0]));
      transparent_[cell] = std::uint8_t(empty_[cell] != 0 || table_->isTransparent(ranges_[cell][0], ranges_[cell][1]));
      if (transparent_[cell] == 0)
        forEachCorner(grid_, cell, [&](std::uint32_t v) { visible[v] = 1; });
    }
    far_from_visible_.resize(ranges_.size());
    for (std::size_t cell = 0; cell < ranges_.size(); ++cell) {
      bool drawn = false;
      forEachCorner(grid_, cell, [&](std::uint32_t v) { drawn = drawn || visible[v] != 0; });
      far_from_visible_[cell] = std::uint8_t(!drawn || empty_[cell] != 0);
    }
  }

  const std::vector<std::uint8_t>& skippedWith(const RenderOptions& options) const {
    const bool exact = backend_ == Backend::kExact || (backend_ == Backend::kNative && options.exact_boundary);
    return exact ? transparent_ : far_from_visible_;
  }

  const Backend backend_;
  std::unique_ptr<Canvas> canvas_;  ///< null in exact
  ExactTracer tracer_;
  DrawnGrid grid_;
  GridSlicer slicer_;
  SliceMesh mesh_;
  std::shared_ptr<const Volume> volume_;
  std::shared_ptr<const Volume> labels_;
  std::optional<TransferTable> table_;
  double rest_diagonal_m_ = 0.0;
  std::vector<std::array<double, 2>> ranges_;  ///< per cell, scalars; NaN where there is none
  // Per cell, 1 where it is not drawn.
  std::vector<std::uint8_t> empty_;             ///< has no scalar
  std::vector<std::uint8_t> transparent_;       ///< or shows nothing
  std::vector<std::uint8_t> far_from_visible_;  ///< or neither it nor a neighbour shows anything
  bool is_update_ = false;                      ///< the frame is the last one where changed_ has no pixels
  ChangedPixels changed_;
  std::optional<DrawJob> job_;
  std::vector<float> planes_extra_;
  Frame frame_;
  std::optional<Last> last_;
  bool shows_last_ = false;                          ///< frame_ is what last_ gave
  std::optional<std::array<double, 2>> rest_range_;  ///< depths of the grid at rest, for last_->camera
  std::optional<SliceMesh> stored_;                  ///< slices of last_
};

Renderer::Renderer(Backend backend) : impl_(std::make_unique<Impl>(backend)) {}
Renderer::~Renderer() = default;
void Renderer::setVolume(std::shared_ptr<const Volume> volume) {
  impl_->setVolume(std::move(volume));
}
void Renderer::setLabels(std::shared_ptr<const Volume> labels) {
  impl_->setLabels(std::move(labels));
}
void Renderer::setTransferFunction(const TransferFunction& function) {
  impl_->setTransferFunction(function);
}
void Renderer::setTopology(const Topology& topology) {
  impl_->setTopology(topology);
}
void Renderer::setGrid(const IrregularGrid& grid) {
  impl_->setGrid(grid);
}
const Frame& Renderer::render(const Camera& camera, const std::vector<Vector3f>& positions,
                              const RenderOptions& options) {
  return impl_->render(camera, positions, options);
}
const Frame& Renderer::render(const Camera& camera, const RenderOptions& options) {
  return impl_->render(camera, options);
}
const Frame& Renderer::renderCrossSection(const Camera& camera, const std::vector<Vector3f>& positions, double z_m) {
  return impl_->renderCrossSection(camera, positions, z_m);
}
const Frame& Renderer::renderCrossSection(const Camera& camera, double z_m) {
  return impl_->renderCrossSection(camera, z_m);
}
const Frame& Renderer::renderStored(const Camera& camera) {
  return impl_->renderStored(camera);
}
void Renderer::forgetFrame() {
  impl_->forgetFrame();
}
std::string Renderer::driver() const {
  return impl_->driver();
}

}  // namespace soft_volume::core
