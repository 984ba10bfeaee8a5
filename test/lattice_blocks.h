#pragma once

#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"

namespace soft_volume::core {

/// A full block of cubic cells of material 0 with its lowest corner at the origin.
inline Lattice makeBlock(int nx, int ny, int nz, double spacing_m) {
  const std::size_t cells = std::size_t(nx) * std::size_t(ny) * std::size_t(nz);
  return makeLattice({nx, ny, nz}, Vector3::Constant(spacing_m), Vector3::Zero(), std::vector<std::int32_t>(cells, 0));
}

inline std::vector<Material> oneMaterial(double youngs_modulus_pa, double damping_per_s = 0.0) {
  Material material;
  material.name = "tissue";
  material.youngs_modulus_pa = youngs_modulus_pa;
  material.density_kg_m3 = 1000.0;
  material.damping_per_s = damping_per_s;
  return {material};
}

}  // namespace soft_volume::core
