#include "recorded_inputs.h"

#include <ros/serialization.h>
#include <std_msgs/Header.h>

#include <algorithm>
#include <utility>

#include "soft_volume/common/hash.h"

namespace soft_volume {
namespace {

/// How ToolForce, ToolCut and ToolGrip begin.
struct InputStart {
  std_msgs::Header header;
  std::uint64_t session = 0;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;
  std::string tool_id;
  std::uint64_t sequence = 0;
};

/// Of a message with a wrong length in it, what comes before. The time, near the front, is enough to find its entry.
InputStart readStart(std::vector<std::uint8_t> bytes) {
  ros::serialization::IStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  InputStart start;
  try {
    stream.next(start.header);
    stream.next(start.session);
    stream.next(start.revision);
    stream.next(start.step);
    stream.next(start.tool_id);
    stream.next(start.sequence);
  } catch (const ros::serialization::StreamOverrunException&) {
    return start;
  }
  return start;
}

/// header.seq comes first in the bytes; see journalPayload().
std::uint64_t payloadHash(std::vector<std::uint8_t> bytes) {
  std::fill_n(bytes.begin(), std::min<std::size_t>(4, bytes.size()), 0);
  return core::hashVector(bytes);
}

}  // namespace

void RecordedInputs::add(const std::string& type, std::vector<std::uint8_t> bytes) {
  const InputStart start = readStart(bytes);
  const std::uint64_t hash = payloadHash(std::move(bytes));
  ++sequences_[{type, start.tool_id, start.session}][start.sequence];
  stamps_[type].emplace(start.header.stamp.toNSec(), hash);
  ++hashes_[type][hash].messages;
}

RecordedInputs::Match RecordedInputs::match(const JournalEntry& entry) {
  auto& hashes = hashes_[entry.type];
  const auto same = hashes.find(payloadHash(entry.payload));
  if (same != hashes.end()) {
    ++same->second.asked_for;
    return Match::kSame;
  }
  const InputStart start = readStart(entry.payload);
  const auto& sequences = sequences_[{entry.type, start.tool_id, start.session}];
  if (sequences.count(start.sequence) != 0)
    return Match::kDiffers;
  const bool between =
      !sequences.empty() && sequences.begin()->first < start.sequence && start.sequence < sequences.rbegin()->first;
  return between ? Match::kMissing : Match::kOutOfRange;
}

bool RecordedInputs::wasAltered(const JournalEntry& entry) const {
  const auto stamps = stamps_.find(entry.type);
  if (stamps == stamps_.end())
    return false;
  const auto stamp = stamps->second.equal_range(readStart(entry.payload).header.stamp.toNSec());
  return std::any_of(stamp.first, stamp.second,
                     [&](const auto& same_time) { return hashes_.at(entry.type).at(same_time.second).asked_for == 0; });
}

std::uint64_t RecordedInputs::unmatched() const {
  std::uint64_t sum = 0;
  for (const auto& type : hashes_) {
    for (const auto& entry : type.second) {
      const Recorded& recorded = entry.second;
      sum += recorded.messages - std::min(recorded.messages, recorded.asked_for);
    }
  }
  return sum;
}

}  // namespace soft_volume
