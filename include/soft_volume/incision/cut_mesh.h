#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "soft_volume/grid/lattice.h"

namespace soft_volume::core {

/// A lattice whose cells are cut into pieces (incision method 2, dissertation section 4.4.2): polyhedra with planar
/// faces, convex but for shallow dents where a cut went through a vertex near by, in the volume frame at rest, metres.
///
/// Vertices, faces and pieces are numbered once and never renumbered; what is cut keeps its number for one part and the
/// other part follows at the end. A face between two pieces is one object that both own, so neighbours have identical
/// loops whatever happens to them; the corners of an edge's neighbours lie on it for all pieces around it, so there are
/// no T-junctions. A piece may have several faces in one plane and vertices in the middle of a straight edge.
///
/// Plain data with the edits that keep it consistent; cutting is in blade_cut.h. Not thread-safe.
class CutMesh {
 public:
  static constexpr std::int32_t kNone = -1;

  /// Where a vertex comes from: position, velocity and the like are a + share (b - a) of vertices a and b. Replicas and
  /// the lattice's own vertices have a == b.
  struct Source {
    std::uint32_t a;
    std::uint32_t b;
    double share;
  };
  /// A planar polygon.
  struct Face {
    std::vector<std::uint32_t> loop;  ///< counter-clockwise seen from outside pieces[0]
    /// pieces[1] is kNone at the surface and where the face was opened, both are where the pieces were removed.
    std::array<std::int32_t, 2> pieces;
    bool opened = false;  ///< the surface made by an incision
  };
  struct Piece {
    std::uint32_t cell;                ///< of the lattice, which it is a part of
    std::vector<std::uint32_t> faces;  ///< increasing; none once it was removed
    std::uint32_t origin;              ///< piece that it was split from; itself for a whole cell
  };

  /// The cells of a lattice as they are, one piece each: piece c is cell c, its vertices are the lattice's.
  explicit CutMesh(const Lattice& lattice);
  /// The same cut as before: `sources` of the vertices that follow the lattice's, all faces, and all pieces, whose
  /// `faces` are not looked at; those that no face names were removed. Throws InputError unless every piece is a closed
  /// polyhedron whose cell and origin exist.
  CutMesh(const Lattice& lattice, const std::vector<Source>& sources, std::vector<Face> faces,
          std::vector<Piece> pieces);

  std::size_t vertexCount() const { return rest_positions_.size(); }
  const std::vector<Vector3>& restPositions() const { return rest_positions_; }
  const Source& source(std::uint32_t vertex) const { return sources_[vertex]; }
  const std::vector<Face>& faces() const { return faces_; }
  const std::vector<Piece>& pieces() const { return pieces_; }
  /// Increasing. All pieces of a place go with its first cell; copies of it (embedding.h) have none here.
  const std::vector<std::uint32_t>& piecesOfCell(std::uint32_t cell) const {
    return cell < pieces_of_cell_.size() ? pieces_of_cell_[cell] : no_pieces_;
  }
  const std::vector<std::uint32_t>& piecesAround(std::uint32_t vertex) const { return pieces_around_[vertex]; }

  /// The loop of a face counter-clockwise seen from outside one of its pieces.
  std::vector<std::uint32_t> outwardLoop(std::uint32_t face, std::uint32_t piece) const;
  /// The vertices of a piece, increasing.
  std::vector<std::uint32_t> verticesOf(std::uint32_t piece) const;
  /// The loops of a piece's faces, outward counter-clockwise, in the order of its faces.
  std::vector<std::vector<std::uint32_t>> loopsOf(std::uint32_t piece) const;
  /// The piece on the other side of a face, or kNone.
  std::int32_t across(std::uint32_t face, std::uint32_t piece) const;

  /// Part of every piece that hangs together through faces, numbered by its lowest piece; takes a pass over the mesh.
  std::vector<std::uint32_t> islands() const;

  /// The pieces whose faces, vertices or neighbours have changed since the last call, increasing.
  std::vector<std::uint32_t> takeChangedPieces();

  // The edits. Arguments have to fit the mesh (asserted).

  /// Puts a vertex on the edge ab, at a + share (b - a), into all loops that have the edge.
  std::uint32_t splitEdge(std::uint32_t a, std::uint32_t b, double share);
  /// Cuts a face by a chord between two vertices of its loop that are not next to each other: the part that runs from
  /// `from` to `to` keeps the number.
  std::uint32_t splitFace(std::uint32_t face, std::uint32_t from, std::uint32_t to);
  /// Gives the faces `moved` to a new piece and puts the faces `section` (loops outward of the old piece) between both.
  std::uint32_t splitPiece(std::uint32_t piece, const std::vector<std::uint32_t>& moved,
                           const std::vector<std::vector<std::uint32_t>>& section);
  /// Makes two faces of a face between two pieces. Afterwards partVertex() is due for its vertices.
  void openFace(std::uint32_t face);
  /// Takes pieces away, together with all that hang together with them through faces: they and their faces stay as
  /// numbers without content (no faces; no loop and no pieces).
  void removePieces(const std::vector<std::uint32_t>& pieces);
  /// Gives every group of pieces around a vertex that hangs together through faces at the vertex, save for the group of
  /// the lowest piece, a replica of its own. Returns how many there are.
  std::uint32_t partVertex(std::uint32_t vertex);

 private:
  std::uint32_t addVertex(const Vector3& rest_m, const Source& source);
  void addPiece(const Lattice& lattice, std::uint32_t cell);
  void takePiece(std::uint32_t number);
  void takeFace(std::uint32_t number);
  void requireClosed(std::uint32_t piece) const;
  std::vector<std::uint32_t> groupsAround(std::uint32_t vertex) const;
  void replaceVertex(std::uint32_t piece, std::uint32_t from, std::uint32_t to);

  std::vector<Vector3> rest_positions_;
  std::vector<Source> sources_;
  std::vector<Face> faces_;
  std::vector<Piece> pieces_;
  std::vector<std::vector<std::uint32_t>> pieces_of_cell_;
  std::vector<std::uint32_t> no_pieces_;
  std::vector<std::vector<std::uint32_t>> pieces_around_;  // per vertex, increasing
  std::vector<std::uint32_t> changed_pieces_;
};

}  // namespace soft_volume::core
