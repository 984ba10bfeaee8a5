#include "soft_volume/grid/topology_delta.h"

#include <algorithm>
#include <functional>
#include <string>
#include <utility>

#include "check_topology.h"
#include "soft_volume/common/error.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

using Numbers = std::vector<std::uint32_t>;

void require(bool good, const std::string& what) {
  if (!good)
    throw InputError("grid topology: delta: " + what + "; the next full topology mends it");
}

void checkNumbers(const Numbers& numbers, std::size_t described, std::uint32_t count, const std::string& what) {
  require(numbers.size() == described, "it does not describe as many " + what + " as it names");
  const bool increasing = std::adjacent_find(numbers.begin(), numbers.end(), std::greater_equal<>()) == numbers.end();
  require(increasing && (numbers.empty() || numbers.back() < count),
          "the numbers of " + what + " do not increase or are out of range");
}

/// Those from `first` on are new, and all of them are to be described.
void checkNew(const Numbers& numbers, std::size_t first, std::uint32_t count, const std::string& what) {
  require(count >= first, "it takes " + what + " away");
  const auto place = std::lower_bound(numbers.begin(), numbers.end(), static_cast<std::uint32_t>(first));
  require(std::size_t(numbers.end() - place) == count - first, "it does not describe all new " + what);
}

/// One value for each vertex or cell: writes those of `ids` over the base's, or behind them.
template <typename T>
std::vector<T> replaceValues(const std::vector<T>& base, std::size_t base_count, const std::vector<T>& entries,
                             const Numbers& ids, std::size_t count) {
  const bool has_values = base.size() == base_count;
  require(ids.empty() || has_values == (entries.size() == ids.size()),
          "either it or its base lacks the origins of vertices or the parents of cells");
  std::vector<T> values = base;
  if (!has_values)
    return values;
  values.resize(count);
  for (std::size_t n = 0; n < ids.size(); ++n)
    values[ids[n]] = entries[n];
  return values;
}

/// Where the entries of each cell's faces begin, and the end.
std::vector<std::size_t> faceOffsets(const Topology& topology) {
  std::vector<std::size_t> offsets = {0};
  offsets.reserve(topology.cellCount() + 1);
  for (std::size_t cell = 0; cell < topology.cellCount(); ++cell) {
    const std::uint32_t* begin = topology.connectivity.data() + topology.cell_offsets[cell];
    offsets.push_back(offsets.back() + faceCount(topology.cell_types[cell], begin));
  }
  return offsets;
}

/// What of a topology has as many entries per cell as the cell needs.
struct CellRows {
  explicit CellRows(const Topology& topology) : topology(&topology), faces(faceOffsets(topology)) {}

  void appendTo(Topology& to, std::size_t begin, std::size_t end) const {
    const auto append = [](const auto& from, std::size_t first, std::size_t last, auto& values) {
      values.insert(values.end(), from.begin() + std::ptrdiff_t(first), from.begin() + std::ptrdiff_t(last));
    };
    const std::uint32_t shift = static_cast<std::uint32_t>(to.connectivity.size()) - topology->cell_offsets[begin];
    append(topology->connectivity, topology->cell_offsets[begin], topology->cell_offsets[end], to.connectivity);
    for (std::size_t cell = begin; cell < end; ++cell)
      to.cell_offsets.push_back(topology->cell_offsets[cell + 1] + shift);
    append(topology->face_neighbours, faces[begin], faces[end], to.face_neighbours);
    append(topology->cut_faces, faces[begin], faces[end], to.cut_faces);
  }

  const Topology* topology;
  std::vector<std::size_t> faces;
};

void replaceRows(const Topology& base, const TopologyDelta& delta, Topology& result) {
  result.cell_offsets.assign(1, 0);
  result.cell_offsets.reserve(delta.cell_count + std::size_t(1));
  result.connectivity.reserve(base.connectivity.size() + delta.entries.connectivity.size());
  result.face_neighbours.reserve(base.face_neighbours.size() + delta.entries.face_neighbours.size());
  result.cut_faces.reserve(base.cut_faces.size() + delta.entries.cut_faces.size());
  const CellRows old_rows(base);
  const CellRows new_rows(delta.entries);
  std::size_t next = 0;
  for (std::size_t n = 0; n < delta.cell_ids.size(); ++n) {
    const std::size_t cell = delta.cell_ids[n];
    if (next < std::min(cell, base.cellCount()))
      old_rows.appendTo(result, next, std::min(cell, base.cellCount()));
    new_rows.appendTo(result, n, n + 1);
    next = cell + 1;
  }
  if (next < base.cellCount())
    old_rows.appendTo(result, next, base.cellCount());
}

}  // namespace

void TopologyDelta::validate() const {
  checkNumbers(vertex_ids, entries.vertexCount(), vertex_count, "vertices");
  checkNumbers(cell_ids, entries.cellCount(), cell_count, "cells");
  checkTopology(entries, vertex_count, cell_count);
}

Topology changedBy(const Topology& base, const TopologyDelta& delta) {
  require(delta.entries.session == base.session && delta.base_revision == base.revision,
          "it changes revision " + std::to_string(delta.base_revision) + " where the grid is at " +
              std::to_string(base.revision) + " (or the session differs)");
  checkNew(delta.vertex_ids, base.vertexCount(), delta.vertex_count, "vertices");
  checkNew(delta.cell_ids, base.cellCount(), delta.cell_count, "cells");
  Topology result;
  result.session = delta.entries.session;
  result.revision = delta.entries.revision;
  const auto changeVertices = [&](auto values) {
    result.*values =
        replaceValues(base.*values, base.vertexCount(), delta.entries.*values, delta.vertex_ids, delta.vertex_count);
  };
  const auto changeCells = [&](auto values) {
    result.*values =
        replaceValues(base.*values, base.cellCount(), delta.entries.*values, delta.cell_ids, delta.cell_count);
  };
  changeVertices(&Topology::rest_positions);
  changeVertices(&Topology::texture_coordinates);
  changeVertices(&Topology::fixed);
  changeVertices(&Topology::origin_vertices);
  changeCells(&Topology::cell_types);
  changeCells(&Topology::parent_cells);
  changeCells(&Topology::materials);
  replaceRows(base, delta, result);
  return result;
}

TopologyDecoder::Result TopologyDecoder::apply(Topology full) {
  full.validate();
  if (topology_ && full.session == topology_->session && full.revision == topology_->revision)
    return Result::kKnown;
  topology_ = std::make_shared<const Topology>(std::move(full));
  return Result::kApplied;
}

TopologyDecoder::Result TopologyDecoder::apply(const TopologyDelta& delta) {
  delta.validate();
  if (!topology_ || delta.entries.session != topology_->session)
    return Result::kNeedsFull;
  if (delta.entries.revision <= topology_->revision)
    return Result::kKnown;
  if (delta.base_revision != topology_->revision)
    return Result::kNeedsFull;
  topology_ = std::make_shared<const Topology>(changedBy(*topology_, delta));
  return Result::kApplied;
}

}  // namespace soft_volume::core
