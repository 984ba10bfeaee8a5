#include <vtkDataObject.h>
#include <vtkDataSet.h>
#include <vtkGenericDataObjectReader.h>
#include <vtkMultiBlockDataSet.h>
#include <vtkMultiBlockPLOT3DReader.h>
#include <vtkNew.h>
#include <vtkSmartPointer.h>
#include <vtkStructuredGrid.h>
#include <vtkXMLImageDataReader.h>
#include <vtkXMLRectilinearGridReader.h>
#include <vtkXMLStructuredGridReader.h>
#include <vtkXMLUnstructuredGridReader.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "formats.h"
#include "grid_arrays.h"
#include "grid_cells.h"
#include "header_text.h"
#include "image.h"
#include "reports.h"

namespace soft_volume::core::reader {
namespace {

using Blocks = std::vector<vtkSmartPointer<vtkDataSet>>;

// --- Files to VTK's data sets

vtkSmartPointer<vtkDataSet> dataSetOf(vtkDataObject* object) {
  vtkDataSet* set = vtkDataSet::SafeDownCast(object);
  if (set == nullptr) {
    throw ReadError(object == nullptr ? std::string("holds no data")
                                      : std::string("holds a ") + object->GetClassName() + ", not a grid of cells");
  }
  return set;
}

template <typename Reader>
Blocks readXml(const std::string& path, const Reports& reports) {
  checkXmlComponents(path);
  const vtkNew<Reader> reader;
  reader->SetFileName(path.c_str());
  reader->Update();
  reports.throwIfAny();
  return {dataSetOf(reader->GetOutputDataObject(0))};
}

/// VTK keeps only the first array of each kind unless it is told to read all.
Blocks readLegacy(const std::string& path, const Reports& reports) {
  const vtkNew<vtkGenericDataObjectReader> reader;
  reader->SetFileName(path.c_str());
  reader->ReadAllScalarsOn();
  reader->ReadAllVectorsOn();
  reader->ReadAllNormalsOn();
  reader->ReadAllTensorsOn();
  reader->ReadAllColorScalarsOn();
  reader->ReadAllTCoordsOn();
  reader->ReadAllFieldsOn();
  reader->Update();
  reports.throwIfAny();
  return {dataSetOf(reader->GetOutput())};
}

/// The detection of the format works for binary files only, and takes text for numbers.
void refuseText(const std::string& path) {
  std::string beginning(256, '\0');
  std::ifstream file(path, std::ios::binary);
  file.read(beginning.data(), std::streamsize(beginning.size()));
  beginning.resize(std::size_t(file.gcount()));
  const auto is_text = [](unsigned char c) { return (c >= 0x20 && c < 0x7F) || (c >= '\t' && c <= '\r'); };
  if (!beginning.empty() && std::all_of(beginning.begin(), beginning.end(), is_text))
    throw ReadError("is a text file; only binary PLOT3D is read");
}

/// Byte order, precision, record marks, blanking and the number of blocks are detected from the file's length.
Blocks readPlot3d(const std::string& path, const std::string& solution, const Reports& reports) {
  constexpr int kPressure = 110, kTemperature = 120, kVelocityMagnitude = 153;
  refuseText(path);
  const vtkNew<vtkMultiBlockPLOT3DReader> reader;
  reader->SetXYZFileName(path.c_str());
  reader->AutoDetectFormatOn();
  if (!solution.empty()) {
    checkFileHolds(solution, 0, 1);
    reader->SetQFileName(solution.c_str());
    for (const int function : {kPressure, kTemperature, kVelocityMagnitude})
      reader->AddFunction(function);
  }
  reader->Update();
  if (reports.mentions("Auto detection check failed"))
    throw ReadError("is no binary PLOT3D grid, or damaged: its length fits no byte order, precision and blanking");
  reports.throwIfAny();
  Blocks blocks;
  for (unsigned i = 0; i < reader->GetOutput()->GetNumberOfBlocks(); ++i)
    blocks.push_back(dataSetOf(reader->GetOutput()->GetBlock(i)));
  return blocks;
}

bool isPlot3d(const std::string& name) {
  const auto endings = {".xyz", ".x", ".p3d", ".bin", ".g", ".grd"};
  return std::any_of(endings.begin(), endings.end(), [&](const char* ending) { return endsWith(name, ending); });
}

Blocks readBlocks(const std::string& path, const std::string& solution, const Reports& reports) {
  const std::string name = lowerCase(path);
  if (isPlot3d(name))
    return readPlot3d(path, solution, reports);
  if (!solution.empty())
    throw ReadError("only PLOT3D has its solution in a second file, but " + solution + " was given");
  if (endsWith(name, ".vtk"))
    return readLegacy(path, reports);
  if (endsWith(name, ".vtu"))
    return readXml<vtkXMLUnstructuredGridReader>(path, reports);
  if (endsWith(name, ".vts"))
    return readXml<vtkXMLStructuredGridReader>(path, reports);
  if (endsWith(name, ".vtr"))
    return readXml<vtkXMLRectilinearGridReader>(path, reports);
  if (endsWith(name, ".vti"))
    return readXml<vtkXMLImageDataReader>(path, reports);
  throw ReadError(
      "the type of this file is not known; use .vtk, .vtu, .vts, .vtr, .vti or PLOT3D (.xyz, .x, .p3d, "
      ".bin, .g, .grd)");
}

// --- Data sets to a grid

/// What was seen while blocks were joined, besides their cells.
struct VertexTally {
  std::size_t used = 0;
  std::size_t unused = 0;
  std::size_t not_finite = 0;  ///< used ones
};

/// Numbers the vertices that cells use, in the block's order.
class VertexNumbers {
 public:
  VertexNumbers(const BlockCells& cells, vtkIdType points) : numbers_(std::size_t(points), kUnused) {
    forEachNumber(cells.types, cells.ends, cells.connectivity, [this](std::uint32_t v) { numbers_[v] = 0; });
    for (std::uint32_t& number : numbers_) {
      if (number != kUnused)
        number = used_++;
    }
  }

  std::uint32_t used() const { return used_; }
  std::uint32_t operator[](std::uint32_t point) const { return numbers_[point]; }
  /// Calls visit(point) for every used one.
  template <typename Visit>
  void forEachUsed(const Visit& visit) const {
    for (std::size_t point = 0; point < numbers_.size(); ++point) {
      if (numbers_[point] != kUnused)
        visit(vtkIdType(point));
    }
  }

  /// Calls visit(number) for all vertex numbers in a connectivity; `ends` per cell.
  template <typename Numbers, typename Visit>
  static void forEachNumber(const std::vector<CellType>& types, const std::vector<std::uint32_t>& ends,
                            Numbers& connectivity, const Visit& visit) {
    auto begin = connectivity.begin();
    for (std::size_t cell = 0; cell < types.size(); ++cell) {
      const auto end = connectivity.begin() + ends[cell];
      forEachVertex(types[cell], begin, end, visit);
      begin = end;
    }
  }

 private:
  static constexpr std::uint32_t kUnused = std::numeric_limits<std::uint32_t>::max();
  std::vector<std::uint32_t> numbers_;
  std::uint32_t used_ = 0;
};

void checkRoom(const IrregularGrid& grid, const BlockCells& cells, std::uint32_t vertices) {
  constexpr std::size_t kMost = std::numeric_limits<std::uint32_t>::max() - 1;
  if (grid.points.size() + vertices > kMost || grid.connectivity.size() + cells.connectivity.size() > kMost)
    throw ReadError("has more cells or points than 32-bit numbers can name; split it");
}

void appendCells(BlockCells& cells, const VertexNumbers& numbers, IrregularGrid& grid) {
  const auto base = static_cast<std::uint32_t>(grid.points.size());
  const auto first = static_cast<std::uint32_t>(grid.connectivity.size());
  VertexNumbers::forEachNumber(cells.types, cells.ends, cells.connectivity,
                               [&](std::uint32_t& number) { number = base + numbers[number]; });
  grid.cell_types.insert(grid.cell_types.end(), cells.types.begin(), cells.types.end());
  grid.connectivity.insert(grid.connectivity.end(), cells.connectivity.begin(), cells.connectivity.end());
  for (const std::uint32_t end : cells.ends)
    grid.cell_offsets.push_back(first + end);
}

void appendPoints(vtkDataSet* block, const VertexNumbers& numbers, IrregularGrid& grid, VertexTally& tally) {
  numbers.forEachUsed([&](vtkIdType point) {
    Vector3 place;
    block->GetPoint(point, place.data());
    grid.points.push_back(place.cast<float>());
    tally.not_finite += grid.points.back().allFinite() ? 0 : 1;
  });
  tally.used += numbers.used();
  tally.unused += std::size_t(block->GetNumberOfPoints()) - numbers.used();
}

void appendScalars(vtkDataSet* block, const GridArrays& arrays, const VertexNumbers& numbers, const BlockCells& cells,
                   IrregularGrid& grid) {
  vtkDataArray* array = arrays.in(block);
  if (arrays.takenArray().place == GridArray::Place::kPoints) {
    numbers.forEachUsed([&](vtkIdType point) { grid.point_scalars.push_back(arrays.value(array, point)); });
  } else {
    for (const vtkIdType cell : cells.numbers)
      grid.cell_scalars.push_back(arrays.value(array, cell));
  }
}

void appendBlock(vtkDataSet* block, const GridArrays& arrays, IrregularGrid& grid, CellTally& cell_tally,
                 VertexTally& tally) {
  BlockCells cells = cellsOf(block, cell_tally);
  const VertexNumbers numbers(cells, block->GetNumberOfPoints());
  checkRoom(grid, cells, numbers.used());
  appendCells(cells, numbers, grid);
  appendPoints(block, numbers, grid, tally);
  appendScalars(block, arrays, numbers, cells, grid);
}

std::size_t countNan(const std::vector<float>& scalars) {
  return std::size_t(std::count_if(scalars.begin(), scalars.end(), [](float s) { return std::isnan(s); }));
}

void addVertexNotes(const IrregularGrid& grid, const VertexTally& tally, std::vector<std::string>& notes) {
  if (tally.unused > 0)
    notes.push_back(std::to_string(tally.unused) + " vertices that no cell uses were left out");
  const std::size_t nan = countNan(grid.point_scalars) + countNan(grid.cell_scalars);
  if (nan > 0)
    notes.push_back(std::to_string(nan) + " scalars are not finite; nothing is drawn there");
}

/// A grid without cells is an error that carries the notes, which say where they went.
void checkResult(const GridFile& file, const VertexTally& tally) {
  if (file.grid.cell_types.empty()) {
    std::string reason = "holds no cells with a volume";
    for (const std::string& note : file.notes)
      reason += "; " + note;
    throw ReadError(reason);
  }
  if (tally.not_finite > 0) {
    throw ReadError(std::to_string(tally.not_finite) + " of the " + std::to_string(tally.used) +
                    " vertices that cells use are not finite (NaN, infinite or too large for float)");
  }
}

Blocks withoutEmptyBlocks(Blocks blocks) {
  const auto is_empty = [](vtkDataSet* block) { return block->GetNumberOfCells() <= 0; };
  blocks.erase(std::remove_if(blocks.begin(), blocks.end(), is_empty), blocks.end());
  if (blocks.empty())
    throw ReadError("holds no cells");
  return blocks;
}

GridArrays arraysOf(const Blocks& blocks, const std::string& path, const GridReadOptions& options) {
  if (isPlot3d(lowerCase(path)) && options.solution.empty())
    throw ReadError("holds no scalars: PLOT3D has them in a second file, so name the solution (Q) file, too");
  return {blocks, options};
}

}  // namespace

GridFile readGridFile(const std::string& path, const GridReadOptions& options) {
  const auto reports = startReports();
  const Blocks blocks = withoutEmptyBlocks(readBlocks(path, options.solution, *reports));
  const GridArrays arrays = arraysOf(blocks, path, options);
  GridFile file;
  file.arrays = arrays.all();
  file.taken = arrays.taken();
  file.grid.cell_offsets.push_back(0);
  CellTally cell_tally;
  VertexTally tally;
  for (vtkDataSet* block : blocks)
    appendBlock(block, arrays, file.grid, cell_tally, tally);
  reports->throwIfAny();
  file.notes = cell_tally.notes();
  addVertexNotes(file.grid, tally, file.notes);
  checkResult(file, tally);
  return file;
}

}  // namespace soft_volume::core::reader
