#pragma once

#include <algorithm>
#include <cmath>
#include <limits>

#include "illumination.h"
#include "transfer_integral.h"

namespace soft_volume::core {

/// Samples of a scalar along a ray, between which it changes evenly.
struct ScalarSample {
  double z;
  double value;
  TransferIntegral::Density up_to;
};

/// What lies between two samples of a scalar.
class ScalarProfile {
 public:
  explicit ScalarProfile(const TransferIntegral& function) : function_(&function) {}
  ScalarSample sample(double z, double value) const { return {z, value, function_->upTo(value)}; }
  TransferIntegral::Density mean(const ScalarSample& a, const ScalarSample& b) const {
    return function_->mean(a.value, a.up_to, b.value, b.up_to);
  }
  ScalarSample middle(const ScalarSample& a, const ScalarSample& b) const {
    return sample(0.5 * (a.z + b.z), 0.5 * (a.value + b.value));
  }
  /// How far the density between the samples may be from that of the straight ways from a to m and from m to b: an even
  /// bend of the value is a quarter as large within the halves, and twice that is looked at for peaks that only the
  /// bend reaches.
  double bendAtMost(const ScalarSample& a, const ScalarSample& m, const ScalarSample& b) const {
    const double bend = std::abs(m.value - 0.5 * (a.value + b.value));
    const auto [low, high] = std::minmax({a.value, m.value, b.value});
    return 0.25 * bend * function_->steepest(low - 0.5 * bend, high + 0.5 * bend);
  }

 private:
  const TransferIntegral* function_;
};

/// Samples of red, green, blue and absorption along a ray, between which they change evenly.
struct ColourSample {
  double z;
  Eigen::Vector4d value;
};

class ColourProfile {
 public:
  /// Of two linear functions' product, exactly.
  TransferIntegral::Density mean(const ColourSample& a, const ColourSample& b) const {
    const TransferIntegral::Density sum = density(a) + 4.0 * density(middle(a, b)) + density(b);
    return sum / 6.0;
  }
  ColourSample middle(const ColourSample& a, const ColourSample& b) const {
    return {0.5 * (a.z + b.z), 0.5 * (a.value + b.value)};
  }
  /// Nothing hides between samples of a smooth density.
  double bendAtMost(const ColourSample&, const ColourSample&, const ColourSample&) const { return 0.0; }

 private:
  static TransferIntegral::Density density(const ColourSample& s) {
    const double absorption = s.value[3];
    return {s.value[0] * absorption, s.value[1] * absorption, s.value[2] * absorption, absorption};
  }
};

/// Emission and absorption along one ray, from front to back.
class PixelIntegral {
 public:
  /// `stretch`: length of the ray per metre of depth; `threshold`: opacity at which depth is taken, 2 for never.
  PixelIntegral(double stretch, double threshold) : stretch_(stretch), left_at_depth_(1.0 - threshold) {}

  /// Nothing behind would be seen: it is below a hundredth of an 8-bit level.
  bool isOpaque() const { return transmittance_ < 4e-5; }
  const Vector3& colour() const { return colour_; }
  double opacity() const { return 1.0 - transmittance_; }
  /// NaN while the threshold is not reached.
  double depth() const { return depth_; }
  /// Texture coordinates at the depth, for who knows them.
  const Vector3& textureAtDepth() const { return texture_at_depth_; }
  void setTextureAtDepth(const Vector3& texture) { texture_at_depth_ = texture; }

  /// Whether the way over m is as good as straight from a to b.
  template <typename Profile, typename Sample>
  bool isStraight(const Profile& profile, const Sample& a, const Sample& m, const Sample& b) const {
    const double length = stretch_ * (b.z - a.z) * transmittance_;
    const Density bend = profile.mean(a, b) - 0.5 * (profile.mean(a, m) + profile.mean(m, b));
    // Not a number where there is nothing to see.
    return !(length * bend.cwiseAbs().maxCoeff() > kBend) && !(length * profile.bendAtMost(a, m, b) > kBendAtMost);
  }

  /// Adds the way from a to b. `lighting()` is called only where there is something to see.
  template <typename Profile, typename Sample, typename Light>
  void add(const Profile& profile, const Sample& a, const Sample& b, const Light& lighting) {
    const TransferIntegral::Density mean = profile.mean(a, b);
    if (mean[3] > 0.0)
      split(profile, a, b, mean, lighting(), kMaxSplits);
  }

 private:
  using Density = TransferIntegral::Density;

  static constexpr double kBend = 2e-5;
  static constexpr double kBendAtMost = 1e-3;
  static constexpr double kThin = 0.01;
  static constexpr double kColourError = 2e-5;
  static constexpr int kMaxSplits = 12;

  struct Slab {
    Vector3 colour;  ///< of the slab alone, times its opacity
    double depth;    ///< optical
    double transmittance;
  };

  /// As if colour and absorption were the same everywhere between.
  Slab slab(const Density& mean, double length_m, const Lighting& light) const {
    const double depth = mean[3] * length_m;
    if (!(depth > 0.0))
      return {Vector3::Zero(), 0.0, 1.0};
    const double opacity = depth < kThin ? depth * (1.0 - depth * (0.5 - depth / 6.0)) : -std::expm1(-depth);
    const Vector3 lit = mean.head<3>() * (light.diffuse / mean[3]) + Vector3::Constant(light.highlight);
    return {opacity * lit.cwiseMin(1.0), depth, 1.0 - opacity};
  }

  /// Halves the way until colours and attenuation mix well enough; two halves tell how well, and remove most of what
  /// is left of the error (Richardson).
  template <typename Profile, typename Sample>
  void split(const Profile& profile, const Sample& a, const Sample& b, const Density& mean, const Lighting& light,
             int splits) {
    const double length = stretch_ * (b.z - a.z);
    Slab whole = slab(mean, length, light);
    if (whole.depth < kThin || splits == 0)
      return composite(profile, a, b, whole);
    const Sample m = profile.middle(a, b);
    const Density front_mean = profile.mean(a, m);
    const Density back_mean = profile.mean(m, b);
    const Slab front = slab(front_mean, 0.5 * length, light);
    const Slab back = slab(back_mean, 0.5 * length, light);
    const Vector3 better = front.colour + front.transmittance * back.colour;
    const Vector3 error = better - whole.colour;
    if (transmittance_ * error.cwiseAbs().maxCoeff() < kColourError) {
      whole.colour = better + error / 3.0;
      return composite(profile, a, b, whole);
    }
    if (front.depth > 0.0)
      split(profile, a, m, front_mean, light, splits - 1);
    if (back.depth > 0.0 && !isOpaque())
      split(profile, m, b, back_mean, light, splits - 1);
  }

  template <typename Profile, typename Sample>
  void composite(const Profile& profile, const Sample& a, const Sample& b, const Slab& slab) {
    colour_ += transmittance_ * slab.colour;
    const double after = transmittance_ * slab.transmittance;
    if (after <= left_at_depth_ && transmittance_ > left_at_depth_)
      depth_ = depthWhere(profile, a, b, std::log(transmittance_ / left_at_depth_));
    transmittance_ = after;
  }

  /// Where the optical depth from a reaches `wanted`.
  template <typename Profile, typename Sample>
  double depthWhere(const Profile& profile, Sample a, Sample b, double wanted) const {
    for (int step = 0; step < 40; ++step) {
      const Sample m = profile.middle(a, b);
      const double front = profile.mean(a, m)[3] * stretch_ * (m.z - a.z);
      if (front < wanted) {
        wanted -= front;
        a = m;
      } else {
        b = m;
      }
    }
    return a.z;
  }

  const double stretch_;
  const double left_at_depth_;  ///< transmittance there
  Vector3 colour_ = Vector3::Zero();
  double transmittance_ = 1.0;
  double depth_ = std::numeric_limits<double>::quiet_NaN();
  Vector3 texture_at_depth_ = Vector3::Zero();
};

}  // namespace soft_volume::core
