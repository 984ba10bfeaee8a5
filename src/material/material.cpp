#include "soft_volume/material/material.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/lattice.h"

namespace soft_volume::core {
namespace {

void checkAspect(const Vector3& spacing_m) {
  const double shortest = spacing_m.minCoeff();
  const double longest = spacing_m.maxCoeff();
  if (!isFinite(spacing_m) || shortest <= 0.0)
    throw SceneError("the lattice spacing must be positive and finite along every axis");
  if (longest <= kMaxSpacingAspect * shortest * (1.0 + 1e-9))  // a ratio of exactly the limit may round up
    return;
  throw SceneError("the lattice spacing is " + std::to_string(longest) + " m along one axis and " +
                   std::to_string(shortest) + " m along another: no springs make such long cells isotropic; choose a " +
                   "ratio of at most " + std::to_string(kMaxSpacingAspect));
}

/// 3 / h_a^2 - 1 / h_b^2 - 1 / h_c^2: what decides the sign of the edge springs along axis a.
Vector3 edgeTerms(const Vector3& squared) {
  const Vector3 inverse = squared.cwiseInverse();
  return 4.0 * inverse - Vector3::Constant(inverse.sum());
}

/// The free parameter of isotropicSprings over mu V: two fifths of the way through the interval in which no spring is
/// negative. Cubic cells get edges of 0.35 mu h; any other cell stays clear of springs without stiffness.
double bodyParameter(const Vector3& squared) {
  const double high = squared.minCoeff() / squared.prod();
  const double low = std::max(0.0, (-edgeTerms(squared).cwiseQuotient(squared)).maxCoeff());
  return low + 0.4 * (high - low);
}

/// Share of their stiffness against hourglass modes that springs give up.
constexpr double kBendingRelief = 0.5;

/// Mode n is the product of a corner's signs along the two axes other than n.
double hourglassSign(int corner, int mode) {
  const int* c = kHexahedronCorners[corner];
  return (2 * c[(mode + 1) % 3] - 1) * (2 * c[(mode + 2) % 3] - 1);
}

}  // namespace

ElasticConstants elasticConstants(double youngs_modulus_pa, double poisson_ratio) {
  const double e = youngs_modulus_pa;
  const double nu = poisson_ratio;
  if (!std::isfinite(e) || e <= 0.0)
    throw SceneError("Young's modulus must be positive and finite, but is " + std::to_string(e) + " Pa");
  if (!(nu >= 0.25 && nu <= 0.49)) {
    throw SceneError("the Poisson ratio must lie between 0.25, which springs have, and 0.49, but is " +
                     std::to_string(nu));
  }
  const double mu_pa = e / (2.0 * (1.0 + nu));
  // lambda - mu in one piece, so that it is exactly 0 where springs are enough.
  const double volume_pa = mu_pa * (4.0 * nu - 1.0) / (1.0 - 2.0 * nu);
  return {mu_pa + volume_pa, mu_pa, volume_pa};
}

CellSprings isotropicSprings(const ElasticConstants& constants, const Vector3& spacing_m) {
  checkAspect(spacing_m);
  const Vector3 squared = spacing_m.cwiseAbs2();
  const Vector3 edge_terms = edgeTerms(squared);
  const double scale = constants.mu_pa * spacing_m.prod();
  const double beta = bodyParameter(squared);
  CellSprings springs{};
  for (int a = 0; a < 3; ++a) {
    const double b2 = squared[(a + 1) % 3];
    const double c2 = squared[(a + 2) % 3];
    // Four cells share an edge and two a face. At the limit of the aspect a zero may round below zero.
    springs.edge_n_m[a] = std::max(0.0, scale * (edge_terms[a] + beta * squared[a]) / 4.0);
    springs.face_n_m[a] = std::max(0.0, scale * (1.0 / (b2 * c2) - beta) * (b2 + c2) / 4.0);
  }
  springs.body_n_m = scale * beta * squared.sum() / 4.0;
  return springs;
}

double springStiffness(const CellSprings& springs, const CornerPair& pair) {
  if (pair.axes == 3)
    return springs.body_n_m;
  for (int d = 0; d < 3; ++d) {
    const bool differs = kHexahedronCorners[pair.a][d] != kHexahedronCorners[pair.b][d];
    if (differs == (pair.axes == 1))
      return pair.axes == 1 ? springs.edge_n_m[d] : springs.face_n_m[d];
  }
  return 0.0;  // not reached: one axis always stands out
}

double bendingRelief(const CellSprings& springs, const Vector3& spacing_m) {
  double least = std::numeric_limits<double>::infinity();
  for (int mode = 0; mode < 3; ++mode) {
    Vector3 stiffness = Vector3::Zero();
    for (const CornerPair& pair : kCornerPairs) {
      Vector3 unit = Vector3::Zero();
      for (int d = 0; d < 3; ++d)
        unit[d] = (kHexahedronCorners[pair.b][d] - kHexahedronCorners[pair.a][d]) * spacing_m[d];
      const double apart = hourglassSign(pair.b, mode) - hourglassSign(pair.a, mode);
      stiffness += springStiffness(springs, pair) * apart * apart / 8.0 * unit.normalized().cwiseAbs2();
    }
    least = std::min(least, stiffness.minCoeff());
  }
  return kBendingRelief * least;
}

double bendingReliefShare(const CornerPair& pair) {
  double sum = 0.0;
  for (int mode = 0; mode < 3; ++mode)
    sum += hourglassSign(pair.a, mode) * hourglassSign(pair.b, mode);
  return sum / 8.0;
}

double dissertationStrength(const Lattice& lattice, const std::vector<Material>& materials) {
  double modulus_sum_pa = 0.0;
  double cells = 0.0;
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    const Material& material = materials[lattice.materials[cell]];
    if (material.fixed)
      continue;
    modulus_sum_pa += lattice.shares[cell] * material.youngs_modulus_pa;
    cells += lattice.shares[cell];
  }
  if (cells <= 0.0)
    throw SceneError("every cell is of a fixed material: one spring strength for all needs tissue that can move");
  return 1.2 * (modulus_sum_pa / cells) * lattice.spacing_m.mean() / (13.0 / 3.0);
}

double bulkTimeStepLimit(const Material& material, const Vector3& spacing_m) {
  const ElasticConstants constants = elasticConstants(material.youngs_modulus_pa, material.poisson_ratio);
  const double modulus_pa = 12.0 * constants.mu_pa + 4.0 * constants.volume_pa;
  return 2.0 * spacing_m.minCoeff() * std::sqrt(material.density_kg_m3 / modulus_pa);
}

}  // namespace soft_volume::core
