#include "soft_volume/grid/state_stream.h"

#include <algorithm>
#include <functional>
#include <string>
#include <utility>

#include "soft_volume/common/error.h"

namespace soft_volume::core {

void StateEncoder::encode(const std::vector<Vector3>& positions_m, bool key_frame, GridStateFrame& frame) {
  const bool changed = session_ != frame.session || revision_ != frame.revision || base_.size() != positions_m.size();
  frame.key_frame = key_frame || changed;
  frame.vertex_count = static_cast<std::uint32_t>(positions_m.size());
  frame.vertex_ids.clear();
  frame.positions_m.clear();
  frame.moved_m.setEmpty();
  const bool same_vertices = base_.size() == positions_m.size();
  for (std::size_t v = 0; v < positions_m.size(); ++v) {
    const Vector3f now = positions_m[v].cast<float>();
    const bool moved = !same_vertices || now != base_[v];
    if (moved) {
      frame.moved_m.extend(now);
      if (same_vertices)
        frame.moved_m.extend(base_[v]);
    }
    if (frame.key_frame || moved)
      frame.positions_m.push_back(now);
    if (!frame.key_frame && moved)
      frame.vertex_ids.push_back(static_cast<std::uint32_t>(v));
  }
  if (frame.key_frame) {
    base_ = frame.positions_m;
    base_step_ = frame.step;
    session_ = frame.session;
    revision_ = frame.revision;
  }
  frame.base_step = base_step_;
}

void StateDecoder::expect(std::uint64_t session, std::uint32_t revision, std::vector<Vector3f> rest) {
  session_ = session;
  revision_ = revision;
  step_ = 0;
  has_base_ = false;
  base_.clear();
  positions_ = std::move(rest);
}

void StateDecoder::check(const GridStateFrame& frame) const {
  const auto reject = [](const std::string& reason) { throw InputError("grid state: " + reason); };
  if (frame.session != session_)
    reject("it belongs to another session");
  if (frame.revision != revision_) {
    reject("revision " + std::to_string(frame.revision) + " where the topology has " + std::to_string(revision_));
  }
  if (frame.vertex_count != positions_.size()) {
    reject(std::to_string(frame.vertex_count) + " vertices where the topology has " +
           std::to_string(positions_.size()));
  }
  const std::size_t expected = frame.key_frame ? positions_.size() : frame.vertex_ids.size();
  if (frame.positions_m.size() != expected || (frame.key_frame && !frame.vertex_ids.empty())) {
    reject("the number of positions does not fit the vertices that it names");
  }
  const auto in_range = [this](std::uint32_t v) { return v < positions_.size(); };
  const bool increasing = std::adjacent_find(frame.vertex_ids.begin(), frame.vertex_ids.end(),
                                             std::greater_equal<>()) == frame.vertex_ids.end();
  if (!increasing || !std::all_of(frame.vertex_ids.begin(), frame.vertex_ids.end(), in_range)) {
    reject("vertex_ids are not increasing or name a vertex that does not exist");
  }
  const auto finite = [](const Vector3f& p) { return p.allFinite(); };
  if (!std::all_of(frame.positions_m.begin(), frame.positions_m.end(), finite))
    reject("a position is not finite");
}

StateDecoder::Result StateDecoder::apply(const GridStateFrame& frame) {
  check(frame);
  if (frame.key_frame) {
    base_ = frame.positions_m;
    base_step_ = frame.step;
    has_base_ = true;
  } else if (!has_base_ || frame.base_step != base_step_) {
    return Result::kNeedsKeyFrame;
  }
  positions_ = base_;
  for (std::size_t n = 0; n < frame.vertex_ids.size(); ++n)
    positions_[frame.vertex_ids[n]] = frame.positions_m[n];
  step_ = frame.step;
  return Result::kApplied;
}

}  // namespace soft_volume::core
