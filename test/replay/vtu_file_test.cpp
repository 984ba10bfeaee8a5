#include "vtu_file.h"

#include <gtest/gtest.h>

#include <fstream>
#include <iterator>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/grid_reader.h"
#include "test_folder.h"

namespace soft_volume {
namespace {

using core::CellType;
using core::GridArray;
using core::GridFile;
using core::Vector3f;

/// A row of unit cubes along x: hexahedra, with a polyhedron of the same shape in place of the second and nothing in
/// place of the third.
core::Topology makeRow(std::uint32_t cells) {
  core::Topology topology;
  for (std::uint32_t x = 0; x <= cells; ++x) {
    for (const Vector3f& corner : {Vector3f(0, 0, 0), Vector3f(0, 1, 0), Vector3f(0, 1, 1), Vector3f(0, 0, 1)})
      topology.rest_positions.push_back(corner + Vector3f(float(x), 0, 0));
  }
  topology.fixed.assign(topology.vertexCount(), 0);
  topology.fixed[0] = 1;
  for (std::uint32_t cell = 0; cell < cells; ++cell) {
    const std::uint32_t a = 4 * cell;
    const std::uint32_t b = a + 4;
    topology.cell_offsets.push_back(std::uint32_t(topology.connectivity.size()));
    topology.materials.push_back(std::uint16_t(cell % 3));
    topology.parent_cells.push_back(100 + cell);
    const std::vector<std::uint32_t> hexahedron = {a, b, b + 1, a + 1, a + 3, b + 3, b + 2, a + 2};
    const std::vector<std::uint32_t> stream = {6, 4,     a,     a + 3, a + 2, a + 1, 4,     b,     b + 1, b + 2, b + 3,
                                               4, a,     b,     b + 3, a + 3, 4,     a + 1, a + 2, b + 2, b + 1, 4,
                                               a, a + 1, b + 1, b,     4,     a + 3, b + 3, b + 2, a + 2};
    const CellType type = cell == 1 ? CellType::kPolyhedron : cell == 2 ? CellType::kEmpty : CellType::kHexahedron;
    topology.cell_types.push_back(type);
    if (type != CellType::kEmpty) {
      const auto& numbers = type == CellType::kPolyhedron ? stream : hexahedron;
      topology.connectivity.insert(topology.connectivity.end(), numbers.begin(), numbers.end());
    }
  }
  topology.cell_offsets.push_back(std::uint32_t(topology.connectivity.size()));
  return topology;
}

/// Sheared along z by how far right it is.
std::vector<Vector3f> sheared(const core::Topology& topology) {
  std::vector<Vector3f> positions = topology.rest_positions;
  for (Vector3f& p : positions)
    p.z() += 0.25F * p.x();
  return positions;
}

GridFile readBack(const std::string& path, const std::string& array, int component = 0) {
  core::GridReadOptions options;
  options.array = array;
  options.component = component;
  return core::readGrid(path, options);
}

TEST(VtuFile, IsReadBackByVtk) {
  const TestFolder folder;
  const core::Topology topology = makeRow(5);
  writeVtu(folder / "row.vtu", deformedGrid(topology, sheared(topology)));
  const GridFile file = readBack(folder / "row.vtu", "displacement", 2);
  EXPECT_TRUE(file.notes.empty()) << file.notes.front();
  EXPECT_EQ(file.grid.points, sheared(topology));
  EXPECT_EQ(file.grid.cell_types, (std::vector<CellType>{CellType::kHexahedron, CellType::kPolyhedron,
                                                         CellType::kHexahedron, CellType::kHexahedron}));
  ASSERT_EQ(file.grid.point_scalars.size(), topology.vertexCount());
  for (std::size_t v = 0; v < topology.vertexCount(); ++v)
    EXPECT_EQ(file.grid.point_scalars[v], 0.25F * topology.rest_positions[v].x());
  // Hexahedron and polyhedron as they were; the empty cell had no numbers.
  EXPECT_EQ(file.grid.connectivity, topology.connectivity);
}

TEST(VtuFile, HoldsWhatBelongsToCells) {
  const TestFolder folder;
  const core::Topology topology = makeRow(5);
  writeVtu(folder / "row.vtu", deformedGrid(topology, topology.rest_positions));
  EXPECT_EQ(readBack(folder / "row.vtu", "material").grid.cell_scalars, (std::vector<float>{0, 1, 0, 1}));
  EXPECT_EQ(readBack(folder / "row.vtu", "lattice_cell").grid.cell_scalars, (std::vector<float>{100, 101, 103, 104}));
  const GridFile fixed = readBack(folder / "row.vtu", "fixed");
  EXPECT_EQ(fixed.grid.point_scalars[0], 1.0F);
  EXPECT_EQ(fixed.grid.point_scalars[1], 0.0F);
}

/// Arrays of several compressed blocks.
TEST(VtuFile, HoldsLargeGrids) {
  const TestFolder folder;
  const core::Topology topology = makeRow(50000);
  writeVtu(folder / "row.vtu", deformedGrid(topology, sheared(topology)));
  const GridFile file = readBack(folder / "row.vtu", "displacement", 2);
  EXPECT_EQ(file.grid.points, sheared(topology));
  EXPECT_EQ(file.grid.connectivity, topology.connectivity);
}

TEST(VtuFile, RefusesWhatDoesNotFit) {
  const core::Topology topology = makeRow(5);
  EXPECT_THROW(deformedGrid(topology, {}), core::InputError);
  EXPECT_THROW(writeVtu("/no/such/folder/row.vtu", pointGrid({Vector3f::Zero()})), core::FileError);
}

TEST(PvdFile, NamesFilesAndTimes) {
  const TestFolder folder;
  writePvd(folder / "series.pvd", {{0.0, "a.vtu"}, {0.1, "b.vtu"}}, "a -- remark");
  std::ifstream file(folder / "series.pvd");
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  EXPECT_NE(text.find("<DataSet timestep=\"0.1\" part=\"0\" file=\"b.vtu\"/>"), std::string::npos) << text;
  EXPECT_EQ(text.find("a -- remark"), std::string::npos) << "two hyphens end a comment";
}

}  // namespace
}  // namespace soft_volume
