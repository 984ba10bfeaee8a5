#include "soft_volume/render/slice_table.h"

#include <algorithm>
#include <cassert>

namespace soft_volume::core {
namespace {

constexpr std::uint8_t kNone = 255;

/// For every cut edge the next one around its loop.
using NextEdge = std::array<std::uint8_t, 12>;
using Table = std::array<SliceLoops, 256>;

std::uint8_t edgeBetween(const CellShape& shape, std::uint8_t a, std::uint8_t b) {
  for (std::uint8_t e = 0; e < shape.edge_count; ++e) {
    const auto& edge = shape.edges[e];
    if ((edge[0] == a && edge[1] == b) || (edge[0] == b && edge[1] == a))
      return e;
  }
  assert(false && "face vertices without a common edge");
  return kNone;
}

/// The segments of one face: walking around it, every run of positive corners is cut off by the segment from the edge
/// where the run ends to the edge where it began. A neighbour walks the other way around, so each cut edge ends one
/// segment and starts another, and the segments of all faces close to loops.
void addFaceSegments(const CellShape& shape, std::size_t face, unsigned signs, NextEdge& next) {
  const std::size_t size = shape.face_sizes[face];
  const auto vertex = [&](std::size_t corner) { return shape.faces[face][corner % size]; };
  const auto positive = [&](std::size_t corner) { return (signs >> vertex(corner) & 1) != 0; };
  const auto edgeAfter = [&](std::size_t corner) { return edgeBetween(shape, vertex(corner), vertex(corner + 1)); };
  for (std::size_t begin = 0; begin < size; ++begin) {
    if (positive(begin) || !positive(begin + 1))
      continue;
    std::size_t end = begin + 1;
    while (positive(end + 1))
      ++end;
    next[edgeAfter(end)] = edgeAfter(begin);
  }
}

SliceLoops walkLoops(NextEdge next) {
  SliceLoops loops;
  std::size_t count = 0;
  for (std::uint8_t start = 0; start < next.size(); ++start) {
    if (next[start] == kNone)
      continue;
    const std::size_t first = count;
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

Table buildTable(CellType type) {
  const CellShape& shape = shapeOf(type);
  Table table;
  for (unsigned signs = 0; signs < 1U << shape.vertex_count; ++signs) {
    NextEdge next;
    next.fill(kNone);
    for (std::size_t face = 0; face < shape.face_count; ++face)
      addFaceSegments(shape, face, signs, next);
    table[signs] = walkLoops(next);
  }
  return table;
}

template <CellType kType>
const Table& tableOf() {
  static const Table kTable = buildTable(kType);
  return kTable;
}

}  // namespace

const SliceLoops* sliceTable(CellType type) {
  switch (type) {
    case CellType::kTetrahedron:
      return tableOf<CellType::kTetrahedron>().data();
    case CellType::kVoxel:
      return tableOf<CellType::kVoxel>().data();
    case CellType::kHexahedron:
      return tableOf<CellType::kHexahedron>().data();
    case CellType::kWedge:
      return tableOf<CellType::kWedge>().data();
    case CellType::kPyramid:
      return tableOf<CellType::kPyramid>().data();
    default:
      shapeOf(type);  // throws
      return nullptr;
  }
}

}  // namespace soft_volume::core
