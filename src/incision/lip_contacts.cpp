#include "soft_volume/incision/lip_contacts.h"

#include <algorithm>
#include <cmath>

#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {
namespace {

using Polygon = std::vector<Vector3>;

/// In units of the shortest cell edge h: what counts as one place, and of h^2: overlaps that are left out, and those
/// that are small enough for one contact. Lips of one opening have the same places but for the rounding of later cuts.
constexpr double kSamePlace = 1e-6;
constexpr double kLeastArea = 1e-6;
constexpr double kSmallArea = 0.05;

/// One side of an opened face.
struct Lip {
  std::uint32_t face;
  std::uint32_t cell;  ///< that carries it
  Vector3 normal;      ///< out of the tissue
  Vector3 middle_m;
  double radius_m;
  Polygon polygon_m;  ///< counter-clockwise seen from outside
};

Vector3 areaOf(const Polygon& polygon_m) {
  Vector3 area = Vector3::Zero();
  for (std::size_t n = 2; n < polygon_m.size(); ++n)
    area += 0.5 * (polygon_m[n - 1] - polygon_m[0]).cross(polygon_m[n] - polygon_m[0]);
  return area;
}

Lip makeLip(const CutMesh& mesh, const Embedding& embedding, std::uint32_t face, std::uint32_t piece) {
  Lip lip{face, embedding.cellOf(piece), Vector3::Zero(), Vector3::Zero(), 0.0, {}};
  for (const std::uint32_t v : mesh.outwardLoop(face, piece)) {
    lip.polygon_m.push_back(mesh.restPositions()[v]);
    lip.middle_m += mesh.restPositions()[v];
  }
  lip.middle_m /= double(lip.polygon_m.size());
  lip.normal = areaOf(lip.polygon_m).normalized();
  for (const Vector3& p : lip.polygon_m)
    lip.radius_m = std::max(lip.radius_m, (p - lip.middle_m).norm());
  return lip;
}

/// The part of a polygon on the inner side of the line through a and b, `inward` being the way to it.
Polygon cutOff(const Polygon& polygon_m, const Vector3& a, const Vector3& inward) {
  Polygon kept;
  for (std::size_t n = 0; n < polygon_m.size(); ++n) {
    const Vector3& p = polygon_m[n];
    const Vector3& q = polygon_m[(n + 1) % polygon_m.size()];
    const double at_p = inward.dot(p - a);
    const double at_q = inward.dot(q - a);
    if (at_p >= 0.0)
      kept.push_back(p);
    if ((at_p > 0.0 && at_q < 0.0) || (at_p < 0.0 && at_q > 0.0))
      kept.emplace_back(p + at_p / (at_p - at_q) * (q - p));
  }
  return kept;
}

/// Without vertices that lie on others or on the line between their neighbours.
Polygon withoutStraightCorners(const Polygon& polygon_m, double tolerance_m) {
  Polygon apart;
  for (const Vector3& p : polygon_m) {
    if (apart.empty() || (p - apart.back()).norm() > tolerance_m)
      apart.push_back(p);
  }
  while (apart.size() > 1 && (apart.front() - apart.back()).norm() <= tolerance_m)
    apart.pop_back();
  Polygon corners;
  for (std::size_t n = 0; n < apart.size(); ++n) {
    const Vector3& before = corners.empty() ? apart[(n + apart.size() - 1) % apart.size()] : corners.back();
    const Vector3 chord = apart[(n + 1) % apart.size()] - before;
    if (chord.cross(apart[n] - before).norm() > tolerance_m * chord.norm())
      corners.push_back(apart[n]);
  }
  return corners;
}

class Finder {
 public:
  Finder(const CutMesh& mesh, const Embedding& embedding, const Lattice& lattice,
         const std::vector<Material>& materials, const IncisionSettings& settings)
      : mesh_(mesh),
        embedding_(embedding),
        lattice_(lattice),
        materials_(materials),
        settings_(settings),
        h_(lattice.spacing_m.minCoeff()) {}

  std::vector<LipContact> run() {
    findCells();
    for (const std::uint32_t cell : cells_)
      findLips(cell);
    begin_.push_back(lips_.size());
    for (std::size_t n = 0; n < cells_.size(); ++n) {
      for (std::size_t lip = begin_[n]; lip < begin_[n + 1]; ++lip) {
        pair(lips_[lip], n);
        for (std::size_t face = 0; face < 6; ++face)
          pair(lips_[lip], neighbour(cells_[n], face));
      }
    }
    return std::move(contacts_);
  }

 private:
  /// Where there may be lips that different cells carry: cells with copies, and those parted from a neighbour.
  void findCells() {
    for (std::uint32_t cell = 0; cell < lattice_.cellCount(); ++cell) {
      const auto& cut = lattice_.cut_faces[cell];
      if (lattice_.shares[cell] < 1.0 || std::any_of(cut.begin(), cut.end(), [](std::uint8_t c) { return c != 0; }))
        cells_.push_back(static_cast<std::uint32_t>(lattice_.cell_at[lattice_.parent_cells[cell]]));
    }
    std::sort(cells_.begin(), cells_.end());
    cells_.erase(std::unique(cells_.begin(), cells_.end()), cells_.end());
  }

  void findLips(std::uint32_t cell) {
    begin_.push_back(lips_.size());
    for (const std::uint32_t piece : mesh_.piecesOfCell(cell)) {
      for (const std::uint32_t face : mesh_.pieces()[piece].faces) {
        if (mesh_.faces()[face].opened)
          lips_.push_back(makeLip(mesh_, embedding_, face, piece));
      }
    }
  }

  /// Place among cells_ of the cell behind a face, or its size.
  std::size_t neighbour(std::uint32_t cell, std::size_t face) const {
    Vector3i at = lattice_.cellIndex(lattice_.parent_cells[cell]);
    at[static_cast<Eigen::Index>(face / 2)] += face % 2 == 0 ? -1 : 1;
    if (at.minCoeff() < 0 || (at.array() >= lattice_.dims.array()).any())
      return cells_.size();
    const std::int32_t other = lattice_.cell_at[lattice_.latticeCell(at.x(), at.y(), at.z())];
    const auto place = std::lower_bound(cells_.begin(), cells_.end(), static_cast<std::uint32_t>(other));
    const bool found = other != Lattice::kNone && place != cells_.end() && *place == static_cast<std::uint32_t>(other);
    return found ? static_cast<std::size_t>(place - cells_.begin()) : cells_.size();
  }

  /// The lip's contacts with those of a cell that have a higher number, so that each is found once.
  void pair(const Lip& a, std::size_t cell) {
    if (cell == cells_.size())
      return;
    for (std::size_t n = begin_[cell]; n < begin_[cell + 1]; ++n) {
      if (lips_[n].face > a.face && areOpposite(a, lips_[n]))
        addContacts(a, lips_[n]);
    }
  }

  bool areOpposite(const Lip& a, const Lip& b) const {
    return a.cell != b.cell && a.normal.dot(b.normal) < -1.0 + kSamePlace &&
           std::abs(a.normal.dot(b.middle_m - a.middle_m)) < kSamePlace * h_ &&
           (a.middle_m - b.middle_m).norm() < a.radius_m + b.radius_m;
  }

  void addContacts(const Lip& a, const Lip& b) {
    Polygon overlap = a.polygon_m;
    for (std::size_t n = 0; n < b.polygon_m.size() && !overlap.empty(); ++n) {
      const Vector3 along = b.polygon_m[(n + 1) % b.polygon_m.size()] - b.polygon_m[n];
      overlap =
          cutOff(overlap, b.polygon_m[n] - kSamePlace * h_ * b.normal.cross(along).normalized(), b.normal.cross(along));
    }
    overlap = withoutStraightCorners(overlap, 2.0 * kSamePlace * h_);
    const double area_m2 = areaOf(overlap).norm();
    if (overlap.size() < 3 || area_m2 < kLeastArea * h_ * h_)
      return;
    const Vector3 middle = centroid(overlap, area_m2);
    if (overlap.size() == 3 || area_m2 < kSmallArea * h_ * h_) {
      add(a, b, middle, area_m2);
      return;
    }
    for (std::size_t n = 0; n < overlap.size(); ++n) {
      const Vector3& p = overlap[n];
      const Vector3& q = overlap[(n + 1) % overlap.size()];
      add(a, b, (middle + p + q) / 3.0, 0.5 * (p - middle).cross(q - middle).norm());
    }
  }

  static Vector3 centroid(const Polygon& polygon_m, double area_m2) {
    Vector3 sum = Vector3::Zero();
    for (std::size_t n = 2; n < polygon_m.size(); ++n) {
      const Vector3 area = 0.5 * (polygon_m[n - 1] - polygon_m[0]).cross(polygon_m[n] - polygon_m[0]);
      sum += area.norm() / area_m2 * (polygon_m[0] + polygon_m[n - 1] + polygon_m[n]) / 3.0;
    }
    return sum;
  }

  /// 0 to 1 along each axis; what lies on a face of the cell hangs on that face's corners alone.
  Vector3 placeIn(std::uint32_t cell, const Vector3& rest_m) const {
    const Vector3 low = lattice_.cellIndex(lattice_.parent_cells[cell]).cast<double>();
    Vector3 place = (rest_m - lattice_.origin_m).cwiseQuotient(lattice_.spacing_m) - low;
    for (int d = 0; d < 3; ++d)
      place[d] = std::abs(place[d]) < kSamePlace ? 0.0 : std::abs(place[d] - 1.0) < kSamePlace ? 1.0 : place[d];
    return place;
  }

  void add(const Lip& a, const Lip& b, const Vector3& rest_m, double area_m2) {
    const Material& of_a = materials_[lattice_.materials[a.cell]];
    const Material& of_b = materials_[lattice_.materials[b.cell]];
    if (of_a.fixed && of_b.fixed)
      return;
    const double modulus_pa = 2.0 / (1.0 / of_a.youngs_modulus_pa + 1.0 / of_b.youngs_modulus_pa);
    LipContact contact;
    contact.cells = {a.cell, b.cell};
    contact.places = {placeIn(a.cell, rest_m), placeIn(b.cell, rest_m)};
    contact.normal = a.normal;
    contact.area_m2 = area_m2;
    contact.stiffness_n_m = kLipStiffness * modulus_pa * area_m2 / h_;
    contact.opening_n = settings_.opening_pressure_pa * area_m2;
    contacts_.push_back(contact);
  }

  const CutMesh& mesh_;
  const Embedding& embedding_;
  const Lattice& lattice_;
  const std::vector<Material>& materials_;
  const IncisionSettings& settings_;
  double h_;
  std::vector<std::uint32_t> cells_;  // first of their places, increasing
  std::vector<std::size_t> begin_;    // of each cell's lips
  std::vector<Lip> lips_;
  std::vector<LipContact> contacts_;
};

}  // namespace

std::vector<LipContact> findLipContacts(const CutMesh& mesh, const Embedding& embedding, const Lattice& lattice,
                                        const std::vector<Material>& materials, const IncisionSettings& settings) {
  return Finder(mesh, embedding, lattice, materials, settings).run();
}

void shortenAcrossLips(Lattice& lattice, const std::vector<LipContact>& lips, double rest_fraction) {
  for (const LipContact& lip : lips) {
    for (const std::uint32_t cell : lip.cells) {
      const Vector3 factor = Vector3::Ones() - (1.0 - rest_fraction) * lip.normal.cwiseAbs2();
      lattice.rest_stretch[cell] = lattice.rest_stretch[cell].cwiseMin(factor);
    }
  }
}

}  // namespace soft_volume::core
