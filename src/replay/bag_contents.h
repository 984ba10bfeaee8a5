#pragma once

#include <rosbag/bag.h>
#include <rosbag/view.h>
#include <soft_volume/RecorderEvent.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "bag_records.h"
#include "recorded_inputs.h"
#include "soft_volume/replay/parse_message.h"
#include "soft_volume/replay/replay_bag.h"

namespace soft_volume {

std::vector<std::uint8_t> readBytes(const rosbag::MessageInstance& instance, std::uint64_t largest);

/// A message of our own in the bag; its content is read when it is needed.
struct BagMessage {
  std::shared_ptr<const rosbag::MessageInstance> instance;
  std::uint32_t revision = 0;
  std::uint64_t step = 0;
  std::uint64_t first_step = 0;  ///< of a journal
  std::uint64_t base_step = 0;   ///< of a state
  double time_s = 0.0;           ///< of a state: simulated time
  bool key_frame = false;        ///< of a state
};

/// What a bag holds of one run, each list in the order of steps.
struct SessionMessages {
  std::uint64_t session = 0;
  std::vector<BagMessage> scenes;
  std::vector<BagMessage> volumes;
  std::vector<BagMessage> topologies;
  std::vector<BagMessage> states;
  std::vector<BagMessage> journals;
  std::vector<BagMessage> checkpoints;
  std::vector<BagMessage> render_stats;
};

struct BagImage {
  std::shared_ptr<const rosbag::MessageInstance> instance;
  std::string topic;
  std::uint64_t stamp_ns = 0;
  bool used = false;
};

/// An opened bag, sorted by session. Topics are told apart by their types, so remapped ones are found too.
class BagContents {
 public:
  /// Throws ReplayError when the bag cannot be read, lacks a topic or was recorded by another version.
  explicit BagContents(const std::string& path);

  std::vector<SessionMessages>& sessions() { return sessions_; }
  RecordedInputs& inputs() { return inputs_; }
  std::vector<BagImage>& images() { return images_; }
  /// What the recorder saw happen, in the order of time.
  const std::vector<RecorderEvent>& events() const { return events_; }

  std::vector<std::uint8_t> bytes(const rosbag::MessageInstance& instance) const {
    return readBytes(instance, records_.largest_chunk_bytes);
  }
  /// Every message of a type in the order of the recording. False when the bag holds the type in another version.
  bool visit(const std::string& type, const std::string& md5sum,
             const std::function<void(const rosbag::MessageInstance&)>& take) const;
  template <typename Message>
  Message read(const rosbag::MessageInstance& instance) const {
    return parseMessage<Message>(bytes(instance));
  }

 private:
  void checkConnections();
  void sortMessages();
  void addMessage(const rosbag::MessageInstance& instance);
  void addImage(const rosbag::MessageInstance& instance);
  void addEvents(const rosbag::MessageInstance& instance);
  SessionMessages& session(std::uint64_t id);

  BagRecords records_;
  rosbag::Bag bag_;
  std::unique_ptr<rosbag::View> view_;
  std::vector<SessionMessages> sessions_;
  RecordedInputs inputs_;
  std::vector<BagImage> images_;
  std::vector<RecorderEvent> events_;
  std::set<std::pair<ros::Time, std::string>> known_events_;
};

}  // namespace soft_volume
