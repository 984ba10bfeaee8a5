#include "soft_volume/ros/recorder_node.h"

#include <ros/callback_queue.h>
#include <ros/console.h>
#include <ros/init.h>
#include <ros/master.h>
#include <soft_volume/SimulationJournal.h>

#include <cstdio>
#include <cstring>

#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/parameters.h"

namespace soft_volume {
namespace {

/// Enough for some seconds of a 1 kHz topic. Callbacks only queue, so it fills up only when the machine stands still.
constexpr std::uint32_t kSubscriberQueue = 10000;
constexpr double kSearchInterval_s = 0.5;
constexpr char kPattern[] = "*/";

const std::vector<std::string>& defaultTopics() {
  static const std::vector<std::string> topics = {topics::kScene,
                                                  topics::kVolume,
                                                  topics::kTopology,
                                                  topics::kState,
                                                  topics::kJournal,
                                                  topics::kCheckpoint,
                                                  topics::kToolForce,
                                                  topics::kToolCut,
                                                  topics::kToolGrip,
                                                  topics::kToolState,
                                                  topics::kServoForce,
                                                  topics::kMeasuredPose,
                                                  topics::kButtons,
                                                  topics::kMeasuredVelocity,
                                                  topics::kRenderStats,
                                                  topics::kSimulationStats,
                                                  "*/image_raw",
                                                  "*/camera_info",
                                                  "*/view"};
  return topics;
}

std::vector<std::string> wantedTopics(const ros::NodeHandle& node) {
  std::vector<std::string> topics;
  if (!node.hasParam("topics"))
    return defaultTopics();
  if (!node.getParam("topics", topics) || topics.empty()) {
    throw core::InputError("the parameter " + node.resolveName("topics") + " must be a list of topic names");
  }
  return topics;
}

BagRecorderSettings recorderSettings(const ros::NodeHandle& node) {
  BagRecorderSettings settings;
  settings.file = requiredParameter<std::string>(node, "file", "the bag to write");
  const auto compression = parameter<std::string>(node, "compression", "lz4");
  if (compression != "lz4" && compression != "none") {
    throw core::InputError("the parameter " + node.resolveName("compression") + " must be lz4 or none");
  }
  settings.compress = compression == "lz4";
  settings.reserve_bytes = std::uint64_t(parameter<int>(node, "reserve_mib", 256, 1, 1 << 30)) << 20;
  settings.queue_bytes = std::uint64_t(parameter<int>(node, "queue_mib", 256, 1, 1 << 20)) << 20;
  return settings;
}

bool endsWith(const std::string& text, const std::string& ending) {
  return text.size() > ending.size() && text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

bool isLatched(const ros::MessageEvent<const AnyMessage>& event) {
  const auto latching = event.getConnectionHeader().find("latching");
  return latching != event.getConnectionHeader().end() && latching->second == "1";
}

}  // namespace

RecorderNode::RecorderNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node),
      file_(recorderSettings(private_node).file),
      recorder_(recorderSettings(private_node)),
      diagnostics_(node, private_node) {
  for (const std::string& topic : wantedTopics(private_node)) {
    if (topic.compare(0, std::strlen(kPattern), kPattern) == 0) {
      endings_.push_back(topic.substr(1));
    } else {
      subscribe(node_.resolveName(topic));
    }
  }
  findTopics();
  status_publisher_ = node_.advertise<RecorderStatus>(topics::kRecorderStatus, 10, true);
  diagnostics_.setHardwareID("none");
  diagnostics_.add("recorder", this, &RecorderNode::diagnose);
  timers_.push_back(node_.createWallTimer(ros::WallDuration(kSearchInterval_s),
                                          [this](const ros::WallTimerEvent&) { findTopics(); }));
  timers_.push_back(node_.createWallTimer(ros::WallDuration(1.0), [this](const ros::WallTimerEvent&) {
    publishStatus();
    diagnostics_.force_update();
  }));
  ROS_INFO("recording into %s", file_.c_str());
}

void RecorderNode::subscribe(const std::string& topic) {
  using Event = ros::MessageEvent<const AnyMessage>;
  ros::SubscribeOptions options;
  options.topic = topic;
  options.queue_size = kSubscriberQueue;
  options.md5sum = ros::message_traits::md5sum<AnyMessage>();
  options.datatype = ros::message_traits::datatype<AnyMessage>();
  options.helper = boost::make_shared<ros::SubscriptionCallbackHelperT<const Event&>>(
      boost::function<void(const Event&)>([this, topic](const Event& event) { hear(topic, event); }));
  options.transport_hints = ros::TransportHints().tcpNoDelay();
  subscribers_[topic] = node_.subscribe(options);
}

void RecorderNode::findTopics() {
  if (endings_.empty())
    return;
  ros::master::V_TopicInfo topics;
  if (!ros::master::getTopics(topics))
    return;
  const std::string own = node_.resolveName("");
  for (const ros::master::TopicInfo& topic : topics) {
    const bool within = topic.name.compare(0, own.size(), own) == 0;
    if (!within || subscribers_.count(topic.name) != 0)
      continue;
    for (const std::string& ending : endings_) {
      if (endsWith(topic.name, ending))
        subscribe(topic.name);
    }
  }
}

void RecorderNode::hear(const std::string& topic, const ros::MessageEvent<const AnyMessage>& event) {
  const boost::shared_ptr<const AnyMessage> message = event.getConstMessage();
  if (message->getDataType() == ros::message_traits::datatype<SimulationJournal>())
    readProgress(*message);
  recorder_.write(topic, event.getReceiptTime(), message, event.getConnectionHeaderPtr(), isLatched(event));
}

void RecorderNode::readProgress(const AnyMessage& journal) {
  std::vector<std::uint8_t> bytes(journal.size());
  ros::serialization::OStream out(bytes.data(), journal.size());
  journal.write(out);
  ros::serialization::IStream in(bytes.data(), journal.size());
  try {
    std_msgs::Header header;
    in.next(header);
    in.next(progress_.session);
    in.next(progress_.revision);
    in.next(progress_.step);
  } catch (const ros::serialization::StreamOverrunException&) {
    ROS_WARN_THROTTLE(1.0, "a journal message is too short; it is recorded as it is");
  }
}

int RecorderNode::run(const volatile std::sig_atomic_t& signal) {
  while (signal == 0 && ros::ok())
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.05));
  const bool was_recording = recorder_.status().recording;
  if (ros::ok())
    takeArrived();
  recorder_.close(signal != 0 ? "signal " + std::to_string(signal) : "ROS shut down");
  const BagRecorder::Status status = recorder_.status();
  if (ros::ok())
    publishStatus();
  // Not through rosout, which may be gone.
  std::printf("recorder: %s, %llu messages, %llu bytes, %llu dropped (%s)\n", file_.c_str(),
              static_cast<unsigned long long>(status.messages), static_cast<unsigned long long>(status.bytes),
              static_cast<unsigned long long>(status.dropped), status.stop_reason.c_str());
  const bool closed = status.stop_reason.find("closing failed") == std::string::npos;
  return was_recording && closed ? 0 : 1;
}

/// What other nodes sent before the signal is still on its way: connections are read by a thread of roscpp's.
void RecorderNode::takeArrived() {
  const ros::WallTime begin = ros::WallTime::now();
  const auto heard = [this] { return recorder_.status().messages; };
  for (std::uint64_t before = heard() + 1; ros::WallTime::now() - begin < ros::WallDuration(2.0);) {
    ros::getGlobalCallbackQueue()->callAvailable(ros::WallDuration(0.1));
    const std::uint64_t now = heard();
    if (now == before)
      return;
    before = now;
  }
}

void RecorderNode::publishStatus() {
  const BagRecorder::Status status = recorder_.status();
  RecorderStatus message = progress_;
  message.header.stamp.fromNSec(ros::WallTime::now().toNSec());
  message.file = file_;
  message.bytes = status.bytes;
  message.free_bytes = status.free_bytes;
  message.messages = status.messages;
  message.dropped = status.dropped;
  message.recording = static_cast<std::uint8_t>(status.recording);
  message.stop_reason = status.stop_reason;
  status_publisher_.publish(message);
}

void RecorderNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& diagnostics) {
  using Level = diagnostic_msgs::DiagnosticStatus;
  const BagRecorder::Status status = recorder_.status();
  if (!status.recording) {
    diagnostics.summary(Level::ERROR, "recording stopped: " + status.stop_reason);
  } else if (status.dropped > diagnosed_drops_) {
    diagnostics.summary(Level::WARN, "messages are dropped: the disk does not keep up");
  } else {
    diagnostics.summary(Level::OK, "recording");
  }
  diagnosed_drops_ = status.dropped;
  diagnostics.add("file", file_);
  diagnostics.add("topics", subscribers_.size());
  diagnostics.add("messages", status.messages);
  diagnostics.add("dropped", status.dropped);
  diagnostics.add("bytes", status.bytes);
  diagnostics.add("free bytes", status.free_bytes);
}

}  // namespace soft_volume
