#include <vtkDataArray.h>
#include <vtkImageData.h>
#include <vtkImageReader2.h>
#include <vtkInformation.h>
#include <vtkMatrix3x3.h>
#include <vtkMatrix4x4.h>
#include <vtkMetaImageReader.h>
#include <vtkNIFTIImageHeader.h>
#include <vtkNIFTIImageReader.h>
#include <vtkNew.h>
#include <vtkNrrdReader.h>
#include <vtkPointData.h>
#include <vtkSmartPointer.h>
#include <vtkStreamingDemandDrivenPipeline.h>
#include <vtkXMLImageDataReader.h>

#include <algorithm>
#include <cstring>
#include <set>
#include <sstream>
#include <vector>

#include "formats.h"
#include "header_text.h"
#include "reports.h"

namespace soft_volume::core::reader {
namespace {

ScalarType scalarTypeOf(int vtk_type) {
  switch (vtk_type) {
    case VTK_CHAR:
    case VTK_SIGNED_CHAR:
      return ScalarType::kInt8;
    case VTK_UNSIGNED_CHAR:
      return ScalarType::kUInt8;
    case VTK_SHORT:
      return ScalarType::kInt16;
    case VTK_UNSIGNED_SHORT:
      return ScalarType::kUInt16;
    case VTK_INT:
      return ScalarType::kInt32;
    case VTK_UNSIGNED_INT:
      return ScalarType::kUInt32;
    case VTK_FLOAT:
      return ScalarType::kFloat32;
    case VTK_DOUBLE:
      return ScalarType::kFloat64;
    default:
      throw ReadError(std::string("scalars of type ") + vtkImageScalarTypeNameMacro(vtk_type) +
                      " are not supported; convert to an integer of up to 32 bits or to floating point");
  }
}

void checkComponents(int components) {
  if (components != 1) {
    throw ReadError("has " + std::to_string(components) +
                    " components a voxel (colour, vectors or time); only one is supported, so extract it first");
  }
}

Vector3i dimsOf(const int* extent) {
  return {extent[1] - extent[0] + 1, extent[3] - extent[2] + 1, extent[5] - extent[4] + 1};
}

/// What the header promises, known before any voxel is read.
struct Claim {
  Vector3i dims;
  std::size_t bytes_per_scalar;
  int components;
};

Claim claimOf(vtkImageReader2* reader, const Reports& reports) {
  reader->UpdateInformation();
  reports.throwIfAny();
  scalarTypeOf(reader->GetDataScalarType());  // refuses the types that we do not have
  return {dimsOf(reader->GetDataExtent()),
          static_cast<std::size_t>(vtkDataArray::GetDataTypeSize(reader->GetDataScalarType())),
          reader->GetNumberOfScalarComponents()};
}

/// Keeps VTK's own array, no copy.
Image imageOf(vtkDataArray* scalars, const VolumeGeometry& geometry) {
  if (scalars == nullptr || std::size_t(scalars->GetNumberOfValues()) != geometry.voxelCount()) {
    throw ReadError("holds no scalars, or another number of them than its header claims");
  }
  Image image;
  image.geometry = geometry;
  image.type = scalarTypeOf(scalars->GetDataType());
  image.byte_count = std::uint64_t(scalars->GetNumberOfValues()) * std::uint64_t(scalars->GetDataTypeSize());
  image.bytes = static_cast<const std::uint8_t*>(scalars->GetVoidPointer(0));
  image.owner = std::make_shared<vtkSmartPointer<vtkDataArray>>(scalars);
  return image;
}

Image readScalars(vtkImageReader2* reader, const Reports& reports, const VolumeGeometry& geometry) {
  reader->Update();
  reports.throwIfAny();
  return imageOf(reader->GetOutput()->GetPointData()->GetScalars(), geometry);
}

Matrix3 stepsFrom(const Matrix3& direction, const double* spacing) {
  return direction * Eigen::Map<const Vector3>(spacing).asDiagonal();
}

// --- NIfTI

/// Units of the first three axes in the header's xyzt_units; absent means millimetres, as nearly all writers intend.
double niftiUnitsPerMetre(int xyzt_units) {
  switch (xyzt_units & 7) {
    case 0:
    case 2:
      return kMillimetresPerMetre;
    case 1:
      return 1.0;
    case 3:
      return 1e6;
    default:
      throw ReadError("the unit of length in the header is unknown (xyzt_units " + std::to_string(xyzt_units) + ")");
  }
}

/// VTK's matrices map its own data coordinates (voxel index times spacing, slices already reversed for qfac = -1) to
/// RAS. The sform is preferred, as other programs do, unless only the qform is there. With neither, the axes are taken
/// as RAS.
Placement niftiPlacement(vtkNIFTIImageReader* reader) {
  Placement placement;
  placement.axes = PatientAxes::kRas;
  placement.units_per_metre = niftiUnitsPerMetre(reader->GetNIFTIHeader()->GetXYZTUnits());
  vtkMatrix4x4* matrix = reader->GetSFormMatrix() != nullptr ? reader->GetSFormMatrix() : reader->GetQFormMatrix();
  Matrix3 direction = Matrix3::Identity();
  for (int row = 0; matrix != nullptr && row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      direction(row, column) = matrix->GetElement(row, column);
    }
    placement.origin[row] = matrix->GetElement(row, 3);
  }
  placement.steps = stepsFrom(direction, reader->GetDataSpacing());
  return placement;
}

void checkNiftiTimes(vtkNIFTIImageReader* reader) {
  if (reader->GetTimeDimension() > 1) {
    throw ReadError("holds " + std::to_string(reader->GetTimeDimension()) + " time points; extract one of them first");
  }
}

template <typename From, typename To>
void rescale(const void* from, std::size_t count, double slope, double intercept, std::vector<std::uint8_t>& to) {
  to.resize(count * sizeof(To));
  for (std::size_t i = 0; i < count; ++i) {
    From value;
    std::memcpy(&value, static_cast<const std::uint8_t*>(from) + i * sizeof(From), sizeof(From));
    const To result = static_cast<To>(slope * double(value) + intercept);
    std::memcpy(to.data() + i * sizeof(To), &result, sizeof(To));
  }
}

void rescale(const Image& image, double slope, double intercept, std::vector<std::uint8_t>& to) {
  const std::size_t count = image.geometry.voxelCount();
  switch (image.type) {
    case ScalarType::kInt8:
      return rescale<std::int8_t, float>(image.bytes, count, slope, intercept, to);
    case ScalarType::kUInt8:
      return rescale<std::uint8_t, float>(image.bytes, count, slope, intercept, to);
    case ScalarType::kInt16:
      return rescale<std::int16_t, float>(image.bytes, count, slope, intercept, to);
    case ScalarType::kUInt16:
      return rescale<std::uint16_t, float>(image.bytes, count, slope, intercept, to);
    case ScalarType::kFloat32:
      return rescale<float, float>(image.bytes, count, slope, intercept, to);
    case ScalarType::kInt32:
      return rescale<std::int32_t, double>(image.bytes, count, slope, intercept, to);
    case ScalarType::kUInt32:
      return rescale<std::uint32_t, double>(image.bytes, count, slope, intercept, to);
    case ScalarType::kFloat64:
      return rescale<double, double>(image.bytes, count, slope, intercept, to);
  }
}

/// A slope or intercept in the header means that the stored numbers are not the intensities: these become float32
/// (float64 where the stored type holds more than 24 bits).
Image withIntensities(const Image& stored, double slope, double intercept) {
  if (slope == 0.0 || !std::isfinite(slope) || !std::isfinite(intercept) || (slope == 1.0 && intercept == 0.0)) {
    return stored;
  }
  auto bytes = std::make_shared<std::vector<std::uint8_t>>();
  rescale(stored, slope, intercept, *bytes);
  Image image = stored;
  image.type = bytes->size() == 8 * stored.geometry.voxelCount() ? ScalarType::kFloat64 : ScalarType::kFloat32;
  image.byte_count = bytes->size();
  image.bytes = bytes->data();
  image.owner = bytes;
  return image;
}

// --- MetaImage

double metaImageUnitsPerMetre(const std::string& unit) {
  if (unit.empty() || unit == "?" || unit == "mm") {
    return kMillimetresPerMetre;
  }
  if (unit == "um") {
    return 1e6;
  }
  if (unit == "cm") {
    return 1e2;
  }
  throw ReadError("the unit of length " + unit + " in the header is unknown; use mm");
}

Vector3 threeNumbers(const std::string& text, const std::string& key, const Vector3& otherwise) {
  const std::vector<double> numbers = numbersIn(text);
  if (text.empty()) {
    return otherwise;
  }
  if (numbers.size() != 3) {
    throw ReadError("the header line " + key + " needs three numbers, got '" + text + "'");
  }
  return {numbers[0], numbers[1], numbers[2]};
}

/// MetaImage has three names for each of these; the first one that is there counts.
std::string firstOf(const HeaderText& header, std::initializer_list<const char*> keys) {
  for (const char* key : keys) {
    if (header.has(key)) {
      return header.value(key);
    }
  }
  return "";
}

/// VTK 9.1 ignores TransformMatrix, so the header's text is read here. The matrix holds one axis of the grid after the
/// other, in LPS.
Placement metaImagePlacement(const HeaderText& header) {
  Placement placement;
  placement.units_per_metre = metaImageUnitsPerMetre(header.lowerCaseValue("distanceunits"));
  const std::string matrix = firstOf(header, {"transformmatrix", "rotation", "orientation"});
  const std::vector<double> axes = numbersIn(matrix);
  if (!matrix.empty() && axes.size() != 9) {
    throw ReadError("the header line TransformMatrix needs nine numbers, got '" + matrix + "'");
  }
  const Matrix3 direction =
      matrix.empty() ? Matrix3(Matrix3::Identity()) : Matrix3(Eigen::Map<const Matrix3>(axes.data()));
  const Vector3 size = threeNumbers(header.value("elementsize"), "ElementSize", Vector3::Ones());
  const Vector3 spacing = threeNumbers(header.value("elementspacing"), "ElementSpacing", size);
  placement.steps = stepsFrom(direction, spacing.data());
  placement.origin = threeNumbers(firstOf(header, {"offset", "position", "origin"}), "Offset", Vector3::Zero());
  return placement;
}

/// MetaIO would fill up what a short file lacks.
void checkMetaImageData(const HeaderText& header, const std::string& path, std::uint64_t byte_count) {
  const std::string file = header.value("elementdatafile");
  if (header.lowerCaseValue("ndims") != "3") {
    throw ReadError("has " + header.value("ndims") + " dimensions; only 3 are supported");
  }
  if (file.find('%') != std::string::npos || lowerCase(file).rfind("list", 0) == 0) {
    throw ReadError("keeps its slices in several files; convert it to one data file first");
  }
  const bool is_compressed = header.lowerCaseValue("compresseddata") == "true";
  const bool is_local = lowerCase(file) == "local";
  const std::string data_path = is_local ? path : beside(path, file);
  checkFileHolds(data_path, is_local ? header.data_offset : 0, is_compressed ? 1 : byte_count);
}

// --- NRRD

double nrrdUnitsPerMetre(const std::string& text) {
  const std::string unit = text.substr(0, text.find(' '));
  if (unit.empty() || unit == "\"mm\"" || unit == "\"\"") {
    return kMillimetresPerMetre;
  }
  if (unit == "\"m\"") {
    return 1.0;
  }
  if (unit == "\"cm\"") {
    return 1e2;
  }
  if (unit == "\"um\"") {
    return 1e6;
  }
  throw ReadError("the unit of length " + unit + " in the header is unknown; use \"mm\"");
}

PatientAxes nrrdAxes(const std::string& space) {
  if (space == "left-posterior-superior" || space == "lps" || space.empty()) {
    return PatientAxes::kLps;
  }
  if (space == "right-anterior-superior" || space == "ras" || space == "3d-right-handed" || space == "scanner-xyz") {
    return PatientAxes::kRas;
  }
  throw ReadError("the space '" + space + "' is not supported; use left-posterior-superior or right-anterior-superior");
}

/// VTK 9.1 keeps neither `space` nor, in all versions, the signs of `space directions`, so the header's text is read
/// here. A file without a space is taken as LPS, as other programs do.
Placement nrrdPlacement(const HeaderText& header) {
  Placement placement;
  placement.axes = nrrdAxes(header.lowerCaseValue("space"));
  placement.units_per_metre = nrrdUnitsPerMetre(header.lowerCaseValue("space units"));
  const std::string directions = header.value("space directions");
  const std::vector<double> numbers = numbersIn(directions);
  if (!directions.empty() && numbers.size() != 9) {
    throw ReadError("the header line 'space directions' needs three vectors, got '" + directions + "'");
  }
  const Vector3 spacing = threeNumbers(header.value("spacings"), "spacings", Vector3::Ones());
  placement.steps =
      directions.empty() ? Matrix3(spacing.asDiagonal()) : Matrix3(Eigen::Map<const Matrix3>(numbers.data()));
  placement.origin = threeNumbers(header.value("space origin"), "space origin", Vector3::Zero());
  return placement;
}

/// VTK 9.1 guesses: it takes a first axis of less than ten for components and drops axes of one. The order of the
/// scalars is the same, so the sizes of the header count here.
Vector3i nrrdDims(const HeaderText& header) {
  const Vector3 sizes = threeNumbers(header.value("sizes"), "sizes", Vector3::Zero());
  if (header.value("dimension") != "3" || !(sizes.cwiseAbs().maxCoeff() < 1e9)) {
    throw ReadError("has " + header.value("dimension") +
                    " dimensions; only 3 are supported (extract one component or time point first)");
  }
  return sizes.cast<int>();
}

void checkNrrdKinds(const HeaderText& header) {
  std::istringstream kinds(header.lowerCaseValue("kinds"));
  const std::set<std::string> places = {"domain", "space", "none", "stub", "???"};
  for (std::string kind; kinds >> kind;) {
    if (places.count(kind) == 0) {
      throw ReadError("an axis is of the kind '" + kind + "'; only one component and one time point are supported");
    }
  }
}

void checkNrrdData(const HeaderText& header, const std::string& path, std::uint64_t byte_count) {
  const std::string file = header.has("data file") ? header.value("data file") : header.value("datafile");
  if (file.find('%') != std::string::npos || lowerCase(file).rfind("list", 0) == 0) {
    throw ReadError("keeps its data in several files; convert it to one data file first");
  }
  const std::string encoding = header.lowerCaseValue("encoding");
  const std::string data_path = file.empty() ? path : beside(path, file);
  const std::uint64_t offset = file.empty() ? header.data_offset : 0;
  checkFileHolds(data_path, offset, encoding == "raw" ? byte_count : 1);
  if (encoding == "gzip" || encoding == "gz") {
    checkGzipHolds(data_path, offset, byte_count);  // VTK 9.1 would wait for the missing bytes for ever
  }
}

// --- VTI

/// VTI knows neither units nor patient axes: millimetres in RAS are assumed.
Placement vtiPlacement(vtkImageData* image) {
  Placement placement;
  placement.axes = PatientAxes::kRas;
  const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> direction(
      image->GetDirectionMatrix()->GetData());
  placement.steps = stepsFrom(direction, image->GetSpacing());
  const int* extent = image->GetExtent();
  const Vector3 first(extent[0], extent[2], extent[4]);
  placement.origin = Eigen::Map<const Vector3>(image->GetOrigin()) + placement.steps * first;
  return placement;
}

/// The active scalars, or the only point array.
vtkDataArray* vtiScalars(vtkImageData* image) {
  vtkPointData* arrays = image->GetPointData();
  if (arrays->GetScalars() != nullptr) {
    return arrays->GetScalars();
  }
  if (arrays->GetNumberOfArrays() != 1) {
    throw ReadError("has " + std::to_string(arrays->GetNumberOfArrays()) +
                    " point data arrays and none is marked as the scalars; write one, at the points");
  }
  return arrays->GetArray(0);
}

}  // namespace

Image readNifti(const std::string& path, std::uint64_t limit) {
  const auto reports = startReports();
  const vtkNew<vtkNIFTIImageReader> reader;
  reader->SetFileName(path.c_str());
  const Claim claim = claimOf(reader, *reports);
  checkComponents(claim.components);
  checkNiftiTimes(reader);
  const std::uint64_t byte_count = requiredBytes(claim.dims, claim.bytes_per_scalar, limit);
  if (lowerCase(path).rfind(".gz") == path.size() - 3) {
    checkGzipHolds(path, 0,
                   std::uint64_t(std::max<vtkTypeInt64>(0, reader->GetNIFTIHeader()->GetVoxOffset())) + byte_count);
  }
  const Image stored = readScalars(reader, *reports, geometryOf(claim.dims, niftiPlacement(reader)));
  return withIntensities(stored, reader->GetRescaleSlope(), reader->GetRescaleIntercept());
}

Image readMetaImage(const std::string& path, std::uint64_t limit) {
  const HeaderText header = readMetaImageHeader(path);
  const auto reports = startReports();
  const vtkNew<vtkMetaImageReader> reader;
  reader->SetFileName(path.c_str());
  const Claim claim = claimOf(reader, *reports);
  checkComponents(claim.components);
  checkMetaImageData(header, path, requiredBytes(claim.dims, claim.bytes_per_scalar, limit));
  return readScalars(reader, *reports, geometryOf(claim.dims, metaImagePlacement(header)));
}

Image readNrrd(const std::string& path, std::uint64_t limit) {
  const HeaderText header = readNrrdHeader(path);
  const Vector3i dims = nrrdDims(header);
  checkNrrdKinds(header);
  const auto reports = startReports();
  const vtkNew<vtkNrrdReader> reader;
  reader->SetFileName(path.c_str());
  const Claim claim = claimOf(reader, *reports);
  checkNrrdData(header, path, requiredBytes(dims, claim.bytes_per_scalar, limit));
  return readScalars(reader, *reports, geometryOf(dims, nrrdPlacement(header)));
}

Image readVti(const std::string& path, std::uint64_t limit) {
  checkXmlComponents(path);
  const auto reports = startReports();
  const vtkNew<vtkXMLImageDataReader> reader;
  reader->SetFileName(path.c_str());
  reader->UpdateInformation();
  reports->throwIfAny();
  int extent[6] = {0, -1, 0, -1, 0, -1};
  reader->GetOutputInformation(0)->Get(vtkStreamingDemandDrivenPipeline::WHOLE_EXTENT(), extent);
  const Vector3i dims = dimsOf(extent);
  requiredBytes(dims, 1, limit);
  reader->Update();
  reports->throwIfAny();
  vtkImageData* image = reader->GetOutput();
  vtkDataArray* scalars = vtiScalars(image);
  checkComponents(scalars->GetNumberOfComponents());
  return imageOf(scalars, geometryOf(dims, vtiPlacement(image)));
}

}  // namespace soft_volume::core::reader
