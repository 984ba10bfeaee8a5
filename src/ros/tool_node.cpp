#include "soft_volume/ros/tool_node.h"

#include <geometry_msgs/WrenchStamped.h>
#include <ros/console.h>
#include <ros/this_node.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolProgress.h>
#include <soft_volume/ToolState.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/button_messages.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/parameters.h"

namespace soft_volume {
namespace {

constexpr double kPublisherWait_s = 0.1;
constexpr double kFarewell_s = 0.05;  // for a last message to leave
/// Messages that may wait in lockstep, where none may be lost: minutes of a device.
constexpr std::uint32_t kLockstepQueue = 200000;
constexpr std::size_t kRememberedRigs = 8;
constexpr std::size_t kLooksKept = 10;  // seconds of percentiles
/// A stamp that is older when a pose is heard says that the clocks differ, not that the pose is late.
constexpr double kLongestTransport_s = 0.02;

/// The tool's numbers go on after a restart of this node while the simulation remembers the old ones.
std::uint64_t firstSequence() {
  return ros::WallTime::now().toNSec();
}

std::optional<core::DeviceProfile> loadProfile(const ros::NodeHandle& private_node) {
  const auto path = parameter<std::string>(private_node, "device", "");
  if (path.empty())
    return std::nullopt;
  return core::loadDeviceProfile(path);
}

TimeCounts::Counts since(const TimeCounts::Counts& now, const TimeCounts::Counts& before) {
  TimeCounts::Counts difference{};
  for (std::size_t bin = 0; bin < now.size(); ++bin)
    difference[bin] = now[bin] - before[bin];
  return difference;
}

void addQuantiles(diagnostic_updater::DiagnosticStatusWrapper& status, const std::string& what,
                  const TimeCounts::Counts& counts) {
  const auto microseconds = [&](double share) { return std::lround(1e6 * TimeCounts::quantile(counts, share)); };
  status.addf(what + ": 50th, 99th, 99.9th percentile [us]", "%ld, %ld, %ld", microseconds(0.5), microseconds(0.99),
              microseconds(0.999));
}

}  // namespace

ToolNode::ToolNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node), profile_(loadProfile(private_node)), diagnostics_(node, private_node), device_handle_(node) {
  device_handle_.setCallbackQueue(&device_queue_);
  rate_hz_ = parameter<double>(private_node, "rate_hz", profile_ ? profile_->rate_hz : 1000.0, 20.0, 4000.0);
  if (profile_) {
    operating_state_ = std::make_unique<OperatingStateListener>(device_handle_, profile_->topics.operating_state,
                                                                profile_->needs_homing, incidents_);
  }
  advertise();
  if (parameter<bool>(private_node, "lockstep", false))
    startLockstep(private_node);
  else
    startLoop(private_node);
  diagnostics_.setHardwareID(profile_ ? profile_->name : "none");
  diagnostics_.add("tool", this, &ToolNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
  subscribe();
  device_spinner_.start();
}

void ToolNode::startLoop(const ros::NodeHandle& private_node) {
  HapticLoop::Settings settings;
  settings.rate_hz = rate_hz_;
  settings.priority = parameter<int>(private_node, "priority", 50, 1, 99);
  settings.wall_timeout_s = parameter<double>(private_node, "wall_timeout_s", 0.25, 0.02, 10.0);
  if (!ros::Time::useSystemTime())
    settings.simulated_time = [] { return ros::Time::now().toSec(); };
  settings.forces_allowed = [this] { return forcesAllowed(); };
  device_buttons_ = std::make_unique<DeviceButtons>(device_handle_, device().buttons, incidents_);
  settings.buttons = [this] { return device_buttons_->buttons(); };
  loop_ = std::make_unique<HapticLoop>(settings);
  publisher_ = std::thread([this] { publishTicks(); });
}

void ToolNode::startLockstep(const ros::NodeHandle& private_node) {
  progress_publisher_ = node_.advertise<ToolProgress>(topics::kToolProgress, kLockstepQueue);
  LockstepLoop::Settings settings;
  settings.has_velocity = !device().measured_cv.empty();
  settings.button_topics = device().buttons.size();
  settings.timeout_s = parameter<double>(private_node, "lockstep_timeout_s", 2.0, 0.1, 3600.0);
  settings.forces_allowed = [this] { return forcesAllowed(); };
  settings.publish_notice = [this](const core::ToolNotice& notice) { publishProgress(notice); };
  settings.publish_tick = [this](std::uint64_t generation, const core::HandTick& tick) {
    publish(LoopTick{tick, generation});
  };
  settings.leave = [this](std::uint64_t session, const std::string& reason) { leaveLockstep(session, reason); };
  settings.warn = [this](const std::string& text) { incidents_.report(topics::kLockstep, text); };
  lockstep_ = std::make_unique<LockstepLoop>(settings);
  device_buttons_ =
      std::make_unique<DeviceButtons>(device_handle_, device().buttons, incidents_, kLockstepQueue,
                                      [this](std::size_t topic, const ros::Time& stamp, const ButtonChange& change) {
                                        const auto stamp_ns = static_cast<std::int64_t>(stamp.toNSec());
                                        lockstep_->hear([&](core::DeviceStreams& streams) {
                                          streams.addButtons(topic, stamp_ns, change.mask, change.pressed);
                                        });
                                      });
}

bool ToolNode::forcesAllowed() const {
  return !operating_state_ || operating_state_->allowed();
}

core::DeviceTopics ToolNode::device() const {
  return deviceTopics(profile_ ? &*profile_ : nullptr);
}

ToolNode::~ToolNode() {
  // In a nodelet callbacks go on in other threads; both use the loop, which ends below.
  diagnostics_timer_.stop();
  reset_service_.shutdown();
  subscribers_.clear();
  device_spinner_.stop();
  running_ = false;
  lockstep_.reset();
  if (publisher_.joinable())
    publisher_.join();
  // A driver may hold the last force that it heard.
  std_msgs::Header header;
  header.stamp = ros::Time::now();
  publishServo(core::Vector3::Zero(), header);
  ros::WallDuration(kFarewell_s).sleep();
}

void ToolNode::advertise() {
  force_publisher_ = node_.advertise<ToolForce>(topics::kToolForce, 1000);
  cut_publisher_ = node_.advertise<ToolCut>(topics::kToolCut, 1000);
  state_publisher_ = node_.advertise<ToolState>(topics::kToolState, 1000);
  const std::string servo = device().servo_cf;
  if (!servo.empty())
    servo_publisher_ = node_.advertise<geometry_msgs::WrenchStamped>(servo, 1000);
}

void ToolNode::subscribe() {
  const core::DeviceTopics device = this->device();
  const std::uint32_t queue = lockstep_ ? kLockstepQueue : 100;
  subscribers_ = {
      subscribeChecked<Scene>(
          node_, topics::kScene, 10, [this](const Scene::ConstPtr& m) { hearScene(m); }, incidents_),
      subscribeChecked<Volume>(
          node_, topics::kVolume, 10, [this](const Volume::ConstPtr& m) { hearVolume(m); }, incidents_),
      subscribeChecked<GridTopology>(
          node_, topics::kTopology, 100, [this](const GridTopology::ConstPtr& m) { hearTopology(m); }, incidents_),
      subscribeChecked<GridPatch>(
          node_, topics::kPatch, lockstep_ ? kLockstepQueue : 2, [this](const GridPatch::ConstPtr& m) { hearPatch(m); },
          incidents_)};
  subscribers_.push_back(subscribeChecked<geometry_msgs::PoseStamped>(
      device_handle_, device.measured_cp, queue, [this](const geometry_msgs::PoseStamped::ConstPtr& m) { hearPose(m); },
      incidents_));
  if (!device.measured_cv.empty())
    subscribers_.push_back(subscribeChecked<geometry_msgs::TwistStamped>(
        device_handle_, device.measured_cv, queue,
        [this](const geometry_msgs::TwistStamped::ConstPtr& m) { hearVelocity(m); }, incidents_));
  reset_service_ = node_.advertiseService<std_srvs::Trigger::Request, std_srvs::Trigger::Response>(
      topics::kToolReset, [this](std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) -> bool {
        if (lockstep_)
          lockstep_->reset();
        else
          loop_->reset();
        response.success = 1;
        response.message = "forces start at zero again";
        return true;
      });
}

void ToolNode::hearScene(const Scene::ConstPtr& message) {
  try {
    auto scene = std::make_shared<core::Scene>(core::parseScene(message->yaml, "the scene message", "/"));
    const std::lock_guard<std::mutex> lock(mutex_);
    scene_ = std::move(scene);
    session_ = message->session;
    {
      const std::lock_guard<std::mutex> frame_lock(frame_mutex_);
      frame_id_ = message->header.frame_id;
    }
    makeRig();
  } catch (const core::Error& error) {
    incidents_.report(topics::kScene, error.what());
  }
}

void ToolNode::makeRig() {
  if (lockstep_ && hand_session_ == session_)
    return;  // latched messages come again with every connection
  const core::DeviceProfile* profile = profile_ ? &*profile_ : nullptr;
  auto rig = std::make_unique<ToolRig>(core::makeToolRig(*scene_, profile, rate_hz_, firstSequence()));
  auto notes = std::make_shared<RigNotes>();
  rig->generation = notes->generation = ++generation_;
  notes->frame_id = frame_id_;
  intakes_.clear();
  spare_.clear();
  for (const auto& tool : rig->tools) {
    const core::ToolConfig& config = tool->config();
    notes->tools.push_back(config);
    intakes_.emplace_back(config.id, config.tissue_threshold);
    if (volume_)
      intakes_.back().setVolume(volume_);
    if (topologies_.topology())
      intakes_.back().setTopology(topologies_.topology());
  }
  {
    const std::lock_guard<std::mutex> lock(notes_mutex_);
    notes_.push_back(std::move(notes));
    if (notes_.size() > kRememberedRigs)
      notes_.pop_front();
  }
  if (lockstep_)
    giveHand();
  else
    loop_->give(std::move(rig));
}

/// Once scene, volume and grid of a session are here.
void ToolNode::giveHand() {
  const auto& topology = topologies_.topology();
  const bool complete = scene_ && volume_ && topology && topology->session == session_ && volume_session_ == session_;
  if (!complete || scene_->tools.empty() || hand_session_ == session_)
    return;
  hand_session_ = session_;
  auto hand = std::make_unique<core::LockstepHand>(ros::this_node::getName(), *scene_, profile_ ? &*profile_ : nullptr,
                                                   rate_hz_, session_, volume_);
  hand->addTopology(topology);
  lockstep_->give(std::move(hand), generation_);
}

void ToolNode::hearVolume(const Volume::ConstPtr& message) {
  try {
    const VolumeAndLabels content = fromMessage(*message);
    const std::lock_guard<std::mutex> lock(mutex_);
    volume_ = content.volume;
    volume_session_ = message->session;
    if (scene_)
      makeRig();
  } catch (const core::Error& error) {
    incidents_.report(topics::kVolume, error.what());
  }
}

void ToolNode::hearTopology(const GridTopology::ConstPtr& message) {
  try {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (takeMessage(*message, topologies_) != core::TopologyDecoder::Result::kApplied)
      return;
    if (lockstep_) {
      if (hand_session_ == message->session)
        lockstep_->addTopology(topologies_.topology());
      else
        giveHand();
      return;
    }
    bool new_session = false;
    for (core::PatchIntake& intake : intakes_)
      new_session |= intake.setTopology(topologies_.topology());
    if (new_session && volume_)
      forgetPatches();
  } catch (const core::Error& error) {
    incidents_.report(topics::kTopology, error.what());
  }
}

PatchParcel ToolNode::emptyParcel(std::size_t tool) {
  return {intakes_[tool].makeEmpty(), generation_, tool};
}

/// The tissue of another session is not that of the old one: until its patches come there is none.
void ToolNode::forgetPatches() {
  for (std::size_t tool = 0; tool < intakes_.size(); ++tool)
    loop_->give(emptyParcel(tool));
}

void ToolNode::prepare(const core::GridPatch& patch, std::size_t tool) {
  PatchParcel back;
  while (loop_->takeBack(back)) {
    if (back.generation == generation_)
      spare_.push_back(std::move(back));
  }
  const auto fits = [&](const PatchParcel& parcel) { return parcel.tool == tool; };
  const auto reused = std::find_if(spare_.begin(), spare_.end(), fits);
  PatchParcel parcel = reused != spare_.end() ? std::move(*reused) : emptyParcel(tool);
  if (reused != spare_.end())
    spare_.erase(reused);
  if (!parcel.patch)
    return;
  intakes_[tool].fill(patch, parcel.patch.get());
  loop_->give(std::move(parcel));
}

void ToolNode::hearPatch(const GridPatch::ConstPtr& message) {
  try {
    if (lockstep_) {
      lockstep_->addPatch(fromMessage(*message), static_cast<std::int64_t>(message->header.stamp.toNSec()),
                          static_cast<std::int64_t>(message->next_stamp.toNSec()));
      return;
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    // Topics are not ordered among each other: a patch of another revision than the topology's is early or late.
    const auto& topology = topologies_.topology();
    if (!topology || !volume_ || message->session != topology->session || message->revision != topology->revision)
      return;
    for (std::size_t tool = 0; tool < intakes_.size(); ++tool) {
      if (scene_->tools[tool].id == message->tool_id)
        prepare(fromMessage(*message), tool);
    }
  } catch (const core::Error& error) {
    incidents_.report(topics::kPatch, error.what());
  }
}

std::string ToolNode::volumeFrame() const {
  const std::lock_guard<std::mutex> lock(frame_mutex_);
  return frame_id_;
}

std::string ToolNode::expectedFrame() const {
  return profile_ ? profile_->base_frame : volumeFrame();
}

/// How long a pose was on its way, as far as the clocks of driver and node agree.
double ToolNode::poseDelay(const ros::Time& stamp) const {
  const double delay_s = (ros::Time::now() - stamp).toSec();
  return delay_s >= 0.0 && delay_s <= kLongestTransport_s ? delay_s : 0.0;
}

void ToolNode::hearPose(const geometry_msgs::PoseStamped::ConstPtr& message) {
  HeardPose heard;
  heard.heard_s = HapticLoop::now();
  // CRTK: a zero stamp says that the data is not valid. That, or the same pose again, is silence to the loop.
  if (message->header.stamp.isZero())
    return;
  heard.stamp_ns = static_cast<std::int64_t>(message->header.stamp.toNSec());
  if (heard.stamp_ns == last_stamp_ns_)
    return;
  last_stamp_ns_ = heard.stamp_ns;
  const std::string frame = expectedFrame();
  if (!frame.empty() && !message->header.frame_id.empty() && message->header.frame_id != frame) {
    incidents_.report(topics::kMeasuredPose, "the pose is in frame '" + message->header.frame_id + "' and not in '" +
                                                 frame + "': transform it before");
    return;
  }
  heard.pose = fromPose(message->pose);
  if (!core::isUsable(heard.pose))
    incidents_.report(topics::kMeasuredPose, "the pose is not finite or its quaternion is not a rotation");
  else
    heard.pose.orientation.normalize();
  if (lockstep_) {
    lockstep_->hear([&](core::DeviceStreams& streams) { streams.addPose(heard.stamp_ns, heard.pose); });
    return;
  }
  if (!loop_->settings().simulated_time)
    heard.delay_s = poseDelay(message->header.stamp);
  loop_->hear(heard);
}

void ToolNode::hearVelocity(const geometry_msgs::TwistStamped::ConstPtr& message) {
  if (message->header.stamp.isZero())
    return;
  const core::Vector3 velocity = fromVector(message->twist.linear);
  if (!core::isFinite(velocity)) {
    incidents_.report(topics::kMeasuredVelocity, "the velocity is not finite");
    return;
  }
  if (lockstep_) {
    const auto stamp_ns = static_cast<std::int64_t>(message->header.stamp.toNSec());
    lockstep_->hear([&](core::DeviceStreams& streams) { streams.addVelocity(stamp_ns, velocity); });
    return;
  }
  loop_->hear(velocity, HapticLoop::now());
}

void ToolNode::publishTicks() {
  LoopTick tick;
  while (running_) {
    if (loop_->next(tick, kPublisherWait_s))
      publish(tick);
  }
}

std::shared_ptr<const ToolNode::RigNotes> ToolNode::notesOf(std::uint64_t generation) {
  const std::lock_guard<std::mutex> lock(notes_mutex_);
  for (const auto& notes : notes_) {
    if (notes->generation == generation)
      return notes;
  }
  return nullptr;
}

void ToolNode::publish(const LoopTick& tick) {
  const auto notes = notesOf(tick.generation);
  if (!notes)
    return;
  const std::string& tool_id = notes->tools[tick.tool].id;
  std_msgs::Header header;
  header.stamp.fromNSec(static_cast<std::uint64_t>(tick.stamp_ns));
  header.frame_id = notes->frame_id;
  if (tick.output.cut) {
    ToolCut cut = toMessage(core::toCommand(tool_id, *tick.output.cut));
    cut.header = header;
    cut_publisher_.publish(cut);
  }
  if (tick.put_down)
    return;
  publishServo(tick.servo_n, header);
  if (tick.output.force) {
    ToolForce force = toMessage(core::toCommand(tool_id, *tick.output.force));
    force.header = header;
    force_publisher_.publish(force);
  }
  publishState(tick, *notes, header);
  const std::lock_guard<std::mutex> lock(notes_mutex_);
  newest_ = tick;
}

void ToolNode::publishServo(const core::Vector3& force_n, std_msgs::Header header) {
  if (!servo_publisher_)
    return;
  geometry_msgs::WrenchStamped servo;
  servo.header = std::move(header);
  if (profile_)
    servo.header.frame_id = profile_->base_frame;
  servo.wrench.force = toVector(force_n);
  servo_publisher_.publish(servo);
}

void ToolNode::publishState(const LoopTick& tick, const RigNotes& notes, const std_msgs::Header& header) {
  ToolState state = toMessage(tick, notes.tools[tick.tool]);
  state.header = header;
  state.sequence = ++state_sequence_;
  state_publisher_.publish(state);
}

void ToolNode::publishProgress(const core::ToolNotice& notice) {
  ToolProgress progress = toMessage(notice);
  progress.header.stamp.fromNSec(static_cast<std::uint64_t>(notice.until_ns));
  progress.header.frame_id = volumeFrame();
  progress_publisher_.publish(progress);
}

void ToolNode::leaveLockstep(std::uint64_t session, const std::string& reason) {
  incidents_.report(topics::kLockstep, reason + ": the run goes on out of lockstep until the next session");
  ToolProgress progress;
  progress.hand = ros::this_node::getName();
  progress.session = session;
  progress.left = 1;
  progress_publisher_.publish(progress);
}

void ToolNode::summarize(diagnostic_updater::DiagnosticStatusWrapper& status, const LoopTick& tick) const {
  using diagnostic_msgs::DiagnosticStatus;
  const core::ToolOutput& output = tick.output;
  if (output.fault == core::ForceFault::kDisabled && operating_state_ && !operating_state_->allowed())
    status.summary(DiagnosticStatus::WARN, "no force: " + operating_state_->reason());
  else if (output.fault != core::ForceFault::kNone)
    status.summary(DiagnosticStatus::WARN, "no force: " + core::describe(output.fault));
  else
    status.summary(DiagnosticStatus::OK, output.contact.touching ? "in contact" : "free");
  status.add("force on the device [N]", tick.servo_n.norm());
  status.add("penetration [m]", output.contact.penetration_m);
  status.add("coupling stiffness [N/m]", output.coupling_stiffness_n_m);
  status.add("stiffness is bounded by", core::describe(output.stiffness_bound));
  status.add("period of pose and force [s]", output.timing.period_s);
  status.add("delay from pose to force [s]", output.timing.delay_s);
  status.add("interval of patches [s]", output.patch_interval_s);
  status.add("energy made by the loop [J]", output.made_energy_j);
  status.add("damping that takes it out [N s/m]", output.passivity_damping_n_s_m);
  status.add("tripped", output.tripped);
}

void ToolNode::addLockstep(diagnostic_updater::DiagnosticStatusWrapper& status) const {
  const LockstepLoop::Counts counts = lockstep_->counts();
  status.add("loop", counts.in_lockstep ? "in lockstep: a tick for every sample, in the order of stamps"
                                        : "lockstep: waits for a session and a device, or has left it");
  status.add("ticks", counts.ticks);
  status.add("poses that wait", counts.waiting);
  status.add("messages that came too late for their sample", counts.late);
}

void ToolNode::addLoop(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const LoopStatistics& loop = loop_->statistics();
  looked_.push_back({loop.periods.counts(), loop.work.counts()});
  const Looked& before = looked_.front();
  if (loop_->settings().simulated_time) {
    status.add("loop", "a tick for every pose, in simulated time");
  } else {
    status.addf("loop", "%g Hz, %s", loop_->settings().rate_hz,
                loop_->realTime() ? "SCHED_FIFO" : "without real-time priority, which was not permitted");
    addQuantiles(status, "period", since(looked_.back().periods, before.periods));
    addQuantiles(status, "work of a tick", since(looked_.back().work, before.work));
    status.add("late ticks", loop.late.load());
  }
  if (looked_.size() > kLooksKept)
    looked_.pop_front();
  status.add("ticks", loop.ticks.load());
  status.add("ticks that were not published", loop.lost.load());
  for (const auto fault : core::kForceFaults)
    status.add(std::string("times: ") + core::describe(fault), loop.faults[static_cast<std::size_t>(fault)].load());
  status.add("tool swaps", loop.swaps.load());
}

void ToolNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  using diagnostic_msgs::DiagnosticStatus;
  std::optional<LoopTick> newest;
  {
    const std::lock_guard<std::mutex> lock(notes_mutex_);
    newest = newest_;
    if (notes_.empty() || notes_.back()->tools.empty())
      status.summary(DiagnosticStatus::OK, "waiting for a scene with tools");
    else if (!newest)
      status.summary(DiagnosticStatus::OK, "waiting for a pose on measured_cp");
  }
  if (newest) {
    const auto notes = notesOf(newest->generation);
    status.add("tool", notes ? notes->tools[newest->tool].id : "");
    summarize(status, *newest);
  }
  if (lockstep_)
    addLockstep(status);
  else
    addLoop(status);
  incidents_.addTo(status);
}

}  // namespace soft_volume
