#pragma once

#include <cstdint>
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
/// An equilibrium need not be stable: what the release compresses may buckle, like a corner of fat that a single cell
/// holds to a bone. Cells with a vertex that the tension leaves less than a third of its stiffness, while its
/// neighbours stay, are therefore imaged slack (s = 1), and the rest is released anew.
///
/// The default is tissue without tension.
struct Prestress {
  std::vector<Vector3> slack_m;  ///< w, one per vertex, replicas' those of their originals; empty without tension
  std::vector<double> stretch;   ///< s, one per cell of the uncut lattice

  bool empty() const { return slack_m.empty(); }
  /// s of a cell, that of its original where it is a copy.
  double stretchOf(const Lattice& lattice, std::size_t cell) const {
    return stretch[lattice.firstCell(static_cast<std::uint32_t>(cell))];
  }
  /// Rest volume of a cell in units of its imaged volume.
  double volume(const Lattice& lattice, std::size_t cell) const;
  /// Gives replicas that were added since their originals' slack.
  void extend(const Lattice& lattice);
};

/// A cut lattice has the tension that it had before.
Prestress findPrestress(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule);

}  // namespace soft_volume::core
