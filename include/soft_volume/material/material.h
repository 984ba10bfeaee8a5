#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {

struct Lattice;

/// A tissue and the voxels that consist of it. SI units.
struct Material {
  std::string name;
  double density_kg_m3 = 1000.0;
  double youngs_modulus_pa = 10000.0;
  double poisson_ratio = 0.25;  ///< 0.25 to 0.49; springs alone have 0.25, more adds the volume energy
  double damping_ratio = 0.0;   ///< of critical, for the slowest mode of the tissue; 1: critical
  /// By how much the tissue is stretched as it was imaged, 1 to 1.5: taut, so that an incision gapes by itself. The
  /// imaged shape stays in equilibrium: tension has what holds it, tissue that is free carries none
  /// (doc/simulation.md).
  double prestretch = 1.0;
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

/// Elastic constants of an isotropic material, pascal.
struct ElasticConstants {
  double lambda_pa;
  double mu_pa;
  /// Modulus of the cell volume energy, kappa = lambda - mu: what springs (lambda = mu) lack; 0 at nu = 0.25.
  double volume_pa;
};
/// lambda = E nu / ((1 + nu) (1 - 2 nu)), mu = E / (2 (1 + nu)). Throws SceneError unless E > 0 and nu is 0.25 to 0.49.
ElasticConstants elasticConstants(double youngs_modulus_pa, double poisson_ratio);

/// Spring stiffness that one box-shaped cell owns, newton per metre, to be summed over the cells that share a spring.
struct CellSprings {
  std::array<double, 3> edge_n_m;  ///< along axis a
  std::array<double, 3> face_n_m;  ///< diagonals of the faces normal to axis a
  double body_n_m;
};

/// Stiffness of the spring between a pair of corners.
double springStiffness(const CellSprings& springs, const CornerPair& pair);

/// Largest ratio of the longest to the shortest cell edge. Springs exist up to sqrt(3): beyond it the longest edges
/// would need a negative stiffness, whatever the third edge is.
constexpr double kMaxSpacingAspect = 1.73;

/// The isotropic rule: springs whose homogenised lattice has shear modulus mu = E / (2 (1 + nu)) and Poisson ratio 1/4
/// exactly in the patch test. In a lattice of box-shaped cells with edges h_a and volume V, after summing over owners,
///   body diagonals  beta (h_x^2 + h_y^2 + h_z^2) / 4
///   face diagonals  (mu V / (h_a^2 h_b^2) - beta) (h_a^2 + h_b^2) / 2
///   edges           mu V (3 / h_a^2 - 1 / h_b^2 - 1 / h_c^2) + beta h_a^2
/// for any beta; it is taken inside the interval where all are positive. Cubic cells own edges of 0.35 mu h, face and
/// body diagonals of 0.30 mu h (at nu = 1/4: 0.14 E h and 0.12 E h). Throws SceneError for an aspect beyond
/// kMaxSpacingAspect.
CellSprings isotropicSprings(const ElasticConstants& constants, const Vector3& spacing_m);

/// What makes springs follow bending: a lattice of springs is too stiff where a cell bends or warps (a cube 2.4 times
/// as stiff as a beam of its size). With x the corners of a cell, g = +-1 by the product of two of a corner's signs
/// (one g for each pair of axes) and q = sum of g x, the energy
///
///   -(1/2) (c / 8) sum over the three g of |q|^2
///
/// takes part of that back. q is zero for every affine deformation and turns with the cell, so the patch test is exact
/// as before, rigid motions cost nothing and both momenta are kept. It amounts to linear springs without rest length
/// between corners: -c / 8 along edges and face diagonals, 3 c / 8 along body diagonals. Returns c, half of the least
/// stiffness that the springs give to any of these modes, newton per metre; the rest keeps the cell stable. The
/// modes are those of hourglass control (Flanagan and Belytschko 1981).
double bendingRelief(const CellSprings& springs, const Vector3& spacing_m);
/// The linear spring between a pair of corners, in units of c.
double bendingReliefShare(const CornerPair& pair);

/// The dissertation's rule (section 4.2): one strength for every spring, however many cells share it, newton per metre.
/// Equal springs k give a cubic lattice the modulus C11 = (13 / 3) k / h; so that it is that of the isotropic rule,
/// k = 1.2 E h / (13 / 3) with E the mean over the cells whose material is not fixed and h the mean cell edge. Throws
/// SceneError when every material is fixed.
double dissertationStrength(const Lattice& lattice, const std::vector<Material>& materials);
/// Section 4.2 does not fix rigid tissue: it moves, and is as many times as heavy.
constexpr double kDissertationRigidMass = 1000.0;

/// Largest stable time step of symplectic Euler for an infinite cubic lattice: 2 h sqrt(rho / (12 mu + 4 kappa)), with
/// the shortest edge for h. A check of the computed limit, which is lower at a free surface.
double bulkTimeStepLimit(const Material& material, const Vector3& spacing_m);

}  // namespace soft_volume::core
