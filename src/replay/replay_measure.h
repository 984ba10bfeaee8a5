#pragma once

#include <soft_volume/GridState.h>
#include <soft_volume/RenderStats.h>

#include <memory>
#include <string>
#include <vector>

#include "grid_pair.h"
#include "soft_volume/grid/state_stream.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/replay_bag.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// Measures how far a replay that need not be bit-identical is from the record. First is the record, second the replay.
class ReplayMeasure {
 public:
  explicit ReplayMeasure(ReplayReport& report) : report_(&report) {}

  /// From now on of the session with this number, in the order of the bag.
  void beginSession(const core::Session& session, std::size_t run);
  /// Takes every recorded state in its order, because deltas refer to key frames. Null when its key frame is not in the
  /// bag.
  std::shared_ptr<const GridPair::Positions> decode(const GridState& recorded);
  /// Measures the session's state now. `topology` is the recorded one, or null.
  void compareState(const core::Session& session, const GridState& recorded, const GridPair::Positions& positions,
                    const GridPair::Grid& topology);
  void compareFrame(const core::Session& session, const RenderStats& stats, const core::Image& recorded,
                    const core::Image& replayed);
  void leaveOutFrame(const RenderStats& stats, const std::string& reason);

 private:
  ComparedQuantity& quantity(const char* key, const std::string& subject, const char* title, const char* unit);
  ComparedQuantity& imageQuantity(const RenderStats& stats);
  ComparedQuantity& similarityQuantity(const RenderStats& stats);

  ReplayReport* report_;
  std::size_t run_ = 0;
  core::StateDecoder decoder_;
  std::uint64_t decoded_session_ = 0;
  std::uint32_t decoded_revision_ = 0;
  std::uint32_t decoded_vertices_ = 0;
  GridPair::Grid recorded_uncut_;
  GridPair::Grid uncut_;
  GridPair::Grid replayed_;
  std::unique_ptr<GridPair> pair_;
  double recorded_area_m2_ = 0.0;
  double replayed_area_m2_ = 0.0;
  double recorded_parts_ = 0.0;
  double replayed_parts_ = 0.0;
};

}  // namespace soft_volume
