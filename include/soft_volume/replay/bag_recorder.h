#pragma once

#include <ros/datatypes.h>
#include <ros/time.h>
#include <topic_tools/shape_shifter.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>

namespace soft_volume {

/// A message of any type, serialised, as the recorder takes it.
using AnyMessage = topic_tools::ShapeShifter;

struct BagRecorderSettings {
  std::string file;                                        ///< written as FILE.active until it is closed
  bool compress = true;                                    ///< lz4
  std::uint64_t queue_bytes = std::uint64_t(256) << 20;    ///< most that waits for the disk; more is dropped, counted
  std::uint64_t reserve_bytes = std::uint64_t(256) << 20;  ///< recording stops when less is free on the disk
  std::uint64_t split_bytes = 0;  ///< a file of this size is closed and the next part begun; 0: one file
  /// Makes the last message of every file, for `last_topic`; may be empty. `next_file` is where the recording goes on,
  /// or `reason` why it ends. Called by the recorder's own thread.
  std::function<boost::shared_ptr<AnyMessage>(const std::string& next_file, const std::string& reason)> last_message;
  std::string last_topic;
};

/// Serialises a message for the recorder.
template <typename Message>
boost::shared_ptr<AnyMessage> anyMessage(const Message& message) {
  const auto any = boost::make_shared<AnyMessage>();
  any->morph(ros::message_traits::md5sum(message), ros::message_traits::datatype(message),
             ros::message_traits::definition(message), "");
  const ros::SerializedMessage bytes = ros::serialization::serializeMessage(message);
  ros::serialization::IStream stream(bytes.message_start, static_cast<std::uint32_t>(bytes.num_bytes - 4));
  any->read(stream);
  return any;
}

/// Writes messages into a bag so that little is lost whatever happens.
///
/// - A thread of its own writes, fed by a bounded queue: a slow disk delays nobody. What does not fit is dropped and
///   counted; latched messages never are.
/// - A chunk is closed at least every half second and handed to the kernel, so after a SIGKILL `rosbag reindex` of
///   FILE.active brings back all but the last second.
/// - It stops by itself when the disk is nearly full or a write fails, with the bag closed properly where that is still
///   possible; else FILE.active can be indexed.
/// - close() writes what is queued and renames FILE.active to FILE. Nothing is replaced: a FILE that was there is kept
///   as FILE.former (.2, .3, ...), and a FILE.active that a killed recorder left behind as FILE.interrupted (likewise).
///
/// With `split_bytes` the files are called NAME_0.bag, NAME_1.bag and so on, beginning beyond those that are there.
/// Each is complete in itself: it begins with everything latched, the topology, the newest checkpoint and what followed
/// it (which the part before holds, too), so it replays alone. A part begins when that can be had: parts grow beyond
/// the size while a run begins, and always hold as much again as they begin with. A size below what is latched stops
/// the recording, with the size needed.
///
/// write() and status() may be called from any thread.
class BagRecorder {
 public:
  struct Status {
    std::string file;              ///< being written, or written last
    std::uint32_t parts = 0;       ///< closed before it
    std::uint64_t bytes = 0;       ///< size of all files
    std::uint64_t free_bytes = 0;  ///< free space beside them
    std::uint64_t messages = 0;    ///< written
    std::uint64_t dropped = 0;     ///< lost because the disk did not keep up or recording had stopped
    bool recording = false;
    bool split_waits = false;  ///< the file has the size of a part, but another cannot begin yet
    bool refused = false;      ///< it stopped because the settings cannot be met
    bool closed = false;       ///< the last file was closed properly
    std::string stop_reason;   ///< why it stopped; empty while it records
  };

  /// Opens FILE.active. Throws core::FileError when it cannot be written, another recorder writes it, or the disk has
  /// less than the reserve.
  explicit BagRecorder(const BagRecorderSettings& settings);
  /// As close("the recorder ended").
  ~BagRecorder();
  BagRecorder(const BagRecorder&) = delete;
  BagRecorder& operator=(const BagRecorder&) = delete;

  /// Queues a message. `header` is the connection header of the publisher, or null; type, md5sum and definition are
  /// filled in where it lacks them. Returns false when the message was dropped.
  bool write(const std::string& topic, const ros::Time& receipt, boost::shared_ptr<const AnyMessage> message,
             const boost::shared_ptr<ros::M_string>& header, bool latched);
  /// For a message whose publisher has no connection.
  template <typename Message>
  bool write(const std::string& topic, const ros::Time& receipt, const Message& message, bool latched = false) {
    return write(topic, receipt, anyMessage(message), nullptr, latched);
  }

  /// Writes what is queued and closes the bag. Later messages count as dropped. Idempotent.
  void close(const std::string& reason);
  Status status() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soft_volume
