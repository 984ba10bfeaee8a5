#include "native_canvas.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "light.h"
#include "mipmap.h"
#include "native_tile.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/cell_shape.h"
#include "vertex_gradients.h"

namespace soft_volume::core {
namespace {

/// Entries of the transfer function by which a scalar may be off where it is taken as linear in a cell.
constexpr float kLinearEntries = 0.25F;
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

int floorDivide(int a, int b) {
  return a >= 0 ? a / b : -((b - 1 - a) / b);
}

constexpr std::array<std::uint8_t, 8> kHexahedronPlaces = {0, 1, 3, 2, 4, 5, 7, 6};  ///< u + 2 v + 4 w of each corner
constexpr std::array<std::uint8_t, 8> kVoxelPlaces = {0, 1, 2, 3, 4, 5, 6, 7};

/// Corners of a cell in the unit cube.
const std::array<std::uint8_t, 8>& placesOf(CellType type) {
  return type == CellType::kVoxel ? kVoxelPlaces : kHexahedronPlaces;
}

/// An edge of the unit cube: where it begins and along which axis it runs.
struct CubeEdge {
  std::uint8_t first;          ///< vertex of the cell
  std::array<float, 3> begin;  ///< its place
  std::uint8_t axis;
};

std::array<CubeEdge, 12> cubeEdges(CellType type) {
  const CellShape& shape = shapeOf(type);
  std::array<CubeEdge, 12> edges{};
  for (std::size_t e = 0; e < edges.size(); ++e) {
    const int from = placesOf(type)[shape.edges[e][0]];
    const int to = placesOf(type)[shape.edges[e][1]];
    const int axis = (from ^ to) == 1 ? 0 : ((from ^ to) == 2 ? 1 : 2);
    edges[e] = {shape.edges[e][0], {float(from & 1), float(from >> 1 & 1), float(from >> 2)}, std::uint8_t(axis)};
  }
  return edges;
}

const std::array<CubeEdge, 12>& cubeEdgesOf(CellType type) {
  static const std::array<CubeEdge, 12> kHexahedron = cubeEdges(CellType::kHexahedron);
  static const std::array<CubeEdge, 12> kVoxel = cubeEdges(CellType::kVoxel);
  return type == CellType::kVoxel ? kVoxel : kHexahedron;
}

/// Of the trilinear polynomial through eight scalars: 1, u, v, w, uv, uw, vw, uvw.
std::array<float, 8> trilinearCoefficients(CellType type, const std::uint32_t* cell,
                                           const std::vector<float>& scalars) {
  const std::array<std::uint8_t, 8>& places = placesOf(type);
  std::array<float, 8> s{};
  for (std::size_t i = 0; i < 8; ++i)
    s[places[i]] = scalars[cell[i]];
  return {s[0],
          s[1] - s[0],
          s[2] - s[0],
          s[4] - s[0],
          s[3] - s[2] - s[1] + s[0],
          s[5] - s[4] - s[1] + s[0],
          s[6] - s[4] - s[2] + s[0],
          s[7] - s[6] - s[5] + s[4] - s[3] + s[2] + s[1] - s[0]};
}

bool isCube(CellType type) {
  return type == CellType::kHexahedron || type == CellType::kVoxel;
}

/// Red, green, blue and absorption, to be interpolated.
void toColour(const TransferTable& table, double scalar, float* colour) {
  if (std::isnan(scalar)) {
    std::fill_n(colour, 4, kNaN);
    return;
  }
  const double place = (scalar - table.firstValue()) * table.entriesPerValue();
  const auto entry = std::size_t(std::clamp(place, 0.0, double(TransferTable::kSize - 1)) + 0.5);
  const TransferTable::Entry& e = table.entries()[entry];
  std::copy_n(e.begin(), 4, colour);
}

/// Repeats the voxels of an axis that has but one: the kernel interpolates between two along each.
template <typename Texel>
void thicken(const Texel* from, const Vector3i& dims, const Vector3i& padded, std::vector<std::uint8_t>& to) {
  to.resize(std::size_t(padded.x()) * std::size_t(padded.y()) * std::size_t(padded.z()) * sizeof(Texel));
  auto* texel = reinterpret_cast<Texel*>(to.data());
  for (int k = 0; k < padded.z(); ++k) {
    for (int j = 0; j < padded.y(); ++j) {
      for (int i = 0; i < padded.x(); ++i) {
        const Vector3i voxel = Vector3i(i, j, k).cwiseMin(dims - Vector3i::Ones());
        *texel++ =
            from[std::size_t(voxel.x()) +
                 std::size_t(dims.x()) * (std::size_t(voxel.y()) + std::size_t(dims.y()) * std::size_t(voxel.z()))];
      }
    }
  }
}

void setDims(const Vector3i& dims, TexelView& view) {
  for (int axis = 0; axis < 3; ++axis)
    view.dims[axis] = dims[axis];
  view.row = std::size_t(dims.x());
  view.slice = view.row * std::size_t(dims.y());
}

TexelView texelView(const VolumeTexels& texels, const Vector3i& dims, std::vector<std::uint8_t>& padded_texels) {
  TexelView view{};
  view.texels = texels.data();
  view.type = texels.type() == GL_SHORT ? 0 : (texels.type() == GL_UNSIGNED_SHORT ? 1 : 2);
  const Vector3i padded = dims.cwiseMax(2);
  if (padded != dims) {
    if (view.type == 0)
      thicken(static_cast<const std::int16_t*>(texels.data()), dims, padded, padded_texels);
    else if (view.type == 1)
      thicken(static_cast<const std::uint16_t*>(texels.data()), dims, padded, padded_texels);
    else
      thicken(static_cast<const float*>(texels.data()), dims, padded, padded_texels);
    view.texels = padded_texels.data();
  }
  setDims(padded, view);
  return view;
}

/// The texels of an axis that interpolation can meet in a brick and its margin.
std::array<int, 2> brickTexels(int brick, int dim) {
  return {std::max(0, brick * kBrickTexels - kBrickMargin),
          std::min(dim, (brick + 1) * kBrickTexels + 1 + kBrickMargin)};
}

/// Smallest and largest texel that interpolation can meet in each brick and its margin: first of every column of a row
/// of bricks, then of the columns.
template <typename Texel>
std::vector<std::array<float, 2>> rangesOf(const TexelView& view, const std::array<int, 3>& bricks, int threads) {
  constexpr std::array<float, 2> kNone = {std::numeric_limits<float>::max(), std::numeric_limits<float>::lowest()};
  const std::size_t rows = std::size_t(bricks[1]) * std::size_t(bricks[2]);
  std::vector<std::array<float, 2>> ranges(std::size_t(bricks[0]) * rows, kNone);
  const auto* texels = static_cast<const Texel*>(view.texels);
  parallelFor(std::ptrdiff_t(rows), threads, [&](std::ptrdiff_t brick_row) {
    const std::array<int, 2> ys = brickTexels(int(brick_row) % bricks[1], view.dims[1]);
    const std::array<int, 2> zs = brickTexels(int(brick_row) / bricks[1], view.dims[2]);
    std::vector<float> low(view.row, kNone[0]);
    std::vector<float> high(view.row, kNone[1]);
    for (int k = zs[0]; k < zs[1]; ++k) {
      for (int j = ys[0]; j < ys[1]; ++j) {
        const Texel* row = texels + std::size_t(j) * view.row + std::size_t(k) * view.slice;
        for (std::size_t i = 0; i < view.row; ++i) {
          low[i] = std::min(low[i], float(row[i]));  // NaN changes neither
          high[i] = std::max(high[i], float(row[i]));
        }
      }
    }
    for (int brick = 0; brick < bricks[0]; ++brick) {
      const std::array<int, 2> xs = brickTexels(brick, view.dims[0]);
      ranges[std::size_t(brick_row) * std::size_t(bricks[0]) + std::size_t(brick)] = {
          *std::min_element(low.begin() + xs[0], low.begin() + xs[1]),
          *std::max_element(high.begin() + xs[0], high.begin() + xs[1])};
    }
  });
  return ranges;
}

/// Spreads marks to the neighbours along one axis.
void spread(const std::array<int, 3>& bricks, std::size_t axis, std::vector<std::uint8_t>& marks) {
  const std::vector<std::uint8_t> before = marks;
  const std::array<int, 3> strides = {1, bricks[0], bricks[0] * bricks[1]};
  for (std::size_t brick = 0; brick < marks.size(); ++brick) {
    const int at = int(brick) / strides[axis] % bricks[axis];
    if (at > 0)
      marks[brick] = std::uint8_t(marks[brick] | before[brick - std::size_t(strides[axis])]);
    if (at + 1 < bricks[axis])
      marks[brick] = std::uint8_t(marks[brick] | before[brick + std::size_t(strides[axis])]);
  }
}

std::vector<std::uint16_t> labelsOf(const Volume& volume) {
  const Vector3i& dims = volume.geometry().dims;
  std::vector<std::uint16_t> labels;
  labels.reserve(volume.geometry().voxelCount());
  for (int k = 0; k < dims.z(); ++k) {
    for (int j = 0; j < dims.y(); ++j) {
      for (int i = 0; i < dims.x(); ++i) {
        const double label = volume.at(i, j, k);
        labels.push_back(label > 0.0 ? std::uint16_t(std::min(label, 65535.0)) : std::uint16_t(0));
      }
    }
  }
  return labels;
}

}  // namespace

NativeCanvas::NativeCanvas(const NativeKernel& kernel) : kernel_(kernel) {}
NativeCanvas::~NativeCanvas() = default;

std::string NativeCanvas::driver() const {
  return "native";
}

void NativeCanvas::setVolume(const Volume& volume) {
  if (volume.geometry().voxelCount() > std::numeric_limits<std::uint32_t>::max() / 2)
    throw InputError("the volume has more than 2^31 voxels; read it with a stride or a region of interest");
  texels_.emplace(volume);
  volume_geometry_ = volume.geometry();
  padded_texels_.clear();
  volume_view_ = texelView(*texels_, volume_geometry_.dims, padded_texels_);
  for (std::size_t axis = 0; axis < 3; ++axis)
    bricks_[axis] = (volume_view_.dims[axis] + kBrickTexels - 1) / kBrickTexels;
  const int threads = threadsFor(0);
  if (volume_view_.type == 0)
    brick_ranges_ = rangesOf<std::int16_t>(volume_view_, bricks_, threads);
  else if (volume_view_.type == 1)
    brick_ranges_ = rangesOf<std::uint16_t>(volume_view_, bricks_, threads);
  else
    brick_ranges_ = rangesOf<float>(volume_view_, bricks_, threads);
  brick_visible_.clear();
  mipmap_.clear();
  mipmap_texels_.clear();
}

template <typename Texel>
void NativeCanvas::makeMipmap(const Texel* texels) {
  const Vector3i all = volume_geometry_.dims;
  Vector3i dims = all;
  std::vector<Texel> level;
  while (dims.maxCoeff() > 1) {
    level = halveVolume(level.empty() ? texels : level.data(), dims);
    dims = halvedDims(dims);
    const Vector3i padded = dims.cwiseMax(2);
    TexelView view{};
    view.type = volume_view_.type;
    setDims(padded, view);
    for (int axis = 0; axis < 3; ++axis) {
      view.per_voxel[axis] = float(dims[axis]) / float(all[axis]);
      view.offset[axis] = 0.5F * view.per_voxel[axis] - 0.5F;
    }
    thicken(level.data(), dims, padded, mipmap_texels_.emplace_back());
    view.texels = mipmap_texels_.back().data();
    mipmap_.push_back(view);
  }
}

/// The coarser levels are used where a plane lies so far away that pixels are wider than voxels. What a pixel gets
/// depends on its depth alone, not on whether the other planes need a mipmap.
void NativeCanvas::prepareMipmap() {
  volume_view_.coarser_levels = 0;
  if (kind_ != SampleKind::kTexture)
    return;
  if (!texture_per_m_) {
    VertexGradients gradients;
    gradients.setGrid(*grid_);
    texture_per_m_ = gradients.meanOfTexture(threads_);
  }
  const SlicePlanes& planes = job_->planes;
  const bool perspective = job_->camera.projection == Projection::kPerspective;
  const double farthest_m = planes.depth(planes.count);
  const double width = pixelWidth(job_->camera, volume_geometry_.dims, *texture_per_m_);
  if (!(width * (perspective ? farthest_m : 1.0) > 1.0))
    return;
  if (mipmap_.empty() && volume_view_.type == 0)
    makeMipmap(static_cast<const std::int16_t*>(texels_->data()));
  else if (mipmap_.empty() && volume_view_.type == 1)
    makeMipmap(static_cast<const std::uint16_t*>(texels_->data()));
  else if (mipmap_.empty())
    makeMipmap(static_cast<const float*>(texels_->data()));
  volume_view_.coarser = mipmap_.data();
  volume_view_.coarser_levels = int(mipmap_.size());
  volume_view_.pixel_width = perspective ? 0.0F : float(width);
  volume_view_.pixel_width_per_depth = perspective ? float(width) : 0.0F;
}

/// Bricks that show something, for the distance of the planes. A deformation may press more voxels between two planes:
/// up to twice as many are provided for.
void NativeCanvas::findVisibleBricks() {
  volume_view_.visible = nullptr;
  if (kind_ != SampleKind::kTexture)
    return;
  if (brick_visible_.empty()) {
    for (const auto& range : brick_ranges_)
      brick_visible_.push_back(range[0] <= range[1] && !table_->isTransparent(range[0], range[1]));
    around_visible_ = brick_visible_;
    for (std::size_t axis = 0; axis < 3; ++axis)
      spread(bricks_, axis, around_visible_);
  }
  const double way = job_->planes.distance_m / volume_geometry_.spacing_m.minCoeff();
  if (way <= kBrickMargin)
    volume_view_.visible = brick_visible_.data();
  else if (way <= kBrickMargin + kBrickTexels)
    volume_view_.visible = around_visible_.data();
  volume_view_.brick_row = bricks_[0];
  volume_view_.brick_slice = bricks_[0] * bricks_[1];
}

void NativeCanvas::setLabels(const Volume* labels) {
  labels_.clear();
  label_view_ = {};
  if (labels == nullptr)
    return;
  labels_ = labelsOf(*labels);
  for (int axis = 0; axis < 3; ++axis)
    label_view_.dims[axis] = labels->geometry().dims[axis];
}

void NativeCanvas::setTable(const TransferTable& table) {
  table_ = &table;
  brick_visible_.clear();
}

void NativeCanvas::setGrid(const DrawnGrid& grid) {
  grid_ = &grid;
  boundary_known_ = false;
  texture_per_m_.reset();
}

SampleKind NativeCanvas::kind() const {
  if (grid_->isTextured())
    return SampleKind::kTexture;
  if (!grid_->cell_scalars.empty() || job_->options.lookup == Lookup::kColour)
    return SampleKind::kColour;
  return SampleKind::kScalar;
}

/// Colours per vertex, or per cell where the scalars are.
void NativeCanvas::prepareColours() {
  colours_.clear();
  if (kind_ != SampleKind::kColour)
    return;
  const std::vector<float>& scalars = grid_->cell_scalars.empty() ? grid_->point_scalars : grid_->cell_scalars;
  colours_.resize(scalars.size() * 4);
  parallelFor(std::ptrdiff_t(scalars.size()), threads_,
              [&](std::ptrdiff_t i) { toColour(*table_, scalars[std::size_t(i)], &colours_[std::size_t(i) * 4]); });
}

void NativeCanvas::prepareTiles() {
  const PixelRect& rect = job_->rect;
  first_tile_x_ = floorDivide(rect.begin_x, kTileWidth);
  first_tile_y_ = floorDivide(rect.begin_y, kTileHeight);
  tiles_x_ = rect.empty() ? 0 : floorDivide(rect.end_x - 1, kTileWidth) + 1 - first_tile_x_;
  tiles_y_ = rect.empty() ? 0 : floorDivide(rect.end_y - 1, kTileHeight) + 1 - first_tile_y_;
  tiles_.resize(tileCount());
  for (std::size_t i = 0; i < tileCount(); ++i) {
    Tile& tile = tiles_[i];
    tile.x = (first_tile_x_ + int(i) % tiles_x_) * kTileWidth;
    tile.y = (first_tile_y_ + int(i) / tiles_x_) * kTileHeight;
    tile.opaque = true;
    tile.blank = true;
    tile.segments = 0;
    tile.event_layers = 0;
    for (int block = 0; block < kTileBlocks; ++block) {
      const bool wanted = isWanted(tile, block);
      tile.blocks[std::size_t(block)] = wanted ? kBlockOutside : kBlockOpaque;
      tile.opaque = tile.opaque && !wanted;
    }
  }
}

/// Whether a block of a tile has pixels to draw.
bool NativeCanvas::isWanted(const Tile& tile, int block) const {
  const PixelRect& rect = job_->rect;
  const int x = tile.x + block * kPixelLanes % kTileWidth;
  const int y = tile.y + block * kPixelLanes / kTileWidth;
  return y >= rect.begin_y && y < rect.end_y && x < rect.end_x && x + kPixelLanes > rect.begin_x &&
         (job_->changed == nullptr || job_->changed->has(x, y));
}

/// Rays that have met nothing. What they keep of the last sample means nothing as long as that is not a number.
void NativeCanvas::startTile(Tile& tile) const {
  tile.blank = false;
  tile.floats.resize(11 * std::size_t(kTilePixels));
  std::fill_n(tile.array(0), 4 * kTilePixels, 0.0F);
  std::fill_n(tile.array(kind_ == SampleKind::kScalar ? 4 : 7), kTilePixels, kNaN);
  if (job_->options.depth)
    std::fill_n(tile.array(10), kTilePixels, kNaN);
  tile.labels.assign(job_->options.labels ? kTilePixels : 0, 0);
}

void NativeCanvas::prepareJob() {
  const Camera& camera = job_->camera;
  const RenderOptions& options = job_->options;
  base_ = {};
  base_.kind = kind_;
  base_.perspective = camera.projection == Projection::kPerspective;
  base_.cx = float(camera.cx);
  base_.cy = float(camera.cy);
  base_.slope_x = base_.perspective ? float(1.0 / camera.fx) : 0.0F;
  base_.slope_y = base_.perspective ? float(1.0 / camera.fy) : 0.0F;
  base_.pixel_x = float(camera.fx);
  base_.pixel_y = float(camera.fy);
  base_.distance = float(job_->planes.distance_m);
  base_.table = {table_->entries().front().data(), table_->integrals().front().data(), float(table_->firstValue()),
                 float(table_->entriesPerValue()), TransferTable::kSize};
  base_.volume = volume_view_;
  base_.labels = label_view_;
  base_.labels.labels = labels_.empty() ? nullptr : labels_.data();
  for (int axis = 0; axis < 3; ++axis) {
    base_.labels.per_voxel[axis] = float(label_view_.dims[axis]) / float(volume_geometry_.dims[axis]);
    base_.labels.offset[axis] = 0.5F * base_.labels.per_voxel[axis] - 0.5F;
  }
  base_.shading = float(options.shading);
  base_.specular = float(options.specular);
  const Vector3f light = lightDirection();
  const Vector3f half_way = (light + Vector3f(0.0F, 0.0F, -1.0F)).normalized();
  for (int axis = 0; axis < 3; ++axis) {
    base_.light[axis] = light[axis];
    base_.half_way[axis] = half_way[axis];
  }
  base_.edge_scale = kEdgesPerRange * float(table_->entriesPerValue()) / float(TransferTable::kSize);
  base_.normal_step = grid_->isTextured() ? float(std::cbrt(volume_geometry_.spacing_m.prod())) : base_.distance;
  for (int axis = 0; axis < 3; ++axis)
    base_.spacing[axis] = float(volume_geometry_.spacing_m[axis]);
  base_.depth_threshold = float(options.depth_threshold);
  base_.jitter = options.jitter;
  base_.cross_section = job_->cross_section;
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  base_.clips = int(options.clip_planes.size());
  for (std::size_t n = 0; n < options.clip_planes.size(); ++n) {
    const ClipPlane& plane = options.clip_planes[n];
    const Vector3 normal = T_camera_volume.orientation * plane.normal;
    for (int axis = 0; axis < 3; ++axis)
      base_.clip[n][axis] = float(normal[axis]);
    base_.clip[n][3] = float(plane.offset_m - plane.normal.dot(camera.T_volume_camera.position_m));
  }
  // Behind far there are no planes, but the exits of exact boundaries are.
  const auto far_m = float(camera.far_m);
  if (options.exact_boundary &&
      std::any_of(job_->positions.begin(), job_->positions.end(), [&](const Vector3f& p) { return p.z() > far_m; })) {
    float* far_plane = base_.clip[base_.clips++];
    far_plane[2] = 1.0F;
    far_plane[3] = far_m;
  }
}

void NativeCanvas::begin(const DrawJob& job) {
  job_ = &job;
  kind_ = kind();
  threads_ = threadsFor(job.options.threads);
  scratch_.resize(std::size_t(threads_));
  for (Scratch& scratch : scratch_)
    scratch.samples.resize(samplePartsOf(kind_) * kRunPlanes * kPlaneSamples);
  polygons_ = 0;
  slices_ = 0;
  prepareColours();
  findVisibleBricks();
  prepareMipmap();
  prepareTiles();
  prepareJob();
  if (job.options.exact_boundary && !job.cross_section)
    prepareEvents();
}

void NativeCanvas::valuesAtVertex(std::uint32_t vertex, float* values) const {
  if (kind_ == SampleKind::kTexture) {
    for (int axis = 0; axis < 3; ++axis)
      values[axis] = grid_->texture[vertex][axis] * float(volume_geometry_.dims[axis]) - 0.5F;
  } else if (kind_ == SampleKind::kColour) {
    std::copy_n(&colours_[std::size_t(vertex) * 4], 4, values);
  } else {
    values[0] = grid_->point_scalars[vertex];
  }
}

/// What every corner of the run's polygons is interpolated from.
void NativeCanvas::prepareValues(const SliceMesh& mesh) {
  const std::size_t count = samplePartsOf(kind_);
  if (kind_ == SampleKind::kColour && !grid_->cell_scalars.empty())
    return;  // constant in the cells
  values_.resize(mesh.vertices.size() * count);
  parallelFor(std::ptrdiff_t(mesh.vertices.size()), threads_, [&](std::ptrdiff_t i) {
    const SliceVertex& vertex = mesh.vertices[std::size_t(i)];
    std::array<float, kMaxAttributes> a{};
    std::array<float, kMaxAttributes> b{};
    valuesAtVertex(vertex.a, a.data());
    valuesAtVertex(vertex.b, b.data());
    for (std::size_t n = 0; n < count; ++n)
      values_[std::size_t(i) * count + n] = a[n] + vertex.t * (b[n] - a[n]);
  });
}

/// Pixels beyond a tile that are filled, too: normals come from the differences of neighbours.
int NativeCanvas::apron() const {
  return base_.shading > 0.0F ? kApron : 0;
}

/// The polygons of every tile, in their order.
void NativeCanvas::binPolygons(const SliceMesh& mesh, std::size_t first_slice, std::size_t end_slice) {
  const std::size_t first = mesh.slices[first_slice].first_polygon;
  const std::size_t end = mesh.slices[end_slice - 1].first_polygon + mesh.slices[end_slice - 1].polygon_count;
  polygon_tiles_.resize(end - first);
  const auto around = float(apron());
  parallelFor(std::ptrdiff_t(end - first), threads_, [&](std::ptrdiff_t i) {
    const SlicePolygon& polygon = mesh.polygons[first + std::size_t(i)];
    Eigen::AlignedBox2f box;
    for (std::uint32_t n = polygon.first; n < polygon.first + polygon.size; ++n) {
      const SliceVertex& vertex = mesh.vertices[mesh.corners[n]];
      box.extend(Eigen::Vector2f(vertex.u, vertex.v));
    }
    const auto tile = [](float pixel, int size, int first_tile, int count) {
      const float place = std::floor(pixel / float(size)) - float(first_tile);
      return std::int16_t(std::clamp(place, -1.0F, float(count)));
    };
    polygon_tiles_[std::size_t(i)] = {
        std::max<std::int16_t>(0, tile(box.min().x() - around, kTileWidth, first_tile_x_, tiles_x_)),
        std::min<std::int16_t>(std::int16_t(tiles_x_ - 1),
                               tile(box.max().x() + around, kTileWidth, first_tile_x_, tiles_x_)),
        std::max<std::int16_t>(0, tile(box.min().y() - around, kTileHeight, first_tile_y_, tiles_y_)),
        std::min<std::int16_t>(std::int16_t(tiles_y_ - 1),
                               tile(box.max().y() + around, kTileHeight, first_tile_y_, tiles_y_))};
  });
  const auto forEachTile = [&](const auto& visit) {
    for (std::size_t i = 0; i < polygon_tiles_.size(); ++i) {
      const auto& range = polygon_tiles_[i];
      for (int y = range[2]; y <= range[3]; ++y) {
        for (int x = range[0]; x <= range[1]; ++x)
          visit(std::size_t(y) * std::size_t(tiles_x_) + std::size_t(x), std::uint32_t(first + i));
      }
    }
  };
  bin_begin_.assign(tileCount() + 1, 0);
  forEachTile([&](std::size_t tile, std::uint32_t) { ++bin_begin_[tile + 1]; });
  for (std::size_t tile = 1; tile < bin_begin_.size(); ++tile)
    bin_begin_[tile] += bin_begin_[tile - 1];
  bins_.resize(bin_begin_.back());
  bin_next_.assign(bin_begin_.begin(), bin_begin_.end() - 1);
  forEachTile([&](std::size_t tile, std::uint32_t polygon) { bins_[bin_next_[tile]++] = polygon; });
}

FillCorner NativeCanvas::cornerAt(const SliceMesh& mesh, const SlicePolygon& polygon, std::size_t corner) const {
  const std::uint32_t number = mesh.corners[polygon.first + corner];
  const SliceVertex& vertex = mesh.vertices[number];
  FillCorner filled{vertex.u, vertex.v, {}};
  const std::size_t count = samplePartsOf(kind_);
  const bool constant = kind_ == SampleKind::kColour && !grid_->cell_scalars.empty();
  std::copy_n(constant ? &colours_[std::size_t(polygon.cell) * 4] : &values_[std::size_t(number) * count], count,
              filled.value);
  return filled;
}

/// The corners' places in the cell, from which the scalar is interpolated.
void NativeCanvas::setTrilinearCorners(const SliceMesh& mesh, const SlicePolygon& polygon, FillCorner* corners) const {
  const std::uint32_t* cell = &grid_->connectivity[grid_->cell_offsets[polygon.cell]];
  const std::array<CubeEdge, 12>& edges = cubeEdgesOf(grid_->cell_types[polygon.cell]);
  for (std::uint32_t n = 0; n < polygon.size; ++n) {
    const SliceVertex& vertex = mesh.vertices[mesh.corners[polygon.first + n]];
    const CubeEdge& edge = edges[mesh.edges[polygon.first + n]];
    const float way = cell[edge.first] == vertex.a ? vertex.t : 1.0F - vertex.t;
    corners[n] = {vertex.u, vertex.v, {edge.begin[0], edge.begin[1], edge.begin[2]}};
    corners[n].value[edge.axis] = edge.begin[edge.axis] == 0.0F ? way : 1.0F - way;
  }
}

/// In most cells the scalar is as good as linear: what is interpolated between the corners is the scalar itself then.
bool NativeCanvas::isTrilinear(const std::array<float, 8>& coefficients) const {
  const float bend =
      std::abs(coefficients[4]) + std::abs(coefficients[5]) + std::abs(coefficients[6]) + std::abs(coefficients[7]);
  return bend * base_.table.entries_per_value > kLinearEntries;
}

void NativeCanvas::fillPolygon(const SliceMesh& mesh, std::uint32_t number, const FillTarget& target,
                               Scratch& scratch) const {
  const SlicePolygon& polygon = mesh.polygons[number];
  scratch.reserveCorners(polygon.size);
  const CellType type = grid_->cell_types[polygon.cell];
  FillCorner* corners = scratch.corners.data();
  if (kind_ == SampleKind::kScalar && isCube(type)) {
    const std::uint32_t* cell = &grid_->connectivity[grid_->cell_offsets[polygon.cell]];
    const std::array<float, 8> coefficients = trilinearCoefficients(type, cell, grid_->point_scalars);
    if (isTrilinear(coefficients)) {
      setTrilinearCorners(mesh, polygon, corners);
      kernel_.fill(target, corners, int(polygon.size), 3, coefficients.data(), scratch.crossings.data());
      return;
    }
  }
  for (std::uint32_t n = 0; n < polygon.size; ++n)
    corners[n] = cornerAt(mesh, polygon, n);
  kernel_.fill(target, corners, int(polygon.size), int(samplePartsOf(kind_)), nullptr, scratch.crossings.data());
}

void NativeCanvas::composite(Tile& tile, CompositeJob& job, const Scratch& scratch) const {
  job.tile_x = tile.x;
  job.tile_y = tile.y;
  const PixelRect& rect = job_->rect;
  job.begin_x = std::max(tile.x, rect.begin_x);
  job.end_x = std::min(tile.x + kTileWidth, rect.end_x);
  job.begin_y = std::max(tile.y, rect.begin_y);
  job.end_y = std::min(tile.y + kTileHeight, rect.end_y);
  job.hits = scratch.hits.data();
  for (std::size_t n = 0; n < samplePartsOf(kind_); ++n)
    job.sample[n] = scratch.sampleAt(n);
  if (tile.event_layers > 0) {
    job.events.z = tile.event_z.data();
    for (std::size_t n = 0; n < kMaxSampleParts; ++n)
      job.events.sample[n] = tile.event_sample[n].data();
    job.events.entering = tile.event_entering.data();
    job.events.count = tile.event_layers;
    job.events.next = tile.event_next.data();
  }
  const PixelState state = tile.state(job_->options.depth);
  tile.segments += kernel_.composite(job, state);
  tile.opaque =
      std::all_of(tile.blocks.begin(), tile.blocks.end(), [](std::uint8_t block) { return block == kBlockOpaque; });
}

/// Samples are only needed where a ray can still see something, and around that for normals.
void NativeCanvas::setWindow(const Tile& tile, FillTarget& target) const {
  constexpr int kBlocks = kTileWidth / kPixelLanes;
  int first_x = kBlocks, last_x = -1, first_y = kTileHeight, last_y = -1;
  for (int block = 0; block < kTileBlocks; ++block) {
    if (tile.blocks[std::size_t(block)] == kBlockOpaque)
      continue;
    first_x = std::min(first_x, block % kBlocks);
    last_x = std::max(last_x, block % kBlocks);
    first_y = std::min(first_y, block / kBlocks);
    last_y = std::max(last_y, block / kBlocks);
  }
  target.begin_x = tile.x + first_x * kPixelLanes - apron();
  target.end_x = tile.x + (last_x + 1) * kPixelLanes + apron();
  target.begin_y = tile.y + first_y - apron();
  target.end_y = tile.y + last_y + 1 + apron();
}

void NativeCanvas::drawTile(const SliceMesh& mesh, Tile& tile, const std::uint32_t* polygons, std::size_t count,
                            std::size_t first_slice, std::size_t end_slice, bool last, Scratch& scratch) const {
  if (tile.opaque || (tile.blank && count == 0 && tile.event_layers == 0))
    return;
  if (tile.blank)
    startTile(tile);
  scratch.occupied.fill(0);
  scratch.hits.fill(0);
  std::size_t slice = first_slice;
  const std::size_t attributes = samplePartsOf(kind_);
  // The first part of a volume's sample tells whether there is one; only its gradient asks the others as well.
  const std::size_t blank = kind_ == SampleKind::kTexture && base_.shading <= 0.0F ? 1 : attributes;
  FillTarget target{};
  target.first_x = tile.x - kPixelLanes;
  target.first_y = tile.y - kApron;
  setWindow(tile, target);
  target.hits = scratch.hits.data();
  const std::size_t first_sample = std::size_t(target.begin_y - target.first_y) * kSampleStride;
  const std::size_t sample_count = std::size_t(target.end_y - target.begin_y) * kSampleStride;
  for (std::size_t n = 0; n < count; ++n) {
    while (polygons[n] >= mesh.slices[slice].first_polygon + mesh.slices[slice].polygon_count)
      ++slice;
    const std::size_t plane = slice - first_slice;
    if (scratch.occupied[plane] == 0) {
      scratch.occupied[plane] = 1;
      for (std::size_t a = 0; a < blank; ++a)
        std::fill_n(scratch.sampleAt(a, plane) + first_sample, sample_count, kNaN);
    }
    for (std::size_t a = 0; a < attributes; ++a)
      target.sample[a] = scratch.sampleAt(a, plane);
    target.plane = std::uint16_t(1U << plane);
    fillPolygon(mesh, polygons[n], target, scratch);
  }
  CompositeJob job = base_;
  std::array<float, kRunPlanes> z{};
  std::array<float, kRunPlanes> front{};
  std::array<float, kRunPlanes> back{};
  std::array<std::uint8_t, kRunPlanes> extra{};
  for (std::size_t n = 0; n < end_slice - first_slice; ++n) {
    const Slice& s = mesh.slices[first_slice + n];
    z[n] = s.z_m;
    front[n] = s.front_m;
    back[n] = s.back_m;
    extra[n] = std::uint8_t(s.extra);
  }
  job.planes = int(end_slice - first_slice);
  job.z = z.data();
  job.front = front.data();
  job.back = back.data();
  job.extra = extra.data();
  job.last = last;
  composite(tile, job, scratch);
}

void NativeCanvas::drawRun(const SliceMesh& mesh, std::size_t first_slice, std::size_t end_slice, bool last) {
  if (first_slice < end_slice)
    binPolygons(mesh, first_slice, end_slice);
  else
    bin_begin_.assign(tileCount() + 1, 0);
  parallelTasks(std::ptrdiff_t(tileCount()), threads_, [&](std::ptrdiff_t i, int worker) {
    const std::uint32_t* polygons = bins_.data() + bin_begin_[std::size_t(i)];
    const std::size_t count = bin_begin_[std::size_t(i) + 1] - bin_begin_[std::size_t(i)];
    drawTile(mesh, tiles_[std::size_t(i)], polygons, count, first_slice, end_slice, last,
             scratch_[std::size_t(worker)]);
  });
}

void NativeCanvas::draw(const SliceMesh& mesh) {
  if (tileCount() == 0)
    return;
  prepareValues(mesh);
  const std::size_t run = samplePartsOf(kind_) > 1 ? kRunPlanesOfParts : kRunPlanes;
  for (std::size_t first = 0; first < mesh.slices.size(); first += run)
    drawRun(mesh, first, std::min(first + run, mesh.slices.size()), false);
  polygons_ += mesh.polygons.size();
  slices_ += int(mesh.slices.size());
}

void NativeCanvas::copyTile(Tile& tile, Frame& frame) const {
  if (tile.blank)
    startTile(tile);
  const PixelState state = tile.state(job_->options.depth);
  for (int block = 0; block < kTileBlocks; ++block) {
    if (!isWanted(tile, block))
      continue;
    const int x = tile.x + block * kPixelLanes % kTileWidth;
    const int y = tile.y + block * kPixelLanes / kTileWidth;
    const int end_x = std::min(x + kPixelLanes, job_->rect.end_x);
    for (int at = std::max(x, job_->rect.begin_x); at < end_x; ++at) {
      const std::size_t from = std::size_t(block) * kPixelLanes + std::size_t(at - x);
      const std::size_t to = std::size_t(y) * std::size_t(frame.width) + std::size_t(at);
      for (std::size_t n = 0; n < 3; ++n)
        frame.rgba[to * 4 + n] = state.colour[n][from];
      frame.rgba[to * 4 + 3] = state.opacity[from];
      if (state.depth != nullptr)
        frame.depth_m[to] = state.depth[from];
      if (state.label != nullptr)
        frame.labels[to] = state.label[from];
    }
  }
}

void NativeCanvas::finish(Frame& frame) {
  if (tileCount() > 0 && !job_->cross_section)
    drawRun({}, 0, 0, true);
  frame.polygons = polygons_;
  frame.slices = slices_;
  frame.fragments = 0;
  for (const Tile& tile : tiles_)
    frame.fragments += tile.segments;
  parallelTasks(std::ptrdiff_t(tileCount()), threads_,
                [&](std::ptrdiff_t i, int) { copyTile(tiles_[std::size_t(i)], frame); });
  job_ = nullptr;
}

}  // namespace soft_volume::core
