#include "soft_volume/material/material.h"

#include <cmath>

namespace soft_volume::core {

CellSprings isotropicSprings(double youngs_modulus_pa, double spacing_m) {
  const double scale = youngs_modulus_pa * spacing_m;
  return {0.14 * scale, 0.12 * scale, 0.12 * scale};
}

double bulkTimeStepLimit(const Material& material, double spacing_m) {
  const double mu_pa = 0.4 * material.youngs_modulus_pa;
  return 2.0 * spacing_m * std::sqrt(material.density_kg_m3 / (12.0 * mu_pa));
}

}  // namespace soft_volume::core
