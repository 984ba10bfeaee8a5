#pragma once

#include "soft_volume/common/geometry.h"

namespace soft_volume::core::validate {

/// A prismatic beam of square section, clamped at one end.
struct Beam {
  double length_m;
  double width_m;
  double youngs_modulus_pa;
  double poisson_ratio;

  double area() const { return width_m * width_m; }
  double inertia() const { return area() * area() / 12.0; }
  double bendingStiffness() const { return youngs_modulus_pa * inertia(); }
};

/// Timoshenko's tip deflection under an end load P: P L^3 / (3 E I) + P L / (kappa G A), with Cowper's shear factor
/// kappa = 10 (1 + nu) / (12 + 11 nu) of a rectangular section.
double endLoadDeflection(const Beam& beam, double load_n);
/// The same under a load q per length: q L^4 / (8 E I) + q L^2 / (2 kappa G A).
double ownWeightDeflection(const Beam& beam, double load_n_m);

/// Tip of the elastica (an inextensible beam without shear, any deflection), in beam lengths.
struct Tip {
  double down;     ///< along the load
  double shorter;  ///< towards the clamp
};
/// EI theta'' = -P cos(theta), theta(0) = 0, theta'(L) = 0, for a = P L^2 / (E I); Runge-Kutta 4 and shooting.
Tip elasticaEndLoad(double a);
/// EI theta'' = -w (L - s) cos(theta) for a = w L^3 / (E I).
Tip elasticaOwnWeight(double a);

/// Displacement of a half-space z >= 0 (z into it) under a uniform pressure on the square |x|, |y| <= half_width of its
/// surface: Boussinesq's point load u_r = P/(4 pi G) (r z/R^3 - (1 - 2 nu) r/(R (R + z))), u_z = P/(4 pi G) (z^2/R^3 +
/// 2 (1 - nu)/R), integrated over the square by Gauss quadrature. Not for points within half a patch of the patch.
Vector3 squarePatchDisplacement(const Vector3& point_m, double half_width_m, double pressure_pa,
                                double youngs_modulus_pa, double poisson_ratio);
/// At the patch's centre: 8 ln(1 + sqrt 2) / pi * (1 - nu^2) p a / E (Love 1929).
double squarePatchCentre(double half_width_m, double pressure_pa, double youngs_modulus_pa, double poisson_ratio);
/// At (x, 0) on the surface, in closed form: the sum of x_i-weighted logarithms of the four corners (Love 1929).
double squarePatchSurface(double x_m, double half_width_m, double pressure_pa, double youngs_modulus_pa,
                          double poisson_ratio);

}  // namespace soft_volume::core::validate
