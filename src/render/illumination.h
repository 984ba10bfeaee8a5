#pragma once

#include <algorithm>
#include <cmath>

#include "light.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {

/// Light on a piece of a ray: its colour times `diffuse` plus `highlight`, at most 1.
struct Lighting {
  double diffuse = 1.0;
  double highlight = 0.0;
};

/// The light of an image as light.h defines it, for gradients in the camera frame.
class Illumination {
 public:
  /// `step_m`: shadingStep(); `range`: of the transfer function.
  Illumination(const RenderOptions& options, double step_m, double range)
      : shading_(options.shading),
        specular_(options.specular),
        step_m_(step_m),
        surface_scale_(step_m * kEdgesPerRange / range),
        light_(lightDirection().cast<double>()),
        half_(highlightDirection().cast<double>()) {}

  bool isOn() const { return shading_ > 0.0; }
  double stepM() const { return step_m_; }

  Lighting on(const Vector3& gradient) const {
    const double steepness = gradient.norm();
    if (!(steepness > 0.0))
      return {mix(1.0, kMeanLight, shading_), 0.0};
    const double strength = std::min(1.0, steepness * surface_scale_);
    const double diffuse = kAmbient + kDiffuse * std::abs(gradient.dot(light_)) / steepness;
    const double gloss = std::pow(std::abs(gradient.dot(half_)) / steepness, kShininess);
    return {mix(1.0, mix(kMeanLight, diffuse, strength), shading_), shading_ * specular_ * strength * gloss};
  }

 private:
  static double mix(double a, double b, double part) { return a + part * (b - a); }

  double shading_;
  double specular_;
  double step_m_;
  double surface_scale_;
  Vector3 light_;
  Vector3 half_;
};

}  // namespace soft_volume::core
