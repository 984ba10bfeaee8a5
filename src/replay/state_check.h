#pragma once

#include <soft_volume/GridState.h>

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <utility>
#include <vector>

#include "bag_contents.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// Compares recorded states with those of the rebuilt session, bit for bit. Deltas refer to key frames, so it keeps the
/// positions of the steps that they name.
class StateCheck {
 public:
  /// `states` in the order in which they were published.
  explicit StateCheck(const std::vector<BagMessage>& states);

  /// Call in every step and after every change of the topology.
  void visit(const core::Session& session);
  /// `previous` is the recorded state before this one, or null.
  std::optional<ReplayDifference> compare(const core::Session& session, const GridState& recorded,
                                          const BagMessage* previous) const;

 private:
  using Place = std::pair<std::uint64_t, std::uint32_t>;  // step, revision
  using Positions = std::vector<core::Vector3>;

  const Positions* find(const Place& place) const;

  std::set<Place> wanted_;
  std::map<Place, Positions> bases_;  ///< as published: rounded to float
};

}  // namespace soft_volume
