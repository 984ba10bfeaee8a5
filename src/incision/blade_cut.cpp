#include "soft_volume/incision/blade_cut.h"

#include <algorithm>
#include <cmath>
#include <map>
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
/// How far from a patch's border it may miss the patch before, in snap distances.
constexpr double kJoint = 15.0;
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

/// -1 or 1 for the pieces at the lips.
using LipSides = std::map<std::uint32_t, int>;

double distanceFromSegment(const Vector3& p, const Vector3& a, const Vector3& b) {
  const Vector3 along = b - a;
  const double length2 = along.squaredNorm();
  const double t = length2 > 0.0 ? std::clamp(along.dot(p - a) / length2, 0.0, 1.0) : 0.0;
  return (p - a - t * along).norm();
}

/// The work of one patch. `lips` are those of the patches that it continues, and get its own; those that are too far
/// away for the next patch are dropped.
class PatchCut {
 public:
  PatchCut(CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
           const CutResolution& resolution, const BladePatch& patch, double reach_m, std::vector<Vector3>& positions_m,
           LipSides& lips, BladeCutResult& result)
      : mesh_(mesh),
        lattice_(lattice),
        materials_(materials),
        snap_m_(resolution.snap * lattice.spacing_m.minCoeff()),
        patch_(patch),
        positions_m_(positions_m),
        lips_(lips),
        result_(result),
        blade_(patch.plane, snap_m_, positions_m) {
    const double h = lattice.spacing_m.minCoeff();
    limits_ = {resolution.least_edge * h, resolution.least_width * h, resolution.deepest_dent * h, kFlatSection * h};
    for (const Plane& side : patch.sides)
      borders_.emplace_back(side, snap_m_, positions_m);
    findPieces(reach_m);
  }

  void run() {
    splitAtBorder();
    splitByBlade();
    openFaces();
    dropFarLips();
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
    if (const auto lip = lips_.find(piece); lip != lips_.end())
      lips_[pieces_.back()] = lip->second;
    ++result_.pieces_split;
    return true;
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
        entered_.insert(piece);
      }
    }
  }

  void splitByBlade() {
    const std::vector<std::uint32_t> all = pieces_;
    for (const std::uint32_t piece : all) {
      if (!isCuttable(piece) || !sidesOf(piece).straddles())
        continue;
      const std::vector<Vector3> section = sectionOf(piece);
      const bool entered = entered_.count(piece) > 0;
      if (section.empty() || (!entered && !covers(centroidOf(section, patch_.plane.normal), 0.0)))
        continue;
      if (!split(piece, blade_))
        kept_whole_.insert(piece);
      else if (entered)
        entered_.insert(pieces_.back());
    }
  }

  /// How a piece stands to the blade when all splits are done.
  struct Stand {
    int side;        ///< -1 or 1
    bool straddles;  ///< and the blade does not part it
    bool kept_whole;
    bool cuttable;
  };
  Stand standOf(std::uint32_t piece) const {
    const Sides sides = sidesOf(piece);
    Stand stand{sides.front ? 1 : -1, sides.straddles(), kept_whole_.count(piece) > 0, isCuttable(piece)};
    if (sides.behind == sides.front) {
      double sum = 0.0;
      for (const std::uint32_t v : mesh_.verticesOf(piece))
        sum += blade_.distance(v);
      stand.side = sum < 0.0 ? -1 : 1;
    }
    return stand;
  }

  bool isToOpen(const CutMesh::Face& face, const Stand& a, const Stand& b) const {
    if (a.side == b.side || !a.cuttable || !b.cuttable)
      return false;
    if (a.straddles || b.straddles)
      return a.straddles <= a.kept_whole && b.straddles <= b.kept_whole;
    Vector3 middle = Vector3::Zero();
    for (const std::uint32_t v : face.loop)
      middle += positions_m_[v] / static_cast<double>(face.loop.size());
    const bool entered = std::all_of(face.pieces.begin(), face.pieces.end(), [this](std::int32_t piece) {
      return entered_.count(static_cast<std::uint32_t>(piece)) > 0;
    });
    return entered || covers(middle, snap_m_);
  }

  void openFaces() {
    std::map<std::uint32_t, Stand> stands;
    for (const std::uint32_t piece : pieces_)
      stands.insert({piece, standOf(piece)});
    std::set<std::uint32_t> to_open;
    for (const auto& [piece, stand] : stands) {
      for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
        const auto other = stands.find(static_cast<std::uint32_t>(mesh_.across(f, piece)));
        if (other != stands.end() && isToOpen(mesh_.faces()[f], stand, other->second))
          to_open.insert(f);
      }
    }
    LipSides lips;
    for (const std::uint32_t f : to_open) {
      for (const std::int32_t piece : mesh_.faces()[f].pieces)
        lips.insert({static_cast<std::uint32_t>(piece), stands.at(static_cast<std::uint32_t>(piece)).side});
    }
    collectJoints(lips, to_open);
    for (const std::uint32_t f : to_open)
      open(f);
    for (const auto& [piece, side] : lips)
      lips_[piece] = side;
    partVertices();
  }

  /// Where a lip of the patches before and an opposite one of this patch meet at a face across the blade, the two
  /// sections have missed each other, because a split was refused or its place snapped.
  void collectJoints(const LipSides& lips, std::set<std::uint32_t>& to_open) const {
    for (const auto& [piece, side] : lips_) {
      if (const auto now = lips.find(piece); now != lips.end() && now->second != side)
        continue;
      for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
        const auto other = lips.find(static_cast<std::uint32_t>(mesh_.across(f, piece)));
        if (other != lips.end() && other->second != side && isAtBorder(mesh_.faces()[f]))
          to_open.insert(f);
      }
    }
  }

  /// The next patch starts at this one, so its joints are near both.
  void dropFarLips() {
    LipSides near;
    for (const std::uint32_t piece : pieces_) {
      if (const auto lip = lips_.find(piece); lip != lips_.end())
        near.insert(*lip);
    }
    lips_ = std::move(near);
  }

  bool isAtBorder(const CutMesh::Face& face) const {
    Vector3 middle = Vector3::Zero();
    for (const std::uint32_t v : face.loop)
      middle += positions_m_[v] / static_cast<double>(face.loop.size());
    const auto count = patch_.corners.size();
    for (std::size_t i = 0; i < count; ++i) {
      if (distanceFromSegment(middle, patch_.corners[i], patch_.corners[(i + 1) % count]) < kJoint * snap_m_)
        return true;
    }
    return false;
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
  ShapeLimits limits_{};
  const BladePatch& patch_;
  std::vector<Vector3>& positions_m_;
  LipSides& lips_;
  BladeCutResult& result_;
  PlaneSides blade_;
  std::vector<PlaneSides> borders_;
  std::vector<std::uint32_t> pieces_;   // near the patch
  std::set<std::uint32_t> entered_;     // covered in part, but a part would be too small: taken to be covered
  std::set<std::uint32_t> kept_whole_;  // to be cut, but a part would be too small
  std::set<std::uint32_t> touched_;     // vertices that may have to be parted
};

}  // namespace

BladeCutResult cutMesh(CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
                       const CutResolution& resolution, const std::vector<SweptQuad>& quads, double reach_m, Lips& lips,
                       std::vector<Vector3>& positions_m) {
  const double h = lattice.spacing_m.minCoeff();
  const std::size_t vertices = mesh.vertexCount();
  BladeCutResult result;
  for (const SweptQuad& quad : quads) {
    if (quad[0] != lips.edge_m[0] || quad[1] != lips.edge_m[1])
      lips.side_of_piece.clear();
    lips.edge_m = {quad[3], quad[2]};
    for (const BladePatch& patch : patchesOf(quad, kFlatQuad * h, kNarrowPatch * resolution.snap * h))
      PatchCut(mesh, lattice, materials, resolution, patch, reach_m, positions_m, lips.side_of_piece, result).run();
  }
  result.vertices_added = static_cast<std::uint32_t>(mesh.vertexCount() - vertices);
  return result;
}

}  // namespace soft_volume::core
