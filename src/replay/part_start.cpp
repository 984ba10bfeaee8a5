#include "part_start.h"

#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolGrip.h>
#include <soft_volume/Volume.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "message_start.h"

namespace soft_volume {
namespace {

/// Messages of a run that ended may still come when the next has begun, such as the statistics of a frame.
constexpr double kSettled_s = 2.0;

template <typename Message>
const std::string& nameOf() {
  static const std::string name = ros::message_traits::DataType<Message>::value();
  return name;
}

bool isInput(const std::string& type) {
  return type == nameOf<ToolForce>() || type == nameOf<ToolCut>() || type == nameOf<ToolGrip>();
}

bool isKnown(const std::string& type) {
  return isInput(type) || type == nameOf<Scene>() || type == nameOf<Volume>() || type == nameOf<GridTopology>() ||
         type == nameOf<GridState>() || type == nameOf<SimulationJournal>() || type == nameOf<SimulationCheckpoint>();
}

std::pair<std::string, std::string> publisherOf(const QueuedMessage& message) {
  const auto caller = message.header->find("callerid");
  return {message.topic, caller == message.header->end() ? "" : caller->second};
}

}  // namespace

void PartStart::hear(const QueuedMessage& message) {
  now_ = message.receipt;
  const std::string& type = message.message->getDataType();
  if (message.latched && type != nameOf<GridTopology>())
    latched_[publisherOf(message)] = message;
  if (!isKnown(type))
    return;
  const std::uint64_t before = session_;
  try {
    hearKnown(type, message);
  } catch (const ros::serialization::StreamOverrunException&) {
    return;  // too short to be a message of ours; it is recorded all the same
  }
  if (session_ != before)
    session_since_ = now_;
  limit();
}

void PartStart::hearKnown(const std::string& type, const QueuedMessage& message) {
  std::vector<std::uint8_t> bytes = contentOf(*message.message);
  const MessageStart start = readMessageStart(type, bytes);
  Known known{message, start.session, start.step, start.first_step};
  if (type == nameOf<Scene>() || type == nameOf<Volume>()) {
    session_ = start.session;
    newest_[type] = std::move(known);
  } else if (type == nameOf<GridTopology>()) {
    if (!start.delta)
      topologies_.clear();
    topologies_.push_back(std::move(known));
  } else if (type == nameOf<GridState>()) {
    if (start.key_frame) {
      for (const Known& state : states_)
        kept_bytes_ -= state.message.bytes();
      states_.clear();
    } else if (states_.empty()) {
      return;  // a change to what is not kept
    }
    keep(states_, std::move(known));
  } else if (type == nameOf<SimulationCheckpoint>()) {
    hearCheckpoint(known);
  } else {
    keep(isInput(type) ? inputs_ : journals_, std::move(known));
  }
}

void PartStart::keep(std::vector<Known>& list, Known known) {
  kept_bytes_ += known.message.bytes();
  list.push_back(std::move(known));
}

/// What came before it is not needed any more. Topics are not ordered among each other, so steps decide.
void PartStart::hearCheckpoint(const Known& checkpoint) {
  const auto forget = [&](std::vector<Known>& list, bool (*is_old)(const Known&, const Known&)) {
    const auto old =
        std::stable_partition(list.begin(), list.end(), [&](const Known& known) { return !is_old(known, checkpoint); });
    for (auto known = old; known != list.end(); ++known)
      kept_bytes_ -= known->message.bytes();
    list.erase(old, list.end());
  };
  forget(journals_, [](const Known& journal, const Known& start) {
    return journal.session != start.session || journal.step <= start.step;
  });
  forget(inputs_, [](const Known& input, const Known& start) {
    return input.session != start.session || input.step < start.step;
  });
  newest_[nameOf<SimulationCheckpoint>()] = checkpoint;
}

void PartStart::limit() {
  if (kept_bytes_ <= most_kept_bytes_)
    return;
  newest_.erase(nameOf<SimulationCheckpoint>());
  for (auto* list : {&states_, &journals_, &inputs_})
    list->clear();
  kept_bytes_ = 0;
}

bool PartStart::ready() const {
  // A clock may have been set back.
  const bool settled = std::abs((now_ - session_since_).toSec()) >= kSettled_s;
  return newest_.size() == 3 && !topologies_.empty() && !states_.empty() && settled && sameSession() &&
         journalIsWhole();
}

bool PartStart::sameSession() const {
  const auto same = [this](const Known& known) { return known.session == session_; };
  return std::all_of(newest_.begin(), newest_.end(), [&](const auto& entry) { return same(entry.second); }) &&
         std::all_of(topologies_.begin(), topologies_.end(), same) &&
         std::all_of(states_.begin(), states_.end(), same) && std::all_of(journals_.begin(), journals_.end(), same) &&
         std::all_of(inputs_.begin(), inputs_.end(), same);
}

bool PartStart::journalIsWhole() const {
  std::uint64_t done = newest_.at(nameOf<SimulationCheckpoint>()).step;
  for (std::size_t n = 0; n < journals_.size(); ++n) {
    const Known& journal = journals_[n];
    if (n == 0 ? journal.first_step > done : journal.first_step != done)
      return false;
    done = journal.step;
  }
  return true;
}

std::vector<QueuedMessage> PartStart::messages() const {
  std::vector<QueuedMessage> all;
  ros::Time begin = ros::TIME_MAX;
  for (const auto* list : {&states_, &journals_, &inputs_}) {
    for (const Known& known : *list)
      begin = std::min(begin, known.message.receipt);
  }
  const auto add = [&](QueuedMessage message) {
    message.receipt = begin;
    all.push_back(std::move(message));
  };
  for (const auto& entry : latched_)
    add(entry.second);
  for (const auto& entry : newest_) {
    if (!entry.second.message.latched)
      add(entry.second.message);
  }
  for (const Known& topology : topologies_)
    add(topology.message);
  for (const auto* list : {&states_, &journals_, &inputs_}) {
    for (const Known& known : *list)
      all.push_back(known.message);
  }
  return all;
}

std::uint64_t PartStart::latchedBytes() const {
  std::uint64_t sum = 0;
  for (const auto& entry : latched_)
    sum += entry.second.message->size();
  for (const Known& topology : topologies_)
    sum += topology.message.message->size();
  return sum;
}

}  // namespace soft_volume
