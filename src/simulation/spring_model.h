#pragma once

#include <array>
#include <vector>

#include "kernel.h"
#include "lattice_index.h"
#include "soft_volume/material/material.h"
#include "soft_volume/simulation/prestress.h"
#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

/// What the materials of a lattice mean for its springs and masses.
struct SpringModel {
  /// What a cell of each material contributes.
  struct OfMaterial {
    std::array<double, kDirections> stiffness_n_m;  ///< by direction between corners
    double volume_pa;                               ///< modulus of the volume energy
    double altitude_n_m;                            ///< stiffness of the altitude springs
    double corner_mass_kg;
    double damping_rate_per_s;
  };
  std::vector<OfMaterial> materials;
  SpringRule rule = SpringRule::kIsotropic;
  double strength_n_m = 0.0;  ///< of every spring, by the dissertation's rule
  bool has_volume_energy = false;
  /// Linear springs without rest length beside the ordinary ones, as a share of their stiffness, by direction; see
  /// bendingRelief() in material.h. All materials have the same.
  std::array<double, kDirections> linear = {};
  std::array<Vector3, kDirections> offsets_m;  ///< to the neighbour in each direction
  std::array<double, kDirections> lengths_m;   ///< of these
  double shortest_edge_m = 0.0;
  Prestress prestress;
  /// A step of symplectic Euler that is stable for certain, from the absolute row sums of one cell; 0 where unknown.
  double certain_step_s = 0.0;
};

/// Direction from corner `a` of a hexahedron to corner `b`.
std::uint8_t cornerDirection(int a, int b);

/// A spring as a vertex sees it, merged over the cells that share it: the sum of their stiffness, and the rest length
/// weighted by stiffness, which exerts exactly the sum of their forces.
struct MergedSpring {
  std::uint32_t neighbour;
  std::uint8_t direction;
  bool stretched;           ///< the rest length is not the distance at rest
  std::int8_t last_corner;  ///< of the vertex in the last cell that shares it; those at one place follow each other
  std::uint8_t places;      ///< at how many places there are cells that share it
  double shares;            ///< of these cells, summed
  double stiffness_n_m;
  double rest_length_m;
};

/// All that one vertex is made of.
struct VertexRow {
  std::vector<MergedSpring> springs;  ///< by direction, then neighbour
  double mass_kg = 0.0;
  double damping_rate_per_s = 0.0;

  /// A third of the summed stiffness: what the vertex feels on average over directions when its neighbours stay.
  double stiffness_n_m() const;
};

/// `damping_frequency_rad_s` is that of the slowest mode, to which the materials' damping ratios refer.
SpringModel makeSpringModel(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule,
                            double damping_frequency_rad_s);

/// 1 where a vertex never moves: where the lattice says so; the dissertation's rigid tissue is only heavy.
inline bool isFixed(const Lattice& lattice, SpringRule rule, std::uint32_t vertex) {
  return rule == SpringRule::kIsotropic && lattice.fixed[vertex] != 0;
}

/// Of the altitude springs of a cell; like all of a cell's stiffness in proportion to its share.
inline double altitudeStiffness(const Lattice& lattice, const SpringModel& model, std::uint32_t cell) {
  return lattice.shares[cell] * model.materials[lattice.materials[cell]].altitude_n_m;
}

void makeRow(const Lattice& lattice, const LatticeIndex& index, const SpringModel& model, std::uint32_t vertex,
             VertexRow& row);

}  // namespace soft_volume::core
