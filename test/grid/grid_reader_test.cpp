#include "soft_volume/grid/grid_reader.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <limits>
#include <map>
#include <set>

#include "grid/grid_files.h"
#include "soft_volume/grid/hexahedron.h"
#include "volume/sample_files.h"

namespace soft_volume::core {
namespace {

using namespace testing_grid;
using testing_volume::TemporaryFolder;

void expectSameGrid(const IrregularGrid& got, const IrregularGrid& expected) {
  EXPECT_EQ(got.points, expected.points);
  EXPECT_EQ(got.cell_types, expected.cell_types);
  EXPECT_EQ(got.cell_offsets, expected.cell_offsets);
  EXPECT_EQ(got.connectivity, expected.connectivity);
  EXPECT_EQ(got.point_scalars, expected.point_scalars);
  EXPECT_EQ(got.cell_scalars, expected.cell_scalars);
}

/// The cells of a curvilinear grid as hexahedra, from the definition.
IrregularGrid hexahedraOf(const Block& block) {
  IrregularGrid grid;
  grid.cell_offsets = {0};
  block.forEach([&](int i, int j, int k) {
    grid.points.push_back(block.point(i, j, k).cast<float>());
    grid.point_scalars.push_back(float(Block::value(i, j, k)));
  });
  Block cells = block;
  cells.dims -= Vector3i::Ones();
  cells.forEach([&](int i, int j, int k) {
    grid.cell_types.push_back(CellType::kHexahedron);
    for (const auto& corner : kHexahedronCorners) {
      const int vertex = i + corner[0] + block.dims.x() * (j + corner[1] + block.dims.y() * (k + corner[2]));
      grid.connectivity.push_back(std::uint32_t(vertex));
    }
    grid.cell_offsets.push_back(std::uint32_t(grid.connectivity.size()));
  });
  return grid;
}

IrregularGrid voxelsOf(const Block& block) {
  IrregularGrid grid = hexahedraOf(block);
  grid.cell_types.assign(grid.cellCount(), CellType::kVoxel);
  for (std::size_t at = 0; at < grid.connectivity.size(); at += 4)
    std::swap(grid.connectivity[at + 2], grid.connectivity[at + 3]);
  return grid;
}

class ReadGrid : public testing::Test {
 protected:
  GridFile read(const std::string& name, const std::string& bytes, const GridReadOptions& options = {}) {
    return readGrid(folder_.write(name, bytes), options);
  }
  GridFile readPlot3d(const std::vector<Block>& blocks, const Plot3dOptions& format, GridReadOptions options = {}) {
    options.solution = folder_.write("a.q", plot3dSolution(blocks, format));
    return read("a.xyz", plot3dGrid(blocks, format), options);
  }

  TemporaryFolder folder_;
};

TEST_F(ReadGrid, MixedCellsFromEveryKindOfUnstructuredFile) {
  for (const IrregularGrid& grid : {mixedGrid(), mixedGridWithCellScalars()}) {
    const FileContents contents(grid);
    expectSameGrid(read("a b.vtu", vtuFile(contents)).grid, grid);
    expectSameGrid(read("b.vtu", appendedVtuFile(contents)).grid, grid);
    expectSameGrid(read("a.vtk", legacyFile(contents)).grid, grid);
    expectSameGrid(read("b.VTK", binaryLegacyFile(contents)).grid, grid);
  }
}

TEST_F(ReadGrid, OfAGoodFileHasNoNotes) {
  const GridFile file = read("a.vtu", vtuFile(FileContents(mixedGrid())));
  EXPECT_TRUE(file.notes.empty());
  ASSERT_EQ(file.arrays.size(), 1U);
  EXPECT_EQ(file.taken, 0U);
  EXPECT_EQ(file.arrays[0].name, "scalar");
  EXPECT_EQ(file.arrays[0].components, 1);
  EXPECT_EQ(file.arrays[0].place, GridArray::Place::kPoints);
  EXPECT_EQ(file.arrays[0].range, (std::array<double, 2>{-1.5, 0.25 * 25 - 1.5}));
}

TEST_F(ReadGrid, CurvilinearGridsAreHexahedra) {
  expectSameGrid(read("a.vtk", legacyStructuredFile({})).grid, hexahedraOf({}));
  expectSameGrid(read("a.vts", vtsFile({})).grid, hexahedraOf({}));
}

TEST_F(ReadGrid, RectilinearGridsAreHexahedra) {
  IrregularGrid expected = hexahedraOf({});
  for (std::size_t v = 0; v < expected.vertexCount(); ++v) {
    const Vector3f index(float(v % 3), float(v / 3 % 4), float(v / 12));
    expected.points[v] = 0.5F * index.cwiseProduct(index);
  }
  expectSameGrid(read("a.vtk", legacyRectilinearFile({})).grid, expected);
  expectSameGrid(read("a.vtr", vtrFile({})).grid, expected);
}

TEST_F(ReadGrid, RegularGridsAreVoxels) {
  IrregularGrid expected = voxelsOf({});
  const auto place = [&expected](const Vector3f& first) {
    for (std::size_t v = 0; v < expected.vertexCount(); ++v)
      expected.points[v] = first + Vector3f(0.5F * float(v % 3), 0.25F * float(v / 3 % 4), 2.0F * float(v / 12));
  };
  place({1, 2, 3});
  expectSameGrid(read("a.vtk", legacyImageFile({})).grid, expected);
  place({1, 2, 3});  // the origin is that of index 0, and the file begins at index 2
  expectSameGrid(read("a.vti", vtiGridFile({})).grid, expected);
}

TEST_F(ReadGrid, TurnedRegularGridsAreHexahedra) {
  const std::string turned =
      testing_volume::replaced(vtiGridFile({}), "Origin=", "Direction=\"0 -1 0 1 0 0 0 0 1\" Origin=");
  const IrregularGrid grid = read("a.vti", turned).grid;
  EXPECT_EQ(grid.cell_types, hexahedraOf({}).cell_types);
  EXPECT_EQ(grid.connectivity, hexahedraOf({}).connectivity);
  EXPECT_EQ(grid.points[1] - grid.points[0], Vector3f(0, 0.5F, 0));
}

TEST_F(ReadGrid, Plot3dInEveryFormat) {
  for (int format = 0; format < 16; ++format) {
    const Plot3dOptions options{(format & 1) != 0, (format & 2) != 0, (format & 4) != 0, (format & 8) != 0};
    SCOPED_TRACE("big endian " + std::to_string(options.big_endian) + ", double " +
                 std::to_string(options.double_precision) + ", marks " + std::to_string(options.record_marks) +
                 ", count " + std::to_string(options.block_count));
    const GridFile file = readPlot3d({Block{}}, options);
    expectSameGrid(file.grid, hexahedraOf({}));
    EXPECT_EQ(file.arrays[file.taken].name, "Density");
    EXPECT_TRUE(file.notes.empty());
  }
}

TEST_F(ReadGrid, Plot3dArraysByName) {
  const float density = float(Block::value(2, 3, 4));
  const auto last = [this](const std::string& array, int component = GridReadOptions::kMagnitude) {
    GridReadOptions options;
    options.array = array;
    options.component = component;
    return readPlot3d({Block{}}, {}, options).grid.point_scalars.back();
  };
  EXPECT_EQ(last("density"), density);
  EXPECT_EQ(last("Momentum"), 13.0F * density);
  EXPECT_EQ(last("Momentum", 1), 4.0F * density);
  EXPECT_EQ(last("StagnationEnergy"), 0.5F * density);
  EXPECT_FLOAT_EQ(last("Pressure"), 0.4F * (0.5F * density - 0.5F * 169.0F * density));  // (gamma - 1) (e - m v^2 / 2)
  EXPECT_FLOAT_EQ(last("VelocityMagnitude"), 13.0F);
}

TEST_F(ReadGrid, Plot3dBlankedPointsTakeTheirCellsAlong) {
  Block block;
  block.blanks.assign(block.count(), 1);
  block.blanks[0] = 0;                   // the corner (0, 0, 0) belongs to one cell
  block.blanks[1] = 2;                   // a wall
  block.blanks[block.count() - 1] = -7;  // interpolated from block 7: valid data
  for (const bool record_marks : {false, true}) {
    Plot3dOptions options;
    options.record_marks = record_marks;
    const GridFile file = readPlot3d({block}, options);
    EXPECT_EQ(file.grid.cellCount(), 2U * 3U * 4U - 1U);
    EXPECT_EQ(file.grid.vertexCount(), block.count() - 1);
    EXPECT_EQ(file.grid.point_scalars.front(), float(Block::value(1, 0, 0)));
    EXPECT_EQ(file.grid.point_scalars.back(), float(Block::value(2, 3, 4)));
    ASSERT_EQ(file.notes.size(), 2U);
    EXPECT_EQ(file.notes[0], "1 blanked or ghost cells were left out");
    EXPECT_EQ(file.notes[1], "1 vertices that no cell uses were left out");
  }
}

TEST_F(ReadGrid, Plot3dBlocksAreJoined) {
  Block second;
  second.dims = {2, 3, 2};
  second.offset = {10, 0, 0};
  const IrregularGrid grid = readPlot3d({Block{}, second}, {}).grid;
  const IrregularGrid a = hexahedraOf({});
  const IrregularGrid b = hexahedraOf(second);
  ASSERT_EQ(grid.cellCount(), a.cellCount() + b.cellCount());
  ASSERT_EQ(grid.vertexCount(), a.vertexCount() + b.vertexCount());
  EXPECT_EQ(grid.points[a.vertexCount() + 3], b.points[3]);
  EXPECT_EQ(grid.point_scalars[a.vertexCount() + 3], b.point_scalars[3]);
  EXPECT_EQ(grid.connectivity[a.connectivity.size() + 8], b.connectivity[8] + a.vertexCount());
}

TEST_F(ReadGrid, BluntFin) {
  const char* data = std::getenv("SOFT_VOLUME_DATA");
  const std::string folder =
      (data != nullptr ? std::string(data) : std::string(SOFT_VOLUME_SOURCE_DIR) + "/../shared/data") + "/blunt_fin/";
  if (!std::filesystem::exists(folder + "bluntfinxyz.bin"))
    GTEST_SKIP() << "the blunt fin is not in " << folder << "; name its parent folder in SOFT_VOLUME_DATA";
  GridReadOptions options;
  options.solution = folder + "bluntfinq.bin";
  const GridFile file = readGrid(folder + "bluntfinxyz.bin", options);
  EXPECT_EQ(file.grid.vertexCount(), 40U * 32U * 32U);
  EXPECT_EQ(file.grid.cellCount(), 39U * 31U * 31U);
  EXPECT_NEAR(file.arrays[file.taken].range[0], 0.193, 0.001);
  EXPECT_NEAR(file.arrays[file.taken].range[1], 4.978, 0.001);
  std::map<std::size_t, int> cells_by_places;  // along the fin's leading edge the grid's lines meet
  for (std::size_t cell = 0; cell < file.grid.cellCount(); ++cell) {
    std::set<std::array<float, 3>> places;
    for (std::size_t corner = 0; corner < 8; ++corner) {
      const Vector3f& p = file.grid.points[file.grid.connectivity[8 * cell + corner]];
      places.insert({p.x(), p.y(), p.z()});
    }
    ++cells_by_places[places.size()];
  }
  EXPECT_EQ(cells_by_places, (std::map<std::size_t, int>{{6, 38}, {7, 1}, {8, 39 * 31 * 31 - 39}}));
}

FileContents withVectors() {
  FileContents contents(mixedGrid());
  FileArray vectors{"velocity", 3, {}};
  for (std::size_t i = 0; i < contents.points.size(); ++i)
    vectors.values.insert(vectors.values.end(), {2.0 * double(i), -3.0 * double(i), 6.0 * double(i)});
  contents.point_arrays.push_back(vectors);
  FileArray age{"Age", 1, {}};
  for (std::size_t i = 0; i < contents.cells.size(); ++i)
    age.values.push_back(100.0 + double(i));
  contents.cell_arrays.push_back(age);
  return contents;
}

TEST_F(ReadGrid, ArraysAreListedAndChosen) {
  for (const std::string& bytes :
       {legacyFile(withVectors()), binaryLegacyFile(withVectors()), vtuFile(withVectors())}) {
    const std::string name = bytes[0] == '#' ? "a.vtk" : "a.vtu";
    const GridFile file = read(name, bytes);
    ASSERT_EQ(file.arrays.size(), 3U);
    EXPECT_EQ(file.arrays[file.taken].name, "scalar");
    EXPECT_EQ(file.arrays[1].name, "velocity");
    EXPECT_EQ(file.arrays[1].components, 3);
    EXPECT_EQ(file.arrays[1].range, (std::array<double, 2>{0.0, 7.0 * 25}));
    EXPECT_EQ(file.arrays[2].name, "Age");
    EXPECT_EQ(file.arrays[2].place, GridArray::Place::kCells);

    const GridFile magnitude = read(name, bytes, {"velocity", GridReadOptions::kMagnitude, ""});
    EXPECT_EQ(magnitude.taken, 1U);
    EXPECT_EQ(magnitude.grid.point_scalars[5], 35.0F);
    EXPECT_EQ(read(name, bytes, {"velocity", 1, ""}).grid.point_scalars[5], -15.0F);
    const GridFile age = read(name, bytes, {"age", GridReadOptions::kMagnitude, ""});
    EXPECT_EQ(age.grid.cell_scalars, (std::vector<float>{100, 101, 102, 103, 104, 105}));
    EXPECT_TRUE(age.grid.point_scalars.empty());
  }
}

TEST_F(ReadGrid, ActiveScalarsComeFirst) {
  FileContents contents = withVectors();
  const std::string marked =
      testing_volume::replaced(vtuFile(contents), "<PointData>", "<PointData Vectors=\"velocity\">");
  EXPECT_EQ(read("a.vtu", marked).taken, 0U);
  const std::string cells = testing_volume::replaced(vtuFile(contents), "<CellData>", "<CellData Scalars=\"Age\">");
  EXPECT_EQ(read("a.vtu", cells).taken, 2U);
}

TEST_F(ReadGrid, HigherOrderCellsAreLinearised) {
  FileContents contents(mixedGrid());
  contents.types[0] = 25;  // a quadratic hexahedron: 8 corners and 12 points in the middle of its edges
  contents.cells[0] = {0, 1, 3, 2, 4, 5, 7, 6};
  for (int i = 0; i < 12; ++i) {
    contents.cells[0].push_back(long(contents.points.size()));
    contents.points.emplace_back(50, 50, 50);
    contents.point_arrays[0].values.push_back(1e6);
  }
  IrregularGrid expected = mixedGrid();
  expected.cell_types[0] = CellType::kHexahedron;
  std::swap(expected.connectivity[2], expected.connectivity[3]);
  std::swap(expected.connectivity[6], expected.connectivity[7]);
  for (const std::string name : {"a.vtk", "a.vtu"}) {
    const GridFile file = read(name, name == "a.vtk" ? legacyFile(contents) : vtuFile(contents));
    expectSameGrid(file.grid, expected);
    ASSERT_EQ(file.notes.size(), 2U);
    EXPECT_EQ(file.notes[0], "1 quadratic hexahedra were linearised: only their corners count");
    EXPECT_EQ(file.notes[1], "12 vertices that no cell uses were left out");
  }
}

TEST_F(ReadGrid, CellsWithoutAVolumeAreLeftOut) {
  FileContents contents(mixedGrid());
  contents.types.insert(contents.types.begin(), {5, 9, 1, 6, 41});
  contents.cells.insert(contents.cells.begin(), {{0, 1, 2}, {0, 1, 3, 2}, {4}, {0, 1, 2, 3, 4}, {0, 1, 2, 4, 8}});
  for (const std::string name : {"a.vtk", "a.vtu"}) {
    const GridFile file = read(name, name == "a.vtk" ? legacyFile(contents) : vtuFile(contents));
    expectSameGrid(file.grid, mixedGrid());
    ASSERT_EQ(file.notes.size(), 2U);
    EXPECT_EQ(file.notes[0], "4 points, lines or surfaces were left out: only cells with a volume are drawn");
    EXPECT_EQ(file.notes[1], "1 cells without faces (convex point sets) were left out: write them as polyhedra");
  }
}

TEST_F(ReadGrid, GhostCellsAreLeftOut) {
  FileContents contents(mixedGridWithCellScalars());
  contents.cell_ghosts = {0, 0, 1, 0, 32, 0};  // a duplicate and a hidden cell
  const GridFile file = read("a.vtu", vtuFile(contents));
  EXPECT_EQ(file.grid.cell_types,
            (std::vector<CellType>{CellType::kVoxel, CellType::kHexahedron, CellType::kWedge, CellType::kPolyhedron}));
  EXPECT_EQ(file.grid.cell_scalars, (std::vector<float>{-1.5F, -1.25F, -0.75F, -0.25F}));
  EXPECT_EQ(file.arrays.size(), 1U);
  EXPECT_EQ(file.notes.front(), "2 blanked or ghost cells were left out");
}

TEST_F(ReadGrid, PrismsBecomePolyhedra) {
  FileContents contents;
  for (const double z : {0.0, 1.0}) {
    for (const auto& [x, y] : {std::pair<double, double>{0, 0}, {2, 0}, {3, 1}, {2, 2}, {0, 2}, {-1, 1}})
      contents.points.emplace_back(x, y, z);
  }
  contents.types = {16};
  contents.cells = {{0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11}};
  contents.point_arrays.push_back({"s", 1, std::vector<double>(12, 1.0)});
  const IrregularGrid grid = read("a.vtu", vtuFile(contents)).grid;
  ASSERT_EQ(grid.cell_types, std::vector<CellType>{CellType::kPolyhedron});
  EXPECT_EQ(grid.connectivity[0], 8U);
  EXPECT_EQ(grid.connectivity.size(), 1U + 2U * 7U + 6U * 5U);
}

/// Six times the volume that the faces of a polyhedron enclose, from its face stream.
double sixfoldVolume(const IrregularGrid& grid) {
  double sum = 0.0;
  for (std::size_t at = 1; at < grid.connectivity.size(); at += 1 + grid.connectivity[at]) {
    const auto p = [&](std::size_t i) { return grid.points[grid.connectivity[at + 1 + i]]; };
    for (std::size_t i = 1; i + 1 < grid.connectivity[at]; ++i)
      sum += double(p(0).dot(p(i).cross(p(i + 1))));
  }
  return sum;
}

TEST_F(ReadGrid, FacesOfPolyhedraAreTurnedOutward) {
  FileContents contents;
  for (int v = 0; v < 8; ++v)
    contents.points.emplace_back(v & 1, v >> 1 & 1, v >> 2);
  contents.point_arrays.push_back({"s", 1, std::vector<double>(8, 1.0)});
  contents.types = {42};
  const std::vector<std::vector<long>> outward = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                                  {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};
  for (unsigned turned = 0; turned < 64; ++turned) {
    contents.cells = {{6}};
    for (std::size_t f = 0; f < 6; ++f) {
      std::vector<long> face = outward[f];
      if ((turned >> f & 1U) != 0)
        std::reverse(face.begin(), face.end());
      contents.cells[0].push_back(4);
      contents.cells[0].insert(contents.cells[0].end(), face.begin(), face.end());
    }
    EXPECT_EQ(sixfoldVolume(read("a.vtu", vtuFile(contents)).grid), 6.0) << turned;
  }
}

TEST_F(ReadGrid, OpenPolyhedraAreLeftOut) {
  FileContents contents(mixedGrid());
  contents.types.push_back(42);
  contents.cells.push_back({4, 3, 0, 1, 2, 3, 0, 1, 4, 3, 1, 2, 4, 3, 0, 4, 1});  // the last face is there twice
  const GridFile file = read("a.vtu", vtuFile(contents));
  expectSameGrid(file.grid, mixedGrid());
  EXPECT_EQ(file.notes.front(), "1 polyhedra were left out because their faces do not close");
}

TEST_F(ReadGrid, RepeatedVerticesOfAPolyhedronAreDropped) {
  FileContents contents(mixedGrid());
  const std::size_t last = contents.cells.size() - 1;
  auto& stream = contents.cells[last];
  stream[1] = 5;  // the first face names its first vertex twice
  stream.insert(stream.begin() + 2, stream[2]);
  stream[0] = 8;  // and a face has collapsed to a line
  stream.insert(stream.end(), {3, 16, 17, 16});
  expectSameGrid(read("a.vtu", vtuFile(contents)).grid, mixedGrid());
}

TEST_F(ReadGrid, CellsOfZeroVolumeStay) {
  FileContents contents(mixedGrid());
  contents.points[15] = contents.points[13];  // flattens the tetrahedron
  contents.points[12] = contents.points[8];   // and the pyramid
  const IrregularGrid grid = read("a.vtk", legacyFile(contents)).grid;
  EXPECT_EQ(grid.cell_types, mixedGrid().cell_types);
  EXPECT_EQ(grid.points[15], grid.points[13]);
}

TEST_F(ReadGrid, ScalarsThatAreNotFiniteBecomeNan) {
  FileContents contents(mixedGrid());
  auto& values = contents.point_arrays[0].values;
  values[2] = std::nan("");
  values[4] = std::numeric_limits<double>::infinity();
  for (const std::string name : {"a.vtk", "a.vtu"}) {
    const GridFile file = read(name, name == "a.vtk" ? binaryLegacyFile(contents) : appendedVtuFile(contents));
    EXPECT_TRUE(std::isnan(file.grid.point_scalars[2]));
    EXPECT_TRUE(std::isnan(file.grid.point_scalars[4]));
    EXPECT_EQ(file.grid.point_scalars[3], -0.75F);
    EXPECT_EQ(file.arrays[0].range[1], 0.25 * 25 - 1.5);
    ASSERT_EQ(file.notes.size(), 1U);
    EXPECT_EQ(file.notes[0], "2 scalars are not finite; nothing is drawn there");
  }
}

TEST_F(ReadGrid, UnusedVerticesMayBeNan) {
  FileContents contents(mixedGrid());
  contents.points.insert(contents.points.begin() + 5, Vector3::Constant(std::nan("")));
  contents.point_arrays[0].values.insert(contents.point_arrays[0].values.begin() + 5, 77.0);
  for (auto& cell : contents.cells) {
    const bool is_stream = &cell == &contents.cells.back();
    std::size_t next_count = is_stream ? 1 : cell.size();
    for (std::size_t i = is_stream ? 1 : 0; i < cell.size(); ++i) {
      if (i == next_count)
        next_count += std::size_t(cell[i]) + 1;
      else
        cell[i] += cell[i] >= 5 ? 1 : 0;
    }
  }
  expectSameGrid(read("a.vtk", binaryLegacyFile(contents)).grid, mixedGrid());
}

}  // namespace
}  // namespace soft_volume::core
