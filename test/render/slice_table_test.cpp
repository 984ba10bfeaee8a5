#include "soft_volume/render/slice_table.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <vector>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr std::array<CellType, 5> kTypes = {CellType::kTetrahedron, CellType::kVoxel, CellType::kHexahedron,
                                            CellType::kWedge, CellType::kPyramid};

unsigned signCount(CellType type) {
  return 1U << shapeOf(type).vertex_count;
}

bool isPositive(unsigned signs, std::size_t vertex) {
  return (signs >> vertex & 1) != 0;
}

bool isCut(CellType type, unsigned signs, std::size_t edge) {
  const auto& ends = shapeOf(type).edges[edge];
  return isPositive(signs, ends[0]) != isPositive(signs, ends[1]);
}

bool faceHasVertex(CellType type, std::size_t face, std::uint8_t vertex) {
  const auto& vertices = shapeOf(type).faces[face];
  const auto end = vertices.begin() + shapeOf(type).face_sizes[face];
  return std::find(vertices.begin(), end, vertex) != end;
}

bool faceHasEdge(CellType type, std::size_t face, std::size_t edge) {
  const auto& ends = shapeOf(type).edges[edge];
  return faceHasVertex(type, face, ends[0]) && faceHasVertex(type, face, ends[1]);
}

bool shareFace(CellType type, std::size_t a, std::size_t b) {
  for (std::size_t face = 0; face < shapeOf(type).face_count; ++face) {
    if (faceHasEdge(type, face, a) && faceHasEdge(type, face, b))
      return true;
  }
  return false;
}

std::vector<std::vector<std::size_t>> loopsOf(CellType type, unsigned signs) {
  const SliceLoops& loops = sliceTable(type)[signs];
  std::vector<std::vector<std::size_t>> result;
  const std::uint8_t* edge = loops.edges.data();
  for (std::size_t loop = 0; loop < loops.loop_count; ++loop) {
    result.emplace_back(edge, edge + loops.loop_sizes[loop]);
    edge += loops.loop_sizes[loop];
  }
  return result;
}

class SliceTable : public testing::TestWithParam<CellType> {};

TEST_P(SliceTable, EveryCutEdgeIsInExactlyOneLoop) {
  for (unsigned signs = 0; signs < signCount(GetParam()); ++signs) {
    std::multiset<std::size_t> used;
    for (const auto& loop : loopsOf(GetParam(), signs))
      used.insert(loop.begin(), loop.end());
    for (std::size_t edge = 0; edge < shapeOf(GetParam()).edge_count; ++edge) {
      EXPECT_EQ(used.count(edge), isCut(GetParam(), signs, edge) ? 1U : 0U) << "signs " << signs << " edge " << edge;
    }
  }
}

TEST_P(SliceTable, LoopsCloseAlongFaces) {
  for (unsigned signs = 0; signs < signCount(GetParam()); ++signs) {
    for (const auto& loop : loopsOf(GetParam(), signs)) {
      ASSERT_GE(loop.size(), 3U) << "signs " << signs;
      for (std::size_t i = 0; i < loop.size(); ++i) {
        EXPECT_TRUE(shareFace(GetParam(), loop[i], loop[(i + 1) % loop.size()])) << "signs " << signs;
      }
    }
  }
}

using Segments = std::set<std::pair<std::size_t, std::size_t>>;

/// The segments that a cell draws on a face whose corners it sees as `signs`, as directed pairs of edges.
Segments segmentsOn(CellType type, std::size_t face, unsigned signs) {
  Segments segments;
  for (const auto& loop : loopsOf(type, signs)) {
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const std::size_t next = loop[(i + 1) % loop.size()];
      if (faceHasEdge(type, face, loop[i]) && faceHasEdge(type, face, next))
        segments.insert({loop[i], next});
    }
  }
  return segments;
}

TEST_P(SliceTable, FaceIsDecidedByItsOwnSignsAlone) {
  for (std::size_t face = 0; face < shapeOf(GetParam()).face_count; ++face) {
    unsigned mask = 0;
    for (std::uint8_t v = 0; v < shapeOf(GetParam()).vertex_count; ++v)
      mask |= unsigned(faceHasVertex(GetParam(), face, v)) << v;
    for (unsigned signs = 0; signs < signCount(GetParam()); ++signs) {
      EXPECT_EQ(segmentsOn(GetParam(), face, signs), segmentsOn(GetParam(), face, signs & mask))
          << "face " << face << " signs " << signs;
    }
  }
}

/// The edge numbers around a face: side i lies between its corners i and i + 1.
std::vector<std::size_t> sidesOf(CellType type, std::size_t face) {
  const CellShape& shape = shapeOf(type);
  std::vector<std::size_t> sides;
  for (std::size_t i = 0; i < shape.face_sizes[face]; ++i) {
    const std::uint8_t a = shape.faces[face][i];
    const std::uint8_t b = shape.faces[face][(i + 1) % shape.face_sizes[face]];
    for (std::size_t edge = 0; edge < shape.edge_count; ++edge) {
      if (shape.edges[edge] == std::array<std::uint8_t, 2>{a, b} ||
          shape.edges[edge] == std::array<std::uint8_t, 2>{b, a})
        sides.push_back(edge);
    }
  }
  return sides;
}

/// All faces with as many corners are decided alike, from whichever corner they start: what makes neighbours of any
/// types fit. Written down by hand: corner 0 positive, and corners 0 and 2 of a quadrilateral, each cut off on its own.
TEST_P(SliceTable, PositiveCornersAreCutOffAlikeOnEveryFace) {
  const CellShape& shape = shapeOf(GetParam());
  for (std::size_t face = 0; face < shape.face_count; ++face) {
    const std::vector<std::size_t> side = sidesOf(GetParam(), face);
    const std::size_t size = shape.face_sizes[face];
    ASSERT_EQ(side.size(), size);
    const auto& vertex = shape.faces[face];
    for (std::size_t i = 0; i < size; ++i) {
      const std::size_t before = side[(i + size - 1) % size];
      EXPECT_EQ(segmentsOn(GetParam(), face, 1U << vertex[i]), (Segments{{side[i], before}}));
      if (size != 4)
        continue;
      const std::size_t opposite = (i + 2) % 4;
      EXPECT_EQ(segmentsOn(GetParam(), face, 1U << vertex[i] | 1U << vertex[opposite]),
                (Segments{{side[i], before}, {side[opposite], side[(i + 1) % 4]}}));
    }
  }
}

INSTANTIATE_TEST_SUITE_P(AllTypes, SliceTable, testing::ValuesIn(kTypes),
                         [](const auto& type) { return "Vtk" + std::to_string(int(type.param)); });

/// Sizes of the loops.
std::vector<std::size_t> sizesOf(CellType type, unsigned signs) {
  std::vector<std::size_t> sizes;
  for (const auto& loop : loopsOf(type, signs))
    sizes.push_back(loop.size());
  return sizes;
}

TEST(SliceTables, PlainCasesAreOnePolygon) {
  using Sizes = std::vector<std::size_t>;
  for (const CellType type : kTypes) {
    EXPECT_EQ(sizesOf(type, 0), Sizes{});
    EXPECT_EQ(sizesOf(type, signCount(type) - 1), Sizes{});
    EXPECT_EQ(sizesOf(type, 1), Sizes{3});
  }
  EXPECT_EQ(sizesOf(CellType::kTetrahedron, 0b0011), Sizes{4});
  EXPECT_EQ(sizesOf(CellType::kHexahedron, 0xF0), Sizes{4}) << "between bottom and top";
  EXPECT_EQ(sizesOf(CellType::kVoxel, 0xF0), Sizes{4});
  EXPECT_EQ(sizesOf(CellType::kWedge, 0b111000), Sizes{3});
  EXPECT_EQ(sizesOf(CellType::kPyramid, 0b10000), Sizes{4});
  EXPECT_EQ(sizesOf(CellType::kHexahedron, 0b00011011), Sizes{6}) << "a corner and its neighbours against the rest";
  EXPECT_EQ(sizesOf(CellType::kHexahedron, 0b01011010), (Sizes{3, 3, 3, 3})) << "every second corner (figure 3.8)";
  EXPECT_THROW(sliceTable(CellType::kPolyhedron), InputError);
}

}  // namespace
}  // namespace soft_volume::core
