#include "soft_volume/messages/journal.h"

#include <utility>

#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

template <typename Message>
JournalEntry makeEntry(const std::string& topic, const Message& message, std::uint64_t sequence) {
  JournalEntry entry;
  entry.topic = topic;
  entry.type = ros::message_traits::datatype<Message>();
  entry.sequence = sequence;
  entry.payload = journalPayload(message);
  return entry;
}

/// A message that cannot become a command is refused like a command that cannot be used.
template <typename Message>
core::Verdict applyMessage(core::Session& session, const Message& message) {
  try {
    return session.apply(fromMessage(message));
  } catch (const core::InputError& error) {
    return {false, error.what()};
  }
}

}  // namespace

const JournalEntry& Journal::add(JournalEntry entry) {
  entry.step = session_->steps();
  entry.order = order_++;
  entry.hash = core::hashVector(entry.payload);
  applied_ += entry.outcome == JournalEntry::APPLIED ? 1 : 0;
  refused_ += entry.outcome == JournalEntry::REFUSED ? 1 : 0;
  entries_.push_back(std::move(entry));
  return entries_.back();
}

const JournalEntry& Journal::addInput(JournalEntry entry, const core::Verdict& verdict) {
  entry.outcome = verdict.applied ? JournalEntry::APPLIED : JournalEntry::REFUSED;
  entry.reason = verdict.reason;
  return add(std::move(entry));
}

const JournalEntry& Journal::apply(const ToolForce& message) {
  return addInput(makeEntry(topics::kToolForce, message, message.sequence), applyMessage(*session_, message));
}

const JournalEntry& Journal::apply(const ToolCut& message) {
  return addInput(makeEntry(topics::kToolCut, message, message.sequence), applyMessage(*session_, message));
}

const JournalEntry& Journal::apply(const ToolGrip& message) {
  return addInput(makeEntry(topics::kToolGrip, message, message.sequence), applyMessage(*session_, message));
}

const JournalEntry& Journal::apply(const PartRemoval& message) {
  return addInput(makeEntry(topics::kRemovePart, message, 0), applyMessage(*session_, message));
}

const JournalEntry& Journal::apply(const SimulationControl& message) {
  return addInput(makeEntry(topics::kSetIntegrator, message, 0), applyMessage(*session_, message));
}

const JournalEntry& Journal::apply(const SimulationCheckpoint& message) {
  return addInput(makeEntry(topics::kRestoreCheckpoint, message, message.step), applyMessage(*session_, message));
}

const JournalEntry& Journal::note(const std::string& topic, const std::string& type,
                                  const std::vector<std::uint8_t>& payload, const std::string& reason) {
  JournalEntry entry;
  entry.outcome = JournalEntry::NOTED;
  entry.topic = topic;
  entry.type = type;
  entry.payload = payload;
  entry.reason = reason;
  return add(std::move(entry));
}

const JournalEntry& Journal::reapply(const JournalEntry& recorded) {
  if (recorded.outcome == JournalEntry::NOTED) {
    return note(recorded.topic, recorded.type, recorded.payload, recorded.reason);
  }
  if (recorded.topic == topics::kToolForce)
    return apply(fromPayload<ToolForce>(recorded.payload));
  if (recorded.topic == topics::kToolCut)
    return apply(fromPayload<ToolCut>(recorded.payload));
  if (recorded.topic == topics::kToolGrip)
    return apply(fromPayload<ToolGrip>(recorded.payload));
  if (recorded.topic == topics::kRemovePart)
    return apply(fromPayload<PartRemoval>(recorded.payload));
  if (recorded.topic == topics::kSetIntegrator)
    return apply(fromPayload<SimulationControl>(recorded.payload));
  if (recorded.topic == topics::kRestoreCheckpoint)
    return apply(fromPayload<SimulationCheckpoint>(recorded.payload));
  throw core::InputError("the journal holds an input from '" + recorded.topic + "', which this version does not know");
}

std::vector<JournalEntry> Journal::take() {
  return std::exchange(entries_, {});
}

}  // namespace soft_volume
