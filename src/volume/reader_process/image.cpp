#include "image.h"

#include <Eigen/SVD>

namespace soft_volume::core::reader {
namespace {

/// Files round their axes: this much is repaired, more is a shear that a regular grid cannot hold.
constexpr double kLargestSkew = 1e-3;
/// Below this the axes are used as they are, bit for bit.
constexpr double kNoSkew = 1e-9;

double skewOf(const Matrix3& axes) {
  return (axes.transpose() * axes - Matrix3::Identity()).cwiseAbs().maxCoeff();
}

Matrix3 nearestRotation(const Matrix3& axes) {
  const Eigen::JacobiSVD<Matrix3> svd(axes, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

Matrix3 orthonormal(const Matrix3& axes) {
  const double skew = skewOf(axes);
  if (!(skew < kLargestSkew)) {
    throw ReadError(
        "the axes of the grid are not perpendicular (a tilted gantry or a shear?); resample the volume to a "
        "rectangular grid first");
  }
  return skew < kNoSkew ? axes : nearestRotation(axes);
}

}  // namespace

VolumeGeometry geometryOf(const Vector3i& dims, const Placement& placement) {
  const Matrix3 to_ras =
      placement.axes == PatientAxes::kLps ? Matrix3(Vector3(-1, -1, 1).asDiagonal()) : Matrix3(Matrix3::Identity());
  VolumeGeometry geometry;
  geometry.dims = dims;
  const Vector3 lengths = placement.steps.colwise().norm();
  if (!(lengths.minCoeff() > 0.0) || !isFinite(lengths) || !isFinite(placement.origin)) {
    throw ReadError("the spacing or origin of the voxels is zero or not a number");
  }
  geometry.spacing_m = lengths / placement.units_per_metre;
  geometry.origin_m = to_ras * placement.origin / placement.units_per_metre;
  geometry.direction = to_ras * orthonormal(placement.steps * lengths.cwiseInverse().asDiagonal());
  return geometry;
}

std::uint64_t requiredBytes(const Vector3i& dims, std::size_t bytes_per_scalar, std::uint64_t limit) {
  if (dims.minCoeff() < 1) {
    throw ReadError("the header claims " + std::to_string(dims.minCoeff()) + " voxels along an axis");
  }
  const double bytes = double(dims.x()) * double(dims.y()) * double(dims.z()) * double(bytes_per_scalar);
  if (bytes > double(limit)) {
    throw ReadError("the header claims " + std::to_string(dims.x()) + " x " + std::to_string(dims.y()) + " x " +
                    std::to_string(dims.z()) + " voxels, more than the memory limit of " + std::to_string(limit >> 20) +
                    " MiB allows");
  }
  return std::uint64_t(dims.x()) * std::uint64_t(dims.y()) * std::uint64_t(dims.z()) * bytes_per_scalar;
}

}  // namespace soft_volume::core::reader
