#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/incision/cut_mesh.h"

namespace soft_volume::core {

struct EmbeddingChange {
  std::uint32_t cells_added = 0;
  std::uint32_t vertices_added = 0;
  Box3 rest_box_m;  ///< of the lattice cells that were looked at; empty when the mesh had not changed
};

/// Puts the pieces of a cut mesh into copies of the lattice's cells, which move them: the virtual node algorithm of
/// Molino, Bao and Fedkiw (2004), "A virtual node algorithm for changing mesh topology during simulation".
///
/// - The pieces of a cell that hang together through closed faces inside the cell form a body. Every body has its own
///   copy of the cell, which carries stiffness, volume energy and mass in proportion to the body's volume. The largest
///   body's share is 1 less the others', so mass is kept.
/// - Corners of cells at different places are the same vertex if and only if their bodies are joined, directly or
///   through others around that corner, by closed faces between these cells.
/// - A vertex that falls apart goes on with those bodies that have tissue there (the lowest cell of several); the
/// others
///   get replicas, whose displacement and velocity Simulation::adoptTopology() takes from the vertex that they
///   replicate, so that momentum is kept.
/// - A replica is fixed where its bodies touch fixed tissue: a corner, edge or face of the cell all of whose corners
/// are
///   fixed.
///
/// Stiffness and mass of a copy scale alike: thin pieces do not shorten the stable step. A cell into which an incision
/// reaches only in part keeps one body, so its lips part when the front has left it.
///
/// Not thread-safe. Deterministic; an update takes time in proportion to what the mesh changed since the last.
class Embedding {
 public:
  /// For a mesh that was made from the lattice and not yet cut.
  explicit Embedding(const CutMesh& mesh);
  /// For a cut mesh, from what cellsOfPieces() said (a checkpoint).
  Embedding(const CutMesh& mesh, std::vector<std::uint32_t> cells_of_pieces);

  /// Adds the copies and vertices that the mesh needs since the last update, and raises the lattice's revision if the
  /// mesh has changed. The lattice is the one that the mesh was made from, changed by nothing but this.
  EmbeddingChange update(const CutMesh& mesh, Lattice& lattice);

  /// The cell that carries a piece.
  std::uint32_t cellOf(std::uint32_t piece) const { return cells_of_pieces_[piece]; }
  const std::vector<std::uint32_t>& cellsOfPieces() const { return cells_of_pieces_; }

  /// Position of a vertex of the mesh as the lattice's vertices carry it (`positions_m`, one for each of these),
  /// trilinear in the cell of its lowest piece; that of the lattice's own vertex at its own corners.
  Vector3 place(const CutMesh& mesh, const Lattice& lattice, const std::vector<Vector3>& positions_m,
                std::uint32_t vertex) const;

 private:
  std::vector<std::uint32_t> cells_of_pieces_;
  std::size_t seen_faces_;
};

}  // namespace soft_volume::core
