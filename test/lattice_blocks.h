#pragma once

#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"

namespace soft_volume::core {

/// A full block of cells of material 0 with its lowest corner at the origin.
inline Lattice makeBlock(const Vector3i& dims, const Vector3& spacing_m) {
  return makeLattice(dims, spacing_m, Vector3::Zero(), std::vector<std::int32_t>(std::size_t(dims.prod()), 0));
}

inline Lattice makeBlock(int nx, int ny, int nz, double spacing_m) {
  return makeBlock({nx, ny, nz}, Vector3::Constant(spacing_m));
}

inline std::vector<Material> oneMaterial(double youngs_modulus_pa, double damping_ratio = 0.0,
                                         double poisson_ratio = 0.25) {
  Material material;
  material.name = "tissue";
  material.youngs_modulus_pa = youngs_modulus_pa;
  material.poisson_ratio = poisson_ratio;
  material.density_kg_m3 = 1000.0;
  material.damping_ratio = damping_ratio;
  return {material};
}

}  // namespace soft_volume::core
