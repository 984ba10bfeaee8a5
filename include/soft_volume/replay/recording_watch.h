#pragma once

#include <soft_volume/RecorderEvent.h>

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "soft_volume/replay/bag_recorder.h"

namespace soft_volume {

/// Watches what comes to a recorder and makes events of what a reader of the recording should know: runs that begin and
/// why, topics that stop and come again, publishers that come again, messages that never came. Those are told by
/// header.seq, which roscpp and rospy count per topic. Not thread-safe.
class RecordingWatch {
 public:
  /// Newest that was seen.
  struct Progress {
    std::uint64_t session = 0;
    std::uint32_t revision = 0;
    std::uint64_t step = 0;
  };

  /// `connection` is the connection header of the publisher: the same object as long as the connection stands.
  void hear(const std::string& topic, const AnyMessage& message, const boost::shared_ptr<ros::M_string>& connection,
            const ros::WallTime& now);
  /// To be called some times a second: finds silences, and sums up what happened since the last call.
  void look(const ros::WallTime& now);
  /// Something that the recorder itself has to tell.
  void tell(std::uint8_t kind, const std::string& text, const ros::WallTime& now, std::uint64_t messages = 0);

  /// Events since the last call.
  std::vector<RecorderEvent> take();
  const Progress& progress() const { return progress_; }
  /// Messages that never came.
  std::uint64_t lost() const { return lost_; }

 private:
  /// A topic of a publisher.
  struct Stream {
    boost::shared_ptr<ros::M_string> connection;
    bool numbered = false;  ///< its messages begin with a header
    std::uint32_t sequence = 0;
    std::uint64_t heard = 0;  ///< since it came, or came again
    ros::WallTime first;      ///< of these
    ros::WallTime last;
    bool silent = false;

    // Since the last look.
    bool reconnected = false;
    bool fell_silent = false;
    double returned_s = 0.0;  ///< after so long
    std::uint64_t lost = 0;
  };
  using Concerned = std::function<bool(const Stream&)>;

  void connect(Stream& stream, const boost::shared_ptr<ros::M_string>& connection, const AnyMessage& message);
  void countLost(Stream& stream, const std::vector<std::uint8_t>& bytes);
  void hearJournal(const Stream& stream, std::vector<std::uint8_t>& bytes, const ros::WallTime& now);
  static bool isSilent(const Stream& stream, const ros::WallTime& now);
  RecorderEvent& add(std::uint8_t kind, const std::string& text, const ros::WallTime& now);
  void addByPublisher(std::uint8_t kind, const ros::WallTime& now, const Concerned& concerned, const char* text);

  std::map<std::string, std::map<std::string, Stream>> streams_;  ///< by publisher and topic
  std::vector<RecorderEvent> events_;
  Progress progress_;
  std::uint64_t lost_ = 0;
};

}  // namespace soft_volume
