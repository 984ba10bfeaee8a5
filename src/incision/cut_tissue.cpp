#include "soft_volume/incision/cut_tissue.h"

#include <algorithm>
#include <cmath>

#include "soft_volume/incision/face_cut.h"
#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {
namespace {

// Of a stroke's quads, in shortest cell edges: as long as the allowed error of an incision's front, and wide enough not
// to be left out (3 snap distances).
constexpr double kStride = 0.5;
constexpr double kLeastWidth = 0.2;
constexpr double kTolerance = 0.03;
/// How far around the end of a stroke's last quad tissue says where it has gone, in longest cell edges.
constexpr double kJointRadius = 1.5;

Vector3 nowAt(const TissuePlace& place, const std::vector<Vector3>& positions_m) {
  Vector3 p = place.offset_m;
  for (std::size_t n = 0; n < place.vertices.size(); ++n)
    p += place.weights[n] * positions_m[place.vertices[n]];
  return p;
}

Box3 boundsOf(const std::vector<SweptQuad>& quads) {
  Box3 box;
  for (const SweptQuad& quad : quads) {
    for (const Vector3& p : quad)
      box.extend(p);
  }
  return box;
}

double travelOf(const std::vector<SweptQuad>& quads) {
  double travel_m = 0.0;
  for (const SweptQuad& quad : quads)
    travel_m += 0.5 * (quad[2] + quad[3] - quad[0] - quad[1]).norm();
  return travel_m;
}

IncisionResult resultOf(const BladeCutResult& cut, const std::vector<SweptQuad>& quads) {
  return {cut.faces_opened, cut.rest_box_m, cut.opened_energy_j, travelOf(quads), {}, {}};
}

/// The cells whose pieces may be in a box, which no vertex is farther from at rest than `reach_m`.
LatticeBox cellsAround(const Lattice& lattice, const Box3& box_m, const Vector3& margin_m, double reach_m) {
  const Vector3 margin = margin_m + Vector3::Constant(reach_m);
  return latticeBox(lattice, Box3(Vector3(box_m.min() - margin), Vector3(box_m.max() + margin)));
}

}  // namespace

CutTissue::CutTissue(const Lattice& lattice, const IncisionSettings& settings)
    : settings_(settings),
      stroke_settings_{kStride * lattice.spacing_m.minCoeff(), kLeastWidth * lattice.spacing_m.minCoeff(),
                       kTolerance * lattice.spacing_m.minCoeff()},
      mesh_(lattice),
      embedding_(mesh_),
      lattice_vertices_(lattice.vertexCount()),
      positions_m_(lattice.rest_positions) {}

void CutTissue::placeVertices(const Lattice& lattice, const std::vector<Vector3>& positions_m, const LatticeBox& box) {
  positions_m_.resize(mesh_.vertexCount(), Vector3::Zero());
  forEachCell(lattice, box, [&](std::uint32_t cell) {
    for (const std::uint32_t piece : mesh_.piecesOfCell(cell)) {
      for (const std::uint32_t f : mesh_.pieces()[piece].faces) {
        for (const std::uint32_t v : mesh_.faces()[f].loop)
          positions_m_[v] = placeOf(lattice, positions_m, v);
      }
    }
  });
}

/// Needs the positions of the vertices around it.
TissuePlace CutTissue::placeNear(const Lattice& lattice, const Vector3& p, double reach_m) const {
  const double radius_m = kJointRadius * lattice.spacing_m.maxCoeff();
  TissuePlace place;
  forEachCell(lattice, cellsAround(lattice, Box3(p, p), Vector3::Constant(radius_m), reach_m), [&](std::uint32_t cell) {
    for (const std::uint32_t piece : mesh_.piecesOfCell(cell)) {
      for (const std::uint32_t v : mesh_.verticesOf(piece)) {
        if ((positions_m_[v] - p).norm() < radius_m)
          place.vertices.push_back(v);
      }
    }
  });
  std::sort(place.vertices.begin(), place.vertices.end());
  place.vertices.erase(std::unique(place.vertices.begin(), place.vertices.end()), place.vertices.end());
  double sum = 0.0;
  for (const std::uint32_t v : place.vertices) {
    const double share = (positions_m_[v] - p).squaredNorm() / (radius_m * radius_m);
    place.weights.push_back((1.0 - share) * (1.0 - share));
    sum += place.weights.back();
  }
  for (double& weight : place.weights)
    weight /= sum;
  place.offset_m = p - nowAt(place, positions_m_);
  return place;
}

IncisionResult CutTissue::cutPieces(const Lattice& lattice, const std::vector<Material>& materials,
                                    const std::vector<Vector3>& positions_m, double reach_m, const std::string& tool_id,
                                    const std::vector<SweptQuad>& sweeps, bool lifted) {
  TissueStroke& under_way = strokes_[tool_id];
  Stroke stroke(stroke_settings_, std::move(under_way.stroke));
  if (stroke.joint()) {
    for (const TissuePlace& place : under_way.joint) {
      for (const std::uint32_t v : place.vertices)
        positions_m_[v] = placeOf(lattice, positions_m, v);
    }
    stroke.moveJoint({nowAt(under_way.joint[0], positions_m_), nowAt(under_way.joint[1], positions_m_)});
  }
  std::vector<SweptQuad> quads;
  for (const SweptQuad& sweep : sweeps)
    stroke.add(sweep, quads);
  if (lifted)
    stroke.end(quads);
  IncisionResult result;
  if (!quads.empty()) {
    // One cell more than cutMesh() looks at: the pieces there share vertices with their neighbours.
    placeVertices(lattice, positions_m, cellsAround(lattice, boundsOf(quads), 2.0 * lattice.spacing_m, reach_m));
    const BladeCutResult cut =
        cutMesh(mesh_, lattice, materials, CutResolution(), quads, reach_m, stroke.lips(), positions_m_);
    result = resultOf(cut, quads);
  }
  if (lifted) {
    strokes_.erase(tool_id);
    return result;
  }
  if (!quads.empty() && stroke.joint()) {
    for (std::size_t end = 0; end < 2; ++end)
      under_way.joint[end] = placeNear(lattice, (*stroke.joint())[end], reach_m);
  }
  under_way.stroke = stroke.state();
  return result;
}

IncisionResult CutTissue::cut(Lattice& lattice, const std::vector<Material>& materials,
                              const std::vector<Vector3>& positions_m, double reach_m, const std::string& tool_id,
                              const std::vector<SweptQuad>& quads, bool lifted) {
  IncisionResult result;
  if (settings_.method == IncisionMethod::kPieces) {
    result = cutPieces(lattice, materials, positions_m, reach_m, tool_id, quads, lifted);
  } else if (!quads.empty()) {
    placeVertices(lattice, positions_m, cellsAround(lattice, boundsOf(quads), 2.0 * lattice.spacing_m, reach_m));
    result = resultOf(cutFaces(mesh_, lattice, materials, quads, reach_m, positions_m_), quads);
  }
  result.changed_pieces = mesh_.takeChangedPieces();
  if (!result.changed_pieces.empty()) {
    embedding_.update(mesh_, lattice);
    result.lips = lips(lattice, materials);
    shortenAcrossLips(lattice, result.lips, settings_.rest_fraction);
  }
  return result;
}

Vector3 CutTissue::placeOf(const Lattice& lattice, const std::vector<Vector3>& positions_m,
                           std::uint32_t vertex) const {
  if (mesh_.piecesAround(vertex).empty())
    return mesh_.restPositions()[vertex];
  // Most are corners of their cell still, with the number that they had.
  const auto& corners = lattice.cells[embedding_.cellOf(mesh_.piecesAround(vertex).front())];
  if (vertex < lattice_vertices_ && std::find(corners.begin(), corners.end(), vertex) != corners.end())
    return positions_m[vertex];
  return embedding_.place(mesh_, lattice, positions_m, vertex);
}

std::vector<Vector3> CutTissue::drawnPositions(const Lattice& lattice, const std::vector<Vector3>& positions_m) const {
  if (lattice.revision == 1)  // the same vertices
    return positions_m;
  std::vector<Vector3> drawn(mesh_.vertexCount());
  for (std::uint32_t v = 0; v < drawn.size(); ++v)
    drawn[v] = placeOf(lattice, positions_m, v);
  return drawn;
}

double CutTissue::opening(const Lattice& lattice, const std::vector<Vector3>& positions_m) const {
  double opening_m = 0.0;
  for (auto v = static_cast<std::uint32_t>(lattice_vertices_); v < mesh_.vertexCount(); ++v) {
    const CutMesh::Source& source = mesh_.source(v);
    const bool was_parted = source.a == source.b && !mesh_.piecesAround(v).empty();
    if (was_parted && !mesh_.piecesAround(source.a).empty()) {
      const Vector3 here = embedding_.place(mesh_, lattice, positions_m, v);
      opening_m = std::max(opening_m, (here - embedding_.place(mesh_, lattice, positions_m, source.a)).norm());
    }
  }
  return opening_m;
}

std::vector<TissuePart> CutTissue::parts(const Lattice& lattice) const {
  const std::vector<std::uint32_t> islands = mesh_.islands();
  std::map<std::uint32_t, TissuePart> found;
  for (std::uint32_t p = 0; p < islands.size(); ++p) {
    if (mesh_.pieces()[p].faces.empty())
      continue;
    TissuePart& part = found.try_emplace(islands[p], TissuePart{islands[p], 0, 0.0}).first->second;
    ++part.pieces;
    const bool is_whole =
        mesh_.piecesOfCell(mesh_.pieces()[p].cell).size() == 1 && lattice.shares[embedding_.cellOf(p)] == 1.0;
    part.volume_m3 += is_whole ? lattice.spacing_m.prod() : volumeOf(solidOf(mesh_, p));
  }
  std::vector<TissuePart> parts;
  for (const auto& entry : found)
    parts.push_back(entry.second);
  std::stable_sort(parts.begin(), parts.end(),
                   [](const TissuePart& a, const TissuePart& b) { return a.volume_m3 > b.volume_m3; });
  return parts;
}

std::vector<std::uint32_t> CutTissue::removePart(Lattice& lattice, std::uint32_t piece) {
  const std::vector<std::uint32_t> islands = mesh_.islands();
  std::vector<std::uint32_t> pieces;
  std::vector<std::uint32_t> vertices;
  for (std::uint32_t p = 0; p < islands.size(); ++p) {
    if (islands[p] != islands[piece] || mesh_.pieces()[p].faces.empty())
      continue;
    pieces.push_back(p);
    // A cell that carries pieces of a part carries no others.
    const std::uint32_t cell = embedding_.cellOf(p);
    lattice.shares[cell] = 0.0;
    lattice.surface_shares[cell].fill(0.0);
    lattice.face_neighbours[cell].fill(Lattice::kNone);
    vertices.insert(vertices.end(), lattice.cells[cell].begin(), lattice.cells[cell].end());
  }
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  // As it was built, a lattice may have parts that meet in a vertex.
  std::vector<std::uint8_t> is_used(lattice.vertexCount(), 0);
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    for (const std::uint32_t v : lattice.cells[cell])
      is_used[v] |= lattice.shares[cell] > 0.0 ? 1 : 0;
  }
  vertices.erase(std::remove_if(vertices.begin(), vertices.end(), [&](std::uint32_t v) { return is_used[v] != 0; }),
                 vertices.end());
  for (const std::uint32_t v : vertices)
    lattice.fixed[v] = lattice.fixed[v] == 0 ? Lattice::kRemoved : lattice.fixed[v];
  mesh_.removePieces(pieces);
  mesh_.takeChangedPieces();  // the next cut tells its own changes only
  lattice.revision += pieces.empty() ? 0 : 1;
  return vertices;
}

}  // namespace soft_volume::core
