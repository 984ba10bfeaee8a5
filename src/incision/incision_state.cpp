#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/incision/cut_tissue.h"

namespace soft_volume::core {
namespace {

/// Rounding of shares that sum to 1.
constexpr double kShareTolerance = 1e-9;

void require(bool condition, const char* problem) {
  if (!condition)
    throw InputError(std::string("the incisions of a saved state: ") + problem);
}

/// Sizes, and which cells and vertices are copies of which.
void checkCopies(const IncisionState& state, const Lattice& built) {
  const std::size_t cells = state.cells.size();
  const std::size_t vertices = state.origin_vertices.size();
  require(cells >= built.cellCount() && vertices >= built.vertexCount(), "they belong to another lattice");
  require(state.parent_cells.size() == cells && state.shares.size() == cells && state.surface_shares.size() == cells &&
              state.rest_stretch.size() == cells && state.face_neighbours.size() == cells &&
              state.cut_faces.size() == cells && state.fixed.size() == vertices,
          "an array does not fit the cells or vertices");
  for (std::size_t c = 0; c < cells; ++c) {
    const std::uint32_t parent = state.parent_cells[c];
    require(c < built.cellCount() ? parent == built.parent_cells[c]
                                  : parent < built.cell_at.size() && built.cell_at[parent] != Lattice::kNone,
            "a cell is a copy of none");
  }
  for (std::uint32_t v = 0; v < vertices; ++v) {
    require(state.fixed[v] <= Lattice::kRemoved, "a vertex is neither free nor fixed nor removed");
    const std::uint32_t origin = state.origin_vertices[v];
    require(v < built.vertexCount() ? origin == v : origin < v, "a vertex is a replica of none");
  }
}

/// The lattice that a state's copies make of the one that was built; what the cells say is not looked at.
Lattice withCopies(const IncisionState& state, const Lattice& built) {
  Lattice lattice = built;
  for (std::size_t c = built.cellCount(); c < state.cells.size(); ++c)
    copyCell(lattice, static_cast<std::uint32_t>(lattice.cell_at[state.parent_cells[c]]));
  for (std::size_t v = built.vertexCount(); v < state.origin_vertices.size(); ++v)
    replicateVertex(lattice, state.origin_vertices[v]);
  lattice.cells = state.cells;
  lattice.shares = state.shares;
  lattice.surface_shares = state.surface_shares;
  lattice.rest_stretch = state.rest_stretch;
  lattice.face_neighbours = state.face_neighbours;
  lattice.cut_faces = state.cut_faces;
  lattice.fixed = state.fixed;
  return lattice;
}

void checkCorners(const Lattice& lattice, std::uint32_t cell) {
  const Vector3i at = lattice.cellIndex(lattice.parent_cells[cell]);
  for (std::size_t c = 0; c < 8; ++c) {
    const int* corner = kHexahedronCorners[c];
    const std::uint32_t v = lattice.cells[cell][c];
    require(
        v < lattice.vertexCount() &&
            lattice.lattice_nodes[v] == lattice.latticeNode(at.x() + corner[0], at.y() + corner[1], at.z() + corner[2]),
        "a cell has a vertex that is not at its corner");
  }
}

void checkNeighbours(const Lattice& lattice, std::uint32_t cell) {
  const Vector3i at = lattice.cellIndex(lattice.parent_cells[cell]);
  for (std::size_t face = 0; face < 6; ++face) {
    const std::int32_t n = lattice.face_neighbours[cell][face];
    if (n == Lattice::kNone)
      continue;
    require(n >= 0 && static_cast<std::size_t>(n) < lattice.cellCount(), "a cell has a neighbour that does not exist");
    Vector3i other = at;
    other[static_cast<int>(face / 2)] += face % 2 == 0 ? -1 : 1;
    require(lattice.cellIndex(lattice.parent_cells[static_cast<std::size_t>(n)]) == other,
            "a cell has a neighbour that is elsewhere");
  }
}

void checkNumbers(const Lattice& lattice, std::uint32_t cell) {
  const Vector3& stretch = lattice.rest_stretch[cell];
  require(isFinite(stretch) && stretch.minCoeff() > 0.0 && stretch.maxCoeff() <= 1.0,
          "a rest stretch is not within (0, 1]");
  const auto is_share = [](double share) { return share >= 0.0 && share <= 1.0 + kShareTolerance; };
  require(is_share(lattice.shares[cell]) &&
              std::all_of(lattice.surface_shares[cell].begin(), lattice.surface_shares[cell].end(), is_share),
          "a share is not within [0, 1]");
}

void checkShares(const Lattice& lattice, const CutMesh& mesh) {
  std::vector<std::uint8_t> removed(lattice.cell_at.size(), 0);
  for (const CutMesh::Piece& piece : mesh.pieces())
    removed[lattice.parent_cells[piece.cell]] |= piece.faces.empty() ? 1 : 0;
  for (std::size_t place = 0; place < lattice.cell_at.size(); ++place) {
    const std::int32_t first = lattice.cell_at[place];
    double sum = first == Lattice::kNone ? 1.0 : 0.0;
    for (std::int32_t cell = first; cell != Lattice::kNone; cell = lattice.next_cells[static_cast<std::size_t>(cell)])
      sum += lattice.shares[static_cast<std::size_t>(cell)];
    require(sum <= 1.0 + kShareTolerance && (removed[place] != 0 || sum >= 1.0 - kShareTolerance),
            "the shares of a place do not sum to 1");
  }
}

void checkCarriers(const IncisionState& state, const Lattice& lattice) {
  require(state.cells_of_pieces.size() == state.pieces.size(), "a piece has no cell");
  for (std::size_t p = 0; p < state.pieces.size(); ++p) {
    const std::uint32_t cell = state.cells_of_pieces[p];
    require(cell < lattice.cellCount() && state.pieces[p].cell < lattice.cellCount() &&
                lattice.parent_cells[cell] == lattice.parent_cells[state.pieces[p].cell],
            "a piece is carried by a cell elsewhere");
  }
}

bool isPlace(const TissuePlace& place, std::size_t vertices) {
  return isFinite(place.offset_m) && place.weights.size() == place.vertices.size() &&
         std::all_of(place.vertices.begin(), place.vertices.end(), [&](std::uint32_t v) { return v < vertices; }) &&
         std::all_of(place.weights.begin(), place.weights.end(), [](double w) { return w >= 0.0 && w <= 1.0; });
}

bool isEdge(const Stroke::Edge& edge) {
  return isFinite(edge.tip) && isFinite(edge.heel);
}

void checkStroke(const TissueStroke& stroke, const CutMesh& mesh) {
  require(isPlace(stroke.joint[0], mesh.vertexCount()) && isPlace(stroke.joint[1], mesh.vertexCount()),
          "a stroke ended at no place of the tissue");
  const Stroke::State& state = stroke.stroke;
  require(std::all_of(state.edges.begin(), state.edges.end(), isEdge) && isEdge(state.blade) &&
              isEdge({state.lips.edge_m[0], state.lips.edge_m[1]}) &&
              isEdge({state.lips.start_m[0], state.lips.start_m[1]}) &&
              state.lips.pieces_seen <= mesh.pieces().size() && (!state.has_joint || !state.edges.empty()),
          "a stroke's edge is not finite");
  for (const auto& [piece, side] : state.lips.side_of_piece)
    require(piece < mesh.pieces().size() && (side == -1 || side == 1), "a lip has no piece");
}

}  // namespace

IncisionState CutTissue::state(const Lattice& lattice) const {
  IncisionState state;
  state.strokes = strokes_;
  if (lattice.revision == 1)
    return state;
  state.cells = lattice.cells;
  state.parent_cells = lattice.parent_cells;
  state.shares = lattice.shares;
  state.surface_shares = lattice.surface_shares;
  state.rest_stretch = lattice.rest_stretch;
  state.face_neighbours = lattice.face_neighbours;
  state.cut_faces = lattice.cut_faces;
  state.origin_vertices = lattice.origin_vertices;
  state.fixed = lattice.fixed;
  for (auto v = static_cast<std::uint32_t>(lattice_vertices_); v < mesh_.vertexCount(); ++v)
    state.sources.push_back(mesh_.source(v));
  state.faces = mesh_.faces();
  for (const CutMesh::Piece& piece : mesh_.pieces())
    state.pieces.push_back({piece.cell, {}, piece.origin});
  state.cells_of_pieces = embedding_.cellsOfPieces();
  return state;
}

CutTissue::CutTissue(const IncisionState& state, Lattice& lattice, const IncisionSettings& settings)
    : CutTissue(lattice, settings) {
  strokes_ = state.strokes;
  if (!state.cells.empty()) {
    checkCopies(state, lattice);
    const Lattice restored = withCopies(state, lattice);
    for (std::uint32_t cell = 0; cell < restored.cellCount(); ++cell) {
      checkCorners(restored, cell);
      checkNeighbours(restored, cell);
      checkNumbers(restored, cell);
    }
    mesh_ = CutMesh(lattice, state.sources, state.faces, state.pieces);
    checkShares(restored, mesh_);
    checkCarriers(state, restored);
    embedding_ = Embedding(mesh_, state.cells_of_pieces);
    positions_m_.assign(mesh_.vertexCount(), Vector3::Zero());
    for (const auto& stroke : strokes_)
      checkStroke(stroke.second, mesh_);
    lattice = restored;
    return;
  }
  for (const auto& stroke : strokes_)
    checkStroke(stroke.second, mesh_);
}

}  // namespace soft_volume::core
