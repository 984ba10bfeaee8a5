#pragma once

#include <ros/serialization.h>
#include <soft_volume/JournalEntry.h>
#include <soft_volume/PartRemoval.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationControl.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolGrip.h>

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/checked_stream.h"
#include "soft_volume/session/session.h"

namespace soft_volume {

/// The bytes of a message as the journal keeps them: serialised, with header.seq set to 0, because each transport
/// numbers messages in its own way.
template <typename Message>
std::vector<std::uint8_t> journalPayload(Message message) {
  message.header.seq = 0;
  std::vector<std::uint8_t> bytes(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  ros::serialization::serialize(stream, message);
  return bytes;
}

/// The reverse. Throws InputError when the bytes are not exactly one such message.
template <typename Message>
Message fromPayload(std::vector<std::uint8_t> payload) {
  Message message;
  try {
    CheckedStream stream(payload.data(), static_cast<std::uint32_t>(payload.size()));
    stream.next(message);
    if (stream.getLength() != 0)
      throw core::InputError("bytes are left over");
  } catch (const std::exception& error) {
    throw core::InputError(std::string("a journal payload cannot be read: ") + error.what());
  }
  return message;
}

/// Applies inputs to a session and keeps them for the journal, in order. Live nodes and the replay both apply inputs
/// through it. Not thread-safe.
class Journal {
 public:
  explicit Journal(core::Session& session) : session_(&session) {}

  /// Each applies or refuses the input now and records it. Returns the entry, valid until the next call.
  const JournalEntry& apply(const ToolForce& message);
  const JournalEntry& apply(const ToolCut& message);
  const JournalEntry& apply(const ToolGrip& message);
  const JournalEntry& apply(const PartRemoval& message);
  const JournalEntry& apply(const SimulationControl& message);
  const JournalEntry& apply(const SimulationCheckpoint& message);
  /// Records something that the physics does not feel: a pause, an input that never reached the session (`reason`).
  const JournalEntry& note(const std::string& topic, const std::string& type, const std::vector<std::uint8_t>& payload,
                           const std::string& reason = "");

  /// Applies the input of a recorded entry again, from its payload. Throws InputError when the payload cannot be read
  /// or its topic is unknown. Entries that were only noted are recorded and nothing else.
  const JournalEntry& reapply(const JournalEntry& recorded);

  /// Entries since the last call.
  std::vector<JournalEntry> take();
  std::uint64_t applied() const { return applied_; }
  std::uint64_t refused() const { return refused_; }

 private:
  const JournalEntry& addInput(JournalEntry entry, const core::Verdict& verdict);
  const JournalEntry& add(JournalEntry entry);

  core::Session* session_;
  std::vector<JournalEntry> entries_;
  std::uint64_t order_ = 0;
  std::uint64_t applied_ = 0;
  std::uint64_t refused_ = 0;
};

}  // namespace soft_volume
