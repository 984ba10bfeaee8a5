#include "soft_volume/grid/lattice.h"

#include <algorithm>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

void checkLattice(const Vector3i& dims, const Vector3& spacing_m, const Vector3& origin_m, std::size_t materials) {
  // 2^28 cells keep every linear index within 32 bits; no machine simulates more.
  constexpr double kMaxCells = 268435456.0;
  if (dims.minCoeff() < 1 || dims.cast<double>().prod() > kMaxCells) {
    throw InputError("a lattice needs 1 to 2^28 cells; choose another spacing or region");
  }
  if (!isFinite(spacing_m) || spacing_m.minCoeff() <= 0.0 || !isFinite(origin_m)) {
    throw InputError("the lattice spacing must be positive and its origin finite");
  }
  const std::size_t expected = std::size_t(dims.x()) * std::size_t(dims.y()) * std::size_t(dims.z());
  if (materials != expected)
    throw InputError("one material per lattice cell is needed");
}

void addCells(Lattice& lattice, const std::vector<std::int32_t>& cell_materials) {
  for (std::size_t parent = 0; parent < cell_materials.size(); ++parent) {
    if (cell_materials[parent] == Lattice::kNone)
      continue;
    lattice.cell_at[parent] = static_cast<std::int32_t>(lattice.parent_cells.size());
    lattice.parent_cells.push_back(static_cast<std::uint32_t>(parent));
    lattice.materials.push_back(static_cast<std::uint16_t>(cell_materials[parent]));
  }
  lattice.cells.resize(lattice.parent_cells.size());
  lattice.rest_stretch.assign(lattice.cells.size(), Vector3::Ones());
  lattice.cut_faces.assign(lattice.cells.size(), {});
  lattice.shares.assign(lattice.cells.size(), 1.0);
  lattice.surface_shares.assign(lattice.cells.size(), {1.0, 1.0, 1.0, 1.0, 1.0, 1.0});
  lattice.next_cells.assign(lattice.cells.size(), Lattice::kNone);
}

std::size_t cornerNode(const Lattice& lattice, const Vector3i& index, int corner) {
  const int* offset = kHexahedronCorners[corner];
  return lattice.latticeNode(index.x() + offset[0], index.y() + offset[1], index.z() + offset[2]);
}

void addVertices(Lattice& lattice) {
  const std::size_t nodes = lattice.latticeNode(lattice.dims.x(), lattice.dims.y(), lattice.dims.z()) + 1;
  std::vector<std::uint8_t> used(nodes, 0);
  for (const std::uint32_t parent : lattice.parent_cells) {
    for (int c = 0; c < 8; ++c)
      used[cornerNode(lattice, lattice.cellIndex(parent), c)] = 1;
  }
  std::vector<std::uint32_t> vertex_at(nodes, 0);
  std::size_t node = 0;
  for (int k = 0; k <= lattice.dims.z(); ++k) {
    for (int j = 0; j <= lattice.dims.y(); ++j) {
      for (int i = 0; i <= lattice.dims.x(); ++i, ++node) {
        if (!used[node])
          continue;
        vertex_at[node] = static_cast<std::uint32_t>(lattice.rest_positions.size());
        lattice.rest_positions.push_back(lattice.origin_m + lattice.spacing_m.cwiseProduct(Vector3(i, j, k)));
        lattice.lattice_nodes.push_back(static_cast<std::uint32_t>(node));
      }
    }
  }
  for (std::size_t cell = 0; cell < lattice.cells.size(); ++cell) {
    const Vector3i index = lattice.cellIndex(lattice.parent_cells[cell]);
    for (int c = 0; c < 8; ++c)
      lattice.cells[cell][c] = vertex_at[cornerNode(lattice, index, c)];
  }
  lattice.fixed.assign(lattice.vertexCount(), 0);
  lattice.origin_vertices.resize(lattice.vertexCount());
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.origin_vertices[v] = v;
}

void addNeighbours(Lattice& lattice) {
  lattice.face_neighbours.resize(lattice.cells.size());
  for (std::size_t cell = 0; cell < lattice.cells.size(); ++cell) {
    const Vector3i index = lattice.cellIndex(lattice.parent_cells[cell]);
    for (int face = 0; face < 6; ++face) {
      Vector3i other = index;
      other[face / 2] += face % 2 == 0 ? -1 : 1;
      const bool inside = other.minCoeff() >= 0 && (other.array() < lattice.dims.array()).all();
      lattice.face_neighbours[cell][face] =
          inside ? lattice.cell_at[lattice.latticeCell(other.x(), other.y(), other.z())] : Lattice::kNone;
    }
  }
}

}  // namespace

LatticeBox latticeBox(const Lattice& lattice, const Box3& box_m) {
  LatticeBox box{Vector3i::Zero(), Vector3i::Zero()};
  if (box_m.isEmpty())
    return box;
  for (int d = 0; d < 3; ++d) {
    const double n = lattice.dims[d];
    const double low = std::floor((box_m.min()[d] - lattice.origin_m[d]) / lattice.spacing_m[d]);
    const double high = std::floor((box_m.max()[d] - lattice.origin_m[d]) / lattice.spacing_m[d]) + 1.0;
    box.begin[d] = static_cast<int>(std::clamp(low, 0.0, n));
    box.end[d] = static_cast<int>(std::clamp(high, static_cast<double>(box.begin[d]), n));
  }
  return box;
}

Lattice makeLattice(const Vector3i& dims, const Vector3& spacing_m, const Vector3& origin_m,
                    const std::vector<std::int32_t>& cell_materials) {
  checkLattice(dims, spacing_m, origin_m, cell_materials.size());
  Lattice lattice;
  lattice.dims = dims;
  lattice.spacing_m = spacing_m;
  lattice.origin_m = origin_m;
  lattice.cell_at.assign(cell_materials.size(), Lattice::kNone);
  addCells(lattice, cell_materials);
  addVertices(lattice);
  addNeighbours(lattice);
  return lattice;
}

std::uint32_t copyCell(Lattice& lattice, std::uint32_t cell) {
  const auto copy = static_cast<std::uint32_t>(lattice.cellCount());
  std::uint32_t last = cell;
  while (lattice.next_cells[last] != Lattice::kNone)
    last = static_cast<std::uint32_t>(lattice.next_cells[last]);
  lattice.next_cells[last] = static_cast<std::int32_t>(copy);
  // By value: a reference would not outlive the growth of what it is appended to.
  const auto append = [cell](auto& values) {
    values.push_back(typename std::decay_t<decltype(values)>::value_type(values[cell]));
  };
  append(lattice.cells);
  append(lattice.parent_cells);
  append(lattice.materials);
  append(lattice.rest_stretch);
  append(lattice.face_neighbours);
  append(lattice.cut_faces);
  append(lattice.surface_shares);
  lattice.shares.push_back(0.0);
  lattice.next_cells.push_back(Lattice::kNone);
  return copy;
}

std::uint32_t replicateVertex(Lattice& lattice, std::uint32_t vertex) {
  const auto replica = static_cast<std::uint32_t>(lattice.vertexCount());
  lattice.rest_positions.push_back(Vector3(lattice.rest_positions[vertex]));
  lattice.fixed.push_back(std::uint8_t(lattice.fixed[vertex]));
  lattice.origin_vertices.push_back(vertex);
  lattice.lattice_nodes.push_back(std::uint32_t(lattice.lattice_nodes[vertex]));
  return replica;
}

Topology makeTopology(const Lattice& lattice, const VolumeGeometry& volume, std::uint64_t session) {
  Topology topology;
  topology.session = session;
  topology.revision = lattice.revision;
  for (const Vector3& p : lattice.rest_positions) {
    topology.rest_positions.push_back(p.cast<float>());
    topology.texture_coordinates.push_back(volume.toTexture(p).cast<float>());
  }
  topology.fixed = lattice.fixed;
  topology.origin_vertices = lattice.origin_vertices;
  topology.cell_types.assign(lattice.cellCount(), CellType::kHexahedron);
  topology.parent_cells = lattice.parent_cells;
  topology.materials = lattice.materials;
  topology.cell_offsets.push_back(0);
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    topology.connectivity.insert(topology.connectivity.end(), lattice.cells[cell].begin(), lattice.cells[cell].end());
    topology.cell_offsets.push_back(static_cast<std::uint32_t>(topology.connectivity.size()));
    for (int face = 0; face < 6; ++face) {
      topology.face_neighbours.push_back(lattice.face_neighbours[cell][face]);
      topology.cut_faces.push_back(lattice.cut_faces[cell][face]);
    }
  }
  return topology;
}

}  // namespace soft_volume::core
