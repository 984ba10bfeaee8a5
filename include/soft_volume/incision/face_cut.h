#pragma once

#include <vector>

#include "soft_volume/incision/blade_cut.h"

namespace soft_volume::core {

/// Incision method 1 (section 4.4.1): parts a mesh along the faces nearest to the swept blade.
///
/// A face between two pieces opens when the segment between their deformed middles crosses a quad of the sweep (two
/// triangles, borders included, so that quads that share an edge leave no gap). A vertex of an opened face is
/// replicated once for every group of its pieces that no longer hangs together through faces; a cut that ends inside
/// the tissue therefore keeps its front closed. Faces with a piece of a fixed material do not open.
///
/// `positions_m` are the deformed positions, one per vertex, and get those of new vertices; `reach_m` bounds the
/// distance of any vertex from rest.
BladeCutResult cutFaces(CutMesh& mesh, const Lattice& lattice, const std::vector<Material>& materials,
                        const std::vector<SweptQuad>& quads, double reach_m, std::vector<Vector3>& positions_m);

}  // namespace soft_volume::core
