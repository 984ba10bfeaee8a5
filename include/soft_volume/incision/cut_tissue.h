#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/incision/blade_cut.h"
#include "soft_volume/incision/cut_mesh.h"
#include "soft_volume/incision/embedding.h"
#include "soft_volume/incision/incision.h"
#include "soft_volume/incision/lip_contacts.h"
#include "soft_volume/incision/stroke.h"
#include "soft_volume/material/material.h"
#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {

/// A place in the tissue, inside or outside: an offset from the weighted mean of vertices of the cut mesh near it.
struct TissuePlace {
  Vector3 offset_m = Vector3::Zero();
  std::vector<std::uint32_t> vertices;  ///< increasing; none where no tissue was near
  std::vector<double> weights;          ///< they sum to 1
};

/// A stroke under way and where its next quad begins: tip and heel.
struct TissueStroke {
  Stroke::State stroke;
  std::array<TissuePlace, 2> joint;
};

/// What a saved state holds of the incisions in a lattice: arrays of Lattice and CutMesh (which see) and the strokes
/// under way, by tool. All empty while the lattice is whole.
struct IncisionState {
  std::vector<std::array<std::uint32_t, 8>> cells;
  std::vector<std::uint32_t> parent_cells;
  std::vector<double> shares;
  std::vector<std::array<double, 6>> surface_shares;
  std::vector<Vector3> rest_stretch;
  std::vector<std::array<std::int32_t, 6>> face_neighbours;
  std::vector<std::array<std::uint8_t, 6>> cut_faces;
  std::vector<std::uint32_t> origin_vertices;
  std::vector<std::uint8_t> fixed;
  std::vector<CutMesh::Source> sources;  ///< of the mesh's vertices that follow those of the lattice as it was built
  std::vector<CutMesh::Face> faces;
  std::vector<CutMesh::Piece> pieces;  ///< without their faces
  std::vector<std::uint32_t> cells_of_pieces;
  std::map<std::string, TissueStroke> strokes;
};

struct IncisionResult {
  std::uint32_t faces_opened = 0;
  Box3 rest_box_m;        ///< rest places of the vertices of opened faces; empty when nothing was opened
  double energy_j = 0.0;  ///< that opening them takes, from the materials' resistance
  double travel_m = 0.0;  ///< of the middle of the blade's edge, in what it cut here
  std::vector<std::uint32_t> changed_pieces;  ///< whose faces, vertices or neighbours changed, increasing
  std::vector<LipContact> lips;               ///< all of the tissue; only where pieces changed
};

/// Tissue that hangs together through faces.
struct TissuePart {
  std::uint32_t piece = 0;   ///< the lowest of its pieces
  std::uint32_t pieces = 0;  ///< how many there are
  double volume_m3 = 0.0;    ///< at rest
};

/// The tissue of a lattice that blades cut: its mesh, what carries it, and the strokes under way. Not thread-safe.
class CutTissue {
 public:
  /// For a lattice without incisions.
  CutTissue(const Lattice& lattice, const IncisionSettings& settings);
  /// As it was saved; `lattice`, as it was built, becomes the one that was saved. Throws InputError, and changes
  /// nothing, unless the state is one that incisions can make of the lattice.
  CutTissue(const IncisionState& state, Lattice& lattice, const IncisionSettings& settings);

  /// Cuts along what the blade of `tool_id` swept; where `lifted`, this ends its stroke. With method pieces a quad acts
  /// once the blade is half a cell edge ahead (stroke.h) or lifted; with faces at once.
  ///
  /// The tissue moves while a stroke goes on: where the last quad ended is remembered as a place in it, so that the
  /// next one joins. `positions_m` are the deformed positions of the lattice's vertices, `reach_m` bounds their
  /// distance from rest. The lattice is the one that this was made from, changed by nothing else; its revision grows
  /// when anything was cut. Quads are finite. Deterministic; takes time in proportion to the tissue near the blade.
  IncisionResult cut(Lattice& lattice, const std::vector<Material>& materials, const std::vector<Vector3>& positions_m,
                     double reach_m, const std::string& tool_id, const std::vector<SweptQuad>& quads, bool lifted);

  /// The parts that the tissue fell into, the largest first; takes a pass over the mesh.
  std::vector<TissuePart> parts(const Lattice& lattice) const;
  /// Takes away the part that a piece belongs to: the cells that carried it have no stiffness and no mass any more, and
  /// the lattice's revision grows. Returns their vertices, increasing, which are fixed now; none when it was removed
  /// before.
  std::vector<std::uint32_t> removePart(Lattice& lattice, std::uint32_t piece);
  /// Where opposite lips may touch, for Simulation::setLips().
  std::vector<LipContact> lips(const Lattice& lattice, const std::vector<Material>& materials) const {
    return findLipContacts(mesh_, embedding_, lattice, materials, settings_);
  }

  const CutMesh& mesh() const { return mesh_; }
  const Embedding& embedding() const { return embedding_; }

  /// Positions of the vertices of the mesh, which are drawn and touched, from those of the lattice's; at rest where
  /// tissue was removed.
  std::vector<Vector3> drawnPositions(const Lattice& lattice, const std::vector<Vector3>& positions_m) const;
  /// Largest distance between a vertex and the one that it was parted from, metres; 0 without incisions.
  double opening(const Lattice& lattice, const std::vector<Vector3>& positions_m) const;

  /// Of the lattice that it was made from.
  IncisionState state(const Lattice& lattice) const;

 private:
  Vector3 placeOf(const Lattice& lattice, const std::vector<Vector3>& positions_m, std::uint32_t vertex) const;
  void placeVertices(const Lattice& lattice, const std::vector<Vector3>& positions_m, const LatticeBox& box);
  TissuePlace placeNear(const Lattice& lattice, const Vector3& p, double reach_m) const;
  IncisionResult cutPieces(const Lattice& lattice, const std::vector<Material>& materials,
                           const std::vector<Vector3>& positions_m, double reach_m, const std::string& tool_id,
                           const std::vector<SweptQuad>& quads, bool lifted);

  IncisionSettings settings_;
  Stroke::Settings stroke_settings_;
  CutMesh mesh_;
  Embedding embedding_;
  std::map<std::string, TissueStroke> strokes_;
  std::size_t lattice_vertices_;      // as it was built
  std::vector<Vector3> positions_m_;  // of the mesh's vertices, up to date only near the last cut
};

}  // namespace soft_volume::core
