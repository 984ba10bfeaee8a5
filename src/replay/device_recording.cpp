#include "device_recording.h"

#include <geometry_msgs/PoseStamped.h>
#include <geometry_msgs/TwistStamped.h>

#include <set>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/button_messages.h"

namespace soft_volume {
namespace {

bool isTopic(const std::string& recorded, const std::string& name) {
  const std::string ending = name.empty() || name.front() == '/' ? name : "/" + name;
  return recorded.size() >= ending.size() && !name.empty() &&
         recorded.compare(recorded.size() - ending.size(), ending.size(), ending) == 0;
}

/// The messages of the topic of that name; where it was remapped, those of the only topic of the type.
template <typename Message>
std::vector<Message> messagesOf(const RecordedRun& run, const std::string& name) {
  std::vector<Message> named;
  std::vector<Message> all;
  std::set<std::string> topics;
  for (RecordedMessage<Message>& recorded : run.messages<Message>()) {
    topics.insert(recorded.topic);
    if (isTopic(recorded.topic, name))
      named.push_back(recorded.message);
    all.push_back(std::move(recorded.message));
  }
  return named.empty() && topics.size() == 1 ? all : named;
}

template <typename Header>
std::int64_t stampOf(const Header& header) {
  return static_cast<std::int64_t>(header.stamp.toNSec());
}

void checkFrame(const std::string& frame, const std::string& wanted, bool has_profile) {
  if (frame.empty() || wanted.empty() || frame == wanted)
    return;
  throw ReplayError("the device's poses are in frame '" + frame + "' and not in '" + wanted + "'; " +
                    (has_profile ? "give the file of the device that was recorded"
                                 : "give the device's file (a name in config/devices, or a path) with --device"));
}

core::Pose poseOf(const geometry_msgs::PoseStamped& message) {
  core::Pose pose = fromPose(message.pose);
  if (core::isUsable(pose))
    pose.orientation.normalize();
  return pose;
}

template <typename Message>
void addButtons(const RecordedRun& run, const core::ButtonSource& source, std::size_t topic,
                core::DeviceStreams& streams) {
  for (const Message& message : messagesOf<Message>(run, source.topic)) {
    try {
      const ButtonChange change = readButtons(source, message);
      streams.addButtons(topic, stampOf(message.header), change.mask, change.pressed);
    } catch (const core::InputError&) {
      // As in the live node, which reports it.
    }
  }
}

}  // namespace

DeviceRecording readDevice(const RecordedRun& run, const core::DeviceProfile* profile,
                           const std::string& volume_frame) {
  DeviceRecording recording;
  const core::DeviceTopics topics = deviceTopics(profile);
  core::DeviceStreams streams(!topics.measured_cv.empty(), topics.buttons.size());
  for (const auto& message : messagesOf<geometry_msgs::PoseStamped>(run, topics.measured_cp)) {
    if (message.header.stamp.isZero())  // CRTK: not valid
      continue;
    recording.frame_id = message.header.frame_id;
    checkFrame(recording.frame_id, profile != nullptr ? profile->base_frame : volume_frame, profile != nullptr);
    streams.addPose(stampOf(message.header), poseOf(message));
  }
  for (const auto& message : messagesOf<geometry_msgs::TwistStamped>(run, topics.measured_cv)) {
    const core::Vector3 velocity = fromVector(message.twist.linear);
    if (!message.header.stamp.isZero() && core::isFinite(velocity))
      streams.addVelocity(stampOf(message.header), velocity);
  }
  for (std::size_t n = 0; n < topics.buttons.size(); ++n) {
    if (topics.buttons[n].closed_below)
      addButtons<sensor_msgs::JointState>(run, topics.buttons[n], n, streams);
    else
      addButtons<sensor_msgs::Joy>(run, topics.buttons[n], n, streams);
  }
  streams.end();
  while (const auto sample = streams.next())
    recording.samples.push_back(*sample);
  if (streams.dropped() > 0) {
    recording.notes.push_back(std::to_string(streams.dropped()) +
                              " messages of the device were left out: their stamps did not increase");
  }
  return recording;
}

}  // namespace soft_volume
