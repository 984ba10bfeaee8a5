#include <DICOMAppHelper.h>
#include <DICOMCallback.h>
#include <DICOMFile.h>
#include <DICOMParser.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <set>
#include <vector>

#include "formats.h"
#include "header_text.h"

// VTK's own vtkDICOMImageReader orders slices by their number, takes their distance from the first two, drops the
// orientation and reads past the end of short files. So this uses the parser below it, file by file, and does the rest
// with checks.

namespace soft_volume::core::reader {
namespace {

/// Slices may be this far from their even distance, as a part of it.
constexpr double kLargestUnevenness = 0.02;
constexpr double kSameOrientation = 1e-4;

struct Slice {
  std::string path;
  Vector3 position_mm;        ///< LPS, centre of the first voxel
  Vector3 row;                ///< direction in which columns count up (i)
  Vector3 column;             ///< direction in which rows count up (j)
  double row_distance_mm;     ///< from one row to the next (along j)
  double column_distance_mm;  ///< from one column to the next (along i)
  double thickness_mm;
  int width;
  int height;
  double depth_mm = 0.0;  ///< along the normal

  Vector3 normal() const { return row.cross(column); }
};

std::string nameOf(const std::string& path) {
  return std::filesystem::path(path).filename().string();
}

/// One file, opened. The helper collects what the parser meets.
class DicomFile {
 public:
  explicit DicomFile(const std::string& path) : path_(path), is_open_(parser_.OpenFile(path)) {
    on_pixels_.SetCallbackFunction(this, &DicomFile::seePixels);
  }

  bool isDicom() { return is_open_ && parser_.IsDICOMFile(); }

  void parseHeader() {
    helper_.RegisterCallbacks(&parser_);
    parser_.ReadHeader();
  }
  void parseAll() {
    helper_.RegisterCallbacks(&parser_);
    helper_.RegisterPixelDataCallback(&parser_);
    parser_.AddDICOMTagCallback(0x7FE0, 0x0010, DICOMParser::VR_OW, &on_pixels_);
    parser_.ReadHeader();
  }
  DICOMAppHelper& helper() { return helper_; }
  /// The file held all the pixels that it claims.
  bool isComplete() const { return is_complete_; }
  [[noreturn]] void refuse(const std::string& reason) const { throw ReadError(nameOf(path_) + ": " + reason); }

 private:
  void seePixels(DICOMParser* parser, doublebyte, doublebyte, DICOMParser::VRTypes, unsigned char*, quadbyte) {
    is_complete_ = parser->GetDICOMFile()->Tell() >= 0;  // a stream that met its end tells -1
  }

  std::string path_;
  DICOMParser parser_;
  DICOMAppHelper helper_;
  DICOMMemberCallback<DicomFile> on_pixels_;
  bool is_open_;
  bool is_complete_ = false;
};

/// The parser reads plain pixels only; compressed ones would come out as noise.
void checkSyntax(DicomFile& file) {
  std::string syntax = file.helper().GetTransferSyntaxUID();
  syntax.erase(std::find(syntax.begin(), syntax.end(), '\0'), syntax.end());
  syntax.erase(syntax.find_last_not_of(' ') + 1);
  const std::set<std::string> plain = {"", "1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2"};
  if (plain.count(syntax) == 0) {
    file.refuse("the pixels are compressed (transfer syntax " + syntax + "); convert the series to uncompressed DICOM");
  }
}

Vector3 vectorOf(const float* numbers) {
  return Vector3(numbers[0], numbers[1], numbers[2]);
}

Slice sliceOf(DicomFile& file, const std::string& path) {
  DICOMAppHelper& helper = file.helper();
  if (helper.GetNumberOfComponents() != 1) {
    file.refuse("holds colours; only one component is supported");
  }
  Slice slice;
  slice.path = path;
  slice.position_mm = vectorOf(helper.GetImagePositionPatient());
  slice.row = vectorOf(helper.GetImageOrientationPatient());
  slice.column = vectorOf(helper.GetImageOrientationPatient() + 3);
  slice.row_distance_mm = helper.GetPixelSpacing()[0];
  slice.column_distance_mm = helper.GetPixelSpacing()[1];
  slice.thickness_mm = helper.GetPixelSpacing()[2];
  slice.width = helper.GetWidth();
  slice.height = helper.GetHeight();
  slice.depth_mm = slice.normal().dot(slice.position_mm);
  if (slice.width < 1 || slice.height < 1 || !std::isfinite(slice.depth_mm)) {
    file.refuse("holds no image, or one without a size and a position");
  }
  return slice;
}

std::vector<std::string> filesIn(const std::string& folder) {
  std::vector<std::string> paths;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    if (entry.is_regular_file() && name[0] != '.' && name != "DICOMDIR") {
      paths.push_back(entry.path().string());
    }
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

bool isNamedDicom(const std::string& path) {
  const std::string extension = lowerCase(std::filesystem::path(path).extension().string());
  return extension == ".dcm" || extension == ".dicom" || extension == ".ima";
}

/// What scanning the folder found.
struct Series {
  std::vector<Slice> slices;
  std::set<std::string> ids;
};

/// Other files (a README, say) are passed over, unless their name promises an image.
void addSlice(const std::string& path, Series& series) {
  DicomFile file(path);
  if (!file.isDicom()) {
    if (isNamedDicom(path)) {
      file.refuse("is no DICOM file; it may be damaged");
    }
    return;
  }
  file.parseHeader();
  checkSyntax(file);
  series.slices.push_back(sliceOf(file, path));
  std::vector<std::string> ids;
  file.helper().GetSeriesUIDs(ids);
  series.ids.insert(ids.begin(), ids.end());
}

Series scan(const std::string& folder) {
  Series series;
  for (const std::string& path : filesIn(folder)) {
    addSlice(path, series);
  }
  if (series.slices.empty()) {
    throw ReadError("the folder holds no DICOM images");
  }
  if (series.ids.size() > 1) {
    throw ReadError("the folder holds " + std::to_string(series.ids.size()) +
                    " DICOM series; move the one that is wanted into a folder of its own");
  }
  std::stable_sort(series.slices.begin(), series.slices.end(),
                   [](const Slice& a, const Slice& b) { return a.depth_mm < b.depth_mm; });
  return series;
}

void checkSameGrid(const Slice& slice, const Slice& first) {
  const double turned = (slice.row - first.row).norm() + (slice.column - first.column).norm();
  if (slice.width != first.width || slice.height != first.height || turned > kSameOrientation ||
      slice.row_distance_mm != first.row_distance_mm || slice.column_distance_mm != first.column_distance_mm) {
    throw ReadError(nameOf(slice.path) + ": differs from " + nameOf(first.path) + " in size, spacing or orientation");
  }
}

/// From the first voxel of one slice to that of the next; its direction need not be the normal (the caller refuses a
/// tilt).
Vector3 sliceStep(const std::vector<Slice>& slices) {
  const Slice& first = slices.front();
  if (slices.size() == 1) {
    return first.normal() * (first.thickness_mm > 0.0 ? first.thickness_mm : 1.0);
  }
  const Vector3 step = (slices.back().position_mm - first.position_mm) / double(slices.size() - 1);
  for (std::size_t i = 1; i < slices.size(); ++i) {
    const Vector3 expected = first.position_mm + step * double(i);
    const double miss_mm = (slices[i].position_mm - expected).norm();
    if (!(miss_mm <= kLargestUnevenness * step.norm()) || !(step.norm() > 0.0)) {
      throw ReadError("the slices are not evenly spaced near " + nameOf(slices[i].path) +
                      ": one is missing or there twice (several acquisitions in one folder?)");
    }
  }
  return step;
}

VolumeGeometry geometryOf(const std::vector<Slice>& slices) {
  const Slice& first = slices.front();
  Placement placement;
  placement.steps.col(0) = first.row * first.column_distance_mm;
  placement.steps.col(1) = first.column * first.row_distance_mm;
  placement.steps.col(2) = sliceStep(slices);  // throws, which Eigen's comma initializer would not bear
  placement.origin = first.position_mm;
  return geometryOf({first.width, first.height, int(slices.size())}, placement);
}

/// Pixels of one slice after the modality's rescale (Hounsfield units for a CT).
struct Pixels {
  ScalarType type;
  std::size_t byte_count;
  const void* data;
};

ScalarType typeOf(DICOMAppHelper& helper) {
  if (helper.RescaledImageDataIsFloat()) {
    return ScalarType::kFloat32;
  }
  const bool is_signed = helper.RescaledImageDataIsSigned();
  if (helper.GetBitsAllocated() <= 8) {
    return is_signed ? ScalarType::kInt8 : ScalarType::kUInt8;
  }
  return is_signed ? ScalarType::kInt16 : ScalarType::kUInt16;
}

Pixels pixelsOf(DicomFile& file, std::size_t count) {
  void* data = nullptr;
  DICOMParser::VRTypes unused = DICOMParser::VR_UNKNOWN;
  unsigned long byte_count = 0;
  file.helper().GetImageData(data, unused, byte_count);
  const ScalarType type = typeOf(file.helper());
  const std::size_t bytes_per_scalar =
      type == ScalarType::kFloat32 ? 4 : (type == ScalarType::kInt8 || type == ScalarType::kUInt8 ? 1 : 2);
  if (data == nullptr || !file.isComplete() || byte_count < bytes_per_scalar * count) {
    file.refuse("is too short for its image; copy it again");
  }
  return {type, bytes_per_scalar * count, data};
}

/// Appends the pixels of one slice; `type` is that of the first slice.
void appendSlice(const Slice& slice, bool is_first, ScalarType& type, std::vector<std::uint8_t>& bytes) {
  DicomFile file(slice.path);
  file.parseAll();
  const std::size_t count = std::size_t(slice.width) * std::size_t(slice.height);
  const Pixels pixels = pixelsOf(file, count);
  if (!is_first && pixels.type != type) {
    file.refuse("has another type of scalars than the slices before it");
  }
  type = pixels.type;
  const auto* begin = static_cast<const std::uint8_t*>(pixels.data);
  bytes.insert(bytes.end(), begin, begin + pixels.byte_count);
}

}  // namespace

Image readDicomFolder(const std::string& path, std::uint64_t limit) {
  const std::vector<Slice> slices = scan(path).slices;
  for (const Slice& slice : slices) {
    checkSameGrid(slice, slices.front());
  }
  Image image;
  image.geometry = geometryOf(slices);
  requiredBytes(image.geometry.dims, sizeof(std::int16_t), limit);
  auto bytes = std::make_shared<std::vector<std::uint8_t>>();
  for (const Slice& slice : slices) {
    appendSlice(slice, bytes->empty(), image.type, *bytes);
  }
  image.byte_count = bytes->size();
  image.bytes = bytes->data();
  image.owner = bytes;
  return image;
}

}  // namespace soft_volume::core::reader
