#include "soft_volume/render/grid_slicer.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "extra_planes.h"
#include "plane_cutter.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/parallel.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

/// Farther away than this a position is an error; it also keeps float arithmetic far from overflow.
constexpr float kMaxCoordinate = 1e6F;
/// Vertices per piece of work: enough to make its start not matter.
constexpr std::size_t kChunk = 4096;
constexpr PlaneRange kNowhere = {0, 0};

bool isUsable(const Vector3f& p) {
  return p.array().isFinite().all() && p.cwiseAbs().maxCoeff() <= kMaxCoordinate;
}

/// Calls body(chunk, begin, end) for pieces of [0, count).
template <typename Body>
void forEachChunk(std::size_t count, int threads, const Body& body) {
  parallelFor(std::ptrdiff_t((count + kChunk - 1) / kChunk), threads, [&](std::ptrdiff_t chunk) {
    const std::size_t begin = std::size_t(chunk) * kChunk;
    body(std::size_t(chunk), begin, std::min(count, begin + kChunk));
  });
}

struct DepthSpan {
  float low_m = std::numeric_limits<float>::max();
  float high_m = std::numeric_limits<float>::lowest();

  void add(float z_m) {
    low_m = std::min(low_m, z_m);
    high_m = std::max(high_m, z_m);
  }
};

/// Finds for a depth how many planes lie before it or at it.
class PlaneRank {
 public:
  explicit PlaneRank(const SlicePlanes& planes) : first_m_(planes.depth(0)), per_m_(1.0 / planes.distance_m) {
    for (int i = 0; i < planes.count; ++i)
      z_m_.push_back(planes.z(i));
  }
  std::uint16_t of(float z_m) const {
    const double estimate = (double(z_m) - first_m_) * per_m_;
    auto rank = std::size_t(std::clamp(estimate + 1.0, 0.0, double(z_m_.size())));
    while (rank > 0 && z_m_[rank - 1] > z_m)
      --rank;
    while (rank < z_m_.size() && z_m_[rank] <= z_m)
      ++rank;
    return std::uint16_t(rank);
  }

 private:
  double first_m_;
  double per_m_;
  std::vector<float> z_m_;
};

/// The sides of a rectangle of the image that a point lies beyond, as bits. A cell whose vertices all lie beyond one
/// side does so as a whole: the sides are planes, through the eye under perspective, where this also holds for points
/// behind the eye of a cell that is partly before it.
class Sides {
 public:
  Sides(const Camera& camera, const PixelRect& rect)
      : camera_(camera),
        // The outermost pixels' borders, and one pixel more for rounding.
        low_u_(rect.begin_x - 1.5 - camera.cx),
        low_v_(rect.begin_y - 1.5 - camera.cy),
        high_u_(rect.end_x + 0.5 - camera.cx),
        high_v_(rect.end_y + 0.5 - camera.cy) {}
  std::uint8_t beyond(const Vector3f& p) const {
    const double u = camera_.fx * double(p.x());
    const double v = camera_.fy * double(p.y());
    const double scale = camera_.projection == Projection::kParallel ? 1.0 : double(p.z());
    return std::uint8_t(unsigned(u < low_u_ * scale) | unsigned(u > high_u_ * scale) << 1 |
                        unsigned(v < low_v_ * scale) << 2 | unsigned(v > high_v_ * scale) << 3);
  }

 private:
  const Camera& camera_;
  double low_u_, low_v_, high_u_, high_v_;
};

/// Calls visit(vertex) for every vertex of a cell, for those of a polyhedron as often as they occur.
template <typename Visit>
void forEachVertex(const BucketedGrid& grid, std::size_t cell, const Visit& visit) {
  const std::uint32_t* begin = grid.connectivity.data() + grid.offsets[cell];
  const std::uint32_t* end = grid.connectivity.data() + grid.offsets[cell + 1];
  if (grid.types[cell] != CellType::kPolyhedron) {
    std::for_each(begin, end, visit);
    return;
  }
  forEachFace(CellType::kPolyhedron, begin, [&](std::size_t, const std::uint32_t* vertices, std::size_t size) {
    std::for_each(vertices, vertices + size, visit);
  });
}

}  // namespace

class GridSlicer::Impl {
 public:
  void setCells(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                const std::vector<std::uint32_t>& connectivity, std::size_t vertex_count);
  void transform(const Camera& camera, const std::vector<Vector3f>& positions, int threads);
  void bucket(const Camera& camera, const SlicePlanes& planes, const std::vector<std::uint8_t>& skip,
              const PixelRect& rect, bool extra, int threads);
  void slice(std::size_t begin, std::size_t end, int threads, SliceMesh& mesh);

  BucketedGrid grid;
  DepthSpan depth;
  std::vector<float> extra_z_m;
  std::size_t vertex_count = 0;

 private:
  struct Missed {
    std::uint32_t plane;  ///< slab * ExtraPlanes::kPlaces + place
    MissedCell cell;
  };

  void findCollapsed();
  void rankVertices(const Camera& camera, const PixelRect& rect, int threads);
  void listDrawn(const std::vector<std::uint8_t>& skip);
  void rangeCells(int threads);
  PlaneRange rangeOf(std::size_t cell) const;
  bool isOutside(std::size_t cell) const;
  void fillBuckets(int threads);
  template <typename IsUsed>
  void markEdges(const IsUsed& isUsed);
  void findMissed(const Camera& camera, const std::vector<std::uint8_t>& skip, int threads);
  void fileMissed(const std::vector<Missed>& found);
  void listPlanes();
  void setExtents();
  void estimateWork();
  ExtraPlanes slab(int number) const;

  Camera camera_;
  SlicePlanes planes_;
  std::vector<std::uint8_t> beyond_;  ///< per vertex, see Sides
  // Per cell that is not skipped:
  std::vector<PlaneRange> cell_ranges_;   ///< empty where it is left out or between planes
  std::vector<std::uint8_t> is_outside_;  ///< nonzero where its image lies outside the rectangle
  bool is_any_beyond_ = false;
  bool is_any_outside_ = false;
  bool lists_known_ = false;
  std::vector<std::uint8_t> skip_;          ///< what the lists were made for
  std::vector<std::uint32_t> drawn_cells_;  ///< not skipped, ascending
  std::vector<std::uint32_t> drawn_edges_;  ///< of them, ascending
  std::vector<std::uint8_t> is_edge_used_;  ///< per edge, as of the last markEdges()
  std::vector<std::uint32_t> extra_keys_;   ///< per extra plane, as Missed::plane
  std::vector<std::size_t> work_;           ///< per plane, how many cells it and those before it cut
  std::vector<PlaneCutter> cutters_;        ///< per thread
  std::vector<SliceMesh> parts_;            ///< per thread after the first
};

void GridSlicer::Impl::setCells(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                                const std::vector<std::uint32_t>& connectivity, std::size_t vertices) {
  grid = BucketedGrid();
  grid.types = types;
  grid.offsets = offsets;
  grid.connectivity = connectivity;
  grid.edges = edgesOf(types, offsets, connectivity, vertices);
  vertex_count = vertices;
  findCollapsed();
  extra_z_m.clear();
  cutters_.clear();
  lists_known_ = false;
}

/// A cell that names a vertex twice. Polyhedra always do, once per face.
void GridSlicer::Impl::findCollapsed() {
  grid.is_collapsed.assign(grid.types.size(), 0);
  std::vector<std::uint32_t> numbers;
  for (std::size_t cell = 0; cell < grid.types.size(); ++cell) {
    numbers.clear();
    forEachVertex(grid, cell, [&](std::uint32_t v) { numbers.push_back(v); });
    std::sort(numbers.begin(), numbers.end());
    grid.is_collapsed[cell] = std::uint8_t(std::adjacent_find(numbers.begin(), numbers.end()) != numbers.end());
  }
}

void GridSlicer::Impl::transform(const Camera& camera, const std::vector<Vector3f>& positions, int threads) {
  if (positions.size() != vertex_count) {
    throw InputError("got " + std::to_string(positions.size()) + " positions for a grid of " +
                     std::to_string(vertex_count) + " vertices");
  }
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  const Matrix3 rotation = T_camera_volume.orientation.toRotationMatrix();
  const std::size_t chunks = (positions.size() + kChunk - 1) / kChunk;
  std::vector<DepthSpan> spans(chunks);
  std::vector<std::size_t> unusable(chunks, positions.size());
  grid.positions.resize(positions.size());
  forEachChunk(positions.size(), threads, [&](std::size_t chunk, std::size_t begin, std::size_t end) {
    DepthSpan span;
    for (std::size_t i = begin; i < end; ++i) {
      if (!isUsable(positions[i]))
        unusable[chunk] = std::min(unusable[chunk], i);
      grid.positions[i] = (rotation * positions[i].cast<double>() + T_camera_volume.position_m).cast<float>();
      span.add(grid.positions[i].z());
    }
    spans[chunk] = span;
  });
  const auto first = std::min_element(unusable.begin(), unusable.end());
  if (first != unusable.end() && *first < positions.size()) {
    throw InputError("the position of vertex " + std::to_string(*first) + " is not finite or farther than 1000 km");
  }
  depth = DepthSpan();
  for (const DepthSpan& span : spans) {
    depth.add(span.low_m);
    depth.add(span.high_m);
  }
}

void GridSlicer::Impl::rankVertices(const Camera& camera, const PixelRect& rect, int threads) {
  const PlaneRank rank(planes_);
  const Sides sides(camera, rect);
  grid.ranks.resize(vertex_count);
  beyond_.resize(vertex_count);
  std::vector<std::uint8_t> beyond_any((vertex_count + kChunk - 1) / kChunk, 0);
  forEachChunk(vertex_count, threads, [&](std::size_t chunk, std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      grid.ranks[v] = rank.of(grid.positions[v].z());
      beyond_[v] = sides.beyond(grid.positions[v]);
      beyond_any[chunk] |= beyond_[v];
    }
  });
  is_any_beyond_ = std::any_of(beyond_any.begin(), beyond_any.end(), [](std::uint8_t beyond) { return beyond != 0; });
}

PlaneRange GridSlicer::Impl::rangeOf(std::size_t cell) const {
  std::uint16_t low = std::numeric_limits<std::uint16_t>::max();
  std::uint16_t high = 0;
  forEachVertex(grid, cell, [&](std::uint32_t v) {
    low = std::min(low, grid.ranks[v]);
    high = std::max(high, grid.ranks[v]);
  });
  return {low, high};
}

bool GridSlicer::Impl::isOutside(std::size_t cell) const {
  unsigned beyond_all = 15;
  forEachVertex(grid, cell, [&](std::uint32_t v) { beyond_all &= beyond_[v]; });
  return beyond_all != 0;
}

/// What is skipped changes seldom: which cells and edges are left is kept.
void GridSlicer::Impl::listDrawn(const std::vector<std::uint8_t>& skip) {
  if (lists_known_ && skip == skip_)
    return;
  lists_known_ = true;
  skip_ = skip;
  drawn_cells_.clear();
  for (std::size_t cell = 0; cell < grid.types.size(); ++cell) {
    if (skip.empty() || skip[cell] == 0)
      drawn_cells_.push_back(std::uint32_t(cell));
  }
  markEdges([](std::uint32_t) { return true; });
  drawn_edges_.clear();
  for (std::size_t edge = 0; edge < is_edge_used_.size(); ++edge) {
    if (is_edge_used_[edge] != 0)
      drawn_edges_.push_back(std::uint32_t(edge));
  }
}

void GridSlicer::Impl::rangeCells(int threads) {
  cell_ranges_.resize(grid.types.size());
  is_outside_.resize(grid.types.size());
  std::vector<std::uint8_t> is_outside_any((drawn_cells_.size() + kChunk - 1) / kChunk, 0);
  forEachChunk(drawn_cells_.size(), threads, [&](std::size_t chunk, std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const std::uint32_t cell = drawn_cells_[i];
      is_outside_[cell] = std::uint8_t(is_any_beyond_ && isOutside(cell));
      cell_ranges_[cell] = is_outside_[cell] == 0 ? rangeOf(cell) : kNowhere;
      is_outside_any[chunk] |= is_outside_[cell];
    }
  });
  is_any_outside_ = std::find(is_outside_any.begin(), is_outside_any.end(), 1) != is_outside_any.end();
}

/// Edges that only cells have which are left out need not be cut.
template <typename IsUsed>
void GridSlicer::Impl::markEdges(const IsUsed& isUsed) {
  is_edge_used_.assign(grid.edges.ends.size(), 0);
  for (const std::uint32_t cell : drawn_cells_) {
    if (!isUsed(cell))
      continue;
    for (std::uint32_t i = grid.edges.cell_offsets[cell]; i < grid.edges.cell_offsets[cell + 1]; ++i) {
      if (grid.edges.cell_edges[i] != GridEdges::kNone)
        is_edge_used_[grid.edges.cell_edges[i]] = 1;
    }
  }
}

void GridSlicer::Impl::fillBuckets(int threads) {
  grid.cell_buckets.build(drawn_cells_, planes_.count, threads,
                          [this](std::uint32_t cell) { return cell_ranges_[cell]; });
  const auto edgeRange = [this](std::uint32_t edge) {
    const std::uint16_t a = grid.ranks[grid.edges.ends[edge][0]];
    const std::uint16_t b = grid.ranks[grid.edges.ends[edge][1]];
    return PlaneRange{std::min(a, b), std::max(a, b)};
  };
  if (!is_any_outside_) {
    grid.edge_buckets.build(drawn_edges_, planes_.count, threads, edgeRange);
    return;
  }
  markEdges([this](std::uint32_t cell) { return cell_ranges_[cell].first < cell_ranges_[cell].end; });
  grid.edge_buckets.build(drawn_edges_, planes_.count, threads,
                          [&](std::uint32_t edge) { return is_edge_used_[edge] != 0 ? edgeRange(edge) : kNowhere; });
}

/// What lies between plane `number` and the one before it; where there is none, the ladder of planes goes on.
ExtraPlanes GridSlicer::Impl::slab(int number) const {
  return {planes_.depth(number - 1), planes_.depth(number)};
}

void GridSlicer::Impl::findMissed(const Camera& camera, const std::vector<std::uint8_t>& skip, int threads) {
  const std::size_t count = grid.types.size();
  std::vector<std::vector<Missed>> found((count + kChunk - 1) / kChunk);
  forEachChunk(count, threads, [&](std::size_t chunk, std::size_t begin, std::size_t end) {
    for (std::size_t cell = begin; cell < end; ++cell) {
      const PlaneRange range = rangeOf(cell);
      if (range.first != range.end || (!skip.empty() && skip[cell] != 0))
        continue;
      DepthSpan span;
      forEachVertex(grid, cell, [&](std::uint32_t v) { span.add(grid.positions[v].z()); });
      const float low_m = std::max({span.low_m, float(camera.near_m), planes_.z(range.first - 1)});
      const float high_m = std::min({span.high_m, float(camera.far_m), planes_.z(range.first)});
      if (low_m >= high_m)
        continue;
      const ExtraPlace place = slab(range.first).placeFor(low_m, high_m);
      found[chunk].push_back(
          {std::uint32_t(range.first * ExtraPlanes::kPlaces + place.place), {std::uint32_t(cell), place.z_m}});
    }
  });
  std::vector<Missed> all;
  for (const auto& part : found)
    all.insert(all.end(), part.begin(), part.end());
  fileMissed(all);
}

/// A counting sort by plane; planes without a cell are left out. Cells outside the rectangle have their planes all the
/// same, but are not cut.
void GridSlicer::Impl::fileMissed(const std::vector<Missed>& found) {
  constexpr std::uint32_t kUnused = 0xFFFFFFFF;
  std::vector<std::uint32_t> plane_of((std::size_t(planes_.count) + 1) * ExtraPlanes::kPlaces, kUnused);
  for (const Missed& missed : found)
    plane_of[missed.plane] = 0;
  for (std::uint32_t key = 0; key < plane_of.size(); ++key) {
    if (plane_of[key] == kUnused)
      continue;
    plane_of[key] = std::uint32_t(extra_keys_.size());
    extra_keys_.push_back(key);
    extra_z_m.push_back(slab(int(key / ExtraPlanes::kPlaces)).z(int(key % ExtraPlanes::kPlaces)));
  }
  grid.missed_begin.assign(extra_keys_.size() + 1, 0);
  for (const Missed& missed : found)
    grid.missed_begin[plane_of[missed.plane] + std::size_t(1)] += is_outside_[missed.cell.cell] == 0 ? 1 : 0;
  std::partial_sum(grid.missed_begin.begin(), grid.missed_begin.end(), grid.missed_begin.begin());
  grid.missed.resize(grid.missed_begin.back());
  std::vector<std::size_t> next = grid.missed_begin;
  for (const Missed& missed : found) {
    if (is_outside_[missed.cell.cell] == 0)
      grid.missed[next[plane_of[missed.plane]]++] = missed.cell;
  }
}

void GridSlicer::Impl::listPlanes() {
  grid.planes.clear();
  std::uint32_t extra = 0;
  for (int i = 0; i <= planes_.count; ++i) {
    for (; extra < extra_keys_.size() && int(extra_keys_[extra] / ExtraPlanes::kPlaces) == i; ++extra)
      grid.planes.push_back({extra_z_m[extra], 0.0F, 0.0F, true, extra});
    if (i < planes_.count)
      grid.planes.push_back({planes_.z(i), 0.0F, 0.0F, false, std::uint32_t(i)});
  }
}

/// Planes reach halfway to their neighbours. Extra ones before or behind all others reach to where the slabs of those
/// end, as the grid at rest does, and beyond that no farther than to their other side.
void GridSlicer::Impl::setExtents() {
  const auto between = [](double a, double b) { return float(0.5 * (a + b)); };
  const double before_all_m = planes_.depth(-1);
  const double behind_all_m = planes_.depth(planes_.count);
  const float begin_m = float(planes_.depth(-0.5));
  const float end_m = float(planes_.depth(planes_.count - 0.5));
  const auto rounding_m = float(0.5 * planes_.distance_m / ExtraPlanes::kPlaces);
  for (std::size_t i = 0; i < grid.planes.size(); ++i) {
    CutPlane& plane = grid.planes[i];
    if (plane.extra) {
      plane.front_m = between(i > 0 ? double(grid.planes[i - 1].z_m) : before_all_m, plane.z_m);
      plane.back_m = between(plane.z_m, i + 1 < grid.planes.size() ? double(grid.planes[i + 1].z_m) : behind_all_m);
      if (i == 0 && planes_.count > 0)
        plane.front_m =
            plane.z_m > begin_m - rounding_m ? std::min(begin_m, plane.z_m) : plane.z_m - (plane.back_m - plane.z_m);
      if (i + 1 == grid.planes.size() && planes_.count > 0)
        plane.back_m =
            plane.z_m < end_m + rounding_m ? std::max(end_m, plane.z_m) : plane.z_m + (plane.z_m - plane.front_m);
    } else {
      plane.front_m = float(planes_.depth(plane.number - 0.5));
      plane.back_m = float(planes_.depth(plane.number + 0.5));
    }
  }
}

/// The number of cells on each plane, summed up: threads get runs of about equal work.
void GridSlicer::Impl::estimateWork() {
  std::vector<std::ptrdiff_t> change(std::size_t(planes_.count) + 1, 0);
  for (int plane = 0; plane < planes_.count; ++plane) {
    const PlaneBuckets::Item* end = grid.cell_buckets.end(plane);
    for (const PlaneBuckets::Item* item = grid.cell_buckets.begin(plane); item != end; ++item) {
      ++change[std::size_t(plane)];
      --change[item->end];
    }
  }
  work_.assign(1, 0);
  std::ptrdiff_t active = 0;
  for (const CutPlane& plane : grid.planes) {
    if (!plane.extra)
      active += change[plane.number];
    const std::size_t cells = plane.extra
                                  ? grid.missed_begin[plane.number + std::size_t(1)] - grid.missed_begin[plane.number]
                                  : std::size_t(active);
    work_.push_back(work_.back() + cells + 1);
  }
}

void GridSlicer::Impl::bucket(const Camera& camera, const SlicePlanes& planes, const std::vector<std::uint8_t>& skip,
                              const PixelRect& rect, bool extra, int threads) {
  assert(planes.count >= 0 && planes.count < 65535 && (skip.empty() || skip.size() == grid.types.size()));
  camera_ = camera;
  planes_ = planes;
  extra_keys_.clear();
  extra_z_m.clear();
  rankVertices(camera, rect, threads);
  listDrawn(skip);
  rangeCells(threads);
  fillBuckets(threads);
  if (extra)
    findMissed(camera, skip, threads);
  listPlanes();
  setExtents();
  estimateWork();
}

namespace {

void clear(SliceMesh& mesh) {
  mesh.vertices.clear();
  mesh.corners.clear();
  mesh.edges.clear();
  mesh.polygons.clear();
  mesh.slices.clear();
}

/// Appends what a thread cut to what the threads before it cut.
void append(const SliceMesh& part, SliceMesh& mesh) {
  const auto vertices = std::uint32_t(mesh.vertices.size());
  const auto corners = std::uint32_t(mesh.corners.size());
  const auto polygons = std::uint32_t(mesh.polygons.size());
  mesh.vertices.insert(mesh.vertices.end(), part.vertices.begin(), part.vertices.end());
  mesh.corners.resize(corners + part.corners.size());
  std::transform(part.corners.begin(), part.corners.end(), mesh.corners.begin() + corners,
                 [vertices](std::uint32_t corner) { return corner + vertices; });
  mesh.edges.insert(mesh.edges.end(), part.edges.begin(), part.edges.end());
  for (const SlicePolygon& polygon : part.polygons)
    mesh.polygons.push_back({polygon.cell, polygon.first + corners, polygon.size});
  for (Slice slice : part.slices) {
    slice.first_polygon += polygons;
    mesh.slices.push_back(slice);
  }
}

}  // namespace

void GridSlicer::Impl::slice(std::size_t begin, std::size_t end, int threads, SliceMesh& mesh) {
  const auto parts = std::size_t(std::clamp(threads, 1, std::max(1, int(end - begin))));
  cutters_.resize(std::max(cutters_.size(), parts));
  parts_.resize(std::max(parts_.size(), parts));
  const auto partBegin = [&](std::size_t part) {
    if (part == parts)
      return end;
    const std::size_t wanted = work_[begin] + (work_[end] - work_[begin]) * part / parts;
    const auto first = work_.begin() + std::ptrdiff_t(begin);
    return std::size_t(std::lower_bound(first, work_.begin() + std::ptrdiff_t(end), wanted) - work_.begin());
  };
  clear(mesh);
  parallelFor(std::ptrdiff_t(parts), threads, [&](std::ptrdiff_t p) {
    const auto part = std::size_t(p);
    SliceMesh& target = part == 0 ? mesh : parts_[part];
    clear(target);
    cutters_[part].cut(grid, camera_, partBegin(part), partBegin(part + 1), target);
  });
  for (std::size_t part = 1; part < parts; ++part)
    append(parts_[part], mesh);
}

GridSlicer::GridSlicer() : impl_(std::make_unique<Impl>()) {}
GridSlicer::~GridSlicer() = default;
GridSlicer::GridSlicer(GridSlicer&&) noexcept = default;
GridSlicer& GridSlicer::operator=(GridSlicer&&) noexcept = default;

void GridSlicer::setCells(const std::vector<CellType>& types, const std::vector<std::uint32_t>& offsets,
                          const std::vector<std::uint32_t>& connectivity, std::size_t vertex_count) {
  impl_->setCells(types, offsets, connectivity, vertex_count);
}

std::size_t GridSlicer::cellCount() const {
  return impl_->grid.types.size();
}

std::size_t GridSlicer::vertexCount() const {
  return impl_->vertex_count;
}

void GridSlicer::transform(const Camera& camera, const std::vector<Vector3f>& positions, int threads) {
  impl_->transform(camera, positions, threads);
}

const std::vector<Vector3f>& GridSlicer::positions() const {
  return impl_->grid.positions;
}

std::array<double, 2> GridSlicer::depthRange(const Camera& camera) const {
  return {std::max(double(impl_->depth.low_m), camera.near_m), std::min(double(impl_->depth.high_m), camera.far_m)};
}

void GridSlicer::bucket(const Camera& camera, const SlicePlanes& planes, const std::vector<std::uint8_t>& skip,
                        const PixelRect& rect, bool extra, int threads) {
  impl_->bucket(camera, planes, skip, rect, extra, threads);
}

int GridSlicer::planeCount() const {
  return int(impl_->grid.planes.size());
}

bool GridSlicer::isExtra(int plane) const {
  return impl_->grid.planes[std::size_t(plane)].extra;
}

const std::vector<float>& GridSlicer::extraPlanes() const {
  return impl_->extra_z_m;
}

void GridSlicer::slice(int begin, int end, int threads, SliceMesh& mesh) {
  impl_->slice(std::size_t(begin), std::size_t(end), threads, mesh);
}

}  // namespace soft_volume::core
