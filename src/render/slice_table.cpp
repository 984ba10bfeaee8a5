#include "soft_volume/render/slice_table.h"

#include <cassert>

namespace soft_volume::core {
namespace {

constexpr std::uint8_t kNone = 255;

/// For every cut edge the next one around its loop.
using NextEdge = std::array<std::uint8_t, 12>;

std::uint8_t edgeBetween(std::uint8_t a, std::uint8_t b) {
  for (std::uint8_t e = 0; e < kHexahedronEdges.size(); ++e) {
    const auto& edge = kHexahedronEdges[e];
    if ((edge[0] == a && edge[1] == b) || (edge[0] == b && edge[1] == a))
      return e;
  }
  assert(false && "face vertices without a common edge");
  return kNone;
}

/// The segments of one face: walking around it, every run of positive corners is cut off by the segment from the edge
/// where the run ends to the edge where it began. A neighbour walks the other way around, so each cut edge ends one
/// segment and starts another, and the segments of all faces close to loops.
void addFaceSegments(const std::array<std::uint8_t, 4>& face, int signs, NextEdge& next) {
  const auto positive = [&](int corner) { return (signs >> face[corner % 4] & 1) != 0; };
  const auto edgeAfter = [&](int corner) { return edgeBetween(face[corner % 4], face[(corner + 1) % 4]); };
  for (int begin = 0; begin < 4; ++begin) {
    if (positive(begin) || !positive(begin + 1))
      continue;
    int end = begin + 1;
    while (positive(end + 1))
      ++end;
    next[edgeAfter(end)] = edgeAfter(begin);
  }
}

SliceLoops walkLoops(NextEdge next) {
  SliceLoops loops;
  int count = 0;
  for (std::uint8_t start = 0; start < next.size(); ++start) {
    if (next[start] == kNone)
      continue;
    const int first = count;
    for (std::uint8_t edge = start; next[edge] != kNone;) {
      loops.edges[count++] = edge;
      const std::uint8_t following = next[edge];
      next[edge] = kNone;
      edge = following;
    }
    loops.loop_sizes[loops.loop_count++] = std::uint8_t(count - first);
  }
  return loops;
}

std::array<SliceLoops, 256> buildHexahedronTable() {
  std::array<SliceLoops, 256> table;
  for (int signs = 0; signs < 256; ++signs) {
    NextEdge next;
    next.fill(kNone);
    for (const auto& face : kHexahedronFaces)
      addFaceSegments(face, signs, next);
    table[std::size_t(signs)] = walkLoops(next);
  }
  return table;
}

}  // namespace

const std::array<SliceLoops, 256>& hexahedronSliceTable() {
  static const std::array<SliceLoops, 256> kTable = buildHexahedronTable();
  return kTable;
}

}  // namespace soft_volume::core
