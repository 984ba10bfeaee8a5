#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core::testing_volume {

/// A new folder (with a space in its name), removed with all its files at the end.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  const std::string& path() const { return path_; }
  std::string file(const std::string& name) const { return path_ + "/" + name; }
  /// Writes a file and returns its path.
  std::string write(const std::string& name, const std::string& bytes) const;

 private:
  std::string path_;
};

/// The grid of all sample files: 5 x 4 x 3 int16, value = i + 10 j + 100 k - 50, non-trivially placed. RAS,
/// millimetres.
struct SampleGrid {
  Vector3i dims{5, 4, 3};
  Vector3 spacing_mm{0.5, 0.75, 1.25};
  Vector3 origin_ras_mm{-10.0, 20.0, 30.0};
  Matrix3 direction_ras = Matrix3::Identity();

  static int value(int i, int j, int k) { return i + 10 * j + 100 * k - 50; }
  Vector3 lps(const Vector3& ras) const { return {-ras.x(), -ras.y(), ras.z()}; }
  Matrix3 stepsRas() const { return direction_ras * spacing_mm.asDiagonal(); }
  /// Scalars as little-endian int16, x fastest.
  std::string bytes() const;
};

/// Quarter turns and a small angle, so that no axis is where it would be by default.
Matrix3 turnedAxes();
/// The same with a left hand.
Matrix3 mirroredAxes();

/// Checks that each voxel of the volume carries the value that the grid has at that place of the patient, whatever the
/// order in which the reader delivers the voxels, and that the axes form a right hand.
void expectSamePlaces(const Volume& volume, const SampleGrid& grid);

std::string metaImageFile(const SampleGrid& grid, const std::string& extra_lines = "");
std::string nrrdFile(const SampleGrid& grid, const std::string& space, const std::string& encoding);
std::string vtiFile(const SampleGrid& grid);

struct NiftiOptions {
  bool use_sform = true;  ///< else the qform, which needs a right-handed or k-mirrored direction
  int xyzt_units = 2;
  float slope = 1.0F;
  float intercept = 0.0F;
  std::vector<std::int16_t> dims;  ///< dim[0..7] instead of the grid's own
  std::int16_t datatype = 4;
  std::int16_t bits = 16;
};
std::string niftiFile(const SampleGrid& grid, const NiftiOptions& options = {});

struct DicomOptions {
  std::string series = "1.2.3.4";
  std::string transfer_syntax = "1.2.840.10008.1.2.1";
  std::string slope = "1";
  std::string intercept = "0";
  bool has_pixels = true;
};
/// Slice k of the grid.
std::string dicomFile(const SampleGrid& grid, int k, const DicomOptions& options = {});
/// Writes all slices, with names whose order is not that of the slices.
void writeDicomSeries(const TemporaryFolder& folder, const SampleGrid& grid, const DicomOptions& options = {});

std::string gzipped(const std::string& bytes);
std::string replaced(std::string text, const std::string& from, const std::string& to);

}  // namespace soft_volume::core::testing_volume
