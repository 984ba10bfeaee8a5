#include "soft_volume/ros/renderer_node.h"

#include <ros/console.h>
#include <ros/init.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/distortion_models.h>
#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstring>
#include <utility>

#include "render_parameters.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/render/option_names.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/parameters.h"

namespace soft_volume {
namespace {

using Clock = std::chrono::steady_clock;

/// A state may come before its topology, but not by this much.
constexpr double kTopologyPatience_s = 1.0;

/// How errors call them.
constexpr char kParametersOrigin[] = "the parameters";

/// Planes of the first frame after a change of view are so many times as far apart; each one after it halves that.
constexpr std::uint32_t kFirstCoarseness = 8;

double millisecondsSince(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

sensor_msgs::CameraInfoPtr cameraInfo(const core::Camera& camera, const std_msgs::Header& header) {
  auto info = boost::make_shared<sensor_msgs::CameraInfo>();
  info->header = header;
  info->width = static_cast<std::uint32_t>(camera.width);
  info->height = static_cast<std::uint32_t>(camera.height);
  info->distortion_model = sensor_msgs::distortion_models::PLUMB_BOB;
  info->D.assign(5, 0.0);
  info->K = {camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0};
  info->R = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
  // (u w, v w, w) = P (x, y, z, 1) holds for both projections; K has no form for a parallel one.
  if (camera.projection == core::Projection::kPerspective) {
    info->P = {camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0};
  } else {
    info->P = {camera.fx, 0.0, 0.0, camera.cx, 0.0, camera.fy, 0.0, camera.cy, 0.0, 0.0, 0.0, 1.0};
  }
  return info;
}

sensor_msgs::ImagePtr colourImage(const core::Image& image, const std_msgs::Header& header) {
  auto message = boost::make_shared<sensor_msgs::Image>();
  message->header = header;
  message->width = static_cast<std::uint32_t>(image.width);
  message->height = static_cast<std::uint32_t>(image.height);
  message->encoding = sensor_msgs::image_encodings::RGB8;
  message->step = message->width * 3;
  message->data = image.rgb;
  return message;
}

/// Depth or labels: one value a pixel.
template <typename Value>
sensor_msgs::ImagePtr valueImage(const core::Frame& frame, const std::vector<Value>& values,
                                 const std::string& encoding, const std_msgs::Header& header) {
  auto message = boost::make_shared<sensor_msgs::Image>();
  message->header = header;
  message->width = static_cast<std::uint32_t>(frame.width);
  message->height = static_cast<std::uint32_t>(frame.height);
  message->encoding = encoding;
  message->step = message->width * static_cast<std::uint32_t>(sizeof(Value));
  message->data.resize(values.size() * sizeof(Value));
  std::memcpy(message->data.data(), values.data(), message->data.size());
  return message;
}

sensor_msgs::CompressedImage compressedImage(const core::Image& image, int quality, const std_msgs::Header& header) {
  sensor_msgs::CompressedImage message;
  message.header = header;
  message.format = "rgb8; jpeg compressed bgr8";  // what image_transport's own plugin writes
  message.data = core::encodeJpeg(image, quality);
  return message;
}

/// What a frame says of itself.
RenderStats statsOf(const core::Frame& frame) {
  RenderStats stats;
  if (!frame.updated.empty()) {
    stats.updated_x = static_cast<std::uint32_t>(frame.updated.begin_x);
    stats.updated_y = static_cast<std::uint32_t>(frame.updated.begin_y);
    stats.updated_width = static_cast<std::uint32_t>(frame.updated.end_x - frame.updated.begin_x);
    stats.updated_height = static_cast<std::uint32_t>(frame.updated.end_y - frame.updated.begin_y);
  }
  stats.cells = static_cast<std::uint32_t>(frame.cells);
  stats.polygons = static_cast<std::uint32_t>(frame.polygons);
  stats.slices = static_cast<std::uint32_t>(frame.slices);
  stats.fragments = frame.fragments;
  stats.transform_ms = frame.transform_ms;
  stats.bucket_ms = frame.bucket_ms;
  stats.slice_ms = frame.slice_ms;
  stats.render_ms = frame.render_ms;
  return stats;
}

}  // namespace

RendererNode::RendererNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node),
      transport_(node),
      diagnostics_(node, private_node),
      threads_(parameter<int>(private_node, "threads", 0, 0, 1024)) {
  parameters_ = std::make_unique<RenderParameters>(private_node, incidents_,
                                                   [this](const std::string& yaml) { return applyParameters(yaml); });
  stats_publisher_ = node_.advertise<RenderStats>(topics::kRenderStats, 1000);
  subscribers_ = {
      subscribeChecked<Scene>(
          node_, topics::kScene, 10, [this](const Scene::ConstPtr& m) { hearScene(m); }, incidents_),
      subscribeChecked<Volume>(
          node_, topics::kVolume, 10, [this](const Volume::ConstPtr& m) { hearVolume(m); }, incidents_),
      subscribeChecked<GridTopology>(
          node_, topics::kTopology, 100, [this](const GridTopology::ConstPtr& m) { hearTopology(m); }, incidents_),
      subscribeChecked<GridState>(
          node_, topics::kState, 100, [this](const GridState::ConstPtr& m) { hearState(m); }, incidents_)};
  diagnostics_.setHardwareID("none");
  diagnostics_.add("renderer", this, &RendererNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
  thread_ = std::thread([this] { run(); });
}

RendererNode::~RendererNode() {
  running_ = false;
  wake_.notify_all();
  thread_.join();
}

void RendererNode::hearScene(const Scene::ConstPtr& message) {
  try {
    auto scene = std::make_shared<core::Scene>(core::parseScene(message->yaml, "the scene message", "/"));
    Channels channels;
    for (const core::CameraSettings& camera : scene->rendering.cameras)
      channels.push_back(openCamera(camera));
    const std::string overrides = parameters_->yaml();
    const core::RenderSettings settings = core::overrideRendering(*scene, overrides, kParametersOrigin);
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      scene_ = std::move(scene);
      channels_ = std::move(channels);
      session_ = message->session;
      adopt(settings, overrides);
    }
    parameters_->show(settings);
  } catch (const core::Error& error) {
    incidents_.report(topics::kScene, error.what());
  }
}

/// Puts parameters in place of the scene's keys, and has everything drawn with them.
core::RenderSettings RendererNode::applyParameters(const std::string& yaml) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const core::RenderSettings settings =
      core::overrideRendering(scene_ ? *scene_ : core::Scene(), yaml, kParametersOrigin);
  adopt(settings, yaml);
  for (const auto& channel : channels_)
    channel->redraw = true;
  wake_.notify_all();
  return settings;
}

/// Needs the lock.
void RendererNode::adopt(const core::RenderSettings& settings, const std::string& overrides) {
  wanted_ = settings;
  overridden_ = overrides != "{}";
  fitSettings();
}

/// Needs the lock.
void RendererNode::fitSettings() {
  core::RenderSettings settings = wanted_;
  if (volume_)
    core::fitTransferFunction(settings, *volume_);
  settings_ = std::make_shared<core::RenderSettings>(settings);
  settings_text_ = overridden_ ? core::writeRendering(settings) : "";
}

/// Opens the topics of a camera, or keeps those that are open: subscribers stay connected across sessions.
std::shared_ptr<RendererNode::CameraChannel> RendererNode::openCamera(const core::CameraSettings& settings) {
  for (const auto& open : channels_) {
    if (open->name != settings.name)
      continue;
    const std::lock_guard<std::mutex> lock(mutex_);
    open->camera = settings.camera;
    open->next_due_s = 0.0;
    open->redraw = true;
    return open;
  }
  auto channel = std::make_shared<CameraChannel>();
  channel->name = settings.name;
  channel->camera = settings.camera;
  std::weak_ptr<CameraChannel> weak = channel;
  const auto joined = [this, weak] {
    if (const auto c = weak.lock())
      c->redraw = true;
    wake_.notify_all();
  };
  const auto image_joined = [joined](const image_transport::SingleSubscriberPublisher&) { joined(); };
  const auto info_joined = [joined](const ros::SingleSubscriberPublisher&) { joined(); };
  const image_transport::SubscriberStatusCallback no_image;
  const ros::SubscriberStatusCallback no_info;
  channel->image =
      transport_.advertiseCamera(settings.name + "/image_raw", 100, image_joined, no_image, info_joined, no_info);
  channel->compressed =
      node_.advertise<sensor_msgs::CompressedImage>(settings.name + "/image_raw/compressed", 100, info_joined);
  channel->depth = node_.advertise<sensor_msgs::Image>(settings.name + "/depth", 100, info_joined);
  channel->labels = node_.advertise<sensor_msgs::Image>(settings.name + "/labels", 100, info_joined);
  channel->view = subscribeChecked<geometry_msgs::PoseStamped>(
      node_, settings.name + "/view", 10,
      [this, weak](const geometry_msgs::PoseStamped::ConstPtr& m) {
        if (const auto c = weak.lock())
          hearView(c, *m);
      },
      incidents_);
  return channel;
}

void RendererNode::hearView(const std::shared_ptr<CameraChannel>& channel, const geometry_msgs::PoseStamped& message) {
  core::Pose pose = fromPose(message.pose);
  if (!core::isUsable(pose)) {
    incidents_.report(channel->name + "/view", "the pose is not finite or its quaternion is not a rotation");
    return;
  }
  pose.orientation.normalize();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    channel->camera.T_volume_camera = pose;
  }
  channel->view_moved = true;
  channel->redraw = true;
  wake_.notify_all();
}

void RendererNode::hearVolume(const Volume::ConstPtr& message) {
  try {
    const VolumeAndLabels content = fromMessage(*message);
    const std::lock_guard<std::mutex> lock(mutex_);
    volume_ = content.volume;
    labels_ = content.labels;
    fitSettings();
  } catch (const core::Error& error) {
    incidents_.report(topics::kVolume, error.what());
  }
}

void RendererNode::hearTopology(const GridTopology::ConstPtr& message) {
  try {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (takeMessage(*message, topologies_) != core::TopologyDecoder::Result::kApplied)
      return;
    const core::Topology& topology = *topologies_.topology();
    decoder_.expect(topology.session, topology.revision, topology.rest_positions);
    topology_step_ = message->step;
    if (early_state_ && !isEarly(*early_state_))
      applyState(*std::exchange(early_state_, nullptr));
  } catch (const core::Error& error) {
    incidents_.report(topics::kTopology, error.what());
  }
}

void RendererNode::hearState(const GridState::ConstPtr& message) {
  try {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (isEarly(*message)) {
      keepEarly(message);
      return;
    }
    const bool overtaken = message->revision < topologies_.topology()->revision && message->step < topology_step_;
    if (overtaken)
      return;  // by an incision
    applyState(*message);
  } catch (const core::Error& error) {
    incidents_.report(topics::kState, error.what());
  }
  wake_.notify_all();
}

/// Needs the lock.
bool RendererNode::isEarly(const GridState& state) const {
  const auto& topology = topologies_.topology();
  return !topology || state.session != topology->session || state.revision > topology->revision;
}

/// Topics are not ordered among each other: the topology is on its way. Key frames alone are worth waiting for, and not
/// for ever. Needs the lock.
void RendererNode::keepEarly(const GridState::ConstPtr& message) {
  const ros::WallTime now = ros::WallTime::now();
  if (early_state_ && topologies_.topology() && now - early_since_ > ros::WallDuration(kTopologyPatience_s)) {
    incidents_.report(topics::kState, "the topology of session " + std::to_string(early_state_->session) +
                                          ", revision " + std::to_string(early_state_->revision) + " does not come");
    early_state_.reset();
  }
  if (!message->key_frame)
    return;
  if (!early_state_)
    early_since_ = now;
  early_state_ = message;
}

/// Needs the lock.
void RendererNode::applyState(const GridState& message) {
  if (decoder_.apply(fromMessage(message)) != core::StateDecoder::Result::kApplied)
    return;
  shown_ = {topologies_.topology(),  decoder_.positions(), decoder_.step(),
            message.simulation_time, message.header,       shown_.number + 1};
}

bool RendererNode::CameraChannel::isWatched() const {
  return image.getNumSubscribers() > 0 || compressed.getNumSubscribers() > 0 || depth.getNumSubscribers() > 0 ||
         labels.getNumSubscribers() > 0;
}

bool RendererNode::takeSnapshot(Snapshot& snapshot) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!scene_ || !volume_ || !shown_.topology || session_ != shown_.topology->session)
    return false;
  snapshot.state = shown_;
  snapshot.settings = settings_;
  snapshot.settings_text = settings_text_;
  snapshot.volume = volume_;
  snapshot.labels = labels_;
  snapshot.channels = channels_;
  return true;
}

void RendererNode::run() {
  Snapshot snapshot;
  while (running_ && ros::ok()) {
    const auto wanted = [&](const auto& channel) { return wantsFrame(*channel, snapshot); };
    if (takeSnapshot(snapshot) && std::any_of(snapshot.channels.begin(), snapshot.channels.end(), wanted)) {
      drawAll(snapshot);
      continue;
    }
    std::unique_lock<std::mutex> lock(mutex_);
    wake_.wait_for(lock, std::chrono::milliseconds(20));
  }
  for (const auto& channel : snapshot.channels)
    channel->renderer.reset();  // in the thread that owns the contexts
}

bool RendererNode::wantsFrame(const CameraChannel& channel, const Snapshot& snapshot) const {
  if (!channel.isWatched())
    return false;
  if (channel.redraw || channel.coarseness > 1)
    return true;
  return snapshot.state.number != channel.drawn_state && snapshot.state.simulation_time_s >= channel.next_due_s - 1e-9;
}

void RendererNode::drawAll(const Snapshot& snapshot) {
  const double interval_s = 1.0 / snapshot.settings->rate_hz;
  for (const auto& channel : snapshot.channels) {
    if (!wantsFrame(*channel, snapshot))
      continue;
    channel->redraw = false;
    const bool moved = channel->view_moved.exchange(false);
    channel->coarseness =
        moved && snapshot.settings->progressive ? kFirstCoarseness : std::max(1U, channel->coarseness / 2);
    const double late_s = snapshot.state.simulation_time_s - channel->next_due_s;
    if (channel->drawn_state != 0 && late_s > interval_s) {
      channel->skipped += static_cast<std::uint64_t>(std::floor(late_s / interval_s));
    }
    channel->next_due_s = interval_s * (std::floor(snapshot.state.simulation_time_s / interval_s + 1e-9) + 1.0);
    channel->drawn_state = snapshot.state.number;
    drawOrReport(*channel, snapshot);
  }
}

/// Whatever is wrong with one camera's frame, the others' are drawn.
void RendererNode::drawOrReport(CameraChannel& channel, const Snapshot& snapshot) {
  std::string failure;
  try {
    draw(channel, snapshot);
  } catch (const std::exception& error) {
    failure = error.what();
    channel.coarseness = 1;
    incidents_.report(channel.name,
                      "the frame of step " + std::to_string(snapshot.state.step) + " is skipped: " + failure);
  }
  const std::lock_guard<std::mutex> lock(stats_mutex_);
  if (failure.empty()) {
    failures_.erase(channel.name);
  } else {
    failures_[channel.name] = failure;
  }
}

void RendererNode::draw(CameraChannel& channel, const Snapshot& snapshot) {
  const Clock::time_point start = Clock::now();
  core::Camera camera;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    camera = channel.camera;
  }
  prepare(channel, snapshot);
  if (!snapshot.settings->incremental)
    channel.renderer->forgetFrame();
  const core::Frame& frame = channel.renderer->render(camera, snapshot.state.positions, optionsOf(channel, snapshot));

  RenderStats stats = statsOf(frame);
  stats.session = snapshot.state.topology->session;
  stats.revision = snapshot.state.topology->revision;
  stats.step = snapshot.state.step;
  stats.camera = channel.name;
  stats.pose = toPose(camera.T_volume_camera);
  stats.backend = core::nameOf(channel.backend);
  stats.settings = snapshot.settings_text;
  stats.coarseness = channel.coarseness;
  stats.refining = static_cast<std::uint8_t>(channel.coarseness > 1);
  publishFrame(channel, snapshot, camera, frame, stats);
  stats.total_ms = millisecondsSince(start);
  stats_publisher_.publish(stats);
  const std::lock_guard<std::mutex> lock(stats_mutex_);
  last_stats_ = stats;
}

/// Gives the camera's renderer what has changed since its last frame.
void RendererNode::prepare(CameraChannel& channel, const Snapshot& snapshot) {
  if (!channel.renderer || channel.backend != snapshot.settings->backend) {
    channel.renderer.reset();
    channel.renderer = std::make_unique<core::Renderer>(snapshot.settings->backend);
    channel.backend = snapshot.settings->backend;
    channel.settings.reset();
    channel.volume.reset();
    channel.labelled.reset();
    channel.topology.reset();
  }
  if (channel.volume != snapshot.volume) {
    channel.renderer->setVolume(snapshot.volume);
    channel.volume = snapshot.volume;
  }
  if (channel.labelled != snapshot.labels) {
    channel.renderer->setLabels(snapshot.labels);
    channel.labelled = snapshot.labels;
  }
  if (channel.settings != snapshot.settings) {
    channel.renderer->setTransferFunction(snapshot.settings->transfer_function);
    channel.settings = snapshot.settings;
  }
  if (channel.topology != snapshot.state.topology) {
    channel.renderer->setTopology(*snapshot.state.topology);
    channel.topology = snapshot.state.topology;
  }
}

core::RenderOptions RendererNode::optionsOf(const CameraChannel& channel, const Snapshot& snapshot) const {
  core::RenderOptions options = snapshot.settings->coarser(channel.coarseness);
  options.labels = snapshot.labels && channel.labels.getNumSubscribers() > 0;
  options.depth = channel.depth.getNumSubscribers() > 0;
  options.threads = threads_;
  return options;
}

void RendererNode::publishFrame(CameraChannel& channel, const Snapshot& snapshot, const core::Camera& camera,
                                const core::Frame& frame, RenderStats& stats) {
  std_msgs::Header header = snapshot.state.header;
  header.frame_id = channel.name + "_optical_frame";
  const core::Image image = frame.toRgb8(snapshot.settings->background);
  channel.image.publish(colourImage(image, header), cameraInfo(camera, header));
  if (channel.compressed.getNumSubscribers() > 0)
    channel.compressed.publish(compressedImage(image, snapshot.settings->jpeg_quality, header));
  if (!frame.depth_m.empty())
    channel.depth.publish(valueImage(frame, frame.depth_m, sensor_msgs::image_encodings::TYPE_32FC1, header));
  if (!frame.labels.empty())
    channel.labels.publish(valueImage(frame, frame.labels, sensor_msgs::image_encodings::MONO16, header));
  stats.header = header;
  stats.image_hash = core::hashVector(image.rgb);
  stats.frames_published = ++channel.published;
  stats.frames_skipped = channel.skipped;
  stats.frames_rejected = incidents_.total();
  stats.renderer = channel.renderer->driver();
}

void RendererNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const bool ready = scene_ && volume_ && shown_.topology;
    status.summary(diagnostic_msgs::DiagnosticStatus::OK, ready ? "ready" : "waiting for scene, volume and grid");
  }
  {
    const std::lock_guard<std::mutex> lock(stats_mutex_);
    status.add("renderer", last_stats_.renderer);
    status.add("backend", last_stats_.backend);
    status.add("last frame [ms]", last_stats_.total_ms);
    status.add("polygons", last_stats_.polygons);
    status.add("frames published", last_stats_.frames_published);
    status.add("frames skipped", last_stats_.frames_skipped);
    for (const auto& failure : failures_)
      status.mergeSummary(diagnostic_msgs::DiagnosticStatus::ERROR,
                          failure.first + " cannot be drawn: " + failure.second);
  }
  incidents_.addTo(status);
}

}  // namespace soft_volume
