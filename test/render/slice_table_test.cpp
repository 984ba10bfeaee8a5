#include "soft_volume/render/slice_table.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <vector>

namespace soft_volume::core {
namespace {

bool isPositive(int signs, int vertex) {
  return (signs >> vertex & 1) != 0;
}

bool isCut(int signs, std::size_t edge) {
  return isPositive(signs, kHexahedronEdges[edge][0]) != isPositive(signs, kHexahedronEdges[edge][1]);
}

bool faceHasEdge(const std::array<std::uint8_t, 4>& face, std::size_t edge) {
  const auto has = [&](std::uint8_t vertex) { return std::find(face.begin(), face.end(), vertex) != face.end(); };
  return has(kHexahedronEdges[edge][0]) && has(kHexahedronEdges[edge][1]);
}

bool shareFace(std::size_t a, std::size_t b) {
  return std::any_of(kHexahedronFaces.begin(), kHexahedronFaces.end(),
                     [&](const auto& face) { return faceHasEdge(face, a) && faceHasEdge(face, b); });
}

std::vector<std::vector<std::size_t>> loopsOf(int signs) {
  const SliceLoops& loops = hexahedronSliceTable()[std::size_t(signs)];
  std::vector<std::vector<std::size_t>> result;
  const std::uint8_t* edge = loops.edges.data();
  for (int loop = 0; loop < loops.loop_count; ++loop) {
    result.emplace_back(edge, edge + loops.loop_sizes[std::size_t(loop)]);
    edge += loops.loop_sizes[std::size_t(loop)];
  }
  return result;
}

TEST(SliceTable, EveryCutEdgeIsInExactlyOneLoop) {
  for (int signs = 0; signs < 256; ++signs) {
    std::multiset<std::size_t> used;
    for (const auto& loop : loopsOf(signs))
      used.insert(loop.begin(), loop.end());
    for (std::size_t edge = 0; edge < 12; ++edge) {
      EXPECT_EQ(used.count(edge), isCut(signs, edge) ? 1U : 0U) << "signs " << signs << " edge " << edge;
    }
  }
}

TEST(SliceTable, LoopsCloseAlongFaces) {
  for (int signs = 0; signs < 256; ++signs) {
    for (const auto& loop : loopsOf(signs)) {
      ASSERT_GE(loop.size(), 3U) << "signs " << signs;
      for (std::size_t i = 0; i < loop.size(); ++i) {
        EXPECT_TRUE(shareFace(loop[i], loop[(i + 1) % loop.size()])) << "signs " << signs;
      }
    }
  }
}

TEST(SliceTable, PlainCasesAreOnePolygon) {
  EXPECT_EQ(loopsOf(0).size(), 0U);
  EXPECT_EQ(loopsOf(255).size(), 0U);
  EXPECT_EQ(loopsOf(1).at(0).size(), 3U);
  EXPECT_EQ(loopsOf(0xF0).at(0).size(), 4U) << "between bottom and top";
  EXPECT_EQ(loopsOf(0b00010111).at(0).size(), 6U) << "a corner and its three neighbours against the rest";
}

/// The segments that a cell draws on a face whose corners it sees as `signs`, as directed pairs of edges.
std::set<std::pair<std::size_t, std::size_t>> segmentsOn(std::size_t face, int signs) {
  std::set<std::pair<std::size_t, std::size_t>> segments;
  for (const auto& loop : loopsOf(signs)) {
    for (std::size_t i = 0; i < loop.size(); ++i) {
      const std::size_t next = loop[(i + 1) % loop.size()];
      if (faceHasEdge(kHexahedronFaces[face], loop[i]) && faceHasEdge(kHexahedronFaces[face], next)) {
        segments.insert({loop[i], next});
      }
    }
  }
  return segments;
}

TEST(SliceTable, FaceIsDecidedByItsOwnSignsAlone) {
  for (std::size_t face = 0; face < 6; ++face) {
    int mask = 0;
    for (const std::uint8_t vertex : kHexahedronFaces[face])
      mask |= 1 << vertex;
    for (int signs = 0; signs < 256; ++signs) {
      EXPECT_EQ(segmentsOn(face, signs), segmentsOn(face, signs & mask)) << "face " << face << " signs " << signs;
    }
  }
}

TEST(SliceTable, PositiveCornersOfAnAmbiguousFaceAreSeparated) {
  // Bottom face 0 3 2 1 with 0 and 2 positive: vertex 0 lies between edges 0 (0-1) and 3 (0-3), vertex 2 between 1
  // and 2.
  const auto segments = segmentsOn(4, 0b00000101);
  ASSERT_EQ(segments.size(), 2U);
  for (const auto& segment : segments) {
    const std::set<std::size_t> edges = {segment.first, segment.second};
    EXPECT_TRUE(edges == (std::set<std::size_t>{0, 3}) || edges == (std::set<std::size_t>{1, 2}));
  }
}

}  // namespace
}  // namespace soft_volume::core
