#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// A tissue and the voxels that consist of it. SI units.
struct Material {
  std::string name;
  double density_kg_m3 = 1000.0;
  double youngs_modulus_pa = 10000.0;
  double poisson_ratio = 0.25;       ///< central-force springs have exactly 0.25
  double damping_per_s = 0.0;        ///< rate at which velocity decays (force = -damping * mass * velocity)
  double cut_resistance_j_m2 = 0.0;  ///< energy to part a unit area; 0 where it is not modelled
  bool fixed = false;                ///< rigid and immovable; blades do not cut it
  Vector3f colour = Vector3f::Ones();
  float opacity = 1.0F;  ///< per unit distance of the transfer function, in [0, 1]

  // A voxel belongs to the material by its label where the material names labels, by its intensity otherwise.
  std::vector<std::int64_t> labels;
  double intensity_min = 0.0;  ///< inclusive
  double intensity_max = 0.0;  ///< exclusive

  bool byLabel() const { return !labels.empty(); }
};

/// Spring stiffness that one cubic cell owns, newton per metre.
struct CellSprings {
  double edge_n_m;
  double face_n_m;
  double body_n_m;
};

/// The isotropic rule for a cubic cell of edge h: edge 0.14 E h, face and body diagonals 0.12 E h, each summed over the
/// cells that share the spring. The homogenised lattice then has Young's modulus E and Poisson ratio 1/4 exactly.
CellSprings isotropicSprings(double youngs_modulus_pa, double spacing_m);

/// Largest stable time step of symplectic Euler for an infinite lattice of these springs: 2 / omega_max with
/// omega_max^2 = 12 mu / (rho h^2), mu = 0.4 E; about 0.88 h sqrt(rho / E).
double bulkTimeStepLimit(const Material& material, double spacing_m);

}  // namespace soft_volume::core
