#include "volume/sample_files.h"

#include <gtest/gtest.h>
#include <unistd.h>
#include <zlib.h>

#include <atomic>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>
#include <stdexcept>

namespace soft_volume::core::testing_volume {
namespace {

template <typename T>
void append(std::string& bytes, T value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

template <typename T>
void put(std::string& bytes, std::size_t at, T value) {
  std::memcpy(&bytes.at(at), &value, sizeof value);
}

std::string text(const Vector3& v, const char* separator = " ") {
  std::ostringstream stream;
  stream.precision(std::numeric_limits<double>::max_digits10);
  stream << v.x() << separator << v.y() << separator << v.z();
  return stream.str();
}

std::string dimsText(const Vector3i& dims) {
  return std::to_string(dims.x()) + " " + std::to_string(dims.y()) + " " + std::to_string(dims.z());
}

void expectVoxel(const Volume& volume, const SampleGrid& grid, const Vector3i& voxel) {
  const VolumeGeometry& geometry = volume.geometry();
  const Vector3 in_volume = geometry.spacing_m.cwiseProduct(voxel.cast<double>());
  const Vector3 p_patient_mm = 1000.0 * (geometry.origin_m + geometry.direction * in_volume);
  const Vector3 in_file = grid.stepsRas().inverse() * (p_patient_mm - grid.origin_ras_mm);
  const Vector3i index = in_file.array().round().cast<int>();
  EXPECT_LT((in_file - index.cast<double>()).norm(), 1e-4) << "voxel " << voxel.transpose() << " is off the grid";
  EXPECT_EQ(volume.at(voxel.x(), voxel.y(), voxel.z()), SampleGrid::value(index.x(), index.y(), index.z()));
}

/// Rotation matrix to the quaternion of a NIfTI header (its first component is not stored, so it must be positive).
Quaternion niftiQuaternion(const Matrix3& rotation) {
  const Quaternion q(rotation);
  return q.w() < 0.0 ? Quaternion(-q.coeffs()) : q;
}

void putQform(std::string& header, const SampleGrid& grid) {
  Matrix3 rotation = grid.direction_ras;
  const bool is_mirrored = rotation.determinant() < 0.0;
  if (is_mirrored) {
    rotation.col(2) *= -1.0;
  }
  const Quaternion q = niftiQuaternion(rotation);
  put(header, 76, is_mirrored ? -1.0F : 1.0F);
  put(header, 252, std::int16_t(1));
  const float numbers[] = {float(q.x()),
                           float(q.y()),
                           float(q.z()),
                           float(grid.origin_ras_mm.x()),
                           float(grid.origin_ras_mm.y()),
                           float(grid.origin_ras_mm.z())};
  std::memcpy(&header.at(256), numbers, sizeof numbers);
}

void putSform(std::string& header, const SampleGrid& grid) {
  put(header, 76, 1.0F);
  put(header, 254, std::int16_t(1));
  const Matrix3 steps = grid.stepsRas();
  for (int row = 0; row < 3; ++row) {
    const float numbers[] = {float(steps(row, 0)), float(steps(row, 1)), float(steps(row, 2)),
                             float(grid.origin_ras_mm[row])};
    std::memcpy(&header.at(280 + 16 * std::size_t(row)), numbers, sizeof numbers);
  }
}

void putElement(std::string& bytes, std::uint16_t group, std::uint16_t element, const char* type,
                const std::string& value) {
  append(bytes, group);
  append(bytes, element);
  bytes += type;
  const std::string kind = type;
  const char padding = kind == "UI" || kind == "OW" ? '\0' : ' ';
  const std::string even = value.size() % 2 == 0 ? value : value + padding;
  if (kind == "OW") {
    append(bytes, std::uint16_t(0));
    append(bytes, std::uint32_t(even.size()));
  } else {
    append(bytes, std::uint16_t(even.size()));
  }
  bytes += even;
}

std::string shortText(std::uint16_t value) {
  return {reinterpret_cast<const char*>(&value), sizeof value};
}

}  // namespace

TemporaryFolder::TemporaryFolder() {
  static std::atomic<int> count{0};
  path_ = ::testing::TempDir() + "soft volume " + std::to_string(getpid()) + " " + std::to_string(count++);
  std::filesystem::create_directories(path_);
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

std::string TemporaryFolder::write(const std::string& name, const std::string& bytes) const {
  std::ofstream stream(file(name), std::ios::binary);
  stream << bytes;
  if (!stream.flush()) {
    throw std::runtime_error("cannot write " + file(name));
  }
  return file(name);
}

std::string SampleGrid::bytes() const {
  std::string result;
  for (int k = 0; k < dims.z(); ++k) {
    for (int j = 0; j < dims.y(); ++j) {
      for (int i = 0; i < dims.x(); ++i) {
        append(result, std::int16_t(value(i, j, k)));
      }
    }
  }
  return result;
}

Matrix3 turnedAxes() {
  return (Eigen::AngleAxisd(0.3, Vector3(1, 2, -1).normalized()) * Eigen::AngleAxisd(M_PI / 2, Vector3::UnitZ()))
      .toRotationMatrix();
}

Matrix3 mirroredAxes() {
  Matrix3 axes = turnedAxes();
  axes.col(0) *= -1.0;
  return axes;
}

void expectSamePlaces(const Volume& volume, const SampleGrid& grid) {
  ASSERT_EQ(volume.geometry().dims, grid.dims);
  EXPECT_LT((1000.0 * volume.geometry().spacing_m - grid.spacing_mm).norm(), 1e-5);
  EXPECT_GT(volume.geometry().direction.determinant(), 0.0);
  for (int k = 0; k < grid.dims.z(); ++k) {
    for (int j = 0; j < grid.dims.y(); ++j) {
      for (int i = 0; i < grid.dims.x(); ++i) {
        expectVoxel(volume, grid, {i, j, k});
      }
    }
  }
}

std::string metaImageFile(const SampleGrid& grid, const std::string& extra_lines) {
  const Matrix3& d = grid.direction_ras;
  return "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\n" + extra_lines +
         "TransformMatrix = " + text(grid.lps(d.col(0))) + " " + text(grid.lps(d.col(1))) + " " +
         text(grid.lps(d.col(2))) + "\nOffset = " + text(grid.lps(grid.origin_ras_mm)) +
         "\nElementSpacing = " + text(grid.spacing_mm) + "\nDimSize = " + dimsText(grid.dims) +
         "\nElementType = MET_SHORT\nElementDataFile = LOCAL\n" + grid.bytes();
}

std::string nrrdFile(const SampleGrid& grid, const std::string& space, const std::string& encoding) {
  const bool is_ras = space == "right-anterior-superior";
  const auto vector = [&](const Vector3& ras) { return "(" + text(is_ras ? ras : grid.lps(ras), ",") + ")"; };
  const Matrix3 steps = grid.stepsRas();
  std::string file = "NRRD0004\n# a comment\ntype: short\ndimension: 3\nspace: " + space +
                     "\nsizes: " + dimsText(grid.dims) + "\nspace directions: " + vector(steps.col(0)) + " " +
                     vector(steps.col(1)) + " " + vector(steps.col(2)) +
                     "\nkinds: domain domain domain\nendian: little\nencoding: " + encoding +
                     "\nspace origin: " + vector(grid.origin_ras_mm) + "\nmodality:=CT\n\n";
  if (encoding == "gzip") {
    return file + gzipped(grid.bytes());
  }
  return file + grid.bytes();
}

std::string vtiFile(const SampleGrid& grid) {
  const Matrix3& d = grid.direction_ras;
  // The extent begins at 2, so the stated origin lies two voxels before the first one.
  const Vector3 origin = grid.origin_ras_mm - grid.stepsRas() * Vector3(2, 2, 2);
  const auto range = [](int count) { return "2 " + std::to_string(count + 1); };
  const std::string extent = range(grid.dims.x()) + " " + range(grid.dims.y()) + " " + range(grid.dims.z());
  std::string file =
      "<?xml version=\"1.0\"?>\n<VTKFile type=\"ImageData\" version=\"0.1\" byte_order=\"LittleEndian\">\n";
  file += "<ImageData WholeExtent=\"" + extent + "\" Origin=\"" + text(origin) + "\" Spacing=\"" +
          text(grid.spacing_mm) + "\" Direction=\"" + text(d.row(0)) + " " + text(d.row(1)) + " " + text(d.row(2)) +
          "\">\n<Piece Extent=\"" + extent + "\">\n<PointData Scalars=\"intensity\">\n" +
          "<DataArray type=\"Int16\" Name=\"intensity\" format=\"ascii\">\n";
  for (int k = 0; k < grid.dims.z(); ++k) {
    for (int j = 0; j < grid.dims.y(); ++j) {
      for (int i = 0; i < grid.dims.x(); ++i) {
        file += std::to_string(SampleGrid::value(i, j, k)) + " ";
      }
    }
  }
  return file + "\n</DataArray>\n</PointData>\n</Piece>\n</ImageData>\n</VTKFile>\n";
}

std::string niftiFile(const SampleGrid& grid, const NiftiOptions& options) {
  std::string header(352, '\0');
  put(header, 0, std::int32_t(348));
  std::vector<std::int16_t> dims = options.dims;
  if (dims.empty()) {
    dims = {3, std::int16_t(grid.dims.x()), std::int16_t(grid.dims.y()), std::int16_t(grid.dims.z()), 1, 1, 1, 1};
  }
  std::memcpy(&header.at(40), dims.data(), 16);
  put(header, 70, options.datatype);
  put(header, 72, options.bits);
  const float spacing[] = {float(grid.spacing_mm.x()), float(grid.spacing_mm.y()), float(grid.spacing_mm.z())};
  std::memcpy(&header.at(80), spacing, sizeof spacing);
  put(header, 108, 352.0F);
  put(header, 112, options.slope);
  put(header, 116, options.intercept);
  put(header, 123, std::int8_t(options.xyzt_units));
  if (options.use_sform) {
    putSform(header, grid);
  } else {
    putQform(header, grid);
  }
  std::memcpy(&header.at(344), "n+1", 4);
  return header + grid.bytes();
}

std::string dicomFile(const SampleGrid& grid, int k, const DicomOptions& options) {
  const Matrix3& d = grid.direction_ras;
  const Vector3 position = grid.lps(grid.origin_ras_mm + grid.stepsRas() * Vector3(0, 0, k));
  std::string syntax;
  putElement(syntax, 0x0002, 0x0010, "UI", options.transfer_syntax);
  const auto syntax_size = std::uint32_t(syntax.size());
  std::string file = std::string(128, '\0') + "DICM";
  putElement(file, 0x0002, 0x0000, "UL", {reinterpret_cast<const char*>(&syntax_size), sizeof syntax_size});
  file += syntax;
  putElement(file, 0x0020, 0x000E, "UI", options.series);
  putElement(file, 0x0020, 0x0013, "IS", "7");  // every slice says 7: the order must come from the position
  putElement(file, 0x0020, 0x0032, "DS", text(position, "\\"));
  putElement(file, 0x0020, 0x0037, "DS", text(grid.lps(d.col(0)), "\\") + "\\" + text(grid.lps(d.col(1)), "\\"));
  putElement(file, 0x0028, 0x0002, "US", shortText(1));
  putElement(file, 0x0028, 0x0004, "CS", "MONOCHROME2");
  putElement(file, 0x0028, 0x0010, "US", shortText(std::uint16_t(grid.dims.y())));
  putElement(file, 0x0028, 0x0011, "US", shortText(std::uint16_t(grid.dims.x())));
  // Distance of rows first, of columns second.
  putElement(file, 0x0028, 0x0030, "DS",
             std::to_string(grid.spacing_mm.y()) + "\\" + std::to_string(grid.spacing_mm.x()));
  putElement(file, 0x0028, 0x0100, "US", shortText(16));
  putElement(file, 0x0028, 0x0101, "US", shortText(16));
  putElement(file, 0x0028, 0x0102, "US", shortText(15));
  putElement(file, 0x0028, 0x0103, "US", shortText(1));
  putElement(file, 0x0028, 0x1052, "DS", options.intercept);
  putElement(file, 0x0028, 0x1053, "DS", options.slope);
  if (options.has_pixels) {
    const std::size_t slice_bytes = 2 * std::size_t(grid.dims.x()) * std::size_t(grid.dims.y());
    putElement(file, 0x7FE0, 0x0010, "OW", grid.bytes().substr(std::size_t(k) * slice_bytes, slice_bytes));
  }
  return file;
}

void writeDicomSeries(const TemporaryFolder& folder, const SampleGrid& grid, const DicomOptions& options) {
  for (int k = 0; k < grid.dims.z(); ++k) {
    folder.write("image" + std::to_string((k * 2 + 1) % 5) + ".dcm", dicomFile(grid, k, options));
  }
}

std::string gzipped(const std::string& bytes) {
  z_stream stream = {};
  deflateInit2(&stream, 6, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY);  // 16: with a gzip header
  std::string result(deflateBound(&stream, bytes.size()) + 32, '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(result.data());
  stream.avail_out = static_cast<uInt>(result.size());
  if (deflate(&stream, Z_FINISH) != Z_STREAM_END) {
    throw std::runtime_error("cannot compress");
  }
  result.resize(stream.total_out);
  deflateEnd(&stream);
  return result;
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  if (at == std::string::npos) {
    throw std::runtime_error("nothing to replace: " + from);
  }
  return text.replace(at, from.size(), to);
}

}  // namespace soft_volume::core::testing_volume
