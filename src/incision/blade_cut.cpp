#include "soft_volume/incision/blade_cut.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "blade_patch.h"
#include "piece_split.h"
#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {
namespace {

/// Flatness of a quad, in h.
constexpr double kFlatQuad = 0.02;
/// Narrowest patch, in snap distances.
constexpr double kNarrowPatch = 3.0;
/// How far a section may reach beyond the patch before it is split at the border, in snap distances.
constexpr double kBorder = 1.5;
/// How far vertices are snapped where a part would be too small otherwise, in snap distances.
constexpr double kFarthestSnap = 4.0;
/// How far from the edge where a patch continues the one before it pieces are looked at again, in snap distances.
constexpr double kJoint = 25.0;
/// Flatness of a section, in h: volumes are exact to about this.
constexpr double kFlatSection = 1e-11;

/// Points around a convex polygon near a plane, in order.
std::vector<Vector3> inOrder(std::vector<Vector3> points, const Vector3& normal) {
  Vector3 middle = Vector3::Zero();
  for (const Vector3& p : points)
    middle += p / static_cast<double>(points.size());
  const Vector3 u = normal.unitOrthogonal();
  const Vector3 v = normal.cross(u);
  std::vector<std::pair<double, Vector3>> by_angle;
  for (const Vector3& p : points)
    by_angle.emplace_back(std::atan2(v.dot(p - middle), u.dot(p - middle)), p);
  std::sort(by_angle.begin(), by_angle.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  std::transform(by_angle.begin(), by_angle.end(), points.begin(), [](const auto& p) { return p.second; });
  return points;
}

/// Centroid of a polygon's area; of its corners where it has none.
Vector3 centroidOf(const std::vector<Vector3>& polygon, const Vector3& normal) {
  Vector3 sum = Vector3::Zero();
  Vector3 mean = Vector3::Zero();
  double area = 0.0;
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    mean += polygon[i] / static_cast<double>(polygon.size());
    if (i < 2)
      continue;
    const double part = normal.dot((polygon[i - 1] - polygon[0]).cross(polygon[i] - polygon[0]));
    sum += part * (polygon[0] + polygon[i - 1] + polygon[i]) / 3.0;
    area += part;
  }
  return area > 0.0 ? Vector3(sum / area) : mean;
}

/// The work of one patch. `last` is the one that it continues, and `sides` are those of the pieces at that; it leaves
/// its own.
class PatchCut {
 public:
  PatchCut(CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
           const CutResolution& resolution, const BladePatch& patch, const std::optional<BladePatch>& last,
           double reach_m, std::vector<Vector3>& positions_m, std::map<std::uint32_t, int>& sides,
           BladeCutResult& result)
      : mesh_(mesh),
        lattice_(lattice),
        materials_(materials),
        snap_m_(resolution.snap * lattice.spacing_m.minCoeff()),
        least_island_m3_(resolution.least_island * std::pow(lattice.spacing_m.minCoeff(), 3)),
        patch_(patch),
        last_(last),
        positions_m_(positions_m),
        sides_(sides),
        result_(result),
        blade_(patch.plane, snap_m_, positions_m) {
    const double h = lattice.spacing_m.minCoeff();
    limits_ = {resolution.least_edge * h, resolution.least_width * h, resolution.deepest_dent * h, kFlatSection * h};
    for (const Plane& side : patch.sides)
      borders_.emplace_back(side, snap_m_, positions_m);
    findPieces(reach_m);
  }

  void run() {
    forgetFarLips();
    splitAtBorder();
    splitByBlade();
    openFaces();
  }

 private:
  void findPieces(double reach_m) {
    Box3 box;
    for (const Vector3& p : patch_.corners)
      box.extend(p);
    const Vector3 margin = lattice_.spacing_m + Vector3::Constant(reach_m);
    box.min() -= margin;
    box.max() += margin;
    forEachCell(lattice_, latticeBox(lattice_, box), [this](std::uint32_t cell) {
      const auto& of_cell = mesh_.piecesOfCell(cell);
      pieces_.insert(pieces_.end(), of_cell.begin(), of_cell.end());
    });
  }

  /// A patch starts where the last one ended, so its joints are near both.
  void forgetFarLips() {
    std::map<std::uint32_t, int> near;
    for (const std::uint32_t piece : pieces_) {
      if (const auto lip = sides_.find(piece); lip != sides_.end())
        near.insert(*lip);
    }
    sides_ = std::move(near);
  }

  bool isCuttable(std::uint32_t piece) const {
    return !materials_[lattice_.materials[mesh_.pieces()[piece].cell]].fixed;
  }

  /// On which sides of the blade a piece has vertices.
  struct Sides {
    bool behind = false;
    bool front = false;
    bool straddles() const { return behind && front; }
  };
  Sides sidesOf(std::uint32_t piece) const {
    Sides sides;
    for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
      for (const std::uint32_t v : mesh_.faces()[f].loop) {
        const int sign = blade_.sign(v);
        sides.behind |= sign < 0;
        sides.front |= sign > 0;
      }
      if (sides.straddles())
        break;
    }
    return sides;
  }

  bool isOnBlade(const std::vector<std::uint32_t>& loop) const {
    return std::all_of(loop.begin(), loop.end(), [this](std::uint32_t v) { return blade_.sign(v) == 0; });
  }

  /// Where the blade's plane meets a piece: through its inside, or along faces to neighbours.
  std::vector<Vector3> sectionOf(std::uint32_t piece) const {
    const bool straddles = sidesOf(piece).straddles();
    std::vector<Vector3> points;
    std::vector<std::uint32_t> on_blade;
    for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
      const auto& face = mesh_.faces()[f];
      if (straddles) {
        addCrossings(face.loop, points);
      } else if (face.pieces[1] == CutMesh::kNone || !isOnBlade(face.loop)) {
        continue;
      }
      for (const std::uint32_t v : face.loop) {
        if (blade_.sign(v) == 0)
          on_blade.push_back(v);
      }
    }
    std::sort(on_blade.begin(), on_blade.end());
    on_blade.erase(std::unique(on_blade.begin(), on_blade.end()), on_blade.end());
    for (const std::uint32_t v : on_blade)
      points.push_back(positions_m_[v]);
    return points.size() < 3 ? std::vector<Vector3>() : inOrder(points, patch_.plane.normal);
  }

  /// Every point comes twice, from the two faces at its edge.
  void addCrossings(const std::vector<std::uint32_t>& loop, std::vector<Vector3>& points) const {
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const std::uint32_t a = loop[i];
      const std::uint32_t b = loop[(i + 1) % loop.size()];
      if (blade_.sign(a) * blade_.sign(b) >= 0)
        continue;
      const double at_a = blade_.distance(a);
      const double at_b = blade_.distance(b);
      points.push_back(positions_m_[a] + at_a / (at_a - at_b) * (positions_m_[b] - positions_m_[a]));
    }
  }

  /// Whether the patch covers more than the edge of a section.
  bool enters(std::vector<Vector3> section) const {
    for (const Plane& side : patch_.sides) {
      if (section.empty())
        return false;
      section = clipPolygon(section, side, snap_m_);
    }
    return !section.empty();
  }

  bool reachesBeyond(const std::vector<Vector3>& section, const Plane& side) const {
    return std::any_of(section.begin(), section.end(),
                       [&](const Vector3& p) { return side.distance(p) < -kBorder * snap_m_; });
  }

  bool covers(const Vector3& point, double slack_m) const {
    return std::all_of(patch_.sides.begin(), patch_.sides.end(),
                       [&](const Plane& side) { return side.distance(point) >= -slack_m; });
  }

  /// A vertex just beyond the snap distance can make a part too small: such vertices are snapped, too, step by step.
  std::optional<PieceSplit> planWithSnap(std::uint32_t piece, PlaneSides& sides) {
    auto plan = planSplit(mesh_, piece, sides, limits_);
    for (double steps = 1.5; !plan && steps <= kFarthestSnap; steps += 0.5) {
      const std::vector<std::uint32_t> snapped = sides.snap(mesh_.verticesOf(piece), steps * snap_m_);
      if (snapped.empty())
        continue;
      plan = planSplit(mesh_, piece, sides, limits_);
      if (!plan)
        sides.release(snapped);
    }
    return plan;
  }

  bool split(std::uint32_t piece, PlaneSides& sides) {
    const auto plan = planWithSnap(piece, sides);
    if (!plan) {
      ++result_.splits_refused;
      return false;
    }
    for (std::size_t n = 0; n < plan->points.size(); ++n)
      touched_.insert(static_cast<std::uint32_t>(mesh_.vertexCount() + n));
    pieces_.push_back(applySplit(*plan, piece, mesh_, sides, positions_m_));
    inheritSide(piece, pieces_.back());
    ++result_.pieces_split;
    return true;
  }

  bool isAtIncision(std::uint32_t piece) const {
    const auto& faces = mesh_.pieces()[piece].faces;
    return std::any_of(faces.begin(), faces.end(), [this](std::uint32_t f) { return mesh_.faces()[f].opened; });
  }

  /// A part that is not at the incision yet may still come to lie on either side.
  void inheritSide(std::uint32_t piece, std::uint32_t part) {
    const auto side = sides_.find(piece);
    if (side == sides_.end())
      return;
    if (isAtIncision(part))
      sides_[part] = side->second;
    if (!isAtIncision(piece))
      sides_.erase(side);
  }

  /// Pieces that are split come again: their parts are looked at when the list's end is reached.
  void splitAtBorder() {
    std::vector<std::uint32_t> waiting = pieces_;
    for (std::size_t n = 0; n < waiting.size(); ++n) {
      const std::uint32_t piece = waiting[n];
      if (!isCuttable(piece))
        continue;
      const std::vector<Vector3> section = sectionOf(piece);
      if (!enters(section))
        continue;
      for (std::size_t s = 0; s < borders_.size(); ++s) {
        if (!reachesBeyond(section, patch_.sides[s]))
          continue;
        if (split(piece, borders_[s])) {
          waiting.push_back(piece);
          waiting.push_back(pieces_.back());
          break;
        }
      }
    }
  }

  void splitByBlade() {
    const std::vector<std::uint32_t> all = pieces_;
    for (const std::uint32_t piece : all) {
      if (!isCuttable(piece) || !sidesOf(piece).straddles())
        continue;
      const std::vector<Vector3> section = sectionOf(piece);
      if (!section.empty() && covers(centroidOf(section, patch_.plane.normal), 0.0))
        splitBySide(piece);
    }
  }

  /// Whatever side a piece was on, its parts are on either.
  void splitBySide(std::uint32_t piece) {
    if (!split(piece, blade_))
      return;
    sides_.erase(piece);
    sides_.erase(pieces_.back());
  }

  Vector3 middleOf(const std::vector<std::uint32_t>& vertices) const {
    Vector3 sum = Vector3::Zero();
    for (const std::uint32_t v : vertices)
      sum += positions_m_[v];
    return sum / static_cast<double>(vertices.size());
  }

  /// Side of a piece that the blade does not part: that of its vertices, or of their middle where they disagree.
  int sideOf(std::uint32_t piece) const {
    const Sides sides = sidesOf(piece);
    if (sides.behind != sides.front)
      return sides.front ? 1 : -1;
    return patch_.plane.distance(middleOf(mesh_.verticesOf(piece))) < 0.0 ? -1 : 1;
  }

  /// Whether the patch runs along a face between two pieces.
  bool isAlong(const CutMesh::Face& face) const {
    return face.pieces[1] != CutMesh::kNone && isOnBlade(face.loop) && covers(middleOf(face.loop), snap_m_);
  }

  bool touchesBlade(std::uint32_t piece) const {
    int first = 0;
    for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
      for (const std::uint32_t v : mesh_.faces()[f].loop) {
        const int sign = blade_.sign(v);
        if (sign == 0 || sign == -first)
          return true;
        first = sign;
      }
    }
    return false;
  }

  bool isAtJoint(std::uint32_t piece) const {
    const Vector3 edge = (patch_.corners[1] - patch_.corners[0]).normalized();
    return edge.cross(middleOf(mesh_.verticesOf(piece)) - patch_.corners[0]).norm() < kJoint * snap_m_;
  }

  /// Side of a piece whose middle is over or under the patch, the one before it (a border may have parted it there
  /// since) or the gap between both; 0 elsewhere.
  int sideBeside(std::uint32_t piece) const {
    const Vector3 middle = middleOf(mesh_.verticesOf(piece));
    const auto isInside = [&](const Plane& side) { return side.distance(middle) >= 0.0; };
    const bool is_between_ends = std::all_of(patch_.sides.begin() + 1, patch_.sides.end(), isInside);
    if (is_between_ends && isInside(patch_.sides[0]))
      return sideOf(piece);
    if (!last_)
      return 0;
    if (std::all_of(last_->sides.begin(), last_->sides.end(), isInside))
      return last_->plane.distance(middle) < 0.0 ? -1 : 1;
    const Vector3 edge = patch_.corners[1] - patch_.corners[0];
    return is_between_ends && last_->plane.normal.cross(edge).dot(middle - patch_.corners[0]) >= 0.0 ? sideOf(piece)
                                                                                                     : 0;
  }

  /// What the patch may pass by: what touches its plane, what is at the lips that it goes on from, and their
  /// neighbours.
  std::vector<std::uint32_t> piecesBeside() const {
    std::vector<std::uint32_t> near = pieces_;
    std::sort(near.begin(), near.end());
    std::vector<std::uint32_t> beside;
    for (const std::uint32_t piece : near) {
      const bool touches = touchesBlade(piece);
      if (touches)
        beside.push_back(piece);
      if (!touches && sides_.count(piece) == 0)
        continue;
      for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
        const auto other = static_cast<std::uint32_t>(mesh_.across(f, piece));
        if (std::binary_search(near.begin(), near.end(), other) && (touches || isAtJoint(other)))
          beside.push_back(other);
      }
    }
    std::sort(beside.begin(), beside.end());
    beside.erase(std::unique(beside.begin(), beside.end()), beside.end());
    return beside;
  }

  bool isAlongPatch(std::uint32_t piece) const {
    const auto& faces = mesh_.pieces()[piece].faces;
    return std::any_of(faces.begin(), faces.end(), [this](std::uint32_t f) { return isAlong(mesh_.faces()[f]); });
  }

  /// Gives sides to the pieces at the patch. What two patches of a stroke are beside keeps the side of the first.
  void takeSides() {
    for (const std::uint32_t piece : piecesBeside()) {
      if (sides_.count(piece) > 0 || !isCuttable(piece))
        continue;
      const int side = isAlongPatch(piece) ? sideOf(piece) : sideBeside(piece);
      if (side != 0)
        sides_[piece] = side;
    }
  }

  std::set<std::uint32_t> facesBetweenSides() const {
    std::set<std::uint32_t> between;
    for (const auto& [piece, side] : sides_) {
      for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
        const auto other = sides_.find(static_cast<std::uint32_t>(mesh_.across(f, piece)));
        if (other != sides_.end() && other->second != side)
          between.insert(f);
      }
    }
    return between;
  }

  void openFaces() {
    takeSides();
    std::set<std::uint32_t> to_open = facesBetweenSides();
    while (keepCrumb(to_open)) {
    }
    for (const std::uint32_t f : to_open)
      open(f);
    partVertices();
  }

  double restVolume(std::uint32_t piece) const {
    const auto& places = mesh_.restPositions();
    const std::vector<std::vector<std::uint32_t>> loops = mesh_.loopsOf(piece);
    const Vector3& origin = places[loops[0][0]];
    double sum = 0.0;
    for (const auto& loop : loops)
      sum += (places[loop[0]] - origin).dot(areaVector(places, loop));
    return sum / 6.0;
  }

  /// What hangs together with a piece when these faces are open; empty when that is not a crumb.
  std::set<std::uint32_t> crumbAround(std::uint32_t piece, const std::set<std::uint32_t>& to_open) const {
    std::vector<std::uint32_t> waiting = {piece};
    std::set<std::uint32_t> crumb = {piece};
    double volume_m3 = 0.0;
    while (!waiting.empty()) {
      const std::uint32_t next = waiting.back();
      waiting.pop_back();
      volume_m3 += restVolume(next);
      if (volume_m3 >= least_island_m3_)
        return {};
      for (const std::uint32_t f : mesh_.pieces()[next].faces) {
        const std::int32_t other = mesh_.across(f, next);
        if (other != CutMesh::kNone && to_open.count(f) == 0 && crumb.insert(static_cast<std::uint32_t>(other)).second)
          waiting.push_back(static_cast<std::uint32_t>(other));
      }
    }
    return crumb;
  }

  /// Finds a part that would come off as a crumb and leaves it to the side that it has more area with.
  bool keepCrumb(std::set<std::uint32_t>& to_open) {
    for (const std::uint32_t face : to_open) {
      for (const std::int32_t piece : mesh_.faces()[face].pieces) {
        const std::set<std::uint32_t> crumb = crumbAround(static_cast<std::uint32_t>(piece), to_open);
        if (crumb.empty())
          continue;
        keep(crumb, to_open);
        return true;
      }
    }
    return false;
  }

  void keep(const std::set<std::uint32_t>& crumb, std::set<std::uint32_t>& to_open) {
    std::map<int, double> area;
    std::map<int, std::vector<std::uint32_t>> faces;
    for (const std::uint32_t piece : crumb) {
      for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
        const auto other = static_cast<std::uint32_t>(mesh_.across(f, piece));
        if (to_open.count(f) == 0 || crumb.count(other) > 0)
          continue;
        area[sides_.at(other)] += areaVector(mesh_.restPositions(), mesh_.faces()[f].loop).norm();
        faces[sides_.at(other)].push_back(f);
      }
    }
    const int side = area[1] > area[-1] ? 1 : -1;
    for (const std::uint32_t f : faces[side])
      to_open.erase(f);
    for (const std::uint32_t piece : crumb)
      sides_[piece] = side;
  }

  double resistanceOf(std::int32_t piece) const {
    const std::uint32_t cell = mesh_.pieces()[static_cast<std::size_t>(piece)].cell;
    return materials_[lattice_.materials[cell]].cut_resistance_j_m2;
  }

  void open(std::uint32_t face) {
    const auto& [first, second] = mesh_.faces()[face].pieces;
    const double area_m2 = 0.5 * areaVector(mesh_.restPositions(), mesh_.faces()[face].loop).norm();
    result_.opened_area_m2 += area_m2;
    result_.opened_energy_j += area_m2 * 0.5 * (resistanceOf(first) + resistanceOf(second));
    for (const std::uint32_t v : mesh_.faces()[face].loop) {
      touched_.insert(v);
      result_.rest_box_m.extend(mesh_.restPositions()[v]);
    }
    mesh_.openFace(face);
    ++result_.faces_opened;
  }

  void partVertices() {
    for (const std::uint32_t v : touched_) {
      for (std::uint32_t replicas = mesh_.partVertex(v); replicas > 0; --replicas)
        positions_m_.push_back(Vector3(positions_m_[v]));
    }
  }

  CutMesh& mesh_;
  const Lattice& lattice_;
  const std::vector<Material>& materials_;
  double snap_m_;
  double least_island_m3_;
  ShapeLimits limits_{};
  const BladePatch& patch_;
  const std::optional<BladePatch>& last_;
  std::vector<Vector3>& positions_m_;
  std::map<std::uint32_t, int>& sides_;  // of pieces at the stroke
  BladeCutResult& result_;
  PlaneSides blade_;
  std::vector<PlaneSides> borders_;
  std::vector<std::uint32_t> pieces_;  // near the patch
  std::set<std::uint32_t> touched_;    // vertices that may have to be parted
};

/// Other strokes may have split pieces at the lips since.
void inheritSides(const CutMesh& mesh, Lips& lips) {
  for (std::uint32_t p = lips.pieces_seen; !lips.side_of_piece.empty() && p < mesh.pieces().size(); ++p) {
    if (const auto origin = lips.side_of_piece.find(mesh.pieces()[p].origin); origin != lips.side_of_piece.end())
      lips.side_of_piece.insert({p, origin->second});
  }
}

std::optional<BladePatch> lastOf(const std::vector<BladePatch>& patches) {
  return patches.empty() ? std::nullopt : std::optional(patches.back());
}

/// Then its sides are the other way round.
bool turnsBack(const std::optional<BladePatch>& last, const BladePatch& patch) {
  return last && last->plane.normal.dot(patch.plane.normal) <= 0.0;
}

}  // namespace

BladeCutResult cutMesh(CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
                       const CutResolution& resolution, const std::vector<SweptQuad>& quads, double reach_m, Lips& lips,
                       std::vector<Vector3>& positions_m) {
  const double h = lattice.spacing_m.minCoeff();
  const std::size_t vertices = mesh.vertexCount();
  BladeCutResult result;
  inheritSides(mesh, lips);
  const auto patches = [&](const SweptQuad& quad) {
    return patchesOf(quad, kFlatQuad * h, kNarrowPatch * resolution.snap * h);
  };
  for (const SweptQuad& quad : quads) {
    std::optional<BladePatch> last =
        lastOf(patches({lips.start_m[0], lips.start_m[1], lips.edge_m[1], lips.edge_m[0]}));
    bool goes_on = quad[0] == lips.edge_m[0] && quad[1] == lips.edge_m[1];
    lips.start_m = {quad[0], quad[1]};
    lips.edge_m = {quad[3], quad[2]};
    for (const BladePatch& patch : patches(quad)) {
      if (!goes_on || turnsBack(last, patch)) {
        last.reset();
        lips.side_of_piece.clear();
      }
      PatchCut(mesh, lattice, materials, resolution, patch, last, reach_m, positions_m, lips.side_of_piece, result)
          .run();
      last = patch;
      goes_on = true;
    }
  }
  lips.pieces_seen = static_cast<std::uint32_t>(mesh.pieces().size());
  result.vertices_added = static_cast<std::uint32_t>(mesh.vertexCount() - vertices);
  return result;
}

}  // namespace soft_volume::core
