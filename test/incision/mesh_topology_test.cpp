#include "soft_volume/incision/mesh_topology.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "incision/topology_cases.h"
#include "soft_volume/grid/cell_shape.h"
#include "soft_volume/incision/cut_tissue.h"

namespace soft_volume::core {
namespace {

constexpr int kCells = 6;
constexpr unsigned kSeed = 5;

Topology topologyOf(const CutBlock& block) {
  return makeTopology(block.mesh, block.lattice, volumeAround(kCells), 7);
}

/// A cell as the topology tells it, with the topology's own vertex numbers.
Polyhedron solidOf(const Topology& topology, std::size_t cell) {
  Polyhedron solid;
  for (const Vector3f& p : topology.rest_positions)
    solid.points_m.push_back(p.cast<double>());
  forEachFace(topology.cell_types[cell], topology.connectivity.data() + topology.cell_offsets[cell],
              [&](std::size_t, const std::uint32_t* vertices, std::size_t size) {
                solid.loops.emplace_back(vertices, vertices + size);
              });
  return solid;
}

/// Every loop of the topology with the cell across it, and those of the mesh: sets, as the order of faces may differ.
using Faces = std::multiset<std::vector<std::int64_t>>;

std::vector<std::int64_t> faceOf(std::vector<std::uint32_t> loop, std::int32_t neighbour, bool opened) {
  std::rotate(loop.begin(), std::min_element(loop.begin(), loop.end()), loop.end());
  std::vector<std::int64_t> face(loop.begin(), loop.end());
  face.insert(face.end(), {neighbour, opened ? 1 : 0});
  return face;
}

Faces facesOf(const CutMesh& mesh, std::uint32_t piece) {
  Faces faces;
  for (const std::uint32_t f : mesh.pieces()[piece].faces)
    faces.insert(faceOf(mesh.outwardLoop(f, piece), mesh.across(f, piece), mesh.faces()[f].opened));
  return faces;
}

TEST(MeshTopology, OfAnUncutBlockIsThatOfItsLattice) {
  CutBlock block(Vector3i(kCells, 4, 5));
  block.lattice.fixed[3] = 1;
  ASSERT_NO_FATAL_FAILURE(expectSame(topologyOf(block), makeTopology(block.lattice, volumeAround(kCells), 7)));
}

TEST(MeshTopology, OfALatticeWithHolesAndCutsOfItsOwnIsThatOfItsLattice) {
  std::vector<std::int32_t> materials(5 * 4 * 4, 0);
  for (std::size_t n = 3; n < materials.size(); n += 7)
    materials[n] = Lattice::kNone;
  Lattice lattice = makeLattice({5, 4, 4}, Vector3::Constant(kH), Vector3::Zero(), materials);
  const SweptQuad quad = squareQuad(Vector3(2, 2, 2.1) * kH, Vector3(0.1, 0.2, 1.0), 1.5 * kH);
  CutTissue(lattice, {IncisionMethod::kFaces, 1.0})
      .cut(lattice, oneMaterial(1e4), std::vector<Vector3>(lattice.rest_positions), 0.0, "scalpel", {quad}, true);
  ASSERT_EQ(lattice.revision, 2U);
  ASSERT_NO_FATAL_FAILURE(expectSame(makeTopology(CutMesh(lattice), lattice, volumeAround(kCells), 7),
                                     makeTopology(lattice, volumeAround(kCells), 7)));
}

TEST(MeshTopology, TellsEveryFaceOfEveryPiece) {
  std::mt19937 random(kSeed);
  EmbeddedBlock block(Vector3i::Constant(kCells));
  for (int cuts = 0; cuts < 8; ++cuts) {
    cutAtRandom(block, 1, random);
    const Topology topology = topologyOf(block);
    ASSERT_NO_THROW(topology.validate());
    ASSERT_EQ(topology.vertexCount(), block.mesh.vertexCount());
    ASSERT_EQ(topology.cellCount(), block.mesh.pieces().size());
    std::size_t face = 0;
    for (std::uint32_t cell = 0; cell < topology.cellCount(); ++cell) {
      Faces told;
      for (auto& loop : solidOf(topology, cell).loops) {
        told.insert(faceOf(loop, topology.face_neighbours[face], topology.cut_faces[face] != 0));
        ++face;
      }
      ASSERT_EQ(told, facesOf(block.mesh, cell)) << "cell " << cell;
    }
  }
}

TEST(MeshTopology, ACutThroughVerticesLeavesHexahedraThatRunOutward) {
  CutBlock block(Vector3i::Constant(kCells));
  block.cut({squareQuad(Vector3::Constant(3 * kH), Vector3::UnitZ(), 20 * kH)});
  const Topology topology = topologyOf(block);
  EXPECT_GT(topology.vertexCount(), block.lattice.vertexCount());
  EXPECT_EQ(topology.cellCount(), block.lattice.cellCount());
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    ASSERT_EQ(topology.cell_types[cell], CellType::kHexahedron);
    ASSERT_NEAR(volumeOf(solidOf(topology, cell)), kH * kH * kH, 1e-5 * kH * kH * kH);
  }
  EXPECT_EQ(std::count(topology.cut_faces.begin(), topology.cut_faces.end(), 1), 2 * kCells * kCells);
}

TEST(MeshTopology, OnlyTouchedCellsArePolyhedra) {
  CutBlock block(Vector3i::Constant(kCells));
  block.cut({squareQuad(Vector3(3, 3, 2.4) * kH, Vector3::UnitZ(), 20 * kH)});
  const Topology topology = topologyOf(block);
  // The layer through which the cut goes, twice; all others have no new corner.
  EXPECT_EQ(std::count(topology.cell_types.begin(), topology.cell_types.end(), CellType::kPolyhedron),
            2 * kCells * kCells);
}

TEST(MeshTopology, NewVerticesComeFromTheirSources) {
  CutBlock block(Vector3i::Constant(kCells));
  for (std::size_t v = 0; v < block.lattice.vertexCount(); ++v)
    block.lattice.fixed[v] = std::uint8_t(block.lattice.rest_positions[v].x() < 0.5 * kH);
  block.cut({squareQuad(Vector3(3, 3, 2.4) * kH, Vector3::UnitZ(), 20 * kH)});
  const Topology topology = topologyOf(block);
  std::size_t parted = 0;
  for (std::uint32_t v = 0; v < topology.vertexCount(); ++v) {
    const Vector3f& rest = topology.rest_positions[v];
    EXPECT_EQ(topology.fixed[v] != 0, rest.x() < 0.5F * float(kH)) << v;
    const Vector3 texture = volumeAround(kCells).toTexture(block.mesh.restPositions()[v]);
    EXPECT_EQ(topology.texture_coordinates[v], Vector3f(texture.cast<float>()));
    const std::uint32_t origin = topology.origin_vertices[v];
    EXPECT_EQ(topology.rest_positions[origin], rest);
    parted += origin != v ? 1 : 0;
  }
  EXPECT_EQ(parted, std::size_t((kCells + 1) * (kCells + 1)));
}

}  // namespace
}  // namespace soft_volume::core
