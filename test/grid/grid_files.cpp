#include "grid/grid_files.h"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <sstream>

namespace soft_volume::core::testing_grid {
namespace {

template <typename T>
void appendBigEndian(std::string& bytes, T value) {
  char raw[sizeof value];
  std::memcpy(raw, &value, sizeof value);
  std::reverse(raw, raw + sizeof value);
  bytes.append(raw, sizeof value);
}

template <typename T>
void append(std::string& bytes, T value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof value);
}

template <typename Values>
std::string joined(const Values& values) {
  std::ostringstream text;
  text.precision(17);
  for (const auto& value : values)
    text << value << ' ';
  return text.str();
}

std::vector<double> flat(const std::vector<Vector3>& points) {
  std::vector<double> numbers;
  for (const Vector3& p : points)
    numbers.insert(numbers.end(), {p.x(), p.y(), p.z()});
  return numbers;
}

std::string named(const std::string& name, const std::string& text) {
  return name + " " + text + "\n";
}

std::string dimsText(const Vector3i& dims) {
  return joined(std::vector<int>{dims.x(), dims.y(), dims.z()});
}

void addCell(IrregularGrid& grid, CellType type, const std::vector<std::uint32_t>& numbers) {
  grid.cell_types.push_back(type);
  grid.connectivity.insert(grid.connectivity.end(), numbers.begin(), numbers.end());
  grid.cell_offsets.push_back(static_cast<std::uint32_t>(grid.connectivity.size()));
}

IrregularGrid mixedCells() {
  IrregularGrid grid;
  grid.cell_offsets = {0};
  // Two layers of four vertices make the voxel, the next make the hexahedron on top.
  grid.points = {{0, 0, 0},  {1, 0, 0},    {0, 1, 0},     {1, 1, 0},     {0, 0, 1},    {1, 0, 1},       {0, 1, 1},
                 {1, 1, 1},  {0, 0, 2},    {1, 0, 2},     {1, 1, 2.25F}, {0, 1, 2},    {0.5F, 0.5F, 3}, {2, 0, 0},
                 {2, 0, 1},  {2, 2, 0.5F}, {-2, 0, 0},    {-1, 0, 0},    {-1, 1, 0},   {-2, 1, 0},      {-2, 0, 1},
                 {-1, 0, 1}, {-2, 1, 1},   {-1, 1, 0.5F}, {-1, 0.5F, 1}, {-1.5F, 1, 1}};
  addCell(grid, CellType::kVoxel, {0, 1, 2, 3, 4, 5, 6, 7});
  addCell(grid, CellType::kHexahedron, {4, 5, 7, 6, 8, 9, 10, 11});
  addCell(grid, CellType::kPyramid, {8, 9, 10, 11, 12});
  addCell(grid, CellType::kWedge, {1, 3, 13, 5, 7, 14});
  addCell(grid, CellType::kTetrahedron, {13, 15, 3, 14});
  // A box [-2, -1] x [0, 1] x [0, 1] without the corner (-1, 1, 1).
  addCell(grid, CellType::kPolyhedron, {7,  4,  16, 19, 18, 17, 5,  20, 21, 24, 25, 22, 4,  16, 17, 21, 20, 5,  19,
                                        22, 25, 23, 18, 4,  16, 20, 22, 19, 5,  17, 18, 23, 24, 21, 3,  23, 25, 24});
  return grid;
}

std::vector<float> counted(std::size_t count) {
  std::vector<float> values(count);
  for (std::size_t i = 0; i < count; ++i)
    values[i] = 0.25F * float(i) - 1.5F;
  return values;
}

FileArray scalarArray(const std::vector<float>& values) {
  return {"scalar", 1, {values.begin(), values.end()}};
}

std::vector<long> legacyCells(const FileContents& contents) {
  std::vector<long> numbers;
  for (const auto& cell : contents.cells) {
    numbers.push_back(long(cell.size()));
    numbers.insert(numbers.end(), cell.begin(), cell.end());
  }
  return numbers;
}

/// `numbers` turns a list of numbers into text or bytes of a type.
using Numbers = std::function<std::string(const std::vector<double>&, bool is_integer)>;

std::string legacyArrays(const char* place, std::size_t count, const std::vector<FileArray>& arrays,
                         const Numbers& numbers) {
  if (arrays.empty())
    return "";
  std::string text = std::string(place) + " " + std::to_string(count) + "\n";
  for (const FileArray& array : arrays) {
    text += array.components == 3
                ? "VECTORS " + array.name + " float\n"
                : "SCALARS " + array.name + " float " + std::to_string(array.components) + "\nLOOKUP_TABLE default\n";
    text += numbers(array.values, false) + "\n";
  }
  return text;
}

std::string legacyFile(const FileContents& contents, const char* kind, const Numbers& numbers) {
  const std::vector<long> cells = legacyCells(contents);
  std::string text = std::string("# vtk DataFile Version 3.0\na grid\n") + kind + "\nDATASET UNSTRUCTURED_GRID\n";
  text += "POINTS " + std::to_string(contents.points.size()) + " float\n" + numbers(flat(contents.points), false);
  text += "\nCELLS " + std::to_string(contents.cells.size()) + " " + std::to_string(cells.size()) + "\n" +
          numbers({cells.begin(), cells.end()}, true);
  text += "\nCELL_TYPES " + std::to_string(contents.types.size()) + "\n" +
          numbers({contents.types.begin(), contents.types.end()}, true) + "\n";
  text += legacyArrays("CELL_DATA", contents.cells.size(), contents.cell_arrays, numbers);
  return text + legacyArrays("POINT_DATA", contents.points.size(), contents.point_arrays, numbers);
}

// --- XML

/// Writes DataArray elements with their numbers inside, or behind the XML.
class XmlArrays {
 public:
  explicit XmlArrays(bool appended) : appended_(appended) {}

  std::string array(const std::string& type, const std::string& name, int components,
                    const std::vector<double>& values) {
    std::string text = "<DataArray type=\"" + type + "\" Name=\"" + name + "\" NumberOfComponents=\"" +
                       std::to_string(components) + "\" format=\"";
    if (!appended_)
      return text + "ascii\">" + joined(values) + "</DataArray>\n";
    text += "appended\" offset=\"" + std::to_string(bytes_.size()) + "\"/>\n";
    std::string block;
    for (const double value : values)
      appendAs(type, value, block);
    append(bytes_, std::uint32_t(block.size()));
    bytes_ += block;
    return text;
  }

  std::string file(const std::string& kind, const std::string& attributes, const std::string& piece) const {
    std::string text = "<?xml version=\"1.0\"?>\n<VTKFile type=\"" + kind +
                       "\" version=\"0.1\" byte_order=\"LittleEndian\">\n<" + kind + " " + attributes + ">\n" + piece +
                       "</" + kind + ">\n";
    if (appended_)
      text += "<AppendedData encoding=\"raw\">\n_" + bytes_ + "\n</AppendedData>\n";
    return text + "</VTKFile>\n";
  }

  std::string data(const std::string& place, const std::vector<FileArray>& arrays, const std::string& more = "") {
    std::string text = "<" + place + ">\n";
    for (const FileArray& a : arrays)
      text += array("Float32", a.name, a.components, a.values);
    return text + more + "</" + place + ">\n";
  }

 private:
  static void appendAs(const std::string& type, double value, std::string& block) {
    if (type == "Float32")
      append(block, float(value));
    else if (type == "Int64")
      append(block, std::int64_t(value));
    else
      append(block, std::uint8_t(value));
  }

  bool appended_;
  std::string bytes_;
};

/// The vertices of a cell once each, as VTU lists them beside the face stream.
std::vector<long> verticesOf(int type, const std::vector<long>& cell) {
  if (type != int(CellType::kPolyhedron))
    return cell;
  std::vector<long> vertices;
  for (std::size_t at = 1; at < cell.size(); at += std::size_t(cell[at]) + 1)
    vertices.insert(vertices.end(), cell.begin() + long(at) + 1, cell.begin() + long(at) + 1 + cell[at]);
  std::sort(vertices.begin(), vertices.end());
  vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
  return vertices;
}

std::string cellsElement(const FileContents& contents, XmlArrays& xml) {
  std::vector<double> connectivity, offsets, faces, face_offsets;
  for (std::size_t c = 0; c < contents.cells.size(); ++c) {
    const bool is_polyhedron = contents.types[c] == int(CellType::kPolyhedron);
    const std::vector<long> vertices = verticesOf(contents.types[c], contents.cells[c]);
    connectivity.insert(connectivity.end(), vertices.begin(), vertices.end());
    offsets.push_back(double(connectivity.size()));
    if (is_polyhedron)
      faces.insert(faces.end(), contents.cells[c].begin(), contents.cells[c].end());
    face_offsets.push_back(is_polyhedron ? double(faces.size()) : -1.0);
  }
  std::string text = "<Cells>\n" + xml.array("Int64", "connectivity", 1, connectivity) +
                     xml.array("Int64", "offsets", 1, offsets) +
                     xml.array("UInt8", "types", 1, {contents.types.begin(), contents.types.end()});
  if (!faces.empty())
    text += xml.array("Int64", "faces", 1, faces) + xml.array("Int64", "faceoffsets", 1, face_offsets);
  return text + "</Cells>\n";
}

std::string vtu(const FileContents& contents, bool appended) {
  XmlArrays xml(appended);
  std::string piece = "<Piece NumberOfPoints=\"" + std::to_string(contents.points.size()) + "\" NumberOfCells=\"" +
                      std::to_string(contents.cells.size()) + "\">\n";
  std::string ghosts;
  if (!contents.cell_ghosts.empty())
    ghosts = xml.array("UInt8", "vtkGhostType", 1, {contents.cell_ghosts.begin(), contents.cell_ghosts.end()});
  piece += xml.data("PointData", contents.point_arrays) + xml.data("CellData", contents.cell_arrays, ghosts);
  piece += "<Points>\n" + xml.array("Float32", "Points", 3, flat(contents.points)) + "</Points>\n";
  return xml.file("UnstructuredGrid", "", piece + cellsElement(contents, xml) + "</Piece>\n");
}

// --- Structured

FileArray valuesOf(const Block& block) {
  FileArray array{"scalar", 1, {}};
  block.forEach([&](int i, int j, int k) { array.values.push_back(Block::value(i, j, k)); });
  return array;
}

std::vector<Vector3> pointsOf(const Block& block) {
  std::vector<Vector3> points;
  block.forEach([&](int i, int j, int k) { points.push_back(block.point(i, j, k)); });
  return points;
}

/// Along one axis of a rectilinear grid: the squares, so that no two cells are equal.
std::vector<double> coordinates(int count) {
  std::vector<double> places;
  for (int i = 0; i < count; ++i)
    places.push_back(0.5 * i * i);
  return places;
}

std::string legacyHead(const char* kind, const Block& block) {
  return std::string("# vtk DataFile Version 3.0\na grid\nASCII\nDATASET ") + kind + "\n" +
         named("DIMENSIONS", dimsText(block.dims));
}

std::string legacyScalars(const Block& block) {
  return legacyArrays("POINT_DATA", block.count(), {valuesOf(block)},
                      [](const std::vector<double>& values, bool) { return joined(values); });
}

/// Starts at index 2 along each axis, as pieces of larger grids do.
std::string extentText(const Block& block) {
  const Vector3i last = block.dims + Vector3i::Ones();
  return joined(std::vector<int>{2, last.x(), 2, last.y(), 2, last.z()});
}

std::string xmlStructured(const std::string& kind, const Block& block, const std::string& attributes,
                          const std::function<std::string(XmlArrays&)>& geometry) {
  XmlArrays xml(false);
  const std::string extent = extentText(block);
  const std::string piece =
      "<Piece Extent=\"" + extent + "\">\n" + xml.data("PointData", {valuesOf(block)}) + geometry(xml) + "</Piece>\n";
  return xml.file(kind, "WholeExtent=\"" + extent + "\" " + attributes, piece);
}

// --- PLOT3D

/// Records of numbers with their bytes in either order.
class Plot3dBytes {
 public:
  explicit Plot3dBytes(const Plot3dOptions& options) : options_(options) {}

  void integer(int value) { add(std::int32_t(value), record_); }
  void real(double value) {
    if (options_.double_precision)
      add(value, record_);
    else
      add(float(value), record_);
  }
  void endRecord() {
    const auto mark = std::int32_t(record_.size());
    if (options_.record_marks)
      add(mark, bytes_);
    bytes_ += record_;
    if (options_.record_marks)
      add(mark, bytes_);
    record_.clear();
  }
  const std::string& bytes() const { return bytes_; }

 private:
  template <typename T>
  void add(T value, std::string& to) const {
    if (options_.big_endian)
      appendBigEndian(to, value);
    else
      append(to, value);
  }

  Plot3dOptions options_;
  std::string record_;
  std::string bytes_;
};

void addPlot3dHead(const std::vector<Block>& blocks, const Plot3dOptions& options, Plot3dBytes& bytes) {
  if (options.block_count || blocks.size() > 1) {
    bytes.integer(int(blocks.size()));
    bytes.endRecord();
  }
  for (const Block& block : blocks) {
    for (int axis = 0; axis < 3; ++axis)
      bytes.integer(block.dims[axis]);
  }
  bytes.endRecord();
}

}  // namespace

IrregularGrid mixedGrid() {
  IrregularGrid grid = mixedCells();
  grid.point_scalars = counted(grid.vertexCount());
  return grid;
}

IrregularGrid mixedGridWithCellScalars() {
  IrregularGrid grid = mixedCells();
  grid.cell_scalars = counted(grid.cellCount());
  return grid;
}

FileContents::FileContents(const IrregularGrid& grid) {
  for (const Vector3f& p : grid.points)
    points.push_back(p.cast<double>());
  for (std::size_t c = 0; c < grid.cellCount(); ++c) {
    types.push_back(int(grid.cell_types[c]));
    cells.emplace_back(grid.connectivity.begin() + grid.cell_offsets[c],
                       grid.connectivity.begin() + grid.cell_offsets[c + 1]);
  }
  if (!grid.point_scalars.empty())
    point_arrays.push_back(scalarArray(grid.point_scalars));
  if (!grid.cell_scalars.empty())
    cell_arrays.push_back(scalarArray(grid.cell_scalars));
}

std::string legacyFile(const FileContents& contents) {
  return legacyFile(contents, "ASCII", [](const std::vector<double>& values, bool) { return joined(values); });
}

std::string binaryLegacyFile(const FileContents& contents) {
  return legacyFile(contents, "BINARY", [](const std::vector<double>& values, bool is_integer) {
    std::string bytes;
    for (const double value : values) {
      if (is_integer)
        appendBigEndian(bytes, std::int32_t(value));
      else
        appendBigEndian(bytes, float(value));
    }
    return bytes;
  });
}

std::string vtuFile(const FileContents& contents) {
  return vtu(contents, false);
}

std::string appendedVtuFile(const FileContents& contents) {
  return vtu(contents, true);
}

Vector3 Block::point(int i, int j, int k) const {
  return offset + Vector3(i + 0.125 * j * j, j + 0.25 * k, k + 0.0625 * i * i);
}

void Block::forEach(const std::function<void(int, int, int)>& visit) const {
  for (int k = 0; k < dims.z(); ++k) {
    for (int j = 0; j < dims.y(); ++j) {
      for (int i = 0; i < dims.x(); ++i)
        visit(i, j, k);
    }
  }
}

std::string legacyStructuredFile(const Block& block) {
  return legacyHead("STRUCTURED_GRID", block) + "POINTS " + std::to_string(block.count()) + " float\n" +
         joined(flat(pointsOf(block))) + "\n" + legacyScalars(block);
}

std::string legacyRectilinearFile(const Block& block) {
  std::string text = legacyHead("RECTILINEAR_GRID", block);
  for (int axis = 0; axis < 3; ++axis) {
    text += std::string(1, char('X' + axis)) + "_COORDINATES " + std::to_string(block.dims[axis]) + " float\n" +
            joined(coordinates(block.dims[axis])) + "\n";
  }
  return text + legacyScalars(block);
}

std::string legacyImageFile(const Block& block) {
  return legacyHead("STRUCTURED_POINTS", block) + "SPACING 0.5 0.25 2\nORIGIN 1 2 3\n" + legacyScalars(block);
}

std::string vtsFile(const Block& block) {
  return xmlStructured("StructuredGrid", block, "", [&](XmlArrays& xml) {
    return "<Points>\n" + xml.array("Float32", "Points", 3, flat(pointsOf(block))) + "</Points>\n";
  });
}

std::string vtrFile(const Block& block) {
  return xmlStructured("RectilinearGrid", block, "", [&](XmlArrays& xml) {
    std::string text = "<Coordinates>\n";
    for (int axis = 0; axis < 3; ++axis)
      text += xml.array("Float32", std::string(1, char('x' + axis)), 1, coordinates(block.dims[axis]));
    return text + "</Coordinates>\n";
  });
}

std::string vtiGridFile(const Block& block) {
  return xmlStructured("ImageData", block, "Origin=\"0 1.5 -1\" Spacing=\"0.5 0.25 2\"",
                       [](XmlArrays&) { return std::string(); });
}

std::string plot3dGrid(const std::vector<Block>& blocks, const Plot3dOptions& options) {
  Plot3dBytes bytes(options);
  addPlot3dHead(blocks, options, bytes);
  for (const Block& block : blocks) {
    for (int axis = 0; axis < 3; ++axis)
      block.forEach([&](int i, int j, int k) { bytes.real(block.point(i, j, k)[axis]); });
    for (const int blank : block.blanks)
      bytes.integer(blank);
    bytes.endRecord();
  }
  return bytes.bytes();
}

std::string plot3dSolution(const std::vector<Block>& blocks, const Plot3dOptions& options) {
  Plot3dBytes bytes(options);
  addPlot3dHead(blocks, options, bytes);
  for (const Block& block : blocks) {
    for (const double condition : {2.0, 0.0, 1e6, 0.0})  // Mach number, angle of attack, Reynolds number, time
      bytes.real(condition);
    bytes.endRecord();
    for (const double factor : {1.0, 3.0, 4.0, 12.0, 0.5})
      block.forEach([&](int i, int j, int k) { bytes.real(factor * Block::value(i, j, k)); });
    bytes.endRecord();
  }
  return bytes.bytes();
}

}  // namespace soft_volume::core::testing_grid
