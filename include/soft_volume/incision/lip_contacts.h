#pragma once

#include <vector>

#include "soft_volume/grid/lip_contact.h"
#include "soft_volume/incision/cut_mesh.h"
#include "soft_volume/incision/embedding.h"
#include "soft_volume/incision/incision.h"
#include "soft_volume/material/material.h"

namespace soft_volume::core {

/// Stiffness of a contact of area A between lips of modulus E (the harmonic mean of both) in cells with the shortest
/// edge h is this times E A / h. Pressed by a fifth of E, the lips are a hundredth of h in each other.
constexpr double kLipStiffness = 20.0;

/// The contacts between all lips of a cut mesh whose embedding is up to date.
///
/// Lips are faces that an incision opened; opposite ones are those that lie on each other at rest, whatever later cuts
/// made of either. Where they overlap, triangles around the middle of the overlap get a contact each at their centroid
/// (one for the whole overlap where it is small or a triangle), which for a rectangle passes an even pressure on to the
/// corners of a cell exactly. Lips that the same cell carries (the front of an incision) cannot move apart nor into
/// each other and have none; nor have fixed tissue's among themselves.
///
/// Deterministic; the result follows from the arguments alone, so it need not be saved. Takes a short pass over the
/// cells, and time in proportion to the area of all incisions.
std::vector<LipContact> findLipContacts(const CutMesh& mesh, const Embedding& embedding, const Lattice& lattice,
                                        const std::vector<Material>& materials, const IncisionSettings& settings);

/// Shortens the rest lengths of the cells that carry lips to `rest_fraction` across these, so that the cut opens
/// (section 4.4.2, last paragraph): along axis a by the factor 1 - (1 - rest_fraction) n_a^2, n the lips' normal, or
/// as much as another lip has shortened it. To be called before Simulation::adoptTopology().
void shortenAcrossLips(Lattice& lattice, const std::vector<LipContact>& lips, double rest_fraction);

}  // namespace soft_volume::core
