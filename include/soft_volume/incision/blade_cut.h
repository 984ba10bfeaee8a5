#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <vector>

#include "soft_volume/incision/cut_mesh.h"
#include "soft_volume/material/material.h"
#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {

/// How fine pieces may become, as shares of the lattice's shortest cell edge h.
struct CutResolution {
  /// Vertices nearer than this to the blade's plane are taken to lie on it.
  double snap = 0.05;
  double least_edge = 0.01;
  double least_width = 0.03;
  /// Of an edge that is not convex (deepestDent() in piece_shape.h): snapping warps a section, and its triangles are a
  /// shallow dent in one of both parts.
  double deepest_dent = 0.1;
  /// Of h3: what would come off with less volume stays on the side with which it has more area.
  double least_island = 0.1;
};

struct BladeCutResult {
  std::uint32_t pieces_split = 0;
  std::uint32_t splits_refused = 0;  ///< a part would have been too small: the cut runs along the piece's faces instead
  std::uint32_t faces_opened = 0;
  std::uint32_t vertices_added = 0;
  double opened_area_m2 = 0.0;   ///< at rest, of the opened faces; one lip's
  double opened_energy_j = 0.0;  ///< that area times the mean of Material::cut_resistance_j_m2 on both of its sides
  Box3 rest_box_m;               ///< rest places of the vertices of opened faces; empty when nothing was opened
};

/// What the quads of a stroke leave for those that continue it, in this call of cutMesh() or a later one. Plain data,
/// the size of a patch's neighbourhood however long the stroke is; belongs to a saved state.
struct Lips {
  std::array<Vector3, 2> edge_m = {Vector3::Zero(), Vector3::Zero()};   ///< tip and heel where the last quad ended
  std::array<Vector3, 2> start_m = {Vector3::Zero(), Vector3::Zero()};  ///< where it began
  std::map<std::uint32_t, int> side_of_piece;                           ///< -1 or 1; empty at the start of a stroke
  std::uint32_t pieces_seen = 0;  ///< later ones were split off by others and are on the side of their origin
};

/// Incision method 2 (section 4.4.2): splits the pieces that the blade's swept surface crosses and opens the faces
/// that it passes through.
///
/// A quad is a planar patch where it is flat within 0.02 h and convex, two triangles otherwise; quads that share an
/// edge leave no gap. Quads narrower than 3 snap distances are left out: join short sweeps first (stroke.h). A patch
/// acts on the deformed tissue as follows.
/// 1. A piece that it covers only in part is split along the patch's border by a plane upright on it. These sections
///    stay closed: the incision ends there, within 1.5 snap distances of the blade's end; only where a part would be
///    too small it goes on to the piece's faces.
/// 2. Covered pieces are split by the patch's plane.
/// 3. Pieces at the patch get a side: that of the plane on which they lie, those that were not split that of their
///    middle, if it is over or under the patch. Faces between opposite sides are opened and vertices parted that no
///    longer hold together. Pieces at the incision keep their side for the patches that follow in the stroke; so where
///    two patches meet, their cuts do, too, wherever a split was refused or snapped. What would come off as a crumb
///    changes sides.
/// `lips` carries the sides from call to call: it makes no difference in how many calls a stroke's quads come. A quad
/// that does not start with the edge where the last one ended, or turns by 90 degrees or more, begins a new stroke.
/// Where a part would be smaller than the resolution allows, vertices up to 4 snap distances away are taken to lie on
/// the plane, too. If that does not help, the split is not made: the piece stays whole on the side of its middle and
/// the cut runs around it. So the sides are parted without a gap in any case.
///
/// Pieces of fixed materials are neither split nor parted from others. `positions_m` are the deformed positions, one
/// per vertex, and get those of new vertices. `reach_m` bounds the distance of any vertex from rest. Quads are finite.
/// Deterministic; takes time in proportion to the pieces near the blade.
BladeCutResult cutMesh(CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
                       const CutResolution& resolution, const std::vector<SweptQuad>& quads, double reach_m, Lips& lips,
                       std::vector<Vector3>& positions_m);

}  // namespace soft_volume::core
