#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/grid/topology.h"
#include "soft_volume/grid/topology_delta.h"
#include "soft_volume/incision/cut_mesh.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// What receivers see of a cut lattice that lies in a volume: cell n is piece n and vertex v is vertex v of the mesh,
/// so numbers stay when more is cut. Of an uncut lattice it is what makeTopology(lattice, ...) gives.
///
/// - A piece with the corners of its whole lattice cell and nothing more is a hexahedron in VTK's order, any other a
///   polyhedron whose faces follow those of the piece, and one without faces is empty.
/// - Texture coordinates are those of the rest places: what is drawn does not slide when it is cut.
/// - A vertex is fixed if it is the lattice's own and fixed there, or if all vertices that it comes from are.
/// - The cell across a face is -1 where an incision opened it, and `cut_faces` is 1.
Topology makeTopology(const CutMesh& mesh, const Lattice& lattice, const VolumeGeometry& volume, std::uint64_t session);

/// What a receiver of a cut mesh had before: its revision and numbers of vertices and cells.
struct TopologyMark {
  std::uint32_t revision = 0;
  std::size_t vertices = 0;
  std::size_t cells = 0;
};

/// The change from such a state to what makeTopology() gives. `changed_pieces` names in any order all pieces of that
/// time that have another face now, or a face with another loop, another piece across it or opened. Takes time in
/// proportion to the change.
TopologyDelta makeTopologyDelta(const CutMesh& mesh, const Lattice& lattice, const VolumeGeometry& volume,
                                std::uint64_t session, const TopologyMark& base,
                                std::vector<std::uint32_t> changed_pieces);

}  // namespace soft_volume::core
