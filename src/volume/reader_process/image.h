#pragma once

#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>

#include "soft_volume/volume/volume.h"

namespace soft_volume::core::reader {

/// Why a file is refused, without its path (the parent adds it).
class ReadError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// What a reader found: scalars (x fastest) and where they lie. `owner` keeps the bytes alive.
struct Image {
  VolumeGeometry geometry;  ///< RAS, metres
  ScalarType type = ScalarType::kInt16;
  std::uint64_t byte_count = 0;
  const std::uint8_t* bytes = nullptr;
  std::shared_ptr<const void> owner;
};

/// Units of a file in a metre. A division by this, not a product with its inverse, gives the closest number: 71 mm
/// become 0.071 m and are written as 71 mm again.
constexpr double kMillimetresPerMetre = 1e3;
enum class PatientAxes { kRas, kLps };

/// Placement as most formats state it: the columns of `steps` go from one voxel to the next, in the file's units.
struct Placement {
  Matrix3 steps = Matrix3::Identity();
  Vector3 origin = Vector3::Zero();
  double units_per_metre = kMillimetresPerMetre;
  PatientAxes axes = PatientAxes::kLps;
};

/// Throws ReadError when the steps are not three perpendicular axes.
VolumeGeometry geometryOf(const Vector3i& dims, const Placement& placement);

/// Bytes that a volume needs. Throws ReadError when the size is not positive or more than `limit`, before anything is
/// allocated.
std::uint64_t requiredBytes(const Vector3i& dims, std::size_t bytes_per_scalar, std::uint64_t limit);

}  // namespace soft_volume::core::reader
