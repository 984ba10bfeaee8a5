#include "soft_volume/incision/embedding.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <numeric>
#include <utility>

#include "disjoint_sets.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {
namespace {

using Numbers = std::vector<std::uint32_t>;

/// Places within a cell nearer than this to a face of it, in cell edges, lie on the face.
constexpr double kOnFace = 1e-9;

void sortUnique(Numbers& numbers) {
  std::sort(numbers.begin(), numbers.end());
  numbers.erase(std::unique(numbers.begin(), numbers.end()), numbers.end());
}

/// In the cell's own coordinates: 0 to 1 along each axis.
Vector3 placeInCell(const Lattice& lattice, std::uint32_t cell, const Vector3& rest_m) {
  const Vector3 low = lattice.cellIndex(lattice.parent_cells[cell]).cast<double>();
  return (rest_m - lattice.origin_m).cwiseQuotient(lattice.spacing_m) - low;
}

/// The face of the cell that a polygon lies in, or -1.
int faceOfLoop(const Lattice& lattice, std::uint32_t cell, const std::vector<Vector3>& rest_m, const Numbers& loop) {
  for (int face = 0; face < 6; ++face) {
    const double at = face % 2;
    if (std::all_of(loop.begin(), loop.end(), [&](std::uint32_t v) {
          return std::abs(placeInCell(lattice, cell, rest_m[v])[face / 2] - at) < kOnFace;
        }))
      return face;
  }
  return -1;
}

/// One update: what the mesh changed since `seen_faces` is brought to the lattice.
class Update {
 public:
  Update(const CutMesh& mesh, Lattice& lattice, Numbers& cells_of_pieces, std::size_t seen_faces)
      : mesh_(mesh), lattice_(lattice), cells_of_pieces_(cells_of_pieces) {
    findTouched(seen_faces);
  }

  EmbeddingChange run() {
    EmbeddingChange change;
    const std::size_t cells = lattice_.cellCount();
    const std::size_t vertices = lattice_.vertexCount();
    for (auto p = static_cast<std::uint32_t>(cells_of_pieces_.size()); p < mesh_.pieces().size(); ++p)
      cells_of_pieces_.push_back(std::uint32_t(cells_of_pieces_[mesh_.pieces()[p].origin]));
    for (const std::uint32_t cell : touched_)
      findBodies(cell);
    findSurroundings();
    findLinks();
    for (const std::uint32_t node : nodes_)
      partNode(node);
    for (const std::uint32_t cell : around_)
      updateFaces(cell);
    for (const std::uint32_t cell : touched_) {
      for (const std::uint32_t v : lattice_.cells[cell])
        change.rest_box_m.extend(lattice_.rest_positions[v]);
    }
    change.cells_added = static_cast<std::uint32_t>(lattice_.cellCount() - cells);
    change.vertices_added = static_cast<std::uint32_t>(lattice_.vertexCount() - vertices);
    lattice_.revision += touched_.empty() ? 0 : 1;
    return change;
  }

 private:
  /// A cell at a lattice node, and which of its corners that is.
  struct Member {
    std::uint32_t cell;
    int corner;
  };
  /// Cells joined through closed parts of a face.
  struct Link {
    std::uint32_t cell;
    int face;
    std::uint32_t other;
    bool operator<(const Link& b) const {
      return cell != b.cell ? cell < b.cell : face != b.face ? face < b.face : other < b.other;
    }
    bool operator==(const Link& b) const { return cell == b.cell && face == b.face && other == b.other; }
  };

  std::uint32_t latticeCellOf(std::int32_t piece) const { return mesh_.pieces()[static_cast<std::size_t>(piece)].cell; }

  /// The cells whose pieces got new faces: a split makes a section, and an opened face a second one.
  void findTouched(std::size_t seen_faces) {
    for (std::size_t f = seen_faces; f < mesh_.faces().size(); ++f) {
      for (const std::int32_t piece : mesh_.faces()[f].pieces) {
        if (piece != CutMesh::kNone)
          touched_.push_back(latticeCellOf(piece));
      }
    }
    sortUnique(touched_);
  }

  /// Gives every body of a cell a copy; that of a body's lowest piece stays with it where no lower body has it.
  void findBodies(std::uint32_t cell) {
    const Numbers& pieces = mesh_.piecesOfCell(cell);
    Numbers parents(pieces.size());
    std::iota(parents.begin(), parents.end(), 0U);
    for (std::uint32_t n = 0; n < pieces.size(); ++n) {
      for (const std::uint32_t f : mesh_.pieces()[pieces[n]].faces) {
        const std::int32_t other = mesh_.across(f, pieces[n]);
        if (other == CutMesh::kNone || latticeCellOf(other) != cell)
          continue;
        const auto place = std::lower_bound(pieces.begin(), pieces.end(), static_cast<std::uint32_t>(other));
        join(parents, n, static_cast<std::uint32_t>(place - pieces.begin()));
      }
    }
    Numbers taken;
    for (std::uint32_t n = 0; n < pieces.size(); ++n) {
      std::uint32_t& copy = cells_of_pieces_[pieces[n]];
      if (rootOf(parents, n) != n) {
        copy = cells_of_pieces_[pieces[rootOf(parents, n)]];
        continue;
      }
      if (std::find(taken.begin(), taken.end(), copy) != taken.end())
        copy = copyCell(lattice_, copy);
      taken.push_back(copy);
    }
    if (taken.size() > 1)
      divide(pieces, taken);
  }

  /// Shares of a cell's copies, by volume.
  void divide(const Numbers& pieces, const Numbers& copies) {
    std::vector<double> volumes(copies.size(), 0.0);
    for (const std::uint32_t piece : pieces) {
      const auto place = std::find(copies.begin(), copies.end(), cells_of_pieces_[piece]) - copies.begin();
      volumes[static_cast<std::size_t>(place)] += volumeOf(solidOf(mesh_, piece));
    }
    const double whole = lattice_.spacing_m.prod();
    const auto largest = static_cast<std::size_t>(std::max_element(volumes.begin(), volumes.end()) - volumes.begin());
    double rest = shareOf(copies);
    for (std::size_t n = 0; n < copies.size(); ++n) {
      lattice_.shares[copies[n]] = volumes[n] / whole;
      rest -= n == largest ? 0.0 : volumes[n] / whole;
    }
    lattice_.shares[copies[largest]] = rest;
  }

  /// What the copies of a cell share: all of it, less what was removed.
  double shareOf(const Numbers& copies) const {
    double sum = 0.0;
    bool removed = false;
    for (std::int32_t cell = static_cast<std::int32_t>(lattice_.firstCell(copies[0])); cell != Lattice::kNone;
         cell = lattice_.next_cells[static_cast<std::size_t>(cell)]) {
      sum += lattice_.shares[static_cast<std::size_t>(cell)];
      removed |= std::find(copies.begin(), copies.end(), static_cast<std::uint32_t>(cell)) == copies.end();
    }
    return removed ? sum : 1.0;
  }

  template <typename Visit>
  void forEachMember(std::uint32_t node, const Visit& visit) const {
    const int nx = lattice_.dims.x() + 1;
    const int ny = lattice_.dims.y() + 1;
    const int n = static_cast<int>(node);
    const Vector3i at(n % nx, (n / nx) % ny, n / (nx * ny));
    for (int c = 0; c < 8; ++c) {
      const Vector3i low = at - Vector3i(kHexahedronCorners[c][0], kHexahedronCorners[c][1], kHexahedronCorners[c][2]);
      const LatticeBox box{low.cwiseMax(0), (low + Vector3i::Ones()).cwiseMin(lattice_.dims)};
      forEachCell(lattice_, box, [&](std::uint32_t cell) { visit(Member{cell, c}); });
    }
  }

  /// The corners of touched cells and all cells around these.
  void findSurroundings() {
    for (const std::uint32_t cell : touched_) {
      for (const std::uint32_t v : lattice_.cells[cell])
        nodes_.push_back(lattice_.lattice_nodes[v]);
    }
    sortUnique(nodes_);
    for (const std::uint32_t node : nodes_)
      forEachMember(node, [this](const Member& member) { around_.push_back(member.cell); });
    sortUnique(around_);
  }

  int faceTowards(std::uint32_t cell, std::uint32_t other) const {
    const Vector3i step =
        lattice_.cellIndex(lattice_.parent_cells[other]) - lattice_.cellIndex(lattice_.parent_cells[cell]);
    assert(step.cwiseAbs().sum() == 1);
    const int axis = step.x() != 0 ? 0 : step.y() != 0 ? 1 : 2;
    return 2 * axis + (step[axis] > 0 ? 1 : 0);
  }

  void findLinks() {
    for (const std::uint32_t cell : around_) {
      if (lattice_.firstCell(cell) != cell)
        continue;
      for (const std::uint32_t piece : mesh_.piecesOfCell(cell)) {
        for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
          const std::int32_t other = mesh_.across(f, piece);
          if (other == CutMesh::kNone || latticeCellOf(other) == cell)
            continue;
          links_.push_back({cells_of_pieces_[piece], faceTowards(cell, latticeCellOf(other)),
                            cells_of_pieces_[static_cast<std::size_t>(other)]});
        }
      }
    }
    std::sort(links_.begin(), links_.end());
    links_.erase(std::unique(links_.begin(), links_.end()), links_.end());
  }

  bool linked(std::uint32_t a, std::uint32_t b) const {
    const auto first = std::lower_bound(links_.begin(), links_.end(), Link{a, 0, 0});
    const auto last = std::lower_bound(first, links_.end(), Link{a, 6, 0});
    return std::any_of(first, last, [b](const Link& link) { return link.other == b; });
  }

  std::uint32_t originalVertex(std::uint32_t vertex) const {
    while (lattice_.origin_vertices[vertex] != vertex)
      vertex = lattice_.origin_vertices[vertex];
    return vertex;
  }

  /// In the lattice as it was built.
  bool wasFixed(std::uint32_t vertex) const { return lattice_.fixed[originalVertex(vertex)] == 1; }

  /// Calls visit(place in the cell) for the mesh vertices of a body until it says true.
  template <typename Visit>
  bool anyVertexOf(std::uint32_t cell, const Visit& visit) const {
    for (const std::uint32_t piece : mesh_.piecesOfCell(lattice_.firstCell(cell))) {
      if (cells_of_pieces_[piece] != cell)
        continue;
      for (const std::uint32_t v : mesh_.verticesOf(piece)) {
        if (visit(placeInCell(lattice_, cell, mesh_.restPositions()[v])))
          return true;
      }
    }
    return false;
  }

  bool isWhole(std::uint32_t cell) const { return lattice_.shares[cell] == 1.0; }

  /// Whether a body has tissue at a corner of its cell.
  bool hasCorner(const Member& member) const {
    const int* c = kHexahedronCorners[member.corner];
    const Vector3 corner(c[0], c[1], c[2]);
    return isWhole(member.cell) ||
           anyVertexOf(member.cell, [&](const Vector3& p) { return (p - corner).cwiseAbs().maxCoeff() < kOnFace; });
  }

  /// Whether a body touches a corner, edge or face of its cell at this corner all of whose corners are fixed.
  bool isHeld(const Member& member) const {
    return isWhole(member.cell) || anyVertexOf(member.cell, [&](const Vector3& p) {
             const auto belongs = [&](int corner) {
               for (int d = 0; d < 3; ++d) {
                 const bool on_other_side = std::abs(p[d] - (1 - kHexahedronCorners[corner][d])) < kOnFace;
                 if (on_other_side)
                   return false;
               }
               return true;
             };
             if (!belongs(member.corner))
               return false;
             for (int c = 0; c < 8; ++c) {
               const std::uint32_t v = lattice_.cells[member.cell][static_cast<std::size_t>(c)];
               if (belongs(c) && !wasFixed(v))
                 return false;
             }
             return true;
           });
  }

  std::uint32_t& vertexOf(const Member& member) {
    return lattice_.cells[member.cell][static_cast<std::size_t>(member.corner)];
  }

  /// Gives a vertex of its own to each group of cells at a node that is joined through faces.
  void partNode(std::uint32_t node) {
    members_.clear();
    forEachMember(node, [this](const Member& member) { members_.push_back(member); });
    std::sort(members_.begin(), members_.end(), [](const Member& a, const Member& b) { return a.cell < b.cell; });
    Numbers parents(members_.size());
    std::iota(parents.begin(), parents.end(), 0U);
    for (std::uint32_t a = 0; a < members_.size(); ++a) {
      for (std::uint32_t b = a + 1; b < members_.size(); ++b) {
        if (linked(members_[a].cell, members_[b].cell))
          join(parents, a, b);
      }
    }
    std::vector<Numbers> groups;
    for (std::uint32_t n = 0; n < members_.size(); ++n) {
      if (rootOf(parents, n) != n)
        continue;
      groups.emplace_back();
      for (std::uint32_t m = n; m < members_.size(); ++m) {
        if (rootOf(parents, m) == n)
          groups.back().push_back(m);
      }
    }
    if (groups.size() > 1)
      giveVertices(groups);
  }

  template <typename Holds>
  bool anyOf(const Numbers& group, const Holds& holds) const {
    return std::any_of(group.begin(), group.end(), [&](std::uint32_t m) { return holds(members_[m]); });
  }

  void giveVertices(const std::vector<Numbers>& groups) {
    const bool fixed = wasFixed(vertexOf(members_[0]));
    std::vector<std::uint32_t> before;
    for (const Numbers& group : groups)
      before.push_back(vertexOf(members_[group[0]]));
    for (std::size_t g = 0; g < groups.size(); ++g) {
      std::uint32_t vertex = before[g];
      if (keeper(groups, before, vertex) != g) {
        vertex = replicateVertex(lattice_, vertex);
        for (const std::uint32_t m : groups[g])
          vertexOf(members_[m]) = vertex;
      }
      if (fixed)
        lattice_.fixed[vertex] = anyOf(groups[g], [this](const Member& m) { return isHeld(m); }) ? 1 : 0;
    }
  }

  /// Which of the groups that had a vertex goes on with it.
  std::size_t keeper(const std::vector<Numbers>& groups, const Numbers& before, std::uint32_t vertex) const {
    const auto count = static_cast<std::size_t>(std::count(before.begin(), before.end(), vertex));
    const auto first = static_cast<std::size_t>(std::find(before.begin(), before.end(), vertex) - before.begin());
    for (std::size_t g = first; count > 1 && g < groups.size(); ++g) {
      if (before[g] == vertex && anyOf(groups[g], [this](const Member& m) { return hasCorner(m); }))
        return g;
    }
    return first;
  }

  /// What lies behind the faces of a cell, and how much of them is surface.
  void updateFaces(std::uint32_t cell) {
    auto& neighbours = lattice_.face_neighbours[cell];
    auto& cut = lattice_.cut_faces[cell];
    const Vector3i at = lattice_.cellIndex(lattice_.parent_cells[cell]);
    for (int face = 0; face < 6; ++face) {
      const auto f = static_cast<std::size_t>(face);
      const auto link = std::lower_bound(links_.begin(), links_.end(), Link{cell, face, 0});
      neighbours[f] =
          link != links_.end() && link->cell == cell && link->face == face ? std::int32_t(link->other) : Lattice::kNone;
      Vector3i other = at;
      other[face / 2] += face % 2 == 0 ? -1 : 1;
      const bool inside = other.minCoeff() >= 0 && (other.array() < lattice_.dims.array()).all();
      const bool tissue =
          inside && lattice_.cell_at[lattice_.latticeCell(other.x(), other.y(), other.z())] != Lattice::kNone;
      cut[f] = tissue && neighbours[f] == Lattice::kNone ? 1 : 0;
    }
    if (!isWhole(cell))
      measureSurface(cell);
  }

  void measureSurface(std::uint32_t cell) {
    auto& shares = lattice_.surface_shares[cell];
    shares.fill(0.0);
    for (const std::uint32_t piece : mesh_.piecesOfCell(lattice_.firstCell(cell))) {
      if (cells_of_pieces_[piece] != cell)
        continue;
      for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
        const CutMesh::Face& polygon = mesh_.faces()[f];
        if (polygon.pieces[1] != CutMesh::kNone || polygon.opened)
          continue;
        const int face = faceOfLoop(lattice_, cell, mesh_.restPositions(), polygon.loop);
        assert(face >= 0);
        const double whole_m2 = lattice_.spacing_m.prod() / lattice_.spacing_m[face / 2];
        shares[static_cast<std::size_t>(face)] +=
            0.5 * areaVector(mesh_.restPositions(), polygon.loop).norm() / whole_m2;
      }
    }
  }

  const CutMesh& mesh_;
  Lattice& lattice_;
  Numbers& cells_of_pieces_;
  Numbers touched_;  // first cells of their places, as those of the mesh are
  Numbers nodes_;
  Numbers around_;
  std::vector<Link> links_;
  std::vector<Member> members_;
};

}  // namespace

Embedding::Embedding(const CutMesh& mesh) : seen_faces_(mesh.faces().size()) {
  for (const CutMesh::Piece& piece : mesh.pieces())
    cells_of_pieces_.push_back(piece.cell);
}

Embedding::Embedding(const CutMesh& mesh, std::vector<std::uint32_t> cells_of_pieces)
    : cells_of_pieces_(std::move(cells_of_pieces)), seen_faces_(mesh.faces().size()) {
  assert(cells_of_pieces_.size() == mesh.pieces().size());
}

EmbeddingChange Embedding::update(const CutMesh& mesh, Lattice& lattice) {
  const EmbeddingChange change = Update(mesh, lattice, cells_of_pieces_, seen_faces_).run();
  seen_faces_ = mesh.faces().size();
  return change;
}

Vector3 Embedding::place(const CutMesh& mesh, const Lattice& lattice, const std::vector<Vector3>& positions_m,
                         std::uint32_t vertex) const {
  const std::uint32_t cell = cellOf(mesh.piecesAround(vertex).front());
  const Vector3 at = placeInCell(lattice, cell, mesh.restPositions()[vertex]);
  Vector3 sum = Vector3::Zero();
  for (std::size_t c = 0; c < 8; ++c) {
    double weight = 1.0;
    for (int d = 0; d < 3; ++d) {
      const double t = std::abs(at[d]) < kOnFace ? 0.0 : std::abs(at[d] - 1.0) < kOnFace ? 1.0 : at[d];
      weight *= kHexahedronCorners[c][d] != 0 ? t : 1.0 - t;
    }
    if (weight != 0.0)
      sum += weight * positions_m[lattice.cells[cell][c]];
  }
  return sum;
}

}  // namespace soft_volume::core
