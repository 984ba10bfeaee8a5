#include "soft_volume/ros/recorder_node.h"

#include <ros/callback_queue.h>
#include <ros/console.h>
#include <ros/init.h>

#include <chrono>
#include <cstdio>
#include <cstring>

#include "graph_api.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/parameters.h"
#include "soft_volume/ros/recording_info.h"

namespace soft_volume {
namespace {

/// Enough for some seconds of a 1 kHz topic. Callbacks only queue, so it fills up only when the machine stands still.
constexpr std::uint32_t kSubscriberQueue = 10000;
constexpr double kSearchInterval_s = 0.25;
constexpr double kWatchInterval_s = 0.25;
constexpr char kPattern[] = "*/";

const std::vector<std::string>& defaultTopics() {
  static const std::vector<std::string> topics = {topics::kScene,       topics::kVolume,
                                                  topics::kTopology,    topics::kState,
                                                  topics::kJournal,     topics::kCheckpoint,
                                                  topics::kToolForce,   topics::kToolCut,
                                                  topics::kToolGrip,    topics::kToolState,
                                                  topics::kServoForce,  topics::kMeasuredPose,
                                                  topics::kButtons,     topics::kMeasuredVelocity,
                                                  topics::kRenderStats, topics::kSimulationStats,
                                                  "/diagnostics",       "/rosout",
                                                  "*/measured_cp",      "*/measured_cv",
                                                  "*/servo_cf",         "*/joy",
                                                  "*/operating_state",  "*/image_raw",
                                                  "*/camera_info",      "*/view"};
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
  settings.split_bytes = std::uint64_t(parameter<int>(node, "split_mib", 0, 0, 1 << 30)) << 20;
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
      recorder_([this, &private_node] {
        BagRecorderSettings settings = recorderSettings(private_node);
        settings.last_topic = node_.resolveName(topics::kRecorderStatus);
        settings.last_message = [this](const std::string& next_file, const std::string& reason) {
          return lastMessage(next_file, reason);
        };
        return settings;
      }()),
      diagnostics_(node, private_node) {
  for (const std::string& topic : wantedTopics(private_node)) {
    if (topic.compare(0, std::strlen(kPattern), kPattern) == 0) {
      endings_.push_back(topic.substr(1));
    } else {
      subscribe(node_.resolveName(topic));
    }
  }
  findTopics();
  if (search_.valid())
    search_.wait();
  findTopics();
  status_publisher_ = node_.advertise<RecorderStatus>(topics::kRecorderStatus, 10, true);
  diagnostics_.setHardwareID("none");
  diagnostics_.add("recorder", this, &RecorderNode::diagnose);
  timers_.push_back(node_.createWallTimer(ros::WallDuration(kSearchInterval_s),
                                          [this](const ros::WallTimerEvent&) { findTopics(); }));
  writeInfo();
  timers_.push_back(
      node_.createWallTimer(ros::WallDuration(kWatchInterval_s), [this](const ros::WallTimerEvent&) { watch(); }));
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
  const bool found = search_.valid() && search_.wait_for(std::chrono::seconds(0)) == std::future_status::ready;
  if (found)
    subscribeMatching(search_.get());
  // In a thread of its own: a master that is away would keep the messages waiting.
  if (!search_.valid())
    search_ = std::async(std::launch::async, master_api::publishedTopics);
}

void RecorderNode::subscribeMatching(const std::set<std::string>& topics) {
  const std::string own = node_.resolveName("");
  for (const std::string& topic : topics) {
    const bool within = topic.compare(0, own.size(), own) == 0;
    if (!within || subscribers_.count(topic) != 0)
      continue;
    for (const std::string& ending : endings_) {
      if (endsWith(topic, ending))
        subscribe(topic);
    }
  }
}

void RecorderNode::hear(const std::string& topic, const ros::MessageEvent<const AnyMessage>& event) {
  const boost::shared_ptr<const AnyMessage> message = event.getConstMessage();
  {
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    watch_.hear(topic, *message, event.getConnectionHeaderPtr(), ros::WallTime::now());
  }
  recorder_.write(topic, event.getReceiptTime(), message, event.getConnectionHeaderPtr(), isLatched(event));
}

void RecorderNode::writeInfo() {
  recorder_.write(node_.resolveName(topics::kRecordingInfo), ros::Time::now(), makeRecordingInfo(), true);
}

/// A launch file has set the parameters of all its nodes before the first run begins.
void RecorderNode::watch() {
  std::uint64_t session = 0;
  {
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    watch_.look(ros::WallTime::now());
    session = watch_.progress().session;
  }
  if (session == informed_session_)
    return;
  informed_session_ = session;
  writeInfo();
}

int RecorderNode::run(const volatile std::sig_atomic_t& signal) {
  while (signal == 0 && ros::ok() && !recorder_.status().refused)
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
  return was_recording && status.closed && !status.refused ? 0 : 1;
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

/// With the events that were not told yet.
RecorderStatus RecorderNode::makeStatus() {
  const BagRecorder::Status status = recorder_.status();
  const std::lock_guard<std::mutex> lock(watch_mutex_);
  tellDrops(status);
  RecorderStatus message;
  message.header.stamp.fromNSec(ros::WallTime::now().toNSec());
  message.session = watch_.progress().session;
  message.revision = watch_.progress().revision;
  message.step = watch_.progress().step;
  message.file = status.file;
  message.parts = status.parts;
  message.bytes = status.bytes;
  message.free_bytes = status.free_bytes;
  message.messages = status.messages;
  message.dropped = status.dropped;
  message.lost = watch_.lost();
  message.recording = static_cast<std::uint8_t>(status.recording);
  message.stop_reason = status.stop_reason;
  message.events = watch_.take();
  return message;
}

void RecorderNode::tellDrops(const BagRecorder::Status& status) {
  if (status.dropped == told_drops_ || !status.recording)
    return;
  const std::uint64_t drops = status.dropped - told_drops_;
  told_drops_ = status.dropped;
  watch_.tell(RecorderEvent::LOST, "the disk did not keep up: " + std::to_string(drops) + " messages were dropped",
              ros::WallTime::now(), drops);
}

void RecorderNode::publishStatus() {
  const RecorderStatus message = makeStatus();
  for (const RecorderEvent& event : message.events)
    ROS_INFO("%s", event.text.c_str());
  if (message.recording != 0)
    recorder_.write(node_.resolveName(topics::kRecorderStatus), ros::Time::now(), message);
  status_publisher_.publish(message);
}

/// In the recorder's thread.
boost::shared_ptr<AnyMessage> RecorderNode::lastMessage(const std::string& next_file, const std::string& reason) {
  const bool ends = next_file.empty();
  {
    const std::lock_guard<std::mutex> lock(watch_mutex_);
    watch_.tell(ends ? RecorderEvent::END : RecorderEvent::PART,
                ends ? "the recording ended: " + reason : "the recording goes on in " + next_file,
                ros::WallTime::now());
  }
  RecorderStatus message = makeStatus();
  message.recording = static_cast<std::uint8_t>(!ends);
  message.stop_reason = reason;
  return anyMessage(message);
}

std::uint64_t RecorderNode::lostOnTheWay() {
  const std::lock_guard<std::mutex> lock(watch_mutex_);
  return watch_.lost();
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
  const std::uint64_t lost = lostOnTheWay();
  if (lost > diagnosed_lost_)
    diagnostics.mergeSummary(Level::WARN, "messages were lost on their way");
  if (status.split_waits)
    diagnostics.mergeSummary(Level::WARN, "the file has the size of a part, but no checkpoint came to begin another");
  diagnosed_drops_ = status.dropped;
  diagnosed_lost_ = lost;
  diagnostics.add("file", status.file);
  diagnostics.add("topics", subscribers_.size());
  diagnostics.add("messages", status.messages);
  diagnostics.add("dropped", status.dropped);
  diagnostics.add("lost on their way", lost);
  diagnostics.add("bytes", status.bytes);
  diagnostics.add("free bytes", status.free_bytes);
}

}  // namespace soft_volume
