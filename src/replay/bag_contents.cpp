#include "bag_contents.h"

#include <sensor_msgs/Image.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/RecorderStatus.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolGrip.h>
#include <soft_volume/Volume.h>

#include <algorithm>
#include <map>
#include <set>

#include "message_start.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

/// How each type that a replay reads is handled, by its name.
struct KnownType {
  std::string md5sum;
  const char* needed_topic = nullptr;  ///< a bag without it cannot be replayed
  bool is_input = false;
  std::vector<BagMessage> SessionMessages::*list = nullptr;
};

template <typename Message>
void addType(std::map<std::string, KnownType>& types, const char* needed_topic, bool is_input,
             std::vector<BagMessage> SessionMessages::*list) {
  types[ros::message_traits::datatype<Message>()] = {ros::message_traits::md5sum<Message>(), needed_topic, is_input,
                                                     list};
}

const std::map<std::string, KnownType>& knownTypes() {
  static const std::map<std::string, KnownType> types = [] {
    std::map<std::string, KnownType> all;
    addType<Scene>(all, topics::kScene, false, &SessionMessages::scenes);
    addType<Volume>(all, topics::kVolume, false, &SessionMessages::volumes);
    addType<GridTopology>(all, nullptr, false, &SessionMessages::topologies);
    addType<GridState>(all, topics::kState, false, &SessionMessages::states);
    addType<SimulationJournal>(all, topics::kJournal, false, &SessionMessages::journals);
    addType<SimulationCheckpoint>(all, nullptr, false, &SessionMessages::checkpoints);
    addType<RenderStats>(all, nullptr, false, &SessionMessages::render_stats);
    addType<ToolForce>(all, nullptr, true, nullptr);
    addType<ToolCut>(all, nullptr, true, nullptr);
    addType<ToolGrip>(all, nullptr, true, nullptr);
    addType<sensor_msgs::Image>(all, nullptr, false, nullptr);
    return all;
  }();
  return types;
}

bool isImage(const rosbag::ConnectionInfo& connection) {
  const std::string ending = "/image_raw";
  return connection.datatype == ros::message_traits::datatype<sensor_msgs::Image>() &&
         connection.topic.size() > ending.size() &&
         connection.topic.compare(connection.topic.size() - ending.size(), ending.size(), ending) == 0;
}

/// Without its right name a message would be left out in silence.
bool isOursByDefinition(const rosbag::ConnectionInfo& connection) {
  const auto& types = knownTypes();
  return std::any_of(types.begin(), types.end(),
                     [&connection](const auto& type) { return type.second.md5sum == connection.md5sum; });
}

/// Bags of other recorders, and of versions that told less, are read all the same.
bool tellsEvents(const rosbag::ConnectionInfo& connection) {
  return connection.datatype == ros::message_traits::datatype<RecorderStatus>() &&
         connection.md5sum == ros::message_traits::md5sum<RecorderStatus>();
}

bool isRead(const rosbag::ConnectionInfo* connection) {
  if (tellsEvents(*connection))
    return true;
  const auto type = knownTypes().find(connection->datatype);
  if (type == knownTypes().end())
    return false;
  return type->second.list != nullptr || type->second.is_input || isImage(*connection);
}

}  // namespace

std::vector<std::uint8_t> readBytes(const rosbag::MessageInstance& instance, std::uint64_t largest) {
  const std::uint32_t size = instance.size();
  if (size > largest)
    throw ReplayError("the bag is damaged: a message is longer than its chunk");
  std::vector<std::uint8_t> bytes(size);
  ros::serialization::OStream stream(bytes.data(), size);
  instance.write(stream);
  return bytes;
}

BagContents::BagContents(const std::string& path) : records_(checkBagRecords(path)) {
  try {
    bag_.open(path, rosbag::bagmode::Read);
    checkConnections();
    view_ = std::make_unique<rosbag::View>(bag_, isRead);
    for (const rosbag::MessageInstance& instance : *view_)
      addMessage(instance);
  } catch (const rosbag::BagUnindexedException&) {
    throw ReplayError(path + ": the bag has no index; run `rosbag reindex '" + path + "'` first");
  } catch (const ReplayError& error) {
    throw ReplayError(path + ": " + error.what());
  } catch (const ros::Exception& error) {
    throw ReplayError(path + ": the bag is damaged: " + error.what());
  }
  for (const auto& type : knownTypes()) {
    const auto list = type.second.list;
    const bool missing = type.second.needed_topic != nullptr &&
                         std::all_of(sessions_.begin(), sessions_.end(),
                                     [list](const SessionMessages& session) { return (session.*list).empty(); });
    if (missing) {
      throw ReplayError(path + ": the bag holds no message of the topic '" + type.second.needed_topic + "' (" +
                        type.first + "), which a replay needs; record it too");
    }
  }
  sortMessages();
}

void BagContents::checkConnections() {
  rosbag::View all(bag_);
  for (const rosbag::ConnectionInfo* connection : all.getConnections()) {
    const auto type = knownTypes().find(connection->datatype);
    if (type == knownTypes().end() && isOursByDefinition(*connection)) {
      throw ReplayError("the bag is damaged: the messages of '" + connection->topic + "' are named " +
                        connection->datatype + ", which their definition is not");
    }
    if (type != knownTypes().end() && type->second.md5sum != connection->md5sum) {
      throw ReplayError("the bag was recorded by another version: the messages of '" + connection->topic + "' (" +
                        connection->datatype +
                        ") are defined differently; replay it with the version that recorded it");
    }
  }
}

void BagContents::addMessage(const rosbag::MessageInstance& instance) {
  const std::string& name = instance.getDataType();
  if (name == ros::message_traits::datatype<RecorderStatus>())
    return addEvents(instance);
  const KnownType& type = knownTypes().at(name);
  if (type.is_input) {
    inputs_.add(name, bytes(instance));
  } else if (type.list == nullptr) {
    addImage(instance);
  } else {
    std::vector<std::uint8_t> content = bytes(instance);
    const MessageStart start = readMessageStart(name, content);
    (session(start.session).*type.list)
        .push_back({std::make_shared<rosbag::MessageInstance>(instance), start.revision, start.step, start.first_step,
                    start.base_step, start.time_s, start.key_frame});
  }
}

void BagContents::addImage(const rosbag::MessageInstance& instance) {
  std::vector<std::uint8_t> data = bytes(instance);
  ros::serialization::IStream stream(data.data(), static_cast<std::uint32_t>(data.size()));
  std_msgs::Header header;
  stream.next(header);
  images_.push_back(
      {std::make_shared<rosbag::MessageInstance>(instance), instance.getTopic(), header.stamp.toNSec(), false});
}

bool BagContents::visit(const std::string& type, const std::string& md5sum,
                        const std::function<void(const rosbag::MessageInstance&)>& take) const {
  bool same_version = true;
  rosbag::View view(bag_, [&](const rosbag::ConnectionInfo* connection) {
    const bool wanted = connection->datatype == type;
    same_version = same_version && (!wanted || connection->md5sum == md5sum);
    return wanted && connection->md5sum == md5sum;
  });
  for (const rosbag::MessageInstance& instance : view)
    take(instance);
  return same_version;
}

/// A status may be there twice: written by the recorder, and recorded as a topic.
void BagContents::addEvents(const rosbag::MessageInstance& instance) {
  const auto status = read<RecorderStatus>(instance);
  for (const RecorderEvent& event : status.events) {
    if (known_events_.emplace(event.stamp, event.text).second)
      events_.push_back(event);
  }
}

SessionMessages& BagContents::session(std::uint64_t id) {
  const auto found =
      std::find_if(sessions_.begin(), sessions_.end(), [id](const SessionMessages& s) { return s.session == id; });
  if (found != sessions_.end())
    return *found;
  sessions_.emplace_back();
  sessions_.back().session = id;
  return sessions_.back();
}

void BagContents::sortMessages() {
  const auto by_step = [](const BagMessage& a, const BagMessage& b) { return a.step < b.step; };
  const auto by_range = [](const BagMessage& a, const BagMessage& b) {
    return std::tie(a.first_step, a.step) < std::tie(b.first_step, b.step);
  };
  for (SessionMessages& session : sessions_) {
    for (const auto& type : knownTypes()) {
      if (type.second.list == nullptr)
        continue;
      auto& list = session.*type.second.list;
      const bool journal = type.second.list == &SessionMessages::journals;
      journal ? std::stable_sort(list.begin(), list.end(), by_range)
              : std::stable_sort(list.begin(), list.end(), by_step);
    }
  }
}

}  // namespace soft_volume
