#include "mipmap.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "soft_volume/common/parallel.h"

namespace soft_volume::core {
namespace {

/// The voxels below one coarser voxel along an axis, and how much of each, in parts of 1 / coarse sides.
struct Footprint {
  int first = 0;
  int count = 0;
  std::array<double, 4> weights{};
};

/// Voxel i of `coarse` covers [i, i + 1) fine / coarse of the fine ones, which is at least 1 and less than 3 wide.
std::vector<Footprint> footprints(int fine, int coarse) {
  std::vector<Footprint> result(std::size_t(coarse), Footprint{});
  for (int i = 0; i < coarse; ++i) {
    Footprint& footprint = result[std::size_t(i)];
    const std::int64_t begin = std::int64_t(i) * fine;
    const std::int64_t end = begin + fine;
    footprint.first = int(begin / coarse);
    for (std::int64_t voxel = footprint.first; voxel * coarse < end; ++voxel) {
      const std::int64_t inside = std::min(end, (voxel + 1) * coarse) - std::max(begin, voxel * coarse);
      footprint.weights[std::size_t(footprint.count++)] = double(inside);
    }
  }
  return result;
}

template <typename Texel>
Texel toTexel(double value) {
  if constexpr (std::numeric_limits<Texel>::is_integer)
    return Texel(std::lround(value));
  else
    return Texel(value);
}

template <typename Texel>
Texel meanOf(const Texel* texels, const Vector3i& dims, const Footprint& x, const Footprint& y, const Footprint& z) {
  double sum = 0.0;
  double weights = 0.0;
  double all = 0.0;
  for (int k = 0; k < z.count; ++k) {
    for (int j = 0; j < y.count; ++j) {
      const Texel* row =
          texels +
          (std::size_t(z.first + k) * std::size_t(dims.y()) + std::size_t(y.first + j)) * std::size_t(dims.x()) +
          x.first;
      for (int i = 0; i < x.count; ++i) {
        const double weight = z.weights[std::size_t(k)] * y.weights[std::size_t(j)] * x.weights[std::size_t(i)];
        all += weight;
        if (std::isnan(double(row[i])))
          continue;
        sum += weight * double(row[i]);
        weights += weight;
      }
    }
  }
  return 2.0 * weights < all ? toTexel<Texel>(std::numeric_limits<double>::quiet_NaN()) : toTexel<Texel>(sum / weights);
}

}  // namespace

template <typename Texel>
std::vector<Texel> halveVolume(const Texel* texels, const Vector3i& dims) {
  const Vector3i half = halvedDims(dims);
  const auto xs = footprints(dims.x(), half.x());
  const auto ys = footprints(dims.y(), half.y());
  const auto zs = footprints(dims.z(), half.z());
  std::vector<Texel> result(xs.size() * ys.size() * zs.size());
  const int threads = threadsFor(0);
  parallelFor(std::ptrdiff_t(zs.size()), threads, [&](std::ptrdiff_t k) {
    Texel* next = &result[std::size_t(k) * ys.size() * xs.size()];
    for (const Footprint& y : ys) {
      for (const Footprint& x : xs)
        *next++ = meanOf(texels, dims, x, y, zs[std::size_t(k)]);
    }
  });
  return result;
}

double pixelWidth(const Camera& camera, const Vector3i& dims, const Matrix3& texture_per_m) {
  const Matrix3 axes = camera.T_volume_camera.orientation.toRotationMatrix();
  const auto voxels = [&](const Vector3& way) { return dims.cast<double>().cwiseProduct(texture_per_m * way).norm(); };
  return std::max(voxels(axes.col(0)) / camera.fx, voxels(axes.col(1)) / camera.fy);
}

template std::vector<std::int16_t> halveVolume(const std::int16_t*, const Vector3i&);
template std::vector<std::uint16_t> halveVolume(const std::uint16_t*, const Vector3i&);
template std::vector<float> halveVolume(const float*, const Vector3i&);

}  // namespace soft_volume::core
