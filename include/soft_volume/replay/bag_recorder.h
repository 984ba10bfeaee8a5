#pragma once

#include <ros/datatypes.h>
#include <ros/time.h>
#include <topic_tools/shape_shifter.h>

#include <cstdint>
#include <memory>
#include <string>

namespace soft_volume {

struct BagRecorderSettings {
  std::string file;                                        ///< written as FILE.active until it is closed
  bool compress = true;                                    ///< lz4
  std::uint64_t queue_bytes = std::uint64_t(256) << 20;    ///< most that waits for the disk; more is dropped, counted
  std::uint64_t reserve_bytes = std::uint64_t(256) << 20;  ///< recording stops when less is free on the disk
};

/// A message of any type, serialised, as the recorder takes it.
using AnyMessage = topic_tools::ShapeShifter;

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
/// - It stops by itself, with the bag closed properly, when the disk is nearly full or a write fails.
/// - close() writes what is queued and renames FILE.active to FILE, replacing a former FILE. A FILE.active that a
///   killed recorder left behind is kept as FILE.interrupted (.2, .3, ...).
///
/// write() and status() may be called from any thread.
class BagRecorder {
 public:
  struct Status {
    std::uint64_t bytes = 0;       ///< size of the file
    std::uint64_t free_bytes = 0;  ///< free space beside it
    std::uint64_t messages = 0;    ///< written
    std::uint64_t dropped = 0;     ///< lost because the disk did not keep up or recording had stopped
    bool recording = false;
    std::string stop_reason;  ///< why it stopped; empty while it records
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
