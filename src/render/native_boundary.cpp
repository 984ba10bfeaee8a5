// Exact entry and exit depths: the faces between drawn cells and everything else, rasterised into a list per pixel.

#include <algorithm>
#include <limits>

#include "native_canvas.h"
#include "native_tile.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

Vector3f centreOf(const std::vector<std::uint32_t>& vertices, const std::vector<Vector3f>& positions) {
  Vector3f sum = Vector3f::Zero();
  for (const std::uint32_t vertex : vertices)
    sum += positions[vertex];
  return sum / float(std::max<std::size_t>(1, vertices.size()));
}

}  // namespace

/// A point of a face, camera frame, and what is interpolated there.
struct NativeCanvas::FaceCorner {
  Vector3f position;
  std::array<float, kMaxSampleParts> values;
};

/// One triangle, cut at the near plane. Under perspective what is interpolated is divided by the depth.
struct NativeCanvas::ScreenFace {
  std::array<FillCorner, 4> corners;
  int size;
  bool entering;
};

/// The faces of drawn cells that no other drawn cell shares.
void NativeCanvas::findBoundary() {
  if (boundary_known_ && boundary_skip_ == job_->skip)
    return;
  boundary_known_ = true;
  boundary_skip_ = job_->skip;
  std::vector<std::uint32_t> drawn;
  std::vector<CellType> types;
  std::vector<std::uint32_t> offsets(1, 0);
  std::vector<std::uint32_t> connectivity;
  for (std::uint32_t cell = 0; cell < grid_->cellCount(); ++cell) {
    if (!boundary_skip_.empty() && boundary_skip_[cell] != 0)
      continue;
    drawn.push_back(cell);
    types.push_back(grid_->cell_types[cell]);
    connectivity.insert(connectivity.end(), grid_->connectivity.begin() + grid_->cell_offsets[cell],
                        grid_->connectivity.begin() + grid_->cell_offsets[cell + 1]);
    offsets.push_back(std::uint32_t(connectivity.size()));
  }
  boundary_ = boundaryFaces(types, offsets, connectivity);
  for (GridFace& face : boundary_)
    face.cell = drawn[face.cell];
}

FillCorner NativeCanvas::screenCorner(const Vector3f& position, const float* values) const {
  const Eigen::Vector2d pixel = job_->camera.project(position.cast<double>());
  FillCorner corner{float(pixel.x()), float(pixel.y()), {}};
  const float scale = base_.perspective ? 1.0F / position.z() : 1.0F;
  corner.value[0] = base_.perspective ? scale : position.z();
  for (std::size_t n = 0; n < samplePartsOf(kind_); ++n)
    corner.value[n + 1] = values[n] * scale;
  return corner;
}

NativeCanvas::FaceCorner NativeCanvas::faceCorner(std::uint32_t vertex, std::uint32_t cell) const {
  FaceCorner corner{job_->positions[vertex], {}};
  if (kind_ == SampleKind::kColour && !grid_->cell_scalars.empty())
    std::copy_n(&colours_[std::size_t(cell) * 4], 4, corner.values.data());
  else
    valuesAtVertex(vertex, corner.values.data());
  return corner;
}

void NativeCanvas::addScreenTriangle(const std::array<FaceCorner, 3>& triangle, const Vector3f& cell_centre,
                                     std::vector<ScreenFace>& faces) const {
  const Vector3f normal =
      (triangle[1].position - triangle[0].position).cross(triangle[2].position - triangle[0].position);
  const Vector3f middle = (triangle[0].position + triangle[1].position + triangle[2].position) / 3.0F;
  const Vector3f ray = base_.perspective ? middle : Vector3f::UnitZ();
  const float inwards = normal.dot(cell_centre - triangle[0].position);
  const float along = normal.dot(ray);
  if (along == 0.0F || inwards == 0.0F)
    return;  // seen edge-on, or a cell without volume
  ScreenFace face{};
  face.entering = (along > 0.0F) == (inwards > 0.0F);
  const auto near_m = float(job_->camera.near_m);
  for (std::size_t i = 0; i < 3; ++i) {
    const FaceCorner& here = triangle[i];
    const FaceCorner& next = triangle[(i + 1) % 3];
    if (here.position.z() >= near_m)
      face.corners[std::size_t(face.size++)] = screenCorner(here.position, here.values.data());
    if ((here.position.z() >= near_m) == (next.position.z() >= near_m))
      continue;
    const float t = (near_m - here.position.z()) / (next.position.z() - here.position.z());
    Vector3f cut = here.position + t * (next.position - here.position);
    cut.z() = near_m;
    std::array<float, kMaxSampleParts> mixed{};
    for (std::size_t n = 0; n < mixed.size(); ++n)
      mixed[n] = here.values[n] + t * (next.values[n] - here.values[n]);
    face.corners[std::size_t(face.size++)] = screenCorner(cut, mixed.data());
  }
  if (face.size >= 3)
    faces.push_back(face);
}

/// Triangles around the middle of the face, as the exact back end parts it (a quadrilateral is bilinear there). Corners
/// are summed from the lowest vertex on, so that both cells at a face would draw the same triangles but for rounding.
void NativeCanvas::addScreenFaces(const GridFace& face, std::vector<ScreenFace>& faces) const {
  const std::uint32_t* cell = &grid_->connectivity[grid_->cell_offsets[face.cell]];
  std::vector<std::uint32_t> corners;
  std::vector<std::uint32_t> all;
  forEachFace(grid_->cell_types[face.cell], cell,
              [&](std::size_t number, const std::uint32_t* vertices, std::size_t size) {
                all.insert(all.end(), vertices, vertices + size);
                if (number == face.face)
                  corners.assign(vertices, vertices + size);
              });
  const Vector3f centre = centreOf(all, job_->positions);
  std::rotate(corners.begin(), std::min_element(corners.begin(), corners.end()), corners.end());
  std::vector<FaceCorner> around;
  FaceCorner middle{Vector3f::Zero(), {}};
  for (const std::uint32_t vertex : corners) {
    around.push_back(faceCorner(vertex, face.cell));
    const float share = 1.0F / float(corners.size());
    middle.position += share * around.back().position;
    for (std::size_t n = 0; n < middle.values.size(); ++n)
      middle.values[n] += share * around.back().values[n];
  }
  if (around.size() == 3)
    return addScreenTriangle({around[0], around[1], around[2]}, centre, faces);
  for (std::size_t i = 0; i < around.size(); ++i)
    addScreenTriangle({around[i], around[(i + 1) % around.size()], middle}, centre, faces);
}

/// Sorts what a face shows in this tile into the lists of its pixels.
void NativeCanvas::placeEvents(Tile& tile, const std::vector<ScreenFace>& faces, const std::uint32_t* numbers,
                               std::size_t count, Scratch& scratch) const {
  const std::size_t parts = samplePartsOf(kind_);
  std::vector<int> lengths(kTilePixels, 0);
  const auto addLayer = [&] {
    const std::size_t size = std::size_t(++tile.event_layers) * kTilePixels;
    tile.event_z.resize(size);
    std::fill_n(&tile.event_z[size - kTilePixels], kTilePixels, kInfinity);
    tile.event_entering.resize(size);
    for (std::size_t n = 0; n < parts; ++n)
      tile.event_sample[n].resize(size);
  };
  tile.event_layers = 0;
  addLayer();
  FillTarget target{};
  target.first_x = tile.x - kPixelLanes;
  target.first_y = tile.y - kApron;
  target.begin_x = tile.x;
  target.end_x = tile.x + kTileWidth;
  target.begin_y = tile.y;
  target.end_y = tile.y + kTileHeight;
  for (std::size_t n = 0; n <= parts; ++n)
    target.sample[n] = scratch.face.data() + n * kPlaneSamples;
  for (std::size_t i = 0; i < count; ++i) {
    const ScreenFace& face = faces[numbers[i]];
    Eigen::AlignedBox2f box;
    for (int n = 0; n < face.size; ++n)
      box.extend(Eigen::Vector2f(face.corners[std::size_t(n)].x, face.corners[std::size_t(n)].y));
    const auto inTile = [](float pixel, int begin, int size) {
      return int(std::clamp(pixel, float(begin), float(begin + size - 1)));
    };
    const int begin_x = inTile(box.min().x(), tile.x, kTileWidth);
    const int end_x = inTile(box.max().x(), tile.x, kTileWidth) + 1;
    const int begin_y = inTile(box.min().y(), tile.y, kTileHeight);
    const int end_y = inTile(box.max().y(), tile.y, kTileHeight) + 1;
    const auto at = [&](int x, int y) {
      return std::size_t(y - target.first_y) * kSampleStride + std::size_t(x - target.first_x);
    };
    for (int y = begin_y; y < end_y; ++y)
      std::fill_n(target.sample[0] + at(begin_x, y), end_x - begin_x, kNaN);
    scratch.reserveCorners(4);
    kernel_.fill(target, face.corners.data(), face.size, int(parts) + 1, nullptr, scratch.crossings.data());
    for (int y = begin_y; y < end_y; ++y) {
      for (int x = begin_x; x < end_x; ++x) {
        const float depth = target.sample[0][at(x, y)];
        if (!(depth > 0.0F))
          continue;
        const float z = base_.perspective ? 1.0F / depth : depth;
        const std::size_t pixel = std::size_t(y - tile.y) * kTileWidth + std::size_t(x - tile.x);
        const auto place = [&](int layer) { return std::size_t(layer) * kTilePixels + pixel; };
        int layer = lengths[pixel]++;
        if (lengths[pixel] == tile.event_layers)
          addLayer();
        // At equal depths the exits come first.
        const auto isBehind = [&](std::size_t other) {
          return tile.event_z[other] > z ||
                 (tile.event_z[other] == z && tile.event_entering[other] != 0 && !face.entering);
        };
        for (; layer > 0 && isBehind(place(layer - 1)); --layer) {
          tile.event_z[place(layer)] = tile.event_z[place(layer - 1)];
          tile.event_entering[place(layer)] = tile.event_entering[place(layer - 1)];
          for (std::size_t n = 0; n < parts; ++n)
            tile.event_sample[n][place(layer)] = tile.event_sample[n][place(layer - 1)];
        }
        tile.event_z[place(layer)] = z;
        tile.event_entering[place(layer)] = std::uint8_t(face.entering);
        for (std::size_t n = 0; n < parts; ++n) {
          const float value = target.sample[n + 1][at(x, y)];
          tile.event_sample[n][place(layer)] = base_.perspective ? value * z : value;
        }
      }
    }
  }
  tile.event_next.assign(kTilePixels, 0);
}

void NativeCanvas::prepareEvents() {
  findBoundary();
  if (tileCount() == 0)
    return;
  std::vector<ScreenFace> faces;
  for (const GridFace& face : boundary_)
    addScreenFaces(face, faces);
  const auto tileOf = [](float pixel, int size, int first, int count) {
    return int(std::clamp(std::floor(pixel / float(size)) - float(first), -1.0F, float(count)));
  };
  std::vector<std::vector<std::uint32_t>> bins(tileCount());
  for (std::size_t i = 0; i < faces.size(); ++i) {
    Eigen::AlignedBox2f box;
    for (int n = 0; n < faces[i].size; ++n)
      box.extend(Eigen::Vector2f(faces[i].corners[std::size_t(n)].x, faces[i].corners[std::size_t(n)].y));
    const int begin_x = std::max(0, tileOf(box.min().x(), kTileWidth, first_tile_x_, tiles_x_));
    const int end_x = std::min(tiles_x_ - 1, tileOf(box.max().x(), kTileWidth, first_tile_x_, tiles_x_));
    const int begin_y = std::max(0, tileOf(box.min().y(), kTileHeight, first_tile_y_, tiles_y_));
    const int end_y = std::min(tiles_y_ - 1, tileOf(box.max().y(), kTileHeight, first_tile_y_, tiles_y_));
    for (int y = begin_y; y <= end_y; ++y) {
      for (int x = begin_x; x <= end_x; ++x)
        bins[std::size_t(y) * std::size_t(tiles_x_) + std::size_t(x)].push_back(std::uint32_t(i));
    }
  }
  parallelTasks(std::ptrdiff_t(tileCount()), threads_, [&](std::ptrdiff_t i, int worker) {
    Scratch& scratch = scratch_[std::size_t(worker)];
    scratch.face.resize(std::size_t(kMaxAttributes) * kPlaneSamples);
    const std::vector<std::uint32_t>& bin = bins[std::size_t(i)];
    placeEvents(tiles_[std::size_t(i)], faces, bin.data(), bin.size(), scratch);
  });
}

}  // namespace soft_volume::core
