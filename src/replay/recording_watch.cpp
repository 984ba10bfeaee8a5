#include "soft_volume/replay/recording_watch.h"

#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>

#include <algorithm>
#include <cstdio>
#include <cstring>

#include "message_start.h"
#include "queued_message.h"
#include "soft_volume/common/error.h"
#include "soft_volume/messages/journal.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/replay/parse_message.h"

namespace soft_volume {
namespace {

constexpr double kLeastSilence_s = 1.0;
/// A topic that comes more rarely than this has no rhythm that it could miss.
constexpr double kRarest_s = 2.0;
constexpr std::uint64_t kRhythmMessages = 20;

/// The first line that declares a field tells: a header has to come first.
bool beginsWithHeader(const std::string& definition) {
  for (std::size_t at = 0; at < definition.size();) {
    const std::size_t end = std::min(definition.find('\n', at), definition.size());
    const std::string line = definition.substr(at, end - at);
    at = end + 1;
    const std::size_t begin = line.find_first_not_of(" \t\r");
    if (begin == std::string::npos || line[begin] == '#')
      continue;
    return line.compare(begin, 7, "Header ") == 0 || line.compare(begin, 16, "std_msgs/Header ") == 0;
  }
  return false;
}

std::string seconds(double duration_s) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.1f s", duration_s);
  return text;
}

std::string restoredFrom(const JournalEntry& entry) {
  const auto checkpoint = fromPayload<SimulationCheckpoint>(entry.payload);
  return "began where session " + std::to_string(checkpoint.session) + " was at step " +
         std::to_string(checkpoint.step);
}

/// Where a run began, by the first journal message that was heard of it.
std::string beginningOf(const SimulationJournal& journal) {
  std::string beginning = journal.first_step == 0
                              ? "began from rest"
                              : "was met at step " + std::to_string(journal.first_step) + ", when it was under way";
  for (const JournalEntry& entry : journal.entries) {
    if (entry.topic == topics::kRestoreCheckpoint && entry.outcome == JournalEntry::APPLIED)
      beginning = restoredFrom(entry);
    if (entry.topic == topics::kResume)
      beginning += "; the simulation " + entry.reason;
  }
  return beginning;
}

}  // namespace

void RecordingWatch::hear(const std::string& topic, const AnyMessage& message,
                          const boost::shared_ptr<ros::M_string>& connection, const ros::WallTime& now) {
  const auto caller = connection->find("callerid");
  Stream& stream = streams_[caller == connection->end() ? "" : caller->second][topic];
  connect(stream, connection, message);
  const bool journal = message.getDataType() == ros::message_traits::DataType<SimulationJournal>::value();
  if (stream.numbered || journal) {
    std::vector<std::uint8_t> bytes = contentOf(message);
    countLost(stream, bytes);
    if (journal)
      hearJournal(stream, bytes, now);
  }
  if (stream.silent) {
    stream.returned_s += (now - stream.last).toSec();
    stream.silent = false;
    stream.heard = 0;
  }
  if (stream.heard++ == 0)
    stream.first = now;
  stream.last = now;
}

void RecordingWatch::connect(Stream& stream, const boost::shared_ptr<ros::M_string>& connection,
                             const AnyMessage& message) {
  if (stream.connection == connection)
    return;
  stream.reconnected = stream.connection != nullptr;
  stream.connection = connection;
  stream.numbered = beginsWithHeader(message.getMessageDefinition());
  stream.sequence = 0;
}

/// What a publisher sent before it was heard of is no loss, nor what it counted anew.
void RecordingWatch::countLost(Stream& stream, const std::vector<std::uint8_t>& bytes) {
  std::uint32_t sequence = 0;
  if (bytes.size() < sizeof(sequence))
    return;
  std::memcpy(&sequence, bytes.data(), sizeof(sequence));
  const bool gap = stream.sequence != 0 && sequence > stream.sequence + 1;
  if (gap) {
    stream.lost += sequence - stream.sequence - 1;
    lost_ += sequence - stream.sequence - 1;
  }
  stream.sequence = sequence;
}

void RecordingWatch::hearJournal(const Stream& stream, std::vector<std::uint8_t>& bytes, const ros::WallTime& now) {
  try {
    const MessageStart start = readMessageStart(ros::message_traits::DataType<SimulationJournal>::value(), bytes);
    const Progress before = progress_;
    progress_ = {start.session, start.revision, start.step};
    if (start.session != before.session) {
      const std::string why = stream.reconnected ? " after a restart of the simulation" : "";
      add(RecorderEvent::SESSION,
          "session " + std::to_string(start.session) + why + " " + beginningOf(parseMessage<SimulationJournal>(bytes)),
          now);
    } else if (start.first_step > before.step) {
      add(RecorderEvent::LOST,
          "the journal of steps " + std::to_string(before.step) + " to " + std::to_string(start.first_step) +
              " never came: a replay cannot go beyond the first of them",
          now);
    }
  } catch (const std::exception& error) {
    add(RecorderEvent::LOST, std::string("a journal message cannot be read: ") + error.what(), now).messages = 1;
  }
}

bool RecordingWatch::isSilent(const Stream& stream, const ros::WallTime& now) {
  if (stream.heard < kRhythmMessages)
    return false;
  const double interval_s = (stream.last - stream.first).toSec() / static_cast<double>(stream.heard - 1);
  return interval_s < kRarest_s && (now - stream.last).toSec() > std::max(kLeastSilence_s, 10.0 * interval_s);
}

void RecordingWatch::look(const ros::WallTime& now) {
  for (auto& publisher : streams_) {
    for (auto& topic : publisher.second) {
      Stream& stream = topic.second;
      stream.fell_silent = !stream.silent && isSilent(stream, now);
      stream.silent = stream.silent || stream.fell_silent;
    }
  }
  addByPublisher(
      RecorderEvent::LOST, now, [](const Stream& stream) { return stream.lost > 0; }, "messages never came");
  addByPublisher(
      RecorderEvent::CONNECTION, now, [](const Stream& stream) { return stream.reconnected; },
      "was restarted, or the network was out; it is connected again");
  addByPublisher(
      RecorderEvent::SILENCE, now, [](const Stream& stream) { return stream.fell_silent; }, "sends nothing any more");
  addByPublisher(
      RecorderEvent::RETURN, now, [](const Stream& stream) { return stream.returned_s > 0.0; }, "sends again");
  for (auto& publisher : streams_) {
    for (auto& topic : publisher.second) {
      Stream& stream = topic.second;
      stream.reconnected = stream.fell_silent = false;
      stream.returned_s = 0.0;
      stream.lost = 0;
    }
  }
}

/// One event for all topics of a publisher: a node that dies takes many with it.
void RecordingWatch::addByPublisher(std::uint8_t kind, const ros::WallTime& now, const Concerned& concerned,
                                    const char* text) {
  for (const auto& publisher : streams_) {
    RecorderEvent sum;
    std::string names;
    for (const auto& topic : publisher.second) {
      const Stream& stream = topic.second;
      if (!concerned(stream))
        continue;
      sum.topics.push_back(topic.first);
      sum.messages += kind == RecorderEvent::LOST ? stream.lost : 0;
      sum.duration = std::max(sum.duration, kind == RecorderEvent::RETURN ? stream.returned_s : 0.0);
      names += (names.empty() ? "" : ", ") + topic.first;
      if (kind == RecorderEvent::LOST)
        names += " (" + std::to_string(stream.lost) + ")";
    }
    if (sum.topics.empty())
      continue;
    const std::string after = sum.duration > 0.0 ? " after " + seconds(sum.duration) : "";
    RecorderEvent& event = add(kind, publisher.first + ": " + text + after + ": " + names, now);
    event.node = publisher.first;
    event.topics = std::move(sum.topics);
    event.messages = sum.messages;
    event.duration = sum.duration;
  }
}

RecorderEvent& RecordingWatch::add(std::uint8_t kind, const std::string& text, const ros::WallTime& now) {
  RecorderEvent event;
  event.stamp.fromNSec(now.toNSec());
  event.kind = kind;
  event.session = progress_.session;
  event.step = progress_.step;
  event.text = text;
  events_.push_back(std::move(event));
  return events_.back();
}

void RecordingWatch::tell(std::uint8_t kind, const std::string& text, const ros::WallTime& now,
                          std::uint64_t messages) {
  add(kind, text, now).messages = messages;
}

std::vector<RecorderEvent> RecordingWatch::take() {
  return std::exchange(events_, {});
}

}  // namespace soft_volume
