#include "face_bins.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "soft_volume/common/parallel.h"

namespace soft_volume::core {
namespace {

/// Pixels that rounding may move a projected vertex by.
constexpr double kMargin = 1e-3;

/// A face that is to be put in order.
struct Candidate {
  double depth = 0.0;
  FaceBins::Entry entry{};
};

/// Corners of a face in the camera frame.
struct Corners {
  std::size_t count;
  std::array<Vector3, 4> p;
};

Corners cornersOf(const PieceFace& face, const std::vector<Vector3>& positions) {
  Corners corners{face.isTriangle() ? 3U : 4U, {}};
  for (std::size_t i = 0; i < corners.count; ++i)
    corners.p[i] = positions[face.vertices[i]];
  return corners;
}

/// The pixels that a face covers at most. Patches lie in the hull of their corners, so where the hull is cut by the
/// near plane, the cuts of all lines between corners bound it.
class PixelBounds {
 public:
  PixelBounds(const Camera& camera, const PixelRect& rect) : camera_(camera), rect_(rect) {}

  PixelRect of(const Corners& corners) const {
    Eigen::AlignedBox2d box;
    const bool cuts = camera_.projection == Projection::kPerspective;
    const double near = 0.99 * camera_.near_m;
    for (std::size_t i = 0; i < corners.count; ++i) {
      if (!cuts || corners.p[i].z() >= near)
        box.extend(camera_.project(corners.p[i]));
      for (std::size_t k = 0; k < i && cuts; ++k)
        extendByCut(corners.p[i], corners.p[k], near, box);
    }
    if (box.isEmpty())
      return {};
    return {pixel(std::ceil(box.min().x() - margin(box.min().x())), rect_.begin_x, rect_.end_x),
            pixel(std::ceil(box.min().y() - margin(box.min().y())), rect_.begin_y, rect_.end_y),
            pixel(std::floor(box.max().x() + margin(box.max().x())) + 1.0, rect_.begin_x, rect_.end_x),
            pixel(std::floor(box.max().y() + margin(box.max().y())) + 1.0, rect_.begin_y, rect_.end_y)};
  }

 private:
  static double margin(double at) { return kMargin + 1e-9 * std::abs(at); }

  static int pixel(double at, int low, int high) { return at > low ? (at < high ? int(at) : high) : low; }

  void extendByCut(const Vector3& p, const Vector3& q, double near, Eigen::AlignedBox2d& box) const {
    if ((p.z() < near) == (q.z() < near))
      return;
    Vector3 cut = p + (near - p.z()) / (q.z() - p.z()) * (q - p);
    cut.z() = near;
    box.extend(camera_.project(cut));
  }

  const Camera& camera_;
  const PixelRect& rect_;
};

/// Whether a bilinear patch may have several points on one ray through the pixels: only if the lines of sight see the
/// planes of its corners from different sides.
bool mayFold(const Corners& corners, const Camera& camera, const PixelRect& pixels) {
  if (corners.count < 4)
    return false;
  int sides = 0;
  for (std::size_t i = 0; i < 4; ++i) {
    const Vector3& p = corners.p[i];
    const Vector3 normal = (corners.p[(i + 1) % 4] - p).cross(corners.p[(i + 3) % 4] - p);
    for (const int u : {pixels.begin_x, pixels.end_x - 1}) {
      for (const int v : {pixels.begin_y, pixels.end_y - 1}) {
        const Eigen::Vector2d slope = camera.raySlope(u, v);
        const double seen = normal.dot(Vector3(slope.x(), slope.y(), 1.0));
        sides |= seen > 0.0 ? 1 : (seen < 0.0 ? 2 : 3);
      }
    }
  }
  return sides == 3;
}

Candidate candidateOf(const PieceFace& face, std::uint32_t number, const std::vector<Vector3>& positions,
                      const Camera& camera, const PixelRect& rect) {
  const Corners corners = cornersOf(face, positions);
  Candidate candidate;
  candidate.entry.face = number;
  candidate.entry.pixels = PixelBounds(camera, rect).of(corners);
  if (candidate.entry.pixels.empty())
    return candidate;
  candidate.entry.may_fold = mayFold(corners, camera, candidate.entry.pixels);
  for (std::size_t i = 0; i < corners.count; ++i)
    candidate.depth += corners.p[i].z() / double(corners.count);
  return candidate;
}

bool isSeen(const PieceFace& face, const PieceMesh& mesh, const std::vector<std::uint8_t>& hidden) {
  const auto seen = [&](const PieceFace::Side& side) {
    return side.piece != PieceFace::kNone && hidden[mesh.pieces()[side.piece].cell] == 0;
  };
  return seen(face.sides[0]) || seen(face.sides[1]);
}

}  // namespace

FaceBins::FaceBins(const PieceMesh& mesh, const std::vector<Vector3>& positions,
                   const std::vector<std::uint8_t>& hidden, const Camera& camera, const PixelRect& rect, int threads)
    : rect_(rect),
      columns_((rect.end_x - rect.begin_x + kTile - 1) / kTile),
      rows_((rect.end_y - rect.begin_y + kTile - 1) / kTile) {
  const std::vector<PieceFace>& faces = mesh.faces();
  std::vector<Candidate> candidates(faces.size());
  parallelFor(std::ptrdiff_t(faces.size()), threads, [&](std::ptrdiff_t i) {
    const PieceFace& face = faces[std::size_t(i)];
    if (isSeen(face, mesh, hidden))
      candidates[std::size_t(i)] = candidateOf(face, std::uint32_t(i), positions, camera, rect);
  });
  candidates.erase(std::remove_if(candidates.begin(), candidates.end(),
                                  [](const Candidate& candidate) { return candidate.entry.pixels.empty(); }),
                   candidates.end());
  std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
    return a.depth != b.depth ? a.depth < b.depth : a.entry.face < b.entry.face;
  });
  entries_.reserve(candidates.size());
  for (const Candidate& candidate : candidates)
    entries_.push_back(candidate.entry);
  fill();
}

template <typename Visit>
void FaceBins::forTiles(const PixelRect& pixels, const Visit& visit) const {
  for (int row = (pixels.begin_y - rect_.begin_y) / kTile; row <= (pixels.end_y - 1 - rect_.begin_y) / kTile; ++row) {
    for (int column = (pixels.begin_x - rect_.begin_x) / kTile; column <= (pixels.end_x - 1 - rect_.begin_x) / kTile;
         ++column)
      visit(std::size_t(row) * std::size_t(columns_) + std::size_t(column));
  }
}

void FaceBins::fill() {
  tile_begin_.assign(tileCount() + 1, 0);
  for (const Entry& entry : entries_)
    forTiles(entry.pixels, [&](std::size_t tile) { ++tile_begin_[tile + 1]; });
  for (std::size_t tile = 0; tile < tileCount(); ++tile)
    tile_begin_[tile + 1] += tile_begin_[tile];
  order_.resize(tile_begin_.back());
  std::vector<std::size_t> next(tile_begin_.begin(), tile_begin_.end() - 1);
  for (std::size_t i = 0; i < entries_.size(); ++i)
    forTiles(entries_[i].pixels, [&](std::size_t tile) { order_[next[tile]++] = std::uint32_t(i); });
}

PixelRect FaceBins::tile(std::size_t index) const {
  const int x = rect_.begin_x + int(index % std::size_t(columns_)) * kTile;
  const int y = rect_.begin_y + int(index / std::size_t(columns_)) * kTile;
  return {x, y, std::min(x + kTile, rect_.end_x), std::min(y + kTile, rect_.end_y)};
}

}  // namespace soft_volume::core
