#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"
#include "soft_volume/tool/tool_command.h"

namespace soft_volume::core {

/// How an incision acts. Defaults are those of the scene file.
struct IncisionSettings {
  /// Rest lengths across the lips, in the cells along the cut, are shortened to this fraction so that the cut opens
  /// (section 4.4.2, last paragraph).
  double rest_fraction = 0.75;
  /// Outward force on the lips of a cut, per rest area, that pulls them apart (the same paragraph).
  double opening_pressure_pa = 0.0;
};

struct IncisionResult {
  std::uint32_t faces_opened = 0;
  std::uint32_t vertices_added = 0;
  Box3 rest_box_m;  ///< rest places of the vertices along the new cut; empty when nothing was cut
};

/// Incision method 1 (section 4.4.1): parts the lattice along the cell faces nearest to the swept blade.
///
/// A face between two cells opens when the segment between their deformed centres crosses a quad of the sweep (two
/// triangles, borders included, so that quads that share an edge leave no gap). A vertex of an opened face is
/// replicated once for every group of its cells that no longer hangs together through faces; a cut that ends inside the
/// tissue therefore keeps its front closed. The group with the lowest cell number keeps the vertex. Replicas start as
/// copies and follow in number order. Faces with a cell of a fixed material do not open.
///
/// `positions_m` are the deformed positions (one per vertex). `reach_m` bounds the distance of any vertex from rest.
/// Changes the lattice and raises its revision only when at least one face opens.
IncisionResult cutLattice(Lattice& lattice, const std::vector<Material>& materials,
                          const std::vector<Vector3>& positions_m, double reach_m, const std::vector<SweptQuad>& quads,
                          const IncisionSettings& settings);

/// Largest distance between a vertex and the one that it was replicated from, metres; 0 without incisions.
double cutOpening(const Lattice& lattice, const std::vector<Vector3>& positions_m);

}  // namespace soft_volume::core
