#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// How one scalar is stored. Values are those of the `Volume` message.
enum class ScalarType : std::uint8_t {
  kInt8 = 0,
  kUInt8 = 1,
  kInt16 = 2,
  kUInt16 = 3,
  kInt32 = 4,
  kUInt32 = 5,
  kFloat32 = 6,
  kFloat64 = 7,
};

/// Bytes of one scalar. Throws InputError on a value outside the enumeration.
std::size_t scalarSize(ScalarType type);
/// "int16", "float32", ...
std::string scalarName(ScalarType type);

/// Where a volume's grid lies.
///
/// The *volume frame* is aligned with the voxel grid: its origin is the centre of voxel (0, 0, 0), x runs along i, y
/// along j, z along k, in metres. Everything in this package (lattice, tools, cameras) lives in this frame, called
/// "volume" in messages. `direction` and `origin_m` keep the orientation that the file gave:
/// p_patient = origin_m + direction * p_volume, with the patient frame in RAS (right, anterior, superior) metres.
struct VolumeGeometry {
  Vector3i dims = Vector3i::Zero();         ///< voxels along i, j, k
  Vector3 spacing_m = Vector3::Ones();      ///< distance of voxel centres along i, j, k
  Vector3 origin_m = Vector3::Zero();       ///< patient-frame position of voxel (0, 0, 0)
  Matrix3 direction = Matrix3::Identity();  ///< orthonormal columns; the determinant is -1 where the file mirrors

  std::size_t voxelCount() const { return std::size_t(dims.x()) * std::size_t(dims.y()) * std::size_t(dims.z()); }
  /// Linear index i + nx*(j + ny*k).
  std::size_t index(int i, int j, int k) const {
    return std::size_t(i) + std::size_t(dims.x()) * (std::size_t(j) + std::size_t(dims.y()) * std::size_t(k));
  }
  /// Continuous voxel index of a point in the volume frame.
  Vector3 toVoxel(const Vector3& p_volume_m) const { return p_volume_m.cwiseQuotient(spacing_m); }
  /// Texture coordinates in [0, 1]^3 of a point in the volume frame: voxel centres are at (i + 0.5) / nx.
  Vector3 toTexture(const Vector3& p_volume_m) const {
    return (toVoxel(p_volume_m) + Vector3::Constant(0.5)).cwiseQuotient(dims.cast<double>());
  }
  Vector3 fromTexture(const Vector3& texture) const {
    return (texture.cwiseProduct(dims.cast<double>()) - Vector3::Constant(0.5)).cwiseProduct(spacing_m);
  }
  /// The box that the voxels fill: half a voxel beyond the outer centres.
  Box3 bounds() const {
    const Vector3 half = 0.5 * spacing_m;
    return {Vector3(-half), Vector3((dims.cast<double>() - Vector3::Constant(0.5)).cwiseProduct(spacing_m))};
  }
};

/// A regular grid of scalars, kept in the type of the file. Immutable after construction, so it can be shared between
/// threads. Sampling outside the grid clamps to the border.
class Volume {
 public:
  Volume() = default;
  /// Takes `data` (dims.x*dims.y*dims.z scalars of `type`, native byte order, x fastest). Throws InputError when the
  /// geometry is not usable (dims < 1, spacing not positive and finite, direction not orthonormal) or the size of
  /// `data` does not match.
  Volume(const VolumeGeometry& geometry, ScalarType type, std::vector<std::uint8_t> data);

  const VolumeGeometry& geometry() const { return geometry_; }
  ScalarType type() const { return type_; }
  const std::vector<std::uint8_t>& data() const { return data_; }
  bool empty() const { return data_.empty(); }

  /// Value of a voxel; indices are clamped. NaN scalars are returned as they are.
  double at(int i, int j, int k) const;
  /// Trilinear interpolation at a point in the volume frame, metres.
  double sample(const Vector3& p_volume_m) const;
  /// Gradient of the trilinear interpolant by central differences over one voxel, per metre.
  Vector3 gradient(const Vector3& p_volume_m) const;
  /// Smallest and largest finite value; {0, 0} when there is none.
  std::array<double, 2> range() const;
  /// Identity of geometry, type and scalars.
  std::uint64_t hash() const;

  /// The part of the volume in [begin, end) (voxel indices), every stride-th voxel. Origin and spacing follow, so that
  /// patient coordinates stay right. Throws InputError when the region is empty or outside the volume.
  Volume region(const Vector3i& begin, const Vector3i& end, const Vector3i& stride) const;

 private:
  VolumeGeometry geometry_;
  ScalarType type_ = ScalarType::kInt16;
  std::vector<std::uint8_t> data_;
};

}  // namespace soft_volume::core
