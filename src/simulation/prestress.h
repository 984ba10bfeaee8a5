#pragma once

#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"
#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

/// Tissue that is taut as it was imaged (Material::prestretch).
///
/// Stretched by s, a cell has springs of rest length L / s, a strain of 1 - 1 / s, and the rest volume V / J with
/// J = 1 + 3 (1 - 1 / s), the growth under this strain, so that both are released together. The tension of these
/// balances inside homogeneous tissue, but not at a free surface or between materials, where it would pull the imaged
/// shape away. So part of it is released before the start: with B w the change of all lengths and volumes under
/// displacements w of the vertices, D their stiffness and t the tensions of the stretch s, w solves
///
///   B^T (t + D B w) = 0,   w = 0 where the tissue is fixed,
///
/// and t + D B w is the tension that the imaged shape carries: in equilibrium with itself and what is fixed, as close
/// to the stretch s as that allows. Across a free surface there is none, along it there is; a body that nothing holds
/// carries none at all. Rest lengths follow: L / s - n . (w_b - w_a) for a spring from a to b along n, and likewise the
/// rest volume. Cuts divide it like all of a cell's energy, and what they part pulls back.
///
/// Returns w, one per vertex, replicas' those of their originals; empty where no material is prestretched. A cut
/// lattice has the tension that it had before.
std::vector<Vector3> findSlack(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule);

/// Gives replicas that were added since their originals' slack.
void extendSlack(const Lattice& lattice, std::vector<Vector3>& slack_m);

/// Rest volume of a cell in units of its imaged volume.
double slackVolume(const Lattice& lattice, const std::vector<Vector3>& slack_m, double prestretch, std::size_t cell);

}  // namespace soft_volume::core
