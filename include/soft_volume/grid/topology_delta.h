#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "soft_volume/grid/topology.h"

namespace soft_volume::core {

/// What an incision changes in a topology: the cells that it touched and what is new. Mirrors the delta form of the
/// message GridTopology. Vertices and cells are never renumbered and never fewer.
struct TopologyDelta {
  std::uint32_t base_revision = 0;  ///< that it changes
  std::uint32_t vertex_count = 0;   ///< of the grid afterwards
  std::uint32_t cell_count = 0;
  std::vector<std::uint32_t> vertex_ids;  ///< that `entries` describes, increasing; all new ones are among them
  std::vector<std::uint32_t> cell_ids;
  Topology entries;  ///< of these alone, with the grid's numbers in them; session and revision afterwards

  /// Throws InputError when sizes do not fit together, numbers do not increase or are out of range, or a position is
  /// not finite.
  void validate() const;
};

/// The topology that a valid delta makes of its base. Throws InputError when the base has another session or revision,
/// or when the delta lacks a new vertex or cell. Takes time in proportion to the grid.
Topology changedBy(const Topology& base, const TopologyDelta& delta);

/// Keeps a receiver's topology up to date. Not thread-safe; the topologies that it hands out never change.
class TopologyDecoder {
 public:
  enum class Result {
    kApplied,
    kKnown,     ///< it leads to a revision that is here already
    kNeedsFull  ///< the delta changes another revision: a message was missed, the next full one mends it
  };

  /// Validates; throws InputError and keeps what it has when something does not hold together.
  Result apply(Topology full);
  Result apply(const TopologyDelta& delta);

  /// Null until the first full one came.
  const std::shared_ptr<const Topology>& topology() const { return topology_; }

 private:
  std::shared_ptr<const Topology> topology_;
};

}  // namespace soft_volume::core
