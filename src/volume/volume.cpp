#include "soft_volume/volume/volume.h"

#include <cassert>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"

namespace soft_volume::core {
namespace {

/// Largest deviation of directionᵀ·direction from the identity: orientations that went through floats pass.
constexpr double kOrthonormalTolerance = 1e-6;

template <typename T>
T load(const std::uint8_t* data, std::size_t index) {
  T value;
  std::memcpy(&value, data + index * sizeof(T), sizeof(T));
  return value;
}

/// Calls `body` with a value of the C++ type that `type` names: the one place where the type is looked at.
template <typename Body>
auto dispatch(ScalarType type, const Body& body) {
  switch (type) {
    case ScalarType::kInt8:
      return body(std::int8_t());
    case ScalarType::kUInt8:
      return body(std::uint8_t());
    case ScalarType::kInt16:
      return body(std::int16_t());
    case ScalarType::kUInt16:
      return body(std::uint16_t());
    case ScalarType::kInt32:
      return body(std::int32_t());
    case ScalarType::kUInt32:
      return body(std::uint32_t());
    case ScalarType::kFloat32:
      return body(float());
    case ScalarType::kFloat64:
      return body(double());
  }
  throw InputError("unknown scalar type " + std::to_string(int(type)) + "; use 0 (int8) to 7 (float64)");
}

std::string text(const Vector3i& v) {
  return std::to_string(v.x()) + " x " + std::to_string(v.y()) + " x " + std::to_string(v.z());
}

void checkDims(const Vector3i& dims, std::size_t bytes_per_scalar) {
  if (dims.minCoeff() < 1) {
    throw InputError("a volume needs at least one voxel along every axis, got " + text(dims));
  }
  const double bytes = double(dims.x()) * double(dims.y()) * double(dims.z()) * double(bytes_per_scalar);
  if (bytes > double(std::numeric_limits<std::int64_t>::max())) {
    throw InputError("a volume of " + text(dims) + " voxels cannot be held in memory");
  }
}

void checkPlacement(const VolumeGeometry& geometry) {
  if (!isFinite(geometry.spacing_m) || !(geometry.spacing_m.minCoeff() > 0.0)) {
    throw InputError("the spacing of a volume must be positive and finite along every axis, metres");
  }
  if (!isFinite(geometry.origin_m)) {
    throw InputError("the origin of a volume must be finite, metres");
  }
  const Matrix3 error = geometry.direction.transpose() * geometry.direction - Matrix3::Identity();
  if (!(error.cwiseAbs().maxCoeff() < kOrthonormalTolerance)) {  // also true for NaN
    throw InputError("the direction of a volume must have orthonormal columns");
  }
}

void checkRegion(const Vector3i& begin, const Vector3i& end, const Vector3i& stride, const Vector3i& dims) {
  if (stride.minCoeff() < 1) {
    throw InputError("the stride of a region must be at least 1 along every axis, got " + text(stride));
  }
  if (begin.minCoeff() < 0 || (dims - end).minCoeff() < 0 || (end - begin).minCoeff() < 1) {
    throw InputError("the region from " + text(begin) + " up to " + text(end) + " is empty or outside the volume of " +
                     text(dims) + " voxels");
  }
}

/// Clamped so that any input, NaN included, gives a valid index.
int clampIndex(int i, int count) {
  return i < 0 ? 0 : (i < count ? i : count - 1);
}

/// One axis of an interpolation: the two voxels and the weight of the upper one.
struct Span {
  int lower;
  int upper;
  double weight;
};

Span spanAt(double voxel, int count) {
  const double last = count - 1;
  const double x = voxel > 0.0 ? (voxel < last ? voxel : last) : 0.0;
  const int lower = static_cast<int>(x);
  return {lower, clampIndex(lower + 1, count), x - lower};
}

double mix(double a, double b, double weight) {
  return a + weight * (b - a);
}

template <typename T>
double interpolate(const VolumeGeometry& geometry, const std::uint8_t* data, const Vector3& voxel) {
  const Span x = spanAt(voxel.x(), geometry.dims.x());
  const Span y = spanAt(voxel.y(), geometry.dims.y());
  const Span z = spanAt(voxel.z(), geometry.dims.z());
  const auto row = [&](int j, int k) {
    const std::size_t start = geometry.index(0, j, k);
    return mix(double(load<T>(data, start + std::size_t(x.lower))), double(load<T>(data, start + std::size_t(x.upper))),
               x.weight);
  };
  const double front = mix(row(y.lower, z.lower), row(y.upper, z.lower), y.weight);
  const double back = mix(row(y.lower, z.upper), row(y.upper, z.upper), y.weight);
  return mix(front, back, z.weight);
}

template <typename T>
Vector3 centralDifferences(const VolumeGeometry& geometry, const std::uint8_t* data, const Vector3& voxel) {
  Vector3 gradient;
  for (int axis = 0; axis < 3; ++axis) {
    const Vector3 half = 0.5 * Vector3::Unit(axis);
    const double difference =
        interpolate<T>(geometry, data, voxel + half) - interpolate<T>(geometry, data, voxel - half);
    gradient[axis] = difference / geometry.spacing_m[axis];
  }
  return gradient;
}

template <typename T>
std::array<double, 2> finiteRange(const std::uint8_t* data, std::size_t count) {
  T smallest = std::numeric_limits<T>::max();
  T largest = std::numeric_limits<T>::lowest();
  for (std::size_t i = 0; i < count; ++i) {
    const T value = load<T>(data, i);
    if (std::is_floating_point_v<T> && !std::isfinite(double(value))) {
      continue;
    }
    smallest = value < smallest ? value : smallest;
    largest = value > largest ? value : largest;
  }
  return smallest <= largest ? std::array<double, 2>{double(smallest), double(largest)} : std::array<double, 2>{0, 0};
}

/// Writes every stride-th scalar of one row.
template <typename T>
void copyRow(const std::uint8_t* row, int count, int stride, std::uint8_t* out) {
  for (int i = 0; i < count; ++i) {
    const T value = load<T>(row, std::size_t(i) * std::size_t(stride));
    std::memcpy(out + std::size_t(i) * sizeof(T), &value, sizeof(T));
  }
}

VolumeGeometry regionGeometry(const VolumeGeometry& geometry, const Vector3i& begin, const Vector3i& end,
                              const Vector3i& stride) {
  VolumeGeometry result = geometry;
  result.dims = (end - begin + stride - Vector3i::Ones()).cwiseQuotient(stride);
  result.spacing_m = geometry.spacing_m.cwiseProduct(stride.cast<double>());
  result.origin_m += geometry.direction * geometry.spacing_m.cwiseProduct(begin.cast<double>());
  return result;
}

/// 0.0 and -0.0 are the same place, so they must not give two identities.
double withoutSign(double x) {
  return x == 0.0 ? 0.0 : x;
}

}  // namespace

std::size_t scalarSize(ScalarType type) {
  return dispatch(type, [](auto zero) { return sizeof(zero); });
}

std::string scalarName(ScalarType type) {
  return dispatch(type, [](auto zero) {
    using T = decltype(zero);
    const std::string kind = std::is_floating_point_v<T> ? "float" : (std::is_signed_v<T> ? "int" : "uint");
    return kind + std::to_string(8 * sizeof(T));
  });
}

Volume::Volume(const VolumeGeometry& geometry, ScalarType type, std::vector<std::uint8_t> data)
    : geometry_(geometry), type_(type), data_(std::move(data)) {
  const std::size_t bytes_per_scalar = scalarSize(type);
  checkDims(geometry.dims, bytes_per_scalar);
  checkPlacement(geometry);
  if (data_.size() != geometry.voxelCount() * bytes_per_scalar) {
    throw InputError("a volume of " + text(geometry.dims) + " " + scalarName(type) + " voxels needs " +
                     std::to_string(geometry.voxelCount() * bytes_per_scalar) + " bytes, got " +
                     std::to_string(data_.size()));
  }
}

double Volume::at(int i, int j, int k) const {
  assert(!empty());
  const Vector3i& dims = geometry_.dims;
  const std::size_t index = geometry_.index(clampIndex(i, dims.x()), clampIndex(j, dims.y()), clampIndex(k, dims.z()));
  return dispatch(type_, [&](auto zero) { return double(load<decltype(zero)>(data_.data(), index)); });
}

double Volume::sample(const Vector3& p_volume_m) const {
  assert(!empty());
  const Vector3 voxel = geometry_.toVoxel(p_volume_m);
  return dispatch(type_, [&](auto zero) { return interpolate<decltype(zero)>(geometry_, data_.data(), voxel); });
}

Vector3 Volume::gradient(const Vector3& p_volume_m) const {
  assert(!empty());
  const Vector3 voxel = geometry_.toVoxel(p_volume_m);
  return dispatch(type_, [&](auto zero) { return centralDifferences<decltype(zero)>(geometry_, data_.data(), voxel); });
}

std::array<double, 2> Volume::range() const {
  const std::size_t count = empty() ? 0 : geometry_.voxelCount();
  return dispatch(type_, [&](auto zero) { return finiteRange<decltype(zero)>(data_.data(), count); });
}

std::uint64_t Volume::hash() const {
  std::array<double, 19> description;
  std::size_t next = 0;
  const auto add = [&](double x) { description[next++] = withoutSign(x); };
  for (int axis = 0; axis < 3; ++axis) {
    add(geometry_.dims[axis]);
    add(geometry_.spacing_m[axis]);
    add(geometry_.origin_m[axis]);
    for (int row = 0; row < 3; ++row) {
      add(geometry_.direction(row, axis));
    }
  }
  add(double(type_));
  assert(next == description.size());
  return hashBytes(data_.data(), data_.size(), hashBytes(description.data(), sizeof(double) * description.size()));
}

Volume Volume::region(const Vector3i& begin, const Vector3i& end, const Vector3i& stride) const {
  checkRegion(begin, end, stride, geometry_.dims);
  const VolumeGeometry part = regionGeometry(geometry_, begin, end, stride);
  const std::size_t bytes_per_scalar = scalarSize(type_);
  std::vector<std::uint8_t> data(part.voxelCount() * bytes_per_scalar);
  dispatch(type_, [&](auto zero) {
    for (int k = 0; k < part.dims.z(); ++k) {
      for (int j = 0; j < part.dims.y(); ++j) {
        const std::size_t from =
            geometry_.index(begin.x(), begin.y() + j * stride.y(), begin.z() + k * stride.z()) * bytes_per_scalar;
        copyRow<decltype(zero)>(data_.data() + from, part.dims.x(), stride.x(),
                                data.data() + part.index(0, j, k) * bytes_per_scalar);
      }
    }
  });
  return Volume(part, type_, std::move(data));
}

}  // namespace soft_volume::core
