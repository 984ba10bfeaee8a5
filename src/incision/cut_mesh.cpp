#include "soft_volume/incision/cut_mesh.h"

#include <algorithm>
#include <cassert>
#include <numeric>
#include <string>
#include <utility>

#include "disjoint_sets.h"
#include "soft_volume/common/error.h"
#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {
namespace {

using Numbers = std::vector<std::uint32_t>;

bool contains(const Numbers& numbers, std::uint32_t wanted) {
  return std::find(numbers.begin(), numbers.end(), wanted) != numbers.end();
}

void insertSorted(Numbers& numbers, std::uint32_t number) {
  const auto place = std::lower_bound(numbers.begin(), numbers.end(), number);
  if (place == numbers.end() || *place != number)
    numbers.insert(place, number);
}

void eraseSorted(Numbers& numbers, std::uint32_t number) {
  const auto place = std::lower_bound(numbers.begin(), numbers.end(), number);
  assert(place != numbers.end() && *place == number);
  numbers.erase(place);
}

/// Puts `middle` between a and b where they follow each other, in whatever order. Says whether they did.
bool insertBetween(Numbers& loop, std::uint32_t a, std::uint32_t b, std::uint32_t middle) {
  for (std::size_t i = 0; i < loop.size(); ++i) {
    const std::uint32_t u = loop[i];
    const std::uint32_t v = loop[(i + 1) % loop.size()];
    if ((u == a && v == b) || (u == b && v == a)) {
      loop.insert(loop.begin() + static_cast<std::ptrdiff_t>(i + 1), middle);
      return true;
    }
  }
  return false;
}

/// The way around a loop from one of its vertices to another, both included.
Numbers wayAround(const Numbers& loop, std::uint32_t from, std::uint32_t to) {
  auto i = static_cast<std::size_t>(std::find(loop.begin(), loop.end(), from) - loop.begin());
  assert(i < loop.size() && contains(loop, to));
  Numbers way = {from};
  while (way.back() != to)
    way.push_back(loop[i = (i + 1) % loop.size()]);
  return way;
}

void require(bool condition, const char* problem) {
  if (!condition)
    throw InputError(std::string("cut mesh: ") + problem);
}

/// Room for cuts, so that the first of them does not move all that there is.
std::size_t withRoom(std::size_t count) {
  return count + count / 4;
}

}  // namespace

CutMesh::CutMesh(const Lattice& lattice) {
  const std::size_t vertices = lattice.rest_positions.size();
  rest_positions_.reserve(withRoom(vertices));
  sources_.reserve(withRoom(vertices));
  pieces_around_.reserve(withRoom(vertices));
  pieces_.reserve(withRoom(lattice.cellCount()));
  faces_.reserve(withRoom(3 * vertices));
  rest_positions_ = lattice.rest_positions;
  for (std::uint32_t v = 0; v < vertices; ++v)
    sources_.push_back({v, v, 0.0});
  pieces_around_.resize(vertices);
  pieces_of_cell_.resize(lattice.cellCount());
  for (std::uint32_t cell = 0; cell < lattice.cellCount(); ++cell)
    pieces_.push_back({cell, {}, cell});
  for (std::uint32_t cell = 0; cell < lattice.cellCount(); ++cell)
    addPiece(lattice, cell);
  for (Piece& piece : pieces_)
    std::sort(piece.faces.begin(), piece.faces.end());
}

/// Its vertices and those faces that no cell with a lower number has.
void CutMesh::addPiece(const Lattice& lattice, std::uint32_t cell) {
  pieces_of_cell_[cell] = {cell};
  for (const std::uint32_t v : lattice.cells[cell])
    insertSorted(pieces_around_[v], cell);
  for (std::size_t f = 0; f < 6; ++f) {
    const std::int32_t other = lattice.face_neighbours[cell][f];
    if (other != Lattice::kNone && other < static_cast<std::int32_t>(cell))
      continue;
    Face face{{}, {static_cast<std::int32_t>(cell), other}, lattice.cut_faces[cell][f] != 0};
    for (const int corner : kHexahedronFaces[f])
      face.loop.push_back(lattice.cells[cell][static_cast<std::size_t>(corner)]);
    const auto number = static_cast<std::uint32_t>(faces_.size());
    pieces_[cell].faces.push_back(number);
    if (other != Lattice::kNone)
      pieces_[static_cast<std::size_t>(other)].faces.push_back(number);
    faces_.push_back(std::move(face));
  }
}

CutMesh::CutMesh(const Lattice& lattice, const std::vector<Source>& sources, std::vector<Face> faces,
                 std::vector<Piece> pieces)
    : faces_(std::move(faces)), pieces_(std::move(pieces)) {
  rest_positions_ = lattice.rest_positions;
  for (std::uint32_t v = 0; v < rest_positions_.size(); ++v)
    sources_.push_back({v, v, 0.0});
  for (const Source& source : sources) {
    require(source.a < vertexCount() && source.b < vertexCount() && source.share >= 0.0 && source.share <= 1.0,
            "a vertex is placed by vertices that follow it");
    rest_positions_.push_back(rest_positions_[source.a] +
                              source.share * (rest_positions_[source.b] - rest_positions_[source.a]));
    sources_.push_back(source);
  }
  require(pieces_.size() >= lattice.cellCount(), "a cell has no piece");
  pieces_of_cell_.resize(lattice.cellCount());
  for (std::uint32_t p = 0; p < pieces_.size(); ++p)
    takePiece(p);
  for (std::uint32_t f = 0; f < faces_.size(); ++f)
    takeFace(f);
  pieces_around_.resize(vertexCount());
  for (std::uint32_t p = 0; p < pieces_.size(); ++p) {
    if (pieces_[p].faces.empty()) {
      eraseSorted(pieces_of_cell_[pieces_[p].cell], p);
      continue;
    }
    requireClosed(p);
    for (const std::uint32_t v : verticesOf(p))
      pieces_around_[v].push_back(p);
  }
}

void CutMesh::takePiece(std::uint32_t number) {
  Piece& piece = pieces_[number];
  piece.faces.clear();
  require(piece.cell < pieces_of_cell_.size() && piece.origin <= number, "a piece belongs to no cell");
  const bool whole = number < pieces_of_cell_.size();
  require(whole ? piece.cell == number && piece.origin == number
                : piece.origin < number && pieces_[piece.origin].cell == piece.cell,
          "a piece comes from another cell");
  pieces_of_cell_[piece.cell].push_back(number);
}

void CutMesh::takeFace(std::uint32_t number) {
  const Face& face = faces_[number];
  if (face.loop.empty() && face.pieces[0] == kNone && face.pieces[1] == kNone)
    return;  // removed
  Numbers vertices = face.loop;
  std::sort(vertices.begin(), vertices.end());
  require(vertices.size() >= 3 && vertices.back() < vertexCount() &&
              std::adjacent_find(vertices.begin(), vertices.end()) == vertices.end(),
          "a face has fewer than three vertices, one twice, or one that does not exist");
  const auto exists = [this](std::int32_t p) { return p >= 0 && static_cast<std::size_t>(p) < pieces_.size(); };
  require(
      exists(face.pieces[0]) && face.pieces[0] != face.pieces[1] && (face.pieces[1] == kNone || exists(face.pieces[1])),
      "a face has no piece");
  for (const std::int32_t piece : face.pieces) {
    if (piece != kNone)
      pieces_[static_cast<std::size_t>(piece)].faces.push_back(number);
  }
}

/// Throws InputError unless each edge of a piece belongs to two of its faces, which run along it in opposite
/// directions.
void CutMesh::requireClosed(std::uint32_t piece) const {
  std::vector<std::array<std::uint32_t, 2>> edges;
  for (const Numbers& loop : loopsOf(piece)) {
    for (std::size_t i = 0; i < loop.size(); ++i)
      edges.push_back({loop[i], loop[(i + 1) % loop.size()]});
  }
  std::sort(edges.begin(), edges.end());
  bool closed = edges.size() >= 12 && std::adjacent_find(edges.begin(), edges.end()) == edges.end();
  for (const auto& [a, b] : edges)
    closed &= std::binary_search(edges.begin(), edges.end(), std::array<std::uint32_t, 2>{b, a});
  require(closed, "a piece is not closed");
}

Numbers CutMesh::takeChangedPieces() {
  Numbers changed = std::move(changed_pieces_);
  changed_pieces_.clear();
  std::sort(changed.begin(), changed.end());
  changed.erase(std::unique(changed.begin(), changed.end()), changed.end());
  return changed;
}

Numbers CutMesh::outwardLoop(std::uint32_t face, std::uint32_t piece) const {
  Numbers loop = faces_[face].loop;
  if (faces_[face].pieces[0] != static_cast<std::int32_t>(piece))
    std::reverse(loop.begin(), loop.end());
  return loop;
}

Numbers CutMesh::verticesOf(std::uint32_t piece) const {
  Numbers vertices;
  for (const std::uint32_t f : pieces_[piece].faces)
    vertices.insert(vertices.end(), faces_[f].loop.begin(), faces_[f].loop.end());
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  return vertices;
}

std::vector<Numbers> CutMesh::loopsOf(std::uint32_t piece) const {
  std::vector<Numbers> loops;
  for (const std::uint32_t f : pieces_[piece].faces)
    loops.push_back(outwardLoop(f, piece));
  return loops;
}

std::int32_t CutMesh::across(std::uint32_t face, std::uint32_t piece) const {
  const auto& owners = faces_[face].pieces;
  return owners[0] == static_cast<std::int32_t>(piece) ? owners[1] : owners[0];
}

Numbers CutMesh::islands() const {
  Numbers parents(pieces_.size());
  std::iota(parents.begin(), parents.end(), 0U);
  for (const Face& face : faces_) {
    if (face.pieces[1] != kNone)
      join(parents, static_cast<std::uint32_t>(face.pieces[0]), static_cast<std::uint32_t>(face.pieces[1]));
  }
  for (std::uint32_t p = 0; p < parents.size(); ++p)
    parents[p] = rootOf(parents, p);
  return parents;
}

std::uint32_t CutMesh::addVertex(const Vector3& rest_m, const Source& source) {
  rest_positions_.push_back(rest_m);
  sources_.push_back(source);
  pieces_around_.emplace_back();
  return static_cast<std::uint32_t>(vertexCount() - 1);
}

std::uint32_t CutMesh::splitEdge(std::uint32_t a, std::uint32_t b, double share) {
  const Vector3 rest_m = rest_positions_[a] + share * (rest_positions_[b] - rest_positions_[a]);
  const std::uint32_t middle = addVertex(rest_m, {a, b, share});
  Numbers around;
  std::set_intersection(pieces_around_[a].begin(), pieces_around_[a].end(), pieces_around_[b].begin(),
                        pieces_around_[b].end(), std::back_inserter(around));
  for (const std::uint32_t piece : around) {
    bool has_edge = false;
    for (const std::uint32_t f : pieces_[piece].faces) {
      // The piece on the other side of a face may have been here before.
      has_edge |= insertBetween(faces_[f].loop, a, b, middle) || contains(faces_[f].loop, middle);
    }
    if (has_edge) {
      pieces_around_[middle].push_back(piece);
      changed_pieces_.push_back(piece);
    }
  }
  return middle;
}

std::uint32_t CutMesh::splitFace(std::uint32_t face, std::uint32_t from, std::uint32_t to) {
  const auto number = static_cast<std::uint32_t>(faces_.size());
  Face rest = faces_[face];
  rest.loop = wayAround(faces_[face].loop, to, from);
  faces_[face].loop = wayAround(faces_[face].loop, from, to);
  assert(rest.loop.size() >= 3 && faces_[face].loop.size() >= 3);
  for (const std::int32_t owner : rest.pieces) {
    if (owner == kNone)
      continue;
    pieces_[static_cast<std::size_t>(owner)].faces.push_back(number);
    changed_pieces_.push_back(static_cast<std::uint32_t>(owner));
  }
  faces_.push_back(std::move(rest));
  return number;
}

std::uint32_t CutMesh::splitPiece(std::uint32_t piece, const Numbers& moved, const std::vector<Numbers>& section) {
  const auto number = static_cast<std::uint32_t>(pieces_.size());
  const Numbers before = verticesOf(piece);
  pieces_.push_back({pieces_[piece].cell, {}, piece});
  pieces_of_cell_[pieces_[piece].cell].push_back(number);
  for (const std::uint32_t f : moved) {
    auto& owners = faces_[f].pieces;
    owners[owners[0] == static_cast<std::int32_t>(piece) ? 0 : 1] = static_cast<std::int32_t>(number);
    eraseSorted(pieces_[piece].faces, f);
    insertSorted(pieces_[number].faces, f);
    if (across(f, number) != kNone)
      changed_pieces_.push_back(static_cast<std::uint32_t>(across(f, number)));
  }
  changed_pieces_.insert(changed_pieces_.end(), {piece, number});
  for (const Numbers& loop : section) {
    const auto f = static_cast<std::uint32_t>(faces_.size());
    faces_.push_back({loop, {static_cast<std::int32_t>(piece), static_cast<std::int32_t>(number)}, false});
    pieces_[piece].faces.push_back(f);
    pieces_[number].faces.push_back(f);
  }
  for (const std::uint32_t v : before)
    eraseSorted(pieces_around_[v], piece);
  for (const std::uint32_t part : {piece, number}) {
    for (const std::uint32_t v : verticesOf(part))
      insertSorted(pieces_around_[v], part);
  }
  return number;
}

void CutMesh::openFace(std::uint32_t face) {
  const auto number = static_cast<std::uint32_t>(faces_.size());
  const std::int32_t other = faces_[face].pieces[1];
  assert(other != kNone);
  Face lip{faces_[face].loop, {other, kNone}, true};
  std::reverse(lip.loop.begin(), lip.loop.end());
  faces_[face].pieces[1] = kNone;
  faces_[face].opened = true;
  changed_pieces_.insert(changed_pieces_.end(),
                         {static_cast<std::uint32_t>(faces_[face].pieces[0]), static_cast<std::uint32_t>(other)});
  Piece& piece = pieces_[static_cast<std::size_t>(other)];
  eraseSorted(piece.faces, face);
  piece.faces.push_back(number);
  faces_.push_back(std::move(lip));
}

void CutMesh::removePieces(const Numbers& pieces) {
  for (const std::uint32_t piece : pieces) {
    for (const std::uint32_t v : verticesOf(piece))
      eraseSorted(pieces_around_[v], piece);
    eraseSorted(pieces_of_cell_[pieces_[piece].cell], piece);
  }
  for (const std::uint32_t piece : pieces) {
    for (const std::uint32_t f : pieces_[piece].faces) {
      faces_[f].loop.clear();
      faces_[f].pieces = {kNone, kNone};
    }
    pieces_[piece].faces.clear();
  }
  changed_pieces_.insert(changed_pieces_.end(), pieces.begin(), pieces.end());
}

/// Group of each of the pieces around a vertex, named by the place of its first piece.
Numbers CutMesh::groupsAround(std::uint32_t vertex) const {
  const Numbers& around = pieces_around_[vertex];
  Numbers groups(around.size());
  std::iota(groups.begin(), groups.end(), 0U);
  for (std::uint32_t n = 0; n < around.size(); ++n) {
    for (const std::uint32_t f : pieces_[around[n]].faces) {
      const std::int32_t other = across(f, around[n]);
      if (other == kNone || !contains(faces_[f].loop, vertex))
        continue;
      const auto place = std::lower_bound(around.begin(), around.end(), static_cast<std::uint32_t>(other));
      join(groups, n, static_cast<std::uint32_t>(place - around.begin()));
    }
  }
  for (std::uint32_t n = 0; n < groups.size(); ++n)
    groups[n] = rootOf(groups, n);
  return groups;
}

void CutMesh::replaceVertex(std::uint32_t piece, std::uint32_t from, std::uint32_t to) {
  for (const std::uint32_t f : pieces_[piece].faces)
    std::replace(faces_[f].loop.begin(), faces_[f].loop.end(), from, to);
}

std::uint32_t CutMesh::partVertex(std::uint32_t vertex) {
  const Numbers groups = groupsAround(vertex);
  const Numbers around = pieces_around_[vertex];
  std::vector<std::int64_t> replicas(around.size(), kNone);
  std::uint32_t added = 0;
  for (std::size_t n = 0; n < around.size(); ++n) {
    if (groups[n] == 0)
      continue;
    std::int64_t& replica = replicas[groups[n]];
    if (replica == kNone) {
      replica = addVertex(Vector3(rest_positions_[vertex]), {vertex, vertex, 0.0});
      ++added;
    }
    const auto number = static_cast<std::uint32_t>(replica);
    replaceVertex(around[n], vertex, number);
    changed_pieces_.push_back(around[n]);
    eraseSorted(pieces_around_[vertex], around[n]);
    pieces_around_[number].push_back(around[n]);
  }
  return added;
}

}  // namespace soft_volume::core
