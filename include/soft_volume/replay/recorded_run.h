#pragma once

#include <ros/message_traits.h>
#include <ros/time.h>
#include <soft_volume/RecorderEvent.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/SimulationStats.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "soft_volume/grid/topology.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/parse_message.h"
#include "soft_volume/replay/replay_bag.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

class BagContents;
struct SessionMessages;

/// A message of any type as it was recorded.
template <typename Message>
struct RecordedMessage {
  std::string topic;  ///< as recorded, with its namespace
  ros::Time receipt;
  Message message;
};

/// A published state, without its positions.
struct RecordedState {
  std::uint64_t step = 0;
  std::uint32_t revision = 0;
  double time_s = 0.0;  ///< simulated time since the start of the session
  bool key_frame = false;
};

/// A recorded frame, without its pixels.
struct RecordedFrame {
  std::string topic;    ///< of the image; empty where only what it shows was recorded
  RenderStats stats;    ///< what it shows: camera, pose, step, revision, settings, renderer
  double time_s = 0.0;  ///< simulated time of the step that it shows
};

/// An input that the simulation applied or refused, with the simulated time from which on it counts.
struct RecordedEntry {
  double time_s = 0.0;
  JournalEntry entry;
};

class RecordedBag;

/// One session of a bag, decoded: what the report, the comparison, the export and a resimulation read. Lists are made
/// once; positions, topologies, images and volumes are read from the file when they are asked for. Not thread-safe. All
/// throw ReplayError where the bag is damaged.
///
/// Times are simulated seconds since the start of the session. The simulation stamps a state with the start of the
/// session + simulated time; stamps of devices and tools are of the same clock.
class RecordedRun {
 public:
  ~RecordedRun();
  RecordedRun(const RecordedRun&) = delete;
  RecordedRun& operator=(const RecordedRun&) = delete;

  std::uint64_t session() const;
  /// As recorded, with versions and hashes; throws ReplayError where it was not.
  Scene sceneMessage() const;
  core::Scene scene() const;
  VolumeAndLabels volume() const;

  /// By step; empty in a bag without states.
  const std::vector<RecordedState>& states() const { return states_; }
  /// Positions of all vertices of that state's revision, volume frame, metres. Throws ReplayError when the key frame
  /// that it refers to is not in the bag; hasPositions() says so before.
  std::vector<core::Vector3f> positions(std::size_t state) const;
  bool hasPositions(std::size_t state) const;

  /// Revisions whose topology can be had, increasing.
  std::vector<std::uint32_t> revisions() const;
  /// Null where neither it nor what it changes is in the bag. Going forward is cheap; going back decodes from the
  /// start.
  std::shared_ptr<const core::Topology> topology(std::uint32_t revision) const;

  /// By step. Images without render/stats are left out: nothing says what they show.
  const std::vector<RecordedFrame>& frames() const { return frames_; }
  /// Whether the pixels were recorded, too.
  bool hasImage(std::size_t frame) const;
  core::Image image(std::size_t frame) const;

  /// By step; empty where another version defined them.
  const std::vector<SimulationStats>& stats() const { return stats_; }
  /// The journal of the session as far as it was recorded, in order.
  std::vector<RecordedEntry> entries() const;
  std::vector<SimulationJournal> journals() const;

  double timeOf(const ros::Time& stamp) const { return (stamp - reference_stamp_).toSec() + reference_time_s_; }
  ros::Time stampAt(double time_s) const { return reference_stamp_ + ros::Duration(time_s - reference_time_s_); }
  /// Simulated time of a step, interpolated between the states around it.
  double timeOfStep(std::uint64_t step) const;

  /// All messages of a type that belong to the session, in the order of the recording: those that name a session by it,
  /// others (devices) by when they were received. Empty, with a note of the bag, where another version defined them.
  template <typename Message>
  std::vector<RecordedMessage<Message>> messages() const;

 private:
  friend class RecordedBag;
  RecordedRun(const RecordedBag& bag, const SessionMessages& messages);

  bool isMine(std::uint64_t session) const;
  void readStates();
  void readFrames();
  std::size_t findImage(const RenderStats& stats) const;
  std::size_t findKeyFrame(std::size_t state) const;

  struct Decoder;
  const RecordedBag* bag_;
  const SessionMessages* messages_;
  std::vector<RecordedState> states_;
  std::vector<RecordedFrame> frames_;
  std::vector<std::size_t> images_;  ///< of the frames, among the bag's; beyond its end where there is none
  std::vector<SimulationStats> stats_;
  ros::Time reference_stamp_;  ///< of the first state, else of the scene
  double reference_time_s_ = 0.0;
  ros::Time begin_;  ///< of the session by receipt
  ros::Time end_;
  std::unique_ptr<Decoder> decoder_;  ///< what was read last
};

/// A bag opened with the checks of BagContents. Call it in a process that may die: rosbag's library crashes on some
/// damaged bags.
class RecordedBag {
 public:
  /// Throws ReplayError when the bag cannot be read, lacks a topic or was recorded by another version.
  explicit RecordedBag(const std::string& path);
  ~RecordedBag();
  RecordedBag(const RecordedBag&) = delete;
  RecordedBag& operator=(const RecordedBag&) = delete;

  const std::string& path() const { return path_; }
  /// Sessions in the order of the bag.
  std::size_t size() const { return runs_.size(); }
  const RecordedRun& run(std::size_t n) const { return *runs_.at(n); }
  /// The run with the most simulated time, which is meant where a bag is spoken of as one run.
  const RecordedRun& longest() const;
  /// What could not be read and why.
  const std::vector<std::string>& notes() const { return notes_; }
  /// What the recorder saw happen, in the order of time.
  const std::vector<RecorderEvent>& events() const;
  /// All messages of a type, whatever session they belong to, in the order of the recording.
  template <typename Message>
  std::vector<RecordedMessage<Message>> messages() const;

 private:
  friend class RecordedRun;
  using Take = std::function<void(const std::string& topic, const ros::Time& receipt, std::vector<std::uint8_t> bytes)>;
  void forEach(const std::string& type, const std::string& md5sum, const Take& take) const;

  std::string path_;
  std::unique_ptr<BagContents> contents_;
  std::vector<std::unique_ptr<RecordedRun>> runs_;
  mutable std::vector<std::string> notes_;
};

namespace recorded_run_detail {
template <typename Message, typename = void>
struct HasSession : std::false_type {};
template <typename Message>
struct HasSession<Message, std::void_t<decltype(std::declval<Message>().session)>> : std::true_type {};
}  // namespace recorded_run_detail

template <typename Message>
std::vector<RecordedMessage<Message>> RecordedBag::messages() const {
  std::vector<RecordedMessage<Message>> all;
  forEach(ros::message_traits::datatype<Message>(), ros::message_traits::md5sum<Message>(),
          [&](const std::string& topic, const ros::Time& receipt, std::vector<std::uint8_t> bytes) {
            all.push_back({topic, receipt, parseMessage<Message>(std::move(bytes))});
          });
  return all;
}

template <typename Message>
std::vector<RecordedMessage<Message>> RecordedRun::messages() const {
  std::vector<RecordedMessage<Message>> all;
  bag_->forEach(ros::message_traits::datatype<Message>(), ros::message_traits::md5sum<Message>(),
                [&](const std::string& topic, const ros::Time& receipt, std::vector<std::uint8_t> bytes) {
                  Message message = parseMessage<Message>(std::move(bytes));
                  if constexpr (recorded_run_detail::HasSession<Message>::value) {
                    if (!isMine(message.session))
                      return;
                  } else if (receipt < begin_ || receipt >= end_) {
                    return;
                  }
                  all.push_back({topic, receipt, std::move(message)});
                });
  return all;
}

}  // namespace soft_volume
