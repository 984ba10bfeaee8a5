#include "soft_volume/incision/mesh_topology.h"

#include <algorithm>
#include <array>
#include <set>
#include <utility>

#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {
namespace {

constexpr int kCorners = 8;
constexpr int kFaces = 6;

/// Not what was taken away.
bool isFixedInLattice(const Lattice& lattice, std::uint32_t vertex) {
  return lattice.fixed[vertex] != 0 && lattice.fixed[vertex] != Lattice::kRemoved;
}

bool isOfLattice(const CutMesh& mesh, std::uint32_t vertex) {
  return mesh.source(vertex).a == vertex;
}

/// All that a vertex comes from, back to the lattice's own vertices, is fixed.
bool isFixed(const CutMesh& mesh, const Lattice& lattice, std::uint32_t vertex) {
  if (isOfLattice(mesh, vertex))
    return isFixedInLattice(lattice, vertex);
  std::set<std::uint32_t> seen;
  std::vector<std::uint32_t> open = {vertex};
  while (!open.empty()) {
    const std::uint32_t v = open.back();
    open.pop_back();
    if (isOfLattice(mesh, v)) {
      if (!isFixedInLattice(lattice, v))
        return false;
    } else if (seen.insert(v).second) {
      open.push_back(mesh.source(v).a);
      open.push_back(mesh.source(v).b);
    }
  }
  return true;
}

/// The lattice node that a vertex lies on, or -1 where it lies between nodes.
std::int64_t nodeOf(const CutMesh& mesh, const Lattice& lattice, std::uint32_t vertex) {
  while (!isOfLattice(mesh, vertex)) {
    const CutMesh::Source& source = mesh.source(vertex);
    if (source.a != source.b)
      return -1;
    vertex = source.a;
  }
  return lattice.lattice_nodes[vertex];
}

/// A piece as the whole cell that it may be: its vertices and faces in VTK's order.
class WholeCell {
 public:
  WholeCell(const CutMesh& mesh, const Lattice& lattice) : mesh_(mesh), lattice_(lattice) {}

  bool take(const CutMesh::Piece& piece) {
    corners_.fill(-1);
    faces_.fill(-1);
    for (int corner = 0; corner < kCorners; ++corner)
      nodes_[corner] = lattice_.lattice_nodes[lattice_.cells[piece.cell][corner]];
    return piece.faces.size() == kFaces &&
           std::all_of(piece.faces.begin(), piece.faces.end(), [this](std::uint32_t f) { return takeFace(f); });
  }
  std::uint32_t vertex(int corner) const { return static_cast<std::uint32_t>(corners_[corner]); }
  std::uint32_t face(int number) const { return static_cast<std::uint32_t>(faces_[number]); }

 private:
  bool takeFace(std::uint32_t face) {
    const auto& loop = mesh_.faces()[face].loop;
    unsigned corners = 0;
    for (const std::uint32_t v : loop) {
      const int corner = takeVertex(v);
      if (corner < 0)
        return false;
      corners |= 1U << corner;
    }
    for (int number = 0; number < kFaces; ++number) {
      unsigned wanted = 0;
      for (const int corner : kHexahedronFaces[number])
        wanted |= 1U << corner;
      if (loop.size() == 4 && corners == wanted && faces_[number] < 0) {
        faces_[number] = face;
        return true;
      }
    }
    return false;
  }

  /// Its corner, or -1.
  int takeVertex(std::uint32_t vertex) {
    const auto place = std::find(nodes_.begin(), nodes_.end(), nodeOf(mesh_, lattice_, vertex));
    const auto corner = static_cast<int>(place - nodes_.begin());
    if (corner == kCorners || (corners_[corner] >= 0 && corners_[corner] != vertex))
      return -1;
    corners_[corner] = vertex;
    return corner;
  }

  const CutMesh& mesh_;
  const Lattice& lattice_;
  std::array<std::int64_t, kCorners> nodes_;
  std::array<std::int64_t, kCorners> corners_;  // vertices of the mesh
  std::array<std::int64_t, kFaces> faces_;      // faces of the mesh
};

/// Appends vertices and pieces of a mesh to a topology.
class MeshDescription {
 public:
  MeshDescription(const CutMesh& mesh, const Lattice& lattice, const VolumeGeometry& volume, Topology& topology)
      : mesh_(mesh), lattice_(lattice), volume_(volume), topology_(topology), whole_(mesh, lattice) {
    topology_.cell_offsets.assign(1, 0);
  }

  void addVertex(std::uint32_t v) {
    const Vector3& rest_m = mesh_.restPositions()[v];
    const CutMesh::Source& source = mesh_.source(v);
    topology_.rest_positions.push_back(rest_m.cast<float>());
    topology_.texture_coordinates.push_back(volume_.toTexture(rest_m).cast<float>());
    topology_.fixed.push_back(isOfLattice(mesh_, v) ? std::uint8_t(lattice_.fixed[v] != 0)
                                                    : std::uint8_t(isFixed(mesh_, lattice_, v)));
    const std::uint32_t origin = source.a == source.b ? source.a : v;
    topology_.origin_vertices.push_back(isOfLattice(mesh_, v) ? lattice_.origin_vertices[v] : origin);
  }

  void addPiece(std::uint32_t p) {
    const CutMesh::Piece& piece = mesh_.pieces()[p];
    topology_.parent_cells.push_back(lattice_.parent_cells[piece.cell]);
    topology_.materials.push_back(lattice_.materials[piece.cell]);
    if (piece.faces.empty())
      topology_.cell_types.push_back(CellType::kEmpty);
    else if (whole_.take(piece))
      addHexahedron(p);
    else
      addPolyhedron(p);
    topology_.cell_offsets.push_back(static_cast<std::uint32_t>(topology_.connectivity.size()));
  }

 private:
  void addHexahedron(std::uint32_t piece) {
    topology_.cell_types.push_back(CellType::kHexahedron);
    for (int corner = 0; corner < kCorners; ++corner)
      topology_.connectivity.push_back(whole_.vertex(corner));
    for (int face = 0; face < kFaces; ++face)
      addFace(whole_.face(face), piece);
  }

  void addPolyhedron(std::uint32_t piece) {
    topology_.cell_types.push_back(CellType::kPolyhedron);
    const auto& faces = mesh_.pieces()[piece].faces;
    topology_.connectivity.push_back(static_cast<std::uint32_t>(faces.size()));
    for (const std::uint32_t face : faces) {
      const auto loop = mesh_.outwardLoop(face, piece);
      topology_.connectivity.push_back(static_cast<std::uint32_t>(loop.size()));
      topology_.connectivity.insert(topology_.connectivity.end(), loop.begin(), loop.end());
      addFace(face, piece);
    }
  }

  void addFace(std::uint32_t face, std::uint32_t piece) {
    topology_.face_neighbours.push_back(mesh_.across(face, piece));
    topology_.cut_faces.push_back(static_cast<std::uint8_t>(mesh_.faces()[face].opened));
  }

  const CutMesh& mesh_;
  const Lattice& lattice_;
  const VolumeGeometry& volume_;
  Topology& topology_;
  WholeCell whole_;
};

}  // namespace

Topology makeTopology(const CutMesh& mesh, const Lattice& lattice, const VolumeGeometry& volume,
                      std::uint64_t session) {
  Topology topology;
  topology.session = session;
  topology.revision = lattice.revision;
  MeshDescription description(mesh, lattice, volume, topology);
  for (std::uint32_t v = 0; v < mesh.vertexCount(); ++v)
    description.addVertex(v);
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p)
    description.addPiece(p);
  return topology;
}

TopologyDelta makeTopologyDelta(const CutMesh& mesh, const Lattice& lattice, const VolumeGeometry& volume,
                                std::uint64_t session, const TopologyMark& base,
                                std::vector<std::uint32_t> changed_pieces) {
  TopologyDelta delta;
  delta.base_revision = base.revision;
  delta.vertex_count = static_cast<std::uint32_t>(mesh.vertexCount());
  delta.cell_count = static_cast<std::uint32_t>(mesh.pieces().size());
  for (auto v = static_cast<std::uint32_t>(base.vertices); v < delta.vertex_count; ++v)
    delta.vertex_ids.push_back(v);
  for (auto p = static_cast<std::uint32_t>(base.cells); p < delta.cell_count; ++p)
    changed_pieces.push_back(p);
  std::sort(changed_pieces.begin(), changed_pieces.end());
  changed_pieces.erase(std::unique(changed_pieces.begin(), changed_pieces.end()), changed_pieces.end());
  delta.cell_ids = std::move(changed_pieces);
  delta.entries.session = session;
  delta.entries.revision = lattice.revision;
  MeshDescription description(mesh, lattice, volume, delta.entries);
  for (const std::uint32_t v : delta.vertex_ids)
    description.addVertex(v);
  for (const std::uint32_t p : delta.cell_ids)
    description.addPiece(p);
  return delta;
}

}  // namespace soft_volume::core
