#include "state_check.h"

#include <algorithm>
#include <cstring>
#include <sstream>

#include "soft_volume/grid/state_stream.h"
#include "soft_volume/messages/conversions.h"

namespace soft_volume {
namespace {

/// Key frames kept for deltas to come; a delta refers to the newest one.
constexpr std::size_t kMostBases = 4;

bool sameBits(const core::Vector3f& a, const core::Vector3f& b) {
  return std::memcmp(a.data(), b.data(), 3 * sizeof(float)) == 0;
}

ReplayDifference stateDifference(const core::GridStateFrame& frame, const std::string& text) {
  ReplayDifference difference;
  difference.kind = "state";
  difference.session = frame.session;
  difference.step = frame.step;
  difference.text = text;
  return difference;
}

ReplayDifference vertexDifference(const core::GridStateFrame& frame, std::uint32_t vertex,
                                  const core::Vector3f& recorded, const core::Vector3f& rebuilt) {
  const double apart = (recorded.cast<double>() - rebuilt.cast<double>()).norm();
  std::ostringstream text;
  text << "vertex " << vertex << " was recorded " << apart << " m away from its place";
  ReplayDifference difference = stateDifference(frame, text.str());
  difference.vertex = vertex;
  difference.size_m = apart;
  return difference;
}

/// The places that a frame names must be those of the session.
std::optional<ReplayDifference> comparePlaces(const core::GridStateFrame& frame,
                                              const std::vector<core::Vector3>& positions) {
  const std::size_t count = frame.key_frame ? positions.size() : frame.vertex_ids.size();
  if (frame.positions_m.size() != count)
    return stateDifference(frame, "it has a wrong number of positions");
  for (std::size_t n = 0; n < count; ++n) {
    const std::size_t v = frame.key_frame ? n : frame.vertex_ids[n];
    if (v >= positions.size())
      return stateDifference(frame, "it names a vertex that does not exist");
    const core::Vector3f rebuilt = positions[v].cast<float>();
    if (!sameBits(frame.positions_m[n], rebuilt)) {
      return vertexDifference(frame, static_cast<std::uint32_t>(v), frame.positions_m[n], rebuilt);
    }
  }
  return std::nullopt;
}

/// A delta leaves out only what is where the key frame has it.
std::optional<ReplayDifference> compareLeftOut(const core::GridStateFrame& frame, const core::GridStateFrame& expected,
                                               const std::vector<core::Vector3>& base) {
  std::vector<std::uint32_t> missing;
  std::set_difference(expected.vertex_ids.begin(), expected.vertex_ids.end(), frame.vertex_ids.begin(),
                      frame.vertex_ids.end(), std::back_inserter(missing));
  if (missing.empty())
    return stateDifference(frame, "it names vertices that did not move");
  const auto at = std::lower_bound(expected.vertex_ids.begin(), expected.vertex_ids.end(), missing.front());
  const core::Vector3f& rebuilt = expected.positions_m[static_cast<std::size_t>(at - expected.vertex_ids.begin())];
  return vertexDifference(frame, missing.front(), base[missing.front()].cast<float>(), rebuilt);
}

bool sameBox(const Eigen::AlignedBox3f& a, const Eigen::AlignedBox3f& b) {
  return sameBits(a.min(), b.min()) && sameBits(a.max(), b.max());
}

}  // namespace

StateCheck::StateCheck(const std::vector<BagMessage>& states) {
  for (const BagMessage& state : states)
    wanted_.insert({state.base_step, state.revision});
}

void StateCheck::visit(const core::Session& session) {
  const Place here(session.steps(), session.lattice().revision);
  if (wanted_.count(here) == 0 || bases_.count(here) != 0)
    return;
  Positions& base = bases_[here];
  for (const core::Vector3& p : session.drawnPositions())
    base.push_back(p.cast<float>().cast<double>());
  if (bases_.size() > kMostBases)
    bases_.erase(bases_.begin());
}

const StateCheck::Positions* StateCheck::find(const Place& place) const {
  const auto found = bases_.find(place);
  return found == bases_.end() ? nullptr : &found->second;
}

std::optional<ReplayDifference> StateCheck::compare(const core::Session& session, const GridState& recorded,
                                                    const BagMessage* previous) const {
  const core::GridStateFrame frame = fromMessage(recorded);
  const std::vector<core::Vector3> positions = session.drawnPositions();
  if (frame.revision != session.lattice().revision) {
    return stateDifference(frame, "it has revision " + std::to_string(frame.revision) + ", the rebuilt grid " +
                                      std::to_string(session.lattice().revision));
  }
  if (frame.vertex_count != positions.size()) {
    return stateDifference(frame, "it has " + std::to_string(frame.vertex_count) + " vertices, the rebuilt grid " +
                                      std::to_string(positions.size()));
  }
  if (auto difference = comparePlaces(frame, positions))
    return difference;
  if (frame.state_hash != session.simulation().stateHash()) {
    return stateDifference(frame, "the state's hash differs, although no published position does");
  }

  // The rest as the encoder makes it. A key frame's box refers to the key frame before it.
  const Place place = frame.key_frame && previous != nullptr ? Place(previous->base_step, previous->revision)
                                                             : Place(frame.base_step, frame.revision);
  const Positions* base = frame.key_frame && previous == nullptr ? nullptr : find(place);
  if (base == nullptr && !frame.key_frame)
    return std::nullopt;
  core::StateEncoder encoder;
  core::GridStateFrame expected = frame;
  if (base != nullptr) {
    expected.step = place.first;
    expected.revision = place.second;
    encoder.encode(*base, true, expected);
  }
  expected.step = frame.step;
  expected.revision = frame.revision;
  encoder.encode(positions, frame.key_frame, expected);
  if (expected.key_frame != frame.key_frame || expected.base_step != frame.base_step) {
    return stateDifference(frame, "it refers to another key frame");
  }
  if (expected.vertex_ids != frame.vertex_ids)
    return compareLeftOut(frame, expected, *base);
  if (base != nullptr && !sameBox(expected.moved_m, frame.moved_m)) {
    return stateDifference(frame, "the box of what moved differs");
  }
  if (frame.simulation_time_s != session.simulationTime())
    return stateDifference(frame, "its simulation time differs");
  return std::nullopt;
}

}  // namespace soft_volume
