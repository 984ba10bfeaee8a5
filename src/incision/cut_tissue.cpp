#include "soft_volume/incision/cut_tissue.h"

#include <algorithm>
#include <cmath>

#include "soft_volume/incision/face_cut.h"

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
          positions_m_[v] = embedding_.place(mesh_, lattice, positions_m, v);
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
        positions_m_[v] = embedding_.place(mesh_, lattice, positions_m, v);
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

std::vector<Vector3> CutTissue::atMesh(const Lattice& lattice, const std::vector<Vector3>& values) const {
  std::vector<Vector3> at_mesh(mesh_.vertexCount());
  if (lattice.revision == 1)  // the same vertices

    return values;
  for (std::uint32_t v = 0; v < at_mesh.size(); ++v)
    at_mesh[v] = embedding_.place(mesh_, lattice, values, v);
  return at_mesh;
}

double CutTissue::opening(const Lattice& lattice, const std::vector<Vector3>& positions_m) const {
  double opening_m = 0.0;
  for (auto v = static_cast<std::uint32_t>(lattice_vertices_); v < mesh_.vertexCount(); ++v) {
    const CutMesh::Source& source = mesh_.source(v);
    if (source.a == source.b) {
      opening_m = std::max(opening_m, (embedding_.place(mesh_, lattice, positions_m, v) -
                                       embedding_.place(mesh_, lattice, positions_m, source.a))
                                          .norm());
    }
  }
  return opening_m;
}

}  // namespace soft_volume::core
