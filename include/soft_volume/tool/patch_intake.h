#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "soft_volume/grid/patch.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/tool/patch_contact.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// A patch ready for contact, with what a tool needs to know of it.
struct ReadyPatch {
  /// An empty one. `volume` must not be null or empty.
  ReadyPatch(std::shared_ptr<const Volume> volume, double tissue_threshold)
      : field(std::move(volume), tissue_threshold) {}

  PatchContact field;
  std::uint64_t session = 0;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;
  double blade_resistance_n = 0.0;
};

/// Makes patches of one tool ready, which takes time and memory, so that its loop need only swap them in. Not thread
/// safe: the caller serialises all calls.
class PatchIntake {
 public:
  explicit PatchIntake(const std::string& tool_id, double tissue_threshold)
      : tool_id_(tool_id), tissue_threshold_(tissue_threshold) {}

  /// The volume of the session; forgets the grid. Must not be null or empty.
  void setVolume(std::shared_ptr<const Volume> volume);
  /// The grid's newest revision. True when it is of another session: what is in use is to be replaced by an empty one.
  bool setTopology(std::shared_ptr<const Topology> topology);

  /// Without cells, of the topology's session; null before a volume came.
  std::unique_ptr<ReadyPatch> makeEmpty() const;
  /// Replaces what `ready` holds, which must come from makeEmpty() since the volume was set. Throws InputError, with
  /// `ready` unchanged, when the patch is for another tool, does not fit the newest topology, or came before volume and
  /// topology.
  void fill(const GridPatch& patch, ReadyPatch* ready) const;

 private:
  std::string tool_id_;
  double tissue_threshold_;
  std::shared_ptr<const Volume> volume_;
  std::shared_ptr<const Topology> topology_;
};

/// Measures how often patches come, from the times at which they were taken, and says when they have stopped: after
/// three usual (median) intervals, but not before 20 ms; after half a second as long as no interval is known. No
/// allocation; one thread at a time.
class PatchWatch {
 public:
  static constexpr double kLeast_s = 0.02;
  static constexpr double kUnknown_s = 0.5;
  static constexpr double kIntervals = 3.0;

  void take(double time_s);
  bool stopped(double time_s) const { return newest_s_ && time_s - *newest_s_ > limit(); }
  /// Usual interval [s]; 0 before two patches came.
  double interval() const;
  void reset() { *this = PatchWatch(); }

 private:
  double limit() const;

  static constexpr std::size_t kKept = 9;
  std::array<double, kKept> intervals_s_{};
  std::size_t count_ = 0;
  std::optional<double> newest_s_;
};

}  // namespace soft_volume::core
