#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"

namespace soft_volume::core {

/// The mass-spring system of a lattice (section 4.2): every cell connects its eight vertices completely; springs that
/// neighbouring cells share are merged into one whose stiffness is the sum and whose rest length is the mean weighted
/// by stiffness, which exerts exactly the sum of their forces. Springs are stored per vertex (both directions) so that
/// a force is a gather over one row. Rows keep the order of neighbour numbers.
struct SpringNetwork {
  std::vector<std::uint32_t> row_begin;   ///< vertices + 1 entries into the arrays below
  std::vector<std::uint32_t> neighbours;  ///< vertex at the other end
  std::vector<double> stiffness_n_m;
  std::vector<double> rest_length_m;

  std::vector<double> mass_kg;       ///< per vertex: an eighth of every cell around it
  std::vector<double> damping_kg_s;  ///< per vertex: mass times the material's damping rate
};

/// Builds the network of a lattice with cubic cells. Springs between two fixed vertices are left out: they never act.
SpringNetwork buildSpringNetwork(const Lattice& lattice, const std::vector<Material>& materials);

}  // namespace soft_volume::core
