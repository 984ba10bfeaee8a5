#include "references.h"

#include <array>
#include <cmath>
#include <functional>

namespace soft_volume::core::validate {
namespace {

double shearStiffness(const Beam& beam) {
  const double nu = beam.poisson_ratio;
  const double factor = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu);
  return factor * beam.area() * beam.youngs_modulus_pa / (2.0 * (1.0 + nu));
}

/// Angle, curvature, and place of a point of the beam, by arc length 0 to 1.
using BeamPoint = Eigen::Vector4d;
using Moment = std::function<double(double arc, double angle)>;  ///< theta''

BeamPoint slope(const Moment& moment, double arc, const BeamPoint& p) {
  return {p[1], moment(arc, p[0]), std::cos(p[0]), std::sin(p[0])};
}

BeamPoint integrate(const Moment& moment, double curvature_at_clamp) {
  constexpr int kSteps = 2000;
  constexpr double kStep = 1.0 / kSteps;
  BeamPoint p(0.0, curvature_at_clamp, 0.0, 0.0);
  for (int n = 0; n < kSteps; ++n) {
    const double s = n * kStep;
    const BeamPoint k1 = slope(moment, s, p);
    const BeamPoint k2 = slope(moment, s + 0.5 * kStep, p + 0.5 * kStep * k1);
    const BeamPoint k3 = slope(moment, s + 0.5 * kStep, p + 0.5 * kStep * k2);
    const BeamPoint k4 = slope(moment, s + kStep, p + kStep * k3);
    p += kStep / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
  }
  return p;
}

/// The curvature at the clamp lies between 0 and what a load that never turns away would need.
Tip shoot(const Moment& moment, double largest_curvature) {
  double low = 0.0;
  double high = largest_curvature;
  for (int n = 0; n < 60; ++n) {
    const double middle = 0.5 * (low + high);
    (integrate(moment, middle)[1] > 0.0 ? high : low) = middle;
  }
  const BeamPoint tip = integrate(moment, 0.5 * (low + high));
  return {tip[3], 1.0 - tip[2]};
}

constexpr int kGauss = 8;
constexpr std::array<double, kGauss> kGaussPoints{-0.9602898564975363, -0.7966664774136267, -0.5255324099163290,
                                                  -0.1834346424956498, 0.1834346424956498,  0.5255324099163290,
                                                  0.7966664774136267,  0.9602898564975363};
constexpr std::array<double, kGauss> kGaussWeights{0.1012285362903763, 0.2223810344533745, 0.3137066458778873,
                                                   0.3626837833783620, 0.3626837833783620, 0.3137066458778873,
                                                   0.2223810344533745, 0.1012285362903763};

Vector3 pointLoadDisplacement(const Vector3& d, double load_n, double shear_pa, double nu) {
  const double distance = d.norm();
  const double r = std::hypot(d.x(), d.y());
  const double factor = load_n / (4.0 * M_PI * shear_pa);
  const double radial =
      r == 0.0 ? 0.0 : d.z() / std::pow(distance, 3) - (1.0 - 2.0 * nu) / (distance * (distance + d.z()));
  const double down = d.z() * d.z() / std::pow(distance, 3) + 2.0 * (1.0 - nu) / distance;
  return factor * Vector3(radial * d.x(), radial * d.y(), down);
}

}  // namespace

double endLoadDeflection(const Beam& beam, double load_n) {
  return load_n * std::pow(beam.length_m, 3) / (3.0 * beam.bendingStiffness()) +
         load_n * beam.length_m / shearStiffness(beam);
}

double ownWeightDeflection(const Beam& beam, double load_n_m) {
  return load_n_m * std::pow(beam.length_m, 4) / (8.0 * beam.bendingStiffness()) +
         load_n_m * beam.length_m * beam.length_m / (2.0 * shearStiffness(beam));
}

Tip elasticaEndLoad(double a) {
  return shoot([a](double, double angle) { return -a * std::cos(angle); }, a);
}

Tip elasticaOwnWeight(double a) {
  return shoot([a](double arc, double angle) { return -a * (1.0 - arc) * std::cos(angle); }, a);
}

Vector3 squarePatchDisplacement(const Vector3& point_m, double half_width_m, double pressure_pa,
                                double youngs_modulus_pa, double poisson_ratio) {
  const double shear_pa = youngs_modulus_pa / (2.0 * (1.0 + poisson_ratio));
  const double area = half_width_m * half_width_m;
  Vector3 total = Vector3::Zero();
  for (int i = 0; i < kGauss; ++i) {
    for (int j = 0; j < kGauss; ++j) {
      const Vector3 source(kGaussPoints[i] * half_width_m, kGaussPoints[j] * half_width_m, 0.0);
      const double load_n = kGaussWeights[i] * kGaussWeights[j] * area * pressure_pa;
      total += pointLoadDisplacement(point_m - source, load_n, shear_pa, poisson_ratio);
    }
  }
  return total;
}

double squarePatchCentre(double half_width_m, double pressure_pa, double youngs_modulus_pa, double poisson_ratio) {
  return 8.0 * std::log(1.0 + std::sqrt(2.0)) / M_PI * (1.0 - poisson_ratio * poisson_ratio) * pressure_pa *
         half_width_m / youngs_modulus_pa;
}

double squarePatchSurface(double x_m, double half_width_m, double pressure_pa, double youngs_modulus_pa,
                          double poisson_ratio) {
  const double a = half_width_m;
  // The integral of 1/r over the rectangle [0, u] x [0, a], an odd function of u; the half y < 0 is the same.
  const auto corner = [a](double u) {
    return u == 0.0 ? 0.0 : u * std::asinh(a / std::abs(u)) + a * std::asinh(u / a);
  };
  const double integral = 2.0 * (corner(x_m + a) - corner(x_m - a));
  return (1.0 - poisson_ratio * poisson_ratio) * pressure_pa * integral / (M_PI * youngs_modulus_pa);
}

}  // namespace soft_volume::core::validate
