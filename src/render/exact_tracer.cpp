#include "exact_tracer.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "exact_medium.h"
#include "face_bins.h"
#include "face_hits.h"
#include "ray_walk.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

/// An opacity that is never reached.
constexpr double kNever = 2.0;

/// The part of a ray between the near, far and clipping planes.
struct DepthRange {
  double begin;
  double end;
};

/// A clipping plane in the camera frame: keeps what lies where normal . p <= offset.
struct CameraPlane {
  Vector3 normal;
  double offset;
};

std::vector<CameraPlane> inCameraFrame(const std::vector<ClipPlane>& planes, const Pose& T_volume_camera) {
  const Quaternion to_camera = T_volume_camera.orientation.conjugate();
  std::vector<CameraPlane> result;
  for (const ClipPlane& plane : planes)
    result.push_back({to_camera * plane.normal, plane.offset_m - plane.normal.dot(T_volume_camera.position_m)});
  return result;
}

DepthRange clip(DepthRange range, const Ray& ray, const std::vector<CameraPlane>& planes) {
  for (const CameraPlane& plane : planes) {
    const double gain = plane.normal.dot(Vector3(ray.slope_x, ray.slope_y, 1.0));
    const double room = plane.offset - plane.normal.dot(ray.at(0.0));
    if (gain > 0.0)
      range.end = std::min(range.end, room / gain);
    else if (gain < 0.0)
      range.begin = std::max(range.begin, room / gain);
    else if (room < 0.0)
      range.end = range.begin;
  }
  return range;
}

/// By depth. The hits come nearly in order.
void sortByDepth(std::vector<FaceHit>& hits) {
  const auto nearer = [](const FaceHit& a, const FaceHit& b) { return a.z < b.z; };
  std::size_t moves_left = 16 * hits.size();
  for (std::size_t i = 1; i < hits.size(); ++i) {
    const FaceHit hit = hits[i];
    std::size_t k = i;
    for (; k > 0 && nearer(hit, hits[k - 1]); --k)
      hits[k] = hits[k - 1];
    hits[k] = hit;
    if (i - k > moves_left)
      return std::stable_sort(hits.begin(), hits.end(), nearer);
    moves_left -= i - k;
  }
}

/// Nearest voxel, 0 outside of 16 bits.
std::uint16_t labelAt(const Volume& labels, const Vector3& texture) {
  const Vector3 voxel = texture.cwiseProduct(labels.geometry().dims.cast<double>());
  const double label = labels.at(int(std::floor(voxel.x())), int(std::floor(voxel.y())), int(std::floor(voxel.z())));
  return label >= 0.0 && label <= 65535.0 ? std::uint16_t(label) : std::uint16_t(0);
}

}  // namespace

/// All that draws one image.
struct ExactTracer::Job {
  const Camera& camera;
  const RenderOptions& options;
  const PixelRect& rect;
  const std::vector<Vector3f>& grid_positions;  ///< per vertex of the grid, camera frame
  const std::vector<Vector3>& positions;        ///< per vertex of the mesh, camera frame
  const std::vector<std::uint8_t>& hidden;      ///< per cell
};

/// Draws tiles, one after the other, on one thread.
template <typename Medium>
class ExactTracer::TileDrawer {
 public:
  TileDrawer(const ExactTracer& tracer, const Job& job, const FaceBins& bins, const Medium& medium, Frame& frame)
      : job_(job),
        mesh_(tracer.mesh_),
        labels_(tracer.labels_),
        bins_(bins),
        planes_(inCameraFrame(job.options.clip_planes, job.camera.T_volume_camera)),
        walk_(mesh_, job.positions, job.hidden, medium),
        frame_(frame) {}

  void draw(std::size_t index) {
    const PixelRect tile = bins_.tile(index);
    findHits(index, tile);
    for (int y = tile.begin_y; y < tile.end_y; ++y) {
      for (int x = tile.begin_x; x < tile.end_x; ++x)
        drawPixel(x, y, hitsAt(tile, x, y));
    }
  }

  std::size_t segments() const { return walk_.segments(); }

 private:
  std::vector<FaceHit>& hitsAt(const PixelRect& tile, int x, int y) {
    return hits_[std::size_t(y - tile.begin_y) * FaceBins::kTile + std::size_t(x - tile.begin_x)];
  }

  void findHits(std::size_t index, const PixelRect& tile) {
    for (std::vector<FaceHit>& hits : hits_)
      hits.clear();
    for (const std::uint32_t* i = bins_.begin(index); i != bins_.end(index); ++i) {
      const FaceBins::Entry& entry = bins_.entry(*i);
      const PieceFace& face = mesh_.faces()[entry.face];
      const PixelRect& seen = entry.pixels;
      for (int y = std::max(tile.begin_y, seen.begin_y); y < std::min(tile.end_y, seen.end_y); ++y) {
        for (int x = std::max(tile.begin_x, seen.begin_x); x < std::min(tile.end_x, seen.end_x); ++x)
          intersect(Ray::through(job_.camera, x, y), job_.positions, face, entry.face, entry.may_fold,
                    hitsAt(tile, x, y));
      }
    }
  }

  void drawPixel(int x, int y, std::vector<FaceHit>& hits) {
    const Ray ray = Ray::through(job_.camera, x, y);
    const bool finds_depth = job_.options.depth || job_.options.labels;
    PixelIntegral pixel(ray.stretch, finds_depth ? job_.options.depth_threshold : kNever);
    const DepthRange range = clip({job_.camera.near_m, job_.camera.far_m}, ray, planes_);
    if (!hits.empty() && range.begin < range.end) {
      sortByDepth(hits);
      walk_.trace(ray, range.begin, range.end, hits, pixel);
    }
    write(pixel, std::size_t(y) * std::size_t(frame_.width) + std::size_t(x));
  }

  void write(const PixelIntegral& pixel, std::size_t index) {
    for (std::size_t channel = 0; channel < 3; ++channel)
      frame_.rgba[4 * index + channel] = float(pixel.colour()[Eigen::Index(channel)]);
    frame_.rgba[4 * index + 3] = float(pixel.opacity());
    if (job_.options.depth)
      frame_.depth_m[index] = float(pixel.depth());
    if (!job_.options.labels)
      return;
    const bool known = labels_ != nullptr && !std::isnan(pixel.depth());
    frame_.labels[index] = known ? labelAt(*labels_, pixel.textureAtDepth()) : std::uint16_t(0);
  }

  const Job& job_;
  const PieceMesh& mesh_;
  const Volume* labels_;
  const FaceBins& bins_;
  const std::vector<CameraPlane> planes_;
  RayWalk<Medium> walk_;
  Frame& frame_;
  std::array<std::vector<FaceHit>, std::size_t(FaceBins::kTile) * FaceBins::kTile> hits_;
};

namespace {

bool isNumber(const DrawnGrid& grid, const Piece& piece) {
  if (!grid.cell_scalars.empty())
    return std::isfinite(grid.cell_scalars[piece.cell]);
  const auto end = piece.vertices.begin() + std::ptrdiff_t(shapeOf(piece.type).vertex_count);
  return std::all_of(piece.vertices.begin(), end, [&](std::uint32_t vertex) {
    return vertex >= grid.point_scalars.size() || std::isfinite(grid.point_scalars[vertex]);
  });
}

/// Per cell, nonzero also where a corner's scalar is not a number.
std::vector<std::uint8_t> hiddenCells(const DrawnGrid& grid, const PieceMesh& mesh,
                                      const std::vector<std::uint8_t>& skip) {
  std::vector<std::uint8_t> hidden = skip;
  if (grid.isTextured())
    return hidden;
  for (const Piece& piece : mesh.pieces())
    hidden[piece.cell] |= std::uint8_t(!isNumber(grid, piece));
  return hidden;
}

std::vector<Vector3> withMeans(const PieceMesh& mesh, const std::vector<Vector3f>& positions) {
  std::vector<Vector3f> all = positions;
  mesh.appendMeans(all);
  std::vector<Vector3> result;
  result.reserve(all.size());
  for (const Vector3f& position : all)
    result.push_back(position.cast<double>());
  return result;
}

/// Colour and absorption of every vertex.
std::vector<Eigen::Vector4f> coloursOf(const TransferIntegral& function, const std::vector<float>& scalars) {
  std::vector<Eigen::Vector4f> colours;
  colours.reserve(scalars.size());
  for (const float scalar : scalars)
    colours.push_back(function.colourAt(scalar).cast<float>());
  return colours;
}

}  // namespace

void ExactTracer::setGrid(const DrawnGrid& grid) {
  grid_ = &grid;
  mesh_ = PieceMesh(grid);
  gradients_.setGrid(grid);
}

void ExactTracer::setTransferFunction(const TransferFunction& function) {
  function_ = std::make_unique<const TransferIntegral>(function);
}

template <typename Medium>
void ExactTracer::drawTiles(const Job& job, const Medium& medium, Frame& frame) const {
  const int threads = threadsFor(job.options.threads);
  const FaceBins bins(mesh_, job.positions, job.hidden, job.camera, job.rect, threads);
  std::vector<TileDrawer<Medium>> drawers(std::size_t(threads), TileDrawer<Medium>(*this, job, bins, medium, frame));
  parallelTasks(std::ptrdiff_t(bins.tileCount()), threads,
                [&](std::ptrdiff_t tile, int worker) { drawers[std::size_t(worker)].draw(std::size_t(tile)); });
  frame.polygons = bins.faceCount();
  frame.fragments = 0;
  for (const TileDrawer<Medium>& drawer : drawers)
    frame.fragments += drawer.segments();
}

void ExactTracer::drawTexture(const Job& job, Frame& frame) const {
  const Illumination light(job.options, shadingStep(*grid_, &volume_->geometry()), function_->range());
  std::vector<Vector3f> texture = grid_->texture;
  mesh_.appendMeans(texture);
  std::vector<Eigen::Matrix3f> maps;
  if (light.isOn()) {
    maps = gradients_.ofTexture(job.grid_positions, threadsFor(job.options.threads));
    mesh_.appendMeans(maps);
  }
  const VolumeLookup volume(*volume_);
  drawTiles(job, TexturedVolume(*function_, light, volume, texture, maps), frame);
}

void ExactTracer::drawPointScalars(const Job& job, Frame& frame) const {
  const Illumination light(job.options, shadingStep(*grid_, nullptr), function_->range());
  std::vector<Vector3f> gradients;
  if (light.isOn()) {
    gradients = gradients_.ofScalar(job.grid_positions, threadsFor(job.options.threads));
    mesh_.appendMeans(gradients);
  }
  const VertexLight vertex_light(light, gradients);
  std::vector<float> scalars = grid_->point_scalars;
  if (job.options.lookup == Lookup::kColour) {
    std::vector<Eigen::Vector4f> colours = coloursOf(*function_, scalars);
    mesh_.appendMeans(colours);
    return drawTiles(job, PointColours(vertex_light, colours), frame);
  }
  mesh_.appendMeans(scalars);
  drawTiles(job, PointScalars(*function_, vertex_light, scalars), frame);
}

void ExactTracer::drawCellScalars(const Job& job, Frame& frame) const {
  const Illumination light(job.options, shadingStep(*grid_, nullptr), function_->range());
  const std::vector<Vector3f> no_gradients;
  const VertexLight vertex_light(light, no_gradients);
  drawTiles(job, CellScalars(*function_, vertex_light, grid_->cell_scalars), frame);
}

void ExactTracer::draw(const Camera& camera, const RenderOptions& options, const std::vector<Vector3f>& positions,
                       const std::vector<std::uint8_t>& skip, const PixelRect& rect, Frame& frame) const {
  const std::vector<Vector3> all_positions = withMeans(mesh_, positions);
  const std::vector<std::uint8_t> hidden = hiddenCells(*grid_, mesh_, skip);
  const Job job{camera, options, rect, positions, all_positions, hidden};
  if (grid_->isTextured())
    return drawTexture(job, frame);
  if (grid_->cell_scalars.empty())
    return drawPointScalars(job, frame);
  drawCellScalars(job, frame);
}

}  // namespace soft_volume::core
