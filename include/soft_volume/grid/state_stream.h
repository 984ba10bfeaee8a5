#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// One published state of a grid; mirrors the message GridState, whose comments define each field.
struct GridStateFrame {
  std::uint64_t session = 0;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;
  double simulation_time_s = 0.0;
  bool key_frame = false;
  std::uint64_t base_step = 0;
  std::uint32_t vertex_count = 0;
  std::vector<std::uint32_t> vertex_ids;
  std::vector<Vector3f> positions_m;
  Eigen::AlignedBox3f moved_m;  ///< empty when nothing moved
  std::uint64_t state_hash = 0;
};

/// Turns states into key frames and deltas against the last key frame. Not thread-safe.
class StateEncoder {
 public:
  /// Fills positions, ids, base and box of `frame` (whose session, revision and step are set) from the positions of all
  /// vertices. Makes a key frame when asked, and always at first, after another revision or another session.
  void encode(const std::vector<Vector3>& positions_m, bool key_frame, GridStateFrame& frame);

 private:
  std::uint64_t session_ = 0;
  std::uint32_t revision_ = 0;
  std::uint64_t base_step_ = 0;
  std::vector<Vector3f> base_;
};

/// Puts published states together again. Not thread-safe.
class StateDecoder {
 public:
  enum class Result {
    kApplied,       ///< positions() is the state of the frame
    kNeedsKeyFrame  ///< the key frame that the delta refers to was missed: positions() did not change
  };

  /// Expects states of this session and revision with this many vertices from now on and forgets the rest. `rest`
  /// serves until the first state arrives.
  void expect(std::uint64_t session, std::uint32_t revision, std::vector<Vector3f> rest);

  /// Throws InputError, and keeps its positions, when the frame is of another session, revision or vertex count, when
  /// its arrays do not fit together, or when a position is not finite.
  Result apply(const GridStateFrame& frame);

  const std::vector<Vector3f>& positions() const { return positions_; }
  std::uint64_t step() const { return step_; }
  bool hasState() const { return has_base_; }

 private:
  void check(const GridStateFrame& frame) const;

  std::uint64_t session_ = 0;
  std::uint32_t revision_ = 0;
  std::uint64_t step_ = 0;
  std::uint64_t base_step_ = 0;
  bool has_base_ = false;
  std::vector<Vector3f> base_;
  std::vector<Vector3f> positions_;
};

}  // namespace soft_volume::core
