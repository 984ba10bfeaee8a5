#include "colour_space.h"

#include <algorithm>
#include <cmath>

namespace soft_volume::core {
namespace {

/// White of D65, CIE 1931, for Y = 1.
const Vector3 kWhite(0.9505, 1.0, 1.089);

// ------------------------------------------------------------------------------------------------------------- CIE Lab

double linearOf(double srgb) {
  return srgb > 0.04045 ? std::pow((srgb + 0.055) / 1.055, 2.4) : srgb / 12.92;
}

double srgbOf(double linear) {
  const double c = linear > 0.0031308 ? 1.055 * std::pow(linear, 1.0 / 2.4) - 0.055 : 12.92 * linear;
  return std::clamp(c, 0.0, 1.0);
}

Matrix3 xyzOfLinear() {
  Matrix3 m;
  m << 0.4124, 0.3576, 0.1805, 0.2126, 0.7152, 0.0722, 0.0193, 0.1192, 0.9505;
  return m;
}

double labCurve(double x) {
  return x > 0.008856 ? std::cbrt(x) : 7.787 * x + 16.0 / 116.0;
}

double labCurveInverse(double f) {
  return f * f * f > 0.008856 ? f * f * f : (f - 16.0 / 116.0) / 7.787;
}

Vector3 labOf(const Vector3& rgb) {
  const Vector3 xyz = (xyzOfLinear() * rgb.unaryExpr(&linearOf)).cwiseQuotient(kWhite);
  const Vector3 f = xyz.unaryExpr(&labCurve);
  return {116.0 * f.y() - 16.0, 500.0 * (f.x() - f.y()), 200.0 * (f.y() - f.z())};
}

Vector3 rgbOfLab(const Vector3& lab) {
  const double y = (lab.x() + 16.0) / 116.0;
  const Vector3 f(y + lab.y() / 500.0, y, y - lab.z() / 200.0);
  const Vector3 xyz = f.unaryExpr(&labCurveInverse).cwiseProduct(kWhite);
  return Vector3(xyzOfLinear().inverse() * xyz).unaryExpr(&srgbOf);
}

// ----------------------------------------------------------------------------------- Msh: polar Lab, for diverging
// maps

Vector3 mshOf(const Vector3& rgb) {
  const Vector3 lab = labOf(rgb);
  const double m = lab.norm();
  const double s = m > 0.001 ? std::acos(std::clamp(lab.x() / m, -1.0, 1.0)) : 0.0;
  return {m, s, s > 0.001 ? std::atan2(lab.z(), lab.y()) : 0.0};
}

Vector3 rgbOfMsh(const Vector3& msh) {
  const double chroma = msh.x() * std::sin(msh.y());
  return rgbOfLab({msh.x() * std::cos(msh.y()), chroma * std::cos(msh.z()), chroma * std::sin(msh.z())});
}

double angleBetween(double a, double b) {
  return std::abs(std::remainder(a - b, 2.0 * M_PI));
}

/// The hue that an unsaturated end gets, such that the way to it looks even.
double hueTowardsWhite(const Vector3& saturated, double unsaturated_m) {
  if (saturated.x() >= unsaturated_m - 0.1)
    return saturated.z();
  const double spin = saturated.y() * std::sqrt(unsaturated_m * unsaturated_m - saturated.x() * saturated.x()) /
                      (saturated.x() * std::sin(saturated.y()));
  return saturated.z() > -M_PI / 3.0 ? saturated.z() + spin : saturated.z() - spin;
}

Vector3 mixDiverging(const Vector3& a, const Vector3& b, double t) {
  constexpr double kSaturated = 0.05;
  Vector3 from = mshOf(a);
  Vector3 to = mshOf(b);
  if (from.y() > kSaturated && to.y() > kSaturated && angleBetween(from.z(), to.z()) > M_PI / 3.0) {
    const Vector3 white(std::max({from.x(), to.x(), 88.0}), 0.0, 0.0);
    (t < 0.5 ? to : from) = white;
    t = t < 0.5 ? 2.0 * t : 2.0 * t - 1.0;
  }
  if (from.y() < kSaturated && to.y() > kSaturated)
    from.z() = hueTowardsWhite(to, from.x());
  else if (to.y() < kSaturated && from.y() > kSaturated)
    to.z() = hueTowardsWhite(from, to.x());
  return rgbOfMsh(from + t * (to - from));
}

// ----------------------------------------------------------------------------------------------------------------- HSV

Vector3 hsvOf(const Vector3& rgb) {
  const double value = rgb.maxCoeff();
  const double range = value - rgb.minCoeff();
  if (range <= 0.0)
    return {0.0, 0.0, value};
  const double sixths = rgb.x() == value   ? (rgb.y() - rgb.z()) / range
                        : rgb.y() == value ? 2.0 + (rgb.z() - rgb.x()) / range
                                           : 4.0 + (rgb.x() - rgb.y()) / range;
  return {sixths < 0.0 ? sixths / 6.0 + 1.0 : sixths / 6.0, range / value, value};
}

Vector3 rgbOfHsv(const Vector3& hsv) {
  const auto channel = [&hsv](double offset) {
    const double k = std::fmod(offset + 6.0 * hsv.x(), 6.0);
    return hsv.z() * (1.0 - hsv.y() * std::clamp(std::min(k, 4.0 - k), 0.0, 1.0));
  };
  return {channel(5.0), channel(3.0), channel(1.0)};
}

/// With `wrap` the hue takes the shorter way around the circle.
Vector3 mixHsv(const Vector3& a, const Vector3& b, double t, bool wrap) {
  Vector3 from = hsvOf(a);
  Vector3 to = hsvOf(b);
  if (wrap && std::abs(from.x() - to.x()) > 0.5)
    (from.x() < to.x() ? from : to).x() += 1.0;
  Vector3 mixed = from + t * (to - from);
  mixed.x() -= std::floor(mixed.x());
  return rgbOfHsv(mixed);
}

}  // namespace

Vector3 mixColours(const Vector3& a, const Vector3& b, double t, ColourSpace space) {
  switch (space) {
    case ColourSpace::kHsv:
    case ColourSpace::kHsvNoWrap:
      return mixHsv(a, b, t, space == ColourSpace::kHsv);
    case ColourSpace::kLab: {
      const Vector3 from = labOf(a);
      return rgbOfLab(from + t * (labOf(b) - from));
    }
    case ColourSpace::kDiverging:
      return mixDiverging(a, b, t);
    case ColourSpace::kStep:
      return t > 0.0 ? b : a;
    case ColourSpace::kRgb:
      break;
  }
  return a + t * (b - a);
}

}  // namespace soft_volume::core
