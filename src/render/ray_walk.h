#pragma once

#include <algorithm>
#include <limits>
#include <vector>

#include "cell_map.h"
#include "exact_medium.h"
#include "face_hits.h"
#include "piece_mesh.h"
#include "pixel_integral.h"

namespace soft_volume::core {

/// Follows rays through a PieceMesh from hit to hit and integrates what lies between them. Not thread-safe: one for
/// each thread.
template <typename Medium>
class RayWalk {
 public:
  /// `positions`: per vertex of the mesh, camera frame; `hidden`: per cell, nonzero where nothing is drawn.
  RayWalk(const PieceMesh& mesh, const std::vector<Vector3>& positions, const std::vector<std::uint8_t>& hidden,
          const Medium& medium)
      : mesh_(mesh), positions_(positions), hidden_(hidden), medium_(medium) {}

  /// Integrates from begin_z to end_z. `hits`: all of the ray in front of begin_z at least, by depth.
  void trace(const Ray& ray, double begin_z, double end_z, const std::vector<FaceHit>& hits, PixelIntegral& pixel) {
    ray_ = ray;
    std::size_t next = 0;
    while (next < hits.size() && hits[next].z < begin_z)
      ++next;
    enterWhereRayBegins(hits, next);
    double z = begin_z;
    for (; next < hits.size() && !pixel.isOpaque(); ++next) {
      const FaceHit& hit = hits[next];
      const double end = std::min(hit.z, end_z);
      if (end > z && !inside_.empty())
        integrate(z, end, hit, pixel);
      if (hit.z >= end_z)
        break;
      cross(hit);
      z = std::max(z, end);
    }
  }

  /// Ways through cells integrated so far.
  std::size_t segments() const { return segments_; }

 private:
  using Place = Placed<typename Medium::Sample>;
  static constexpr int kOverlapSteps = 16;
  static constexpr int kMaxHalvings = 7;

  /// A piece that the ray is in.
  struct Inside {
    std::uint32_t piece;
    int winding;  ///< how often its surface is around
    Place place;  ///< where the ray came in, or the last place that was drawn
    bool drawn;   ///< in the present interval
  };

  /// A piece's polynomials along the ray.
  class Curve {
   public:
    Curve(const RayWalk& walk, const Piece& piece)
        : walk_(walk),
          map_(piece.type, [&](int i) { return walk.positions_[piece.vertices[std::size_t(i)]]; }),
          values_(piece.type, [&](int i) { return walk.medium_.value(piece, piece.vertices[std::size_t(i)]); }) {}
    Place at(double z, const Vector3& guess) const {
      const Vector3 r = invert(map_, walk_.ray_.at(z), guess);
      return {r, walk_.medium_.sample(z, values_.at(r))};
    }

   private:
    const RayWalk& walk_;
    CellPolynomial<3> map_;
    CellPolynomial<Medium::kComponents> values_;
  };

  /// What the hit adds to the winding of the piece on one side.
  static int change(const FaceHit& hit, const PieceFace::Side& side) {
    return side.reversed ? -hit.winding : hit.winding;
  }

  bool isSeen(const PieceFace::Side& side) const {
    return side.piece != PieceFace::kNone && hidden_[mesh_.pieces()[side.piece].cell] == 0;
  }

  /// All windings of a piece add up to zero, so what the hits from `first` on leave over was there before.
  void enterWhereRayBegins(const std::vector<FaceHit>& hits, std::size_t first) {
    inside_.clear();
    for (std::size_t i = first; i < hits.size(); ++i) {
      for (const PieceFace::Side& side : mesh_.faces()[hits[i].face].sides) {
        if (isSeen(side))
          turn(side.piece, -change(hits[i], side), [&] { return beforeBegin(hits[i], side); });
      }
    }
  }

  /// A guess only: integrate() moves it to the begin.
  Place beforeBegin(const FaceHit& hit, const PieceFace::Side& side) const {
    Place place = placeOf(hit, side);
    place.sample.z = -std::numeric_limits<double>::infinity();
    return place;
  }

  void cross(const FaceHit& hit) {
    for (const PieceFace::Side& side : mesh_.faces()[hit.face].sides) {
      if (isSeen(side))
        turn(side.piece, change(hit, side), [&] { return placeOf(hit, side); });
    }
  }

  template <typename MakePlace>
  void turn(std::uint32_t piece, int winding, const MakePlace& make_place) {
    const auto known =
        std::find_if(inside_.begin(), inside_.end(), [&](const Inside& in) { return in.piece == piece; });
    if (known == inside_.end()) {
      inside_.push_back({piece, winding, make_place(), false});
      return;
    }
    known->winding += winding;
    if (known->winding == 0)
      inside_.erase(known);
  }

  /// A hit as the piece on one side of the face sees it.
  Place placeOf(const FaceHit& hit, const PieceFace::Side& side) const {
    const PieceFace& face = mesh_.faces()[hit.face];
    const Piece& piece = mesh_.pieces()[side.piece];
    const double u = hit.u;
    const double v = hit.v;
    const std::array<double, 4> weights =
        face.isTriangle() ? std::array<double, 4>{1.0 - u - v, u, v, 0.0}
                          : std::array<double, 4>{(1.0 - u) * (1.0 - v), u * (1.0 - v), u * v, (1.0 - u) * v};
    typename Medium::Value value = weights[0] * medium_.value(piece, face.vertices[0]);
    Vector3 r = weights[0] * referenceCorner(piece.type, side.corners[0]);
    for (std::size_t i = 1; i < (face.isTriangle() ? 3U : 4U); ++i) {
      value += weights[i] * medium_.value(piece, face.vertices[i]);
      r += weights[i] * referenceCorner(piece.type, side.corners[i]);
    }
    return {r, medium_.sample(hit.z, value)};
  }

  /// The way from z to end, where a hit may be.
  void integrate(double z, double end, const FaceHit& hit, PixelIntegral& pixel) {
    const int drawn = choosePieces();
    const int steps = drawn > 1 ? kOverlapSteps : 1;
    for (int step = 1; step <= steps; ++step) {
      const double step_end = step == steps ? end : z + (end - z) * step / steps;
      for (Inside& in : inside_) {
        if (!in.drawn || pixel.isOpaque())
          continue;
        const double begin = z + (end - z) * (step - 1) / steps;
        integratePiece(in, begin, step_end, step == steps && hit.z == end ? &hit : nullptr, pixel);
      }
    }
    segments_ += std::size_t(drawn);
  }

  /// Of each cell one piece is drawn where the windings of all of its pieces do not cancel: one that turns the way that
  /// the cell does. Returns how many.
  int choosePieces() {
    if (inside_.size() == 1) {
      inside_[0].drawn = true;
      return 1;
    }
    int count = 0;
    for (std::size_t i = 0; i < inside_.size(); ++i)
      count += (inside_[i].drawn = standsForCell(i)) ? 1 : 0;
    return count;
  }

  bool standsForCell(std::size_t index) const {
    const auto cell = [&](const Inside& in) { return mesh_.pieces()[in.piece].cell; };
    int winding = 0;
    for (const Inside& other : inside_)
      winding += cell(other) == cell(inside_[index]) ? other.winding : 0;
    const auto fits = [&](const Inside& in) { return cell(in) == cell(inside_[index]) && in.winding * winding > 0; };
    return fits(inside_[index]) && std::none_of(inside_.begin(), inside_.begin() + std::ptrdiff_t(index), fits);
  }

  void integratePiece(Inside& in, double begin, double end, const FaceHit* hit, PixelIntegral& pixel) {
    const Piece& piece = mesh_.pieces()[in.piece];
    const PieceFace::Side* side = hit != nullptr ? sideOf(*hit, in.piece) : nullptr;
    const bool straight = medium_.isStraight(piece);
    if (straight && side != nullptr && in.place.sample.z == begin) {
      const Place place = placeOf(*hit, *side);
      medium_.add(piece, in.place, place, pixel);
      in.place = place;
      return;
    }
    const Curve curve(*this, piece);
    if (in.place.sample.z != begin)
      in.place = curve.at(begin, in.place.r);
    const Place place = side != nullptr ? placeOf(*hit, *side) : curve.at(end, in.place.r);
    if (straight)
      medium_.add(piece, in.place, place, pixel);
    else
      bend(curve, piece, in.place, place, kMaxHalvings, pixel);
    in.place = place;
  }

  const PieceFace::Side* sideOf(const FaceHit& hit, std::uint32_t piece) const {
    const auto& sides = mesh_.faces()[hit.face].sides;
    return sides[0].piece == piece ? &sides[0] : (sides[1].piece == piece ? &sides[1] : nullptr);
  }

  void bend(const Curve& curve, const Piece& piece, const Place& a, const Place& b, int halvings,
            PixelIntegral& pixel) const {
    const Place m = curve.at(0.5 * (a.sample.z + b.sample.z), 0.5 * (a.r + b.r));
    if (halvings > 0 && !medium_.isStraight(pixel, a.sample, m.sample, b.sample)) {
      bend(curve, piece, a, m, halvings - 1, pixel);
      if (!pixel.isOpaque())
        bend(curve, piece, m, b, halvings - 1, pixel);
      return;
    }
    medium_.add(piece, a, m, pixel);
    medium_.add(piece, m, b, pixel);
  }

  const PieceMesh& mesh_;
  const std::vector<Vector3>& positions_;
  const std::vector<std::uint8_t>& hidden_;
  const Medium& medium_;
  Ray ray_;
  std::vector<Inside> inside_;
  std::size_t segments_ = 0;
};

}  // namespace soft_volume::core
