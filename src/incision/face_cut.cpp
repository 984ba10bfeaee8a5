#include "soft_volume/incision/face_cut.h"

#include <set>

#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {
namespace {

/// Whether the segment pq crosses the triangle abc, borders included; parallel segments do not cross.
bool crossesTriangle(const Vector3& p, const Vector3& q, const Vector3& a, const Vector3& b, const Vector3& c) {
  const Vector3 direction = q - p;
  const Vector3 normal = (b - a).cross(c - a);
  const double along = normal.dot(direction);
  if (along == 0.0)
    return false;
  const double t = normal.dot(a - p) / along;
  if (t < 0.0 || t > 1.0)
    return false;
  const Vector3 hit = p + t * direction;
  // A sliver of tolerance closes the seam between two triangles that share an edge.
  const double slack = -1e-9 * normal.squaredNorm();
  return normal.dot((b - a).cross(hit - a)) >= slack && normal.dot((c - b).cross(hit - b)) >= slack &&
         normal.dot((a - c).cross(hit - c)) >= slack;
}

bool crossesQuad(const Vector3& p, const Vector3& q, const SweptQuad& quad) {
  return crossesTriangle(p, q, quad[0], quad[1], quad[2]) || crossesTriangle(p, q, quad[0], quad[2], quad[3]);
}

Vector3 middleOf(const CutMesh& mesh, const std::vector<Vector3>& positions_m, std::uint32_t piece) {
  const std::vector<std::uint32_t> vertices = mesh.verticesOf(piece);
  Vector3 sum = Vector3::Zero();
  for (const std::uint32_t v : vertices)
    sum += positions_m[v];
  return sum / static_cast<double>(vertices.size());
}

LatticeBox cellsNear(const Lattice& lattice, const SweptQuad& quad, double reach_m) {
  Box3 box;
  for (const Vector3& p : quad)
    box.extend(p);
  const Vector3 margin = lattice.spacing_m + Vector3::Constant(reach_m);
  return latticeBox(lattice, Box3(Vector3(box.min() - margin), Vector3(box.max() + margin)));
}

/// The faces that a quad parts.
void collectFaces(const CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
                  const std::vector<Vector3>& positions_m, double reach_m, const SweptQuad& quad,
                  std::set<std::uint32_t>& faces) {
  const auto is_fixed = [&](std::uint32_t piece) {
    return materials[lattice.materials[mesh.pieces()[piece].cell]].fixed;
  };
  forEachCell(lattice, cellsNear(lattice, quad, reach_m), [&](std::uint32_t cell) {
    for (const std::uint32_t piece : mesh.piecesOfCell(cell)) {
      if (is_fixed(piece))
        continue;
      const Vector3 middle = middleOf(mesh, positions_m, piece);
      for (const std::uint32_t f : mesh.pieces()[piece].faces) {
        const std::int32_t other = mesh.across(f, piece);
        if (other <= static_cast<std::int32_t>(piece) || is_fixed(static_cast<std::uint32_t>(other)))
          continue;
        if (crossesQuad(middle, middleOf(mesh, positions_m, static_cast<std::uint32_t>(other)), quad))
          faces.insert(f);
      }
    }
  });
}

}  // namespace

BladeCutResult cutFaces(CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
                        const std::vector<SweptQuad>& quads, double reach_m, std::vector<Vector3>& positions_m) {
  std::set<std::uint32_t> faces;
  for (const SweptQuad& quad : quads)
    collectFaces(mesh, lattice, materials, positions_m, reach_m, quad, faces);
  BladeCutResult result;
  result.faces_opened = static_cast<std::uint32_t>(faces.size());
  std::set<std::uint32_t> touched;
  for (const std::uint32_t f : faces) {
    const double area_m2 = 0.5 * areaVector(mesh.restPositions(), mesh.faces()[f].loop).norm();
    result.opened_area_m2 += area_m2;
    for (const std::int32_t piece : mesh.faces()[f].pieces) {
      const std::uint32_t cell = mesh.pieces()[static_cast<std::size_t>(piece)].cell;
      result.opened_energy_j += 0.5 * area_m2 * materials[lattice.materials[cell]].cut_resistance_j_m2;
    }
    touched.insert(mesh.faces()[f].loop.begin(), mesh.faces()[f].loop.end());
    mesh.openFace(f);
  }
  for (const std::uint32_t v : touched) {
    result.rest_box_m.extend(mesh.restPositions()[v]);
    const std::uint32_t added = mesh.partVertex(v);
    positions_m.insert(positions_m.end(), added, Vector3(positions_m[v]));
    result.vertices_added += added;
  }
  return result;
}

}  // namespace soft_volume::core
