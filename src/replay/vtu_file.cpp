#include "vtu_file.h"

#include <zlib.h>

#include <algorithm>
#include <charconv>
#include <fstream>
#include <type_traits>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume {
namespace {

constexpr std::uint8_t kVtkVertex = 1;
constexpr std::size_t kBlockBytes = std::size_t(1) << 18;

bool isBigEndian() {
  const std::uint16_t one = 1;
  return *reinterpret_cast<const std::uint8_t*>(&one) == 0;
}

template <typename Number>
const char* vtkName() {
  if constexpr (std::is_same_v<Number, float>)
    return "Float32";
  else if constexpr (std::is_same_v<Number, std::uint32_t>)
    return "UInt32";
  else if constexpr (std::is_same_v<Number, std::uint8_t>)
    return "UInt8";
  else
    return "Int64";
}

/// Shortest text that reads back as the same number, whatever the locale.
std::string numberText(double value) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, value).ptr};
}

void finish(std::ofstream& file, const std::string& path) {
  file.close();
  if (!file)
    throw core::FileError(path + ": cannot be written; check that the folder exists, is writable and has space left");
}

/// What follows the XML: one compressed array after the other.
class AppendedData {
 public:
  /// Returns the offset that the XML names.
  template <typename Number>
  std::size_t add(const std::vector<Number>& values) {
    return addBytes(reinterpret_cast<const std::uint8_t*>(values.data()), values.size() * sizeof(Number));
  }
  const std::vector<std::uint8_t>& bytes() const { return bytes_; }

 private:
  /// Blocks that are compressed one by one, behind a header with their number, their size, the size of the last one
  /// where it is smaller, and their compressed sizes.
  std::size_t addBytes(const std::uint8_t* data, std::size_t size) {
    const std::size_t begin = bytes_.size();
    std::vector<std::uint64_t> header = {(size + kBlockBytes - 1) / kBlockBytes, kBlockBytes, size % kBlockBytes};
    std::vector<std::uint8_t> packed;
    for (std::size_t at = 0; at < size; at += kBlockBytes) {
      const std::size_t before = packed.size();
      uLongf packed_size = compressBound(kBlockBytes);
      packed.resize(before + packed_size);
      compress2(&packed[before], &packed_size, data + at, uLong(std::min(kBlockBytes, size - at)), Z_BEST_SPEED);
      packed.resize(before + packed_size);
      header.push_back(packed_size);
    }
    const auto* head = reinterpret_cast<const std::uint8_t*>(header.data());
    bytes_.insert(bytes_.end(), head, head + header.size() * sizeof(std::uint64_t));
    bytes_.insert(bytes_.end(), packed.begin(), packed.end());
    return begin;
  }

  std::vector<std::uint8_t> bytes_;
};

/// The XML of a grid, while its arrays go into the appended data.
class VtuText {
 public:
  explicit VtuText(AppendedData& data) : data_(&data) {}

  template <typename Number>
  void addArray(const std::string& name, int components, const std::vector<Number>& values) {
    text_ += "        <DataArray type=\"" + std::string(vtkName<Number>()) + "\" Name=\"" + name +
             "\" NumberOfComponents=\"" + std::to_string(components) + "\" format=\"appended\" offset=\"" +
             std::to_string(data_->add(values)) + "\"/>\n";
  }
  void addArrays(const char* place, const std::vector<VtuArray>& arrays) {
    text_ += std::string("      <") + place + ">\n";
    for (const VtuArray& array : arrays)
      std::visit([&](const auto& values) { addArray(array.name, array.components, values); }, array.values);
    text_ += std::string("      </") + place + ">\n";
  }
  void add(const std::string& text) { text_ += text; }
  const std::string& text() const { return text_; }

 private:
  AppendedData* data_;
  std::string text_;
};

std::vector<float> coordinates(const std::vector<core::Vector3f>& points) {
  std::vector<float> numbers;
  numbers.reserve(3 * points.size());
  for (const core::Vector3f& p : points)
    numbers.insert(numbers.end(), p.data(), p.data() + 3);
  return numbers;
}

void addCell(const core::Topology& topology, std::size_t cell, VtuGrid& grid) {
  const std::uint32_t* begin = &topology.connectivity[topology.cell_offsets[cell]];
  const std::uint32_t* end = topology.connectivity.data() + topology.cell_offsets[cell + 1];
  const bool polyhedron = topology.cell_types[cell] == core::CellType::kPolyhedron;
  if (polyhedron) {
    const std::vector<std::uint32_t> vertices = core::verticesOfPolyhedron(begin);
    grid.connectivity.insert(grid.connectivity.end(), vertices.begin(), vertices.end());
    grid.faces.insert(grid.faces.end(), begin, end);
  } else {
    grid.connectivity.insert(grid.connectivity.end(), begin, end);
  }
  grid.types.push_back(static_cast<std::uint8_t>(topology.cell_types[cell]));
  grid.offsets.push_back(std::int64_t(grid.connectivity.size()));
  grid.faces_offsets.push_back(polyhedron ? std::int64_t(grid.faces.size()) : -1);
}

VtuText describe(const VtuGrid& grid, AppendedData& data) {
  VtuText xml(data);
  xml.add("    <Piece NumberOfPoints=\"" + std::to_string(grid.points.size()) + "\" NumberOfCells=\"" +
          std::to_string(grid.types.size()) + "\">\n      <Points>\n");
  xml.addArray("Points", 3, coordinates(grid.points));
  xml.add("      </Points>\n      <Cells>\n");
  xml.addArray("connectivity", 1, grid.connectivity);
  xml.addArray("offsets", 1, grid.offsets);
  xml.addArray("types", 1, grid.types);
  if (!grid.faces.empty()) {
    xml.addArray("faces", 1, grid.faces);
    xml.addArray("faceoffsets", 1, grid.faces_offsets);
  }
  xml.add("      </Cells>\n");
  xml.addArrays("PointData", grid.point_arrays);
  xml.addArrays("CellData", grid.cell_arrays);
  xml.add("    </Piece>\n");
  return xml;
}

}  // namespace

VtuGrid deformedGrid(const core::Topology& topology, const std::vector<core::Vector3f>& positions_m) {
  if (positions_m.size() != topology.vertexCount())
    throw core::InputError("a grid of " + std::to_string(topology.vertexCount()) + " vertices cannot have " +
                           std::to_string(positions_m.size()) + " positions");
  VtuGrid grid;
  grid.points = positions_m;
  std::vector<std::uint32_t> materials;
  std::vector<std::uint32_t> lattice_cells;
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    if (topology.cell_types[cell] == core::CellType::kEmpty)
      continue;
    addCell(topology, cell, grid);
    materials.push_back(topology.materials[cell]);
    lattice_cells.push_back(topology.parent_cells.empty() ? std::uint32_t(cell) : topology.parent_cells[cell]);
  }
  std::vector<core::Vector3f> displacements(positions_m.size());
  for (std::size_t v = 0; v < positions_m.size(); ++v)
    displacements[v] = positions_m[v] - topology.rest_positions[v];
  grid.point_arrays = {{"displacement", 3, coordinates(displacements)}, {"fixed", 1, topology.fixed}};
  grid.cell_arrays = {{"material", 1, std::move(materials)}, {"lattice_cell", 1, std::move(lattice_cells)}};
  return grid;
}

VtuGrid pointGrid(std::vector<core::Vector3f> points_m) {
  VtuGrid grid;
  grid.points = std::move(points_m);
  for (std::size_t n = 0; n < grid.points.size(); ++n) {
    grid.connectivity.push_back(std::int64_t(n));
    grid.offsets.push_back(std::int64_t(n) + 1);
    grid.types.push_back(kVtkVertex);
  }
  return grid;
}

void writeVtu(const std::string& path, const VtuGrid& grid) {
  AppendedData data;
  const VtuText xml = describe(grid, data);
  std::ofstream file(path, std::ios::binary);
  file << "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\""
       << (isBigEndian() ? "BigEndian" : "LittleEndian")
       << "\" header_type=\"UInt64\" compressor=\"vtkZLibDataCompressor\">\n  <UnstructuredGrid>\n"
       << xml.text() << "  </UnstructuredGrid>\n  <AppendedData encoding=\"raw\">\n_";
  file.write(reinterpret_cast<const char*>(data.bytes().data()), std::streamsize(data.bytes().size()));
  file << "\n  </AppendedData>\n</VTKFile>\n";
  finish(file, path);
}

void writePvd(const std::string& path, const std::vector<VtuSeriesEntry>& entries, const std::string& remark) {
  std::string comment = remark;
  std::replace(comment.begin(), comment.end(), '-', '_');  // two hyphens would end it
  std::ofstream file(path);
  file << "<?xml version=\"1.0\"?>\n<!-- " << comment << " -->\n<VTKFile type=\"Collection\" version=\"0.1\">\n"
       << "  <Collection>\n";
  for (const VtuSeriesEntry& entry : entries)
    file << "    <DataSet timestep=\"" << numberText(entry.time_s) << "\" part=\"0\" file=\"" << entry.file << "\"/>\n";
  file << "  </Collection>\n</VTKFile>\n";
  finish(file, path);
}

}  // namespace soft_volume
