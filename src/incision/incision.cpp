#include "soft_volume/incision/incision.h"

#include <algorithm>
#include <array>
#include <set>
#include <utility>

namespace soft_volume::core {
namespace {

using FaceOfCell = std::pair<std::uint32_t, int>;

Vector3 cellCentre(const Lattice& lattice, const std::vector<Vector3>& positions_m, std::uint32_t cell) {
  Vector3 sum = Vector3::Zero();
  for (const std::uint32_t v : lattice.cells[cell])
    sum += positions_m[v];
  return sum / 8.0;
}

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

Box3 boundsOf(const SweptQuad& quad) {
  Box3 box;
  for (const Vector3& p : quad)
    box.extend(p);
  return box;
}

/// Faces that the quad parts, each named once by the cell on its lower side.
void collectFaces(const Lattice& lattice, const std::vector<Material>& materials,
                  const std::vector<Vector3>& positions_m, double reach_m, const SweptQuad& quad,
                  std::set<FaceOfCell>& faces) {
  Box3 box = boundsOf(quad);
  const Vector3 margin = lattice.spacing_m + Vector3::Constant(reach_m);
  box.min() -= margin;
  box.max() += margin;
  forEachCell(lattice, latticeBox(lattice, box), [&](std::uint32_t cell) {
    if (materials[lattice.materials[cell]].fixed)
      return;
    const Vector3 centre = cellCentre(lattice, positions_m, cell);
    for (const int face : {1, 3, 5}) {
      const std::int32_t other = lattice.face_neighbours[cell][face];
      if (other == Lattice::kNone || materials[lattice.materials[other]].fixed)
        continue;
      const Vector3 other_centre = cellCentre(lattice, positions_m, static_cast<std::uint32_t>(other));
      if (crossesQuad(centre, other_centre, quad))
        faces.insert({cell, face});
    }
  });
}

void shortenAcross(Lattice& lattice, std::uint32_t cell, int axis, double rest_fraction) {
  double& stretch = lattice.rest_stretch[cell][axis];
  stretch = std::min(stretch, rest_fraction);
}

void openFace(Lattice& lattice, const FaceOfCell& face, double rest_fraction) {
  const std::uint32_t cell = face.first;
  const auto other = static_cast<std::uint32_t>(lattice.face_neighbours[cell][face.second]);
  const int back = oppositeFace(face.second);
  lattice.cut_faces[cell][face.second] = 1;
  lattice.cut_faces[other][back] = 1;
  lattice.face_neighbours[cell][face.second] = Lattice::kNone;
  lattice.face_neighbours[other][back] = Lattice::kNone;
  shortenAcross(lattice, cell, face.second / 2, rest_fraction);
  shortenAcross(lattice, other, face.second / 2, rest_fraction);
}

/// The up to eight cells around a vertex, in lattice order.
std::vector<std::uint32_t> cellsAround(const Lattice& lattice, std::uint32_t vertex) {
  const int nx = lattice.dims.x() + 1;
  const int ny = lattice.dims.y() + 1;
  const int node = static_cast<int>(lattice.lattice_nodes[vertex]);
  const Vector3i index(node % nx, (node / nx) % ny, node / (nx * ny));
  const LatticeBox box{(index - Vector3i::Ones()).cwiseMax(0), (index + Vector3i::Ones()).cwiseMin(lattice.dims)};
  std::vector<std::uint32_t> cells;
  forEachCell(lattice, box, [&](std::uint32_t cell) {
    const auto& vertices = lattice.cells[cell];
    if (std::find(vertices.begin(), vertices.end(), vertex) != vertices.end())
      cells.push_back(cell);
  });
  return cells;
}

/// Group of each of the cells, hanging together through faces among themselves; numbered by first occurrence.
std::vector<int> groupByFaces(const Lattice& lattice, const std::vector<std::uint32_t>& cells) {
  std::vector<int> group(cells.size());
  for (std::size_t n = 0; n < cells.size(); ++n)
    group[n] = static_cast<int>(n);
  // At most eight cells: spreading the lowest number until nothing changes is short and needs no other structure.
  for (bool changed = true; changed;) {
    changed = false;
    for (std::size_t a = 0; a < cells.size(); ++a) {
      for (std::size_t b = 0; b < cells.size(); ++b) {
        const auto& neighbours = lattice.face_neighbours[cells[a]];
        const bool joined =
            std::find(neighbours.begin(), neighbours.end(), static_cast<std::int32_t>(cells[b])) != neighbours.end();
        if (joined && group[b] < group[a]) {
          group[a] = group[b];
          changed = true;
        }
      }
    }
  }
  return group;
}

/// Gives every group of cells around the vertex but the first a replica of its own.
std::uint32_t splitVertex(Lattice& lattice, std::uint32_t vertex) {
  const std::vector<std::uint32_t> cells = cellsAround(lattice, vertex);
  const std::vector<int> group = groupByFaces(lattice, cells);
  std::vector<std::int64_t> replica(cells.size(), -1);
  std::uint32_t added = 0;
  for (std::size_t n = 0; n < cells.size(); ++n) {
    if (group[n] == group[0])
      continue;
    std::int64_t& number = replica[group[n]];
    if (number < 0) {
      number = replicateVertex(lattice, vertex);
      ++added;
    }
    auto& vertices = lattice.cells[cells[n]];
    std::replace(vertices.begin(), vertices.end(), vertex, static_cast<std::uint32_t>(number));
  }
  return added;
}

}  // namespace

IncisionResult cutLattice(Lattice& lattice, const std::vector<Material>& materials,
                          const std::vector<Vector3>& positions_m, double reach_m, const std::vector<SweptQuad>& quads,
                          const IncisionSettings& settings) {
  std::set<FaceOfCell> faces;
  for (const SweptQuad& quad : quads)
    collectFaces(lattice, materials, positions_m, reach_m, quad, faces);
  IncisionResult result;
  if (faces.empty())
    return result;

  std::set<std::uint32_t> touched;
  for (const FaceOfCell& face : faces) {
    for (const int corner : kHexahedronFaces[face.second])
      touched.insert(lattice.cells[face.first][corner]);
    openFace(lattice, face, settings.rest_fraction);
  }
  for (const std::uint32_t vertex : touched) {
    result.rest_box_m.extend(lattice.rest_positions[vertex]);
    result.vertices_added += splitVertex(lattice, vertex);
  }
  result.faces_opened = static_cast<std::uint32_t>(faces.size());
  ++lattice.revision;
  return result;
}

double cutOpening(const Lattice& lattice, const std::vector<Vector3>& positions_m) {
  double squared = 0.0;
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v) {
    squared = std::max(squared, (positions_m[v] - positions_m[lattice.origin_vertices[v]]).squaredNorm());
  }
  return std::sqrt(squared);
}

}  // namespace soft_volume::core
