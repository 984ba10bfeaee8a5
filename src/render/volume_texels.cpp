#include "volume_texels.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace soft_volume::core {
namespace {

/// Calls `visit` with a null pointer of the type that `type` stands for.
template <typename Visit>
void withScalarType(ScalarType type, const Visit& visit) {
  switch (type) {
    case ScalarType::kInt8:
      return visit(static_cast<const std::int8_t*>(nullptr));
    case ScalarType::kUInt8:
      return visit(static_cast<const std::uint8_t*>(nullptr));
    case ScalarType::kInt16:
      return visit(static_cast<const std::int16_t*>(nullptr));
    case ScalarType::kUInt16:
      return visit(static_cast<const std::uint16_t*>(nullptr));
    case ScalarType::kInt32:
      return visit(static_cast<const std::int32_t*>(nullptr));
    case ScalarType::kUInt32:
      return visit(static_cast<const std::uint32_t*>(nullptr));
    case ScalarType::kFloat32:
      return visit(static_cast<const float*>(nullptr));
    case ScalarType::kFloat64:
      return visit(static_cast<const double*>(nullptr));
  }
}

/// Voxels that trilinear look-up with clamping touches between two texture coordinates along one axis, both included. A
/// thousandth of a voxel more on both sides covers rounding on the GPU.
std::array<int, 2> voxelsTouched(float low, float high, int count) {
  const double first = std::floor(double(low) * count - 0.5 - 1e-3);
  const double last = std::floor(double(high) * count - 0.5 + 1e-3) + 1.0;
  return {int(std::clamp(first, 0.0, count - 1.0)), int(std::clamp(last, 0.0, count - 1.0))};
}

template <typename Scalar>
std::array<double, 2> rangeInBox(const Scalar* scalars, const VolumeGeometry& geometry,
                                 const std::array<Vector3f, 2>& box) {
  std::array<std::array<int, 2>, 3> voxels{};
  for (int axis = 0; axis < 3; ++axis) {
    voxels[std::size_t(axis)] = voxelsTouched(box[0][axis], box[1][axis], geometry.dims[axis]);
  }
  Scalar low = std::numeric_limits<Scalar>::max();
  Scalar high = std::numeric_limits<Scalar>::lowest();
  for (int k = voxels[2][0]; k <= voxels[2][1]; ++k) {
    for (int j = voxels[1][0]; j <= voxels[1][1]; ++j) {
      const Scalar* row = scalars + geometry.index(0, j, k);
      for (int i = voxels[0][0]; i <= voxels[0][1]; ++i) {
        if (row[i] < low)
          low = row[i];  // both comparisons are false for NaN
        if (row[i] > high)
          high = row[i];
      }
    }
  }
  if (low > high)
    return {0.0, 0.0};
  return {double(low), double(high)};
}

}  // namespace

template <typename Scalar, typename Texel>
void VolumeTexels::convert(const Volume& volume) {
  const auto* scalars = reinterpret_cast<const Scalar*>(volume.data().data());
  const std::size_t count = volume.geometry().voxelCount();
  converted_.resize(count * sizeof(Texel));
  std::transform(scalars, scalars + count, reinterpret_cast<Texel*>(converted_.data()),
                 [](Scalar scalar) { return Texel(scalar); });
  data_ = converted_.data();
}

VolumeTexels::VolumeTexels(const Volume& volume) : data_(volume.data().data()) {
  switch (volume.type()) {
    case ScalarType::kInt8:
      convert<std::int8_t, std::int16_t>(volume);
      break;
    case ScalarType::kUInt8:
      convert<std::uint8_t, std::uint16_t>(volume);
      break;
    case ScalarType::kInt32:
      convert<std::int32_t, float>(volume);
      break;
    case ScalarType::kUInt32:
      convert<std::uint32_t, float>(volume);
      break;
    case ScalarType::kFloat64:
      convert<double, float>(volume);
      break;
    default:
      break;  // int16, uint16 and float32 are texels as they are
  }
  switch (volume.type()) {
    case ScalarType::kInt8:
    case ScalarType::kInt16:
      setFormat(GL_R16_SNORM, GL_SHORT, 32767.0);
      break;
    case ScalarType::kUInt8:
    case ScalarType::kUInt16:
      setFormat(GL_R16, GL_UNSIGNED_SHORT, 65535.0);
      break;
    default:
      break;
  }
}

void VolumeTexels::setFormat(GLint internal_format, GLenum type, double scale) {
  internal_format_ = internal_format;
  type_ = type;
  scale_ = scale;
}

std::vector<std::array<double, 2>> scalarRanges(const Volume& volume,
                                                const std::vector<std::array<Vector3f, 2>>& boxes) {
  std::vector<std::array<double, 2>> ranges;
  ranges.reserve(boxes.size());
  withScalarType(volume.type(), [&](auto type) {
    const auto* scalars = reinterpret_cast<decltype(type)>(volume.data().data());
    for (const auto& box : boxes)
      ranges.push_back(rangeInBox(scalars, volume.geometry(), box));
  });
  return ranges;
}

}  // namespace soft_volume::core
