#include <charconv>
#include <fstream>
#include <string>

#include "soft_volume/common/error.h"
#include "soft_volume/volume/volume_reader.h"

namespace soft_volume::core {
namespace {

bool endsWith(const std::string& text, const std::string& end) {
  return text.size() >= end.size() && text.compare(text.size() - end.size(), end.size(), end) == 0;
}

const char* elementType(ScalarType type) {
  static const char* const kNames[] = {"MET_CHAR", "MET_UCHAR", "MET_SHORT", "MET_USHORT",
                                       "MET_INT",  "MET_UINT",  "MET_FLOAT", "MET_DOUBLE"};
  return kNames[static_cast<int>(type)];
}

/// Shortest text that reads back as the same number, whatever the locale.
std::string number(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value == 0.0 ? 0.0 : value).ptr};
}

std::string numbers(const Vector3& v) {
  return number(v.x()) + " " + number(v.y()) + " " + number(v.z());
}

/// MetaImage speaks millimetres in LPS (left, posterior, superior); the patient frame here is metres in RAS.
Vector3 lpsFromRas(const Vector3& v) {
  return {-v.x(), -v.y(), v.z()};
}

bool isBigEndian() {
  const std::uint16_t one = 1;
  return *reinterpret_cast<const std::uint8_t*>(&one) == 0;
}

std::string metaImageHeader(const VolumeGeometry& geometry, ScalarType type, const std::string& data_file) {
  const Vector3i& dims = geometry.dims;
  const Matrix3& direction = geometry.direction;
  std::string header = "ObjectType = Image\nNDims = 3\nBinaryData = True\n";
  header += std::string("BinaryDataByteOrderMSB = ") + (isBigEndian() ? "True\n" : "False\n");
  header += "CompressedData = False\n";
  // Three numbers per axis of the grid: where i, j and k point.
  header += "TransformMatrix = " + numbers(lpsFromRas(direction.col(0))) + " " + numbers(lpsFromRas(direction.col(1))) +
            " " + numbers(lpsFromRas(direction.col(2))) + "\n";
  header += "Offset = " + numbers(lpsFromRas(1000.0 * geometry.origin_m)) + "\n";
  header += "CenterOfRotation = 0 0 0\nAnatomicalOrientation = RAI\n";
  header += "ElementSpacing = " + numbers(1000.0 * geometry.spacing_m) + "\n";
  header +=
      "DimSize = " + std::to_string(dims.x()) + " " + std::to_string(dims.y()) + " " + std::to_string(dims.z()) + "\n";
  header += std::string("ElementType = ") + elementType(type) + "\nElementDataFile = " + data_file + "\n";
  return header;
}

void writeBytes(std::ofstream& file, const std::vector<std::uint8_t>& data) {
  file.write(reinterpret_cast<const char*>(data.data()), static_cast<std::streamsize>(data.size()));
}

void finish(std::ofstream& file, const std::string& path) {
  file.close();
  if (!file) {
    throw FileError(path + ": cannot be written; check that the folder exists, is writable and has space left");
  }
}

void writeOneFile(const Volume& volume, const std::string& path) {
  std::ofstream file(path, std::ios::binary);
  file << metaImageHeader(volume.geometry(), volume.type(), "LOCAL");
  writeBytes(file, volume.data());
  finish(file, path);
}

/// The data first, so that a header never points at a file that is not there yet.
void writeTwoFiles(const Volume& volume, const std::string& path) {
  const std::string raw_path = path.substr(0, path.size() - 4) + ".raw";
  std::ofstream raw(raw_path, std::ios::binary);
  writeBytes(raw, volume.data());
  finish(raw, raw_path);
  std::ofstream header(path, std::ios::binary);
  header << metaImageHeader(volume.geometry(), volume.type(), raw_path.substr(raw_path.find_last_of('/') + 1));
  finish(header, path);
}

}  // namespace

void writeMetaImage(const Volume& volume, const std::string& path) {
  if (volume.empty()) {
    throw FileError(path + ": an empty volume cannot be written");
  }
  if (endsWith(path, ".mha")) {
    writeOneFile(volume, path);
  } else if (endsWith(path, ".mhd")) {
    writeTwoFiles(volume, path);
  } else {
    throw FileError(path + ": a MetaImage ends in .mha (one file) or .mhd (header beside a .raw file)");
  }
}

}  // namespace soft_volume::core
