#include "soft_volume/grid/topology_delta.h"

#include <gtest/gtest.h>

#include <functional>

#include "incision/topology_cases.h"
#include "soft_volume/common/error.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

constexpr int kCells = 6;
constexpr unsigned kSeed = 11;

Topology topologyOf(const EmbeddedBlock& block) {
  return makeTopology(block.mesh, block.lattice, volumeAround(kCells), 7);
}

/// Every cell as one list of all that a topology says of it.
std::vector<std::vector<std::int64_t>> cellsOf(const Topology& topology) {
  std::vector<std::vector<std::int64_t>> cells(topology.cellCount());
  std::size_t face = 0;
  for (std::size_t cell = 0; cell < cells.size(); ++cell) {
    const std::uint32_t* begin = topology.connectivity.data() + topology.cell_offsets[cell];
    cells[cell] = {std::int64_t(topology.cell_types[cell]), topology.materials[cell]};
    cells[cell].insert(cells[cell].end(), begin, topology.connectivity.data() + topology.cell_offsets[cell + 1]);
    for (std::size_t end = face + faceCount(topology.cell_types[cell], begin); face < end; ++face)
      cells[cell].insert(cells[cell].end(), {topology.face_neighbours[face], topology.cut_faces[face]});
  }
  return cells;
}

std::vector<std::uint32_t> changedCells(const Topology& before, const Topology& after) {
  const auto old_cells = cellsOf(before);
  const auto new_cells = cellsOf(after);
  std::vector<std::uint32_t> changed;
  for (std::uint32_t cell = 0; cell < old_cells.size(); ++cell) {
    if (old_cells[cell] != new_cells[cell])
      changed.push_back(cell);
  }
  return changed;
}

TopologyMark markOf(const Topology& topology) {
  return {topology.revision, topology.vertexCount(), topology.cellCount()};
}

TopologyDelta deltaTo(const EmbeddedBlock& block, const Topology& before) {
  return makeTopologyDelta(block.mesh, block.lattice, volumeAround(kCells), 7, markOf(before),
                           changedCells(before, topologyOf(block)));
}

/// A block, what is known of it, and a delta that changes that.
struct Change {
  Change() : block(Vector3i::Constant(kCells)), before(topologyOf(block)) {
    block.cutAndFollow({squareQuad(Vector3(3, 3, 2.4) * kH, Vector3(0.3, 0.2, 1.0), 1.6 * kH)});
    after = topologyOf(block);
    delta = deltaTo(block, before);
  }
  EmbeddedBlock block;
  Topology before;
  Topology after;
  TopologyDelta delta;
};

TEST(TopologyDelta, LeadsToTheFullTopologyBitForBit) {
  for (unsigned n = 0; n < unsigned(caseCount(12)); ++n) {
    std::mt19937 random(kSeed + n);
    EmbeddedBlock block(Vector3i::Constant(kCells));
    Topology sent = topologyOf(block);
    TopologyDecoder decoder;
    decoder.apply(sent);
    for (int cuts = 0; cuts < 8; ++cuts) {
      cutAtRandom(block, 1, random);
      const TopologyDelta delta = deltaTo(block, sent);
      const Topology full = topologyOf(block);
      if (full.revision == sent.revision)
        continue;
      ASSERT_EQ(decoder.apply(delta), TopologyDecoder::Result::kApplied);
      ASSERT_NO_FATAL_FAILURE(expectSame(*decoder.topology(), full));
      sent = full;
    }
    EXPECT_GT(sent.revision, 3U);
  }
}

TEST(TopologyDelta, NamesWhatTheCutTouchedAlone) {
  const Change change;
  EXPECT_LT(change.delta.cell_ids.size(), change.after.cellCount() / 2);
  EXPECT_EQ(change.delta.vertex_ids.size(), change.after.vertexCount() - change.before.vertexCount());
}

TEST(TopologyDelta, WaitsForAFullOneWhereItDoesNotFit) {
  const Change change;
  TopologyDecoder decoder;
  EXPECT_EQ(decoder.apply(change.delta), TopologyDecoder::Result::kNeedsFull);
  EXPECT_EQ(decoder.topology(), nullptr);
  decoder.apply(change.before);
  TopologyDelta later = change.delta;
  later.base_revision = change.after.revision;
  later.entries.revision = change.after.revision + 1;
  EXPECT_EQ(decoder.apply(later), TopologyDecoder::Result::kNeedsFull);
  TopologyDelta other = change.delta;
  other.entries.session = 8;
  EXPECT_EQ(decoder.apply(other), TopologyDecoder::Result::kNeedsFull);
  ASSERT_NO_FATAL_FAILURE(expectSame(*decoder.topology(), change.before));
  EXPECT_EQ(decoder.apply(change.delta), TopologyDecoder::Result::kApplied);
  EXPECT_EQ(decoder.apply(change.delta), TopologyDecoder::Result::kKnown);
  EXPECT_EQ(decoder.apply(change.after), TopologyDecoder::Result::kKnown);
  ASSERT_NO_FATAL_FAILURE(expectSame(*decoder.topology(), change.after));
}

TEST(TopologyDelta, MalformedOnesAreRefusedAndChangeNothing) {
  const Change change;
  TopologyDecoder decoder;
  decoder.apply(change.before);
  const auto refused = [&](const std::function<void(TopologyDelta&)>& spoil, const std::string& reason) {
    TopologyDelta bad = change.delta;
    spoil(bad);
    try {
      decoder.apply(bad);
      ADD_FAILURE() << "accepted; expected: " << reason;
    } catch (const InputError& error) {
      EXPECT_NE(std::string(error.what()).find(reason), std::string::npos) << error.what();
    }
    expectSame(*decoder.topology(), change.before);
  };
  refused([](TopologyDelta& d) { d.vertex_ids.pop_back(); }, "as many vertices as it names");
  refused([](TopologyDelta& d) { d.cell_ids.push_back(d.cell_count); }, "as many cells as it names");
  refused([](TopologyDelta& d) { std::swap(d.cell_ids[0], d.cell_ids[1]); }, "do not increase");
  refused([](TopologyDelta& d) { d.cell_ids[1] = d.cell_ids[0]; }, "do not increase");
  refused([](TopologyDelta& d) { d.cell_ids.back() = d.cell_count; }, "out of range");
  refused([](TopologyDelta& d) { ++d.vertex_count; }, "all new vertices");
  refused([](TopologyDelta& d) { ++d.cell_count; }, "all new cells");
  refused([](TopologyDelta& d) { d.vertex_ids[0] = 0; }, "all new vertices");
  refused([](TopologyDelta& d) { d.entries.connectivity[3] = d.vertex_count; }, "names vertex");
  refused([](TopologyDelta& d) { d.entries.connectivity.pop_back(); }, "do not span");
  refused([](TopologyDelta& d) { d.entries.cell_types[0] = CellType(7); }, "VTK type 7");
  refused([](TopologyDelta& d) { d.entries.face_neighbours[0] = std::int32_t(d.cell_count); }, "face neighbour");
  refused([](TopologyDelta& d) { d.entries.cut_faces.pop_back(); }, "cut_faces");
  refused([](TopologyDelta& d) { d.entries.origin_vertices[0] = d.vertex_count; }, "origin vertex");
  refused([](TopologyDelta& d) { d.entries.origin_vertices.clear(); }, "lacks the origins");
  refused([](TopologyDelta& d) { d.entries.rest_positions[0].x() = NAN; }, "not finite");
  TopologyDelta fewer = change.delta;
  fewer.vertex_ids.clear();
  fewer.cell_ids.clear();
  fewer.entries = Topology();
  fewer.entries.session = 7;
  fewer.entries.revision = change.after.revision;
  fewer.entries.cell_offsets = {0};
  refused([&](TopologyDelta& d) { (d = fewer).vertex_count = 10; }, "takes vertices away");
  EXPECT_EQ(decoder.apply(change.delta), TopologyDecoder::Result::kApplied);
}

}  // namespace
}  // namespace soft_volume::core
