#include "soft_volume/ros/tool_node.h"

#include <geometry_msgs/WrenchStamped.h>
#include <ros/console.h>
#include <soft_volume/ToolCut.h>
#include <soft_volume/ToolForce.h>
#include <soft_volume/ToolState.h>

#include <algorithm>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/parameters.h"

namespace soft_volume {
namespace {

/// How often a force is computed when no pose comes: the device must be at zero within 50 ms of the last one.
constexpr double kWatchInterval_s = 0.005;

/// The tool's numbers go on after a restart of this node while the simulation remembers the old ones.
std::uint64_t firstSequence() {
  return ros::WallTime::now().toNSec();
}

}  // namespace

ToolNode::ToolNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node),
      wall_timeout_s_(parameter<double>(private_node, "wall_timeout_s", 0.25, 0.02, 10.0)),
      diagnostics_(node, private_node) {
  force_publisher_ = node_.advertise<ToolForce>(topics::kToolForce, 1000);
  cut_publisher_ = node_.advertise<ToolCut>(topics::kToolCut, 1000);
  state_publisher_ = node_.advertise<ToolState>(topics::kToolState, 1000);
  servo_publisher_ = node_.advertise<geometry_msgs::WrenchStamped>(topics::kServoForce, 1000);
  const ros::TransportHints hints = ros::TransportHints().tcpNoDelay();
  subscribers_ = {
      subscribeChecked<Scene>(
          node_, topics::kScene, 10, [this](const Scene::ConstPtr& m) { hearScene(m); }, incidents_),
      subscribeChecked<Volume>(
          node_, topics::kVolume, 10, [this](const Volume::ConstPtr& m) { hearVolume(m); }, incidents_),
      subscribeChecked<GridTopology>(
          node_, topics::kTopology, 100, [this](const GridTopology::ConstPtr& m) { hearTopology(m); }, incidents_),
      subscribeChecked<GridPatch>(
          node_, topics::kPatch, 2, [this](const GridPatch::ConstPtr& m) { hearPatch(m); }, incidents_),
      subscribeChecked<sensor_msgs::Joy>(
          node_, topics::kButtons, 100, [this](const sensor_msgs::Joy::ConstPtr& m) { hearButtons(m); }, incidents_),
      node_.subscribe(topics::kMeasuredPose, 100, &ToolNode::hearPose, this, hints),
      node_.subscribe(topics::kMeasuredVelocity, 100, &ToolNode::hearVelocity, this, hints)};
  reset_service_ = node_.advertiseService<std_srvs::Trigger::Request, std_srvs::Trigger::Response>(
      topics::kToolReset, [this](std_srvs::Trigger::Request&, std_srvs::Trigger::Response& response) -> bool {
        const std::lock_guard<std::mutex> lock(mutex_);
        if (!tools_.empty())
          publishCut(tool().reset(), poseHeader());
        response.success = 1;
        response.message = "forces start at zero again";
        return true;
      });
  watchdog_ =
      node_.createWallTimer(ros::WallDuration(kWatchInterval_s), [this](const ros::WallTimerEvent&) { watch(); });
  diagnostics_.setHardwareID("none");
  diagnostics_.add("tool", this, &ToolNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
}

void ToolNode::hearScene(const Scene::ConstPtr& message) {
  try {
    auto scene = std::make_shared<core::Scene>(core::parseScene(message->yaml, "the scene message", "/"));
    const std::lock_guard<std::mutex> lock(mutex_);
    scene_ = std::move(scene);
    frame_id_ = message->header.frame_id;
    makeTools();
  } catch (const core::Error& error) {
    incidents_.report(topics::kScene, error.what());
  }
}

void ToolNode::makeTools() {
  tools_.clear();
  selected_ = 0;
  const std::uint64_t first = firstSequence();
  for (const core::ToolConfig& config : scene_->tools) {
    tools_.push_back(std::make_unique<core::Tool>(config, first));
    if (volume_)
      tools_.back()->setVolume(volume_);
    if (topologies_.topology())
      tools_.back()->setTopology(topologies_.topology());
  }
}

void ToolNode::hearVolume(const Volume::ConstPtr& message) {
  try {
    const VolumeAndLabels content = fromMessage(*message);
    const std::lock_guard<std::mutex> lock(mutex_);
    volume_ = content.volume;
    for (const auto& tool : tools_) {
      tool->setVolume(volume_);
      if (topologies_.topology())
        tool->setTopology(topologies_.topology());
    }
  } catch (const core::Error& error) {
    incidents_.report(topics::kVolume, error.what());
  }
}

void ToolNode::hearTopology(const GridTopology::ConstPtr& message) {
  try {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (takeMessage(*message, topologies_) != core::TopologyDecoder::Result::kApplied || !volume_)
      return;
    for (const auto& tool : tools_)
      tool->setTopology(topologies_.topology());
  } catch (const core::Error& error) {
    incidents_.report(topics::kTopology, error.what());
  }
}

void ToolNode::hearPatch(const GridPatch::ConstPtr& message) {
  try {
    const std::lock_guard<std::mutex> lock(mutex_);
    // Topics are not ordered among each other: a patch of another revision than the topology's is early or late.
    const auto& topology = topologies_.topology();
    if (!topology || message->session != topology->session || message->revision != topology->revision)
      return;
    for (const auto& tool : tools_) {
      if (tool->config().id == message->tool_id)
        tool->setPatch(fromMessage(*message));
    }
  } catch (const core::Error& error) {
    incidents_.report(topics::kPatch, error.what());
  }
}

void ToolNode::hearPose(const geometry_msgs::PoseStamped::ConstPtr& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  // CRTK: a zero stamp says that the data is not valid. Silence is then what the watchdog acts on.
  if (message->header.stamp.isZero())
    return;
  if (!message->header.frame_id.empty() && message->header.frame_id != frame_id_) {
    incidents_.report(topics::kMeasuredPose, "the pose is in frame '" + message->header.frame_id + "' and not in '" +
                                                 frame_id_ + "': transform it before");
    return;
  }
  input_.pose = fromPose(message->pose);
  if (!core::isUsable(input_.pose)) {
    incidents_.report(topics::kMeasuredPose, "the pose is not finite or its quaternion is not a rotation");
  } else {
    input_.pose.orientation.normalize();
  }
  input_.pose_time_s = message->header.stamp.toSec();
  pose_heard_ = ros::WallTime::now();
  has_pose_ = true;
  update();
}

void ToolNode::hearVelocity(const geometry_msgs::TwistStamped::ConstPtr& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (message->header.stamp.isZero())
    return;
  const core::Vector3 velocity = fromVector(message->twist.linear);
  if (!core::isFinite(velocity)) {
    incidents_.report(topics::kMeasuredVelocity, "the velocity is not finite");
    input_.velocity_m_s.reset();
    return;
  }
  input_.velocity_m_s = velocity;
}

void ToolNode::hearButtons(const sensor_msgs::Joy::ConstPtr& message) {
  const std::lock_guard<std::mutex> lock(mutex_);
  core::Buttons buttons;
  for (std::size_t b = 0; b < std::min(message->buttons.size(), buttons.size()); ++b)
    buttons[b] = message->buttons[b] != 0;
  const bool swap = scene_ && buttons[scene_->swap_button] && !input_.buttons[scene_->swap_button];
  input_.buttons = buttons;
  if (swap)
    swapTool();
}

/// The tool that is put down lets go of the tissue: reset() ends its contact, and the simulation lets its last force
/// expire.
void ToolNode::swapTool() {
  if (tools_.size() < 2)
    return;
  publishCut(tool().reset(), poseHeader());
  selected_ = (selected_ + 1) % tools_.size();
  tool().reset();
  ++swaps_;
  ROS_INFO("tool in the hand: %s", tool().config().id.c_str());
}

double ToolNode::now() const {
  const double now_s = ros::Time::now().toSec();
  if (!ros::Time::useSystemTime()) {
    // Simulated time stands still when the simulation dies; the motor must not stay on then.
    const double silence_s = (ros::WallTime::now() - pose_heard_).toSec();
    return std::max(now_s, input_.pose_time_s) + std::max(0.0, silence_s - wall_timeout_s_);
  }
  return std::max(now_s, input_.pose_time_s);
}

void ToolNode::watch() {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!has_pose_ || (ros::WallTime::now() - pose_heard_).toSec() < kWatchInterval_s)
    return;
  update();
}

void ToolNode::update() {
  if (tools_.empty() || !has_pose_)
    return;
  input_.time_s = now();
  publish(tool().update(input_));
}

std_msgs::Header ToolNode::poseHeader() const {
  std_msgs::Header header;
  header.stamp = ros::Time(input_.pose_time_s);
  header.frame_id = frame_id_;
  return header;
}

void ToolNode::publishCut(const std::optional<core::TissueCut>& command, const std_msgs::Header& header) {
  if (!command)
    return;
  ToolCut cut = toMessage(core::toCommand(tool().config().id, *command));
  cut.header = header;
  cut_publisher_.publish(cut);
}

void ToolNode::publish(const core::ToolOutput& output) {
  const std_msgs::Header header = poseHeader();
  geometry_msgs::WrenchStamped servo;
  servo.header = header;
  servo.wrench.force = toVector(output.device_force_n);
  servo_publisher_.publish(servo);
  if (output.force) {
    ToolForce force = toMessage(core::toCommand(tool().config().id, *output.force));
    force.header = header;
    force_publisher_.publish(force);
  }
  publishCut(output.cut, header);
  publishState(output, header);
  last_output_ = output;
}

void ToolNode::publishState(const core::ToolOutput& output, const std_msgs::Header& header) {
  const core::ToolConfig& config = tool().config();
  const core::TickHeader& patch = output.patch;
  ToolState state;
  state.header = header;
  state.session = patch.session;
  state.revision = patch.revision;
  state.step = patch.step;
  state.tool_id = config.id;
  state.sequence = ++state_sequence_;
  state.kind = static_cast<std::uint8_t>(config.kind);
  state.pose = toPose(input_.pose);
  state.twist.linear = toVector(output.velocity_m_s);
  for (std::size_t b = 0; b < 8; ++b)
    state.buttons.push_back(static_cast<std::uint8_t>(input_.buttons[b]));
  state.patch_radius = config.patch_radius_m;
  state.in_contact = static_cast<std::uint8_t>(output.contact.touching);
  state.surface_point = toPoint(output.contact.surface_point_m);
  state.surface_normal = toVector(output.contact.normal);
  state.penetration = output.contact.penetration_m;
  state.device_force = toVector(output.device_force_n);
  state.coupling_stiffness = output.coupling_stiffness_n_m;
  state.pose_stale = static_cast<std::uint8_t>(output.pose_stale);
  state.saturated = static_cast<std::uint8_t>(output.saturated);
  state.slew_limited = static_cast<std::uint8_t>(output.slew_limited);
  state.tripped = static_cast<std::uint8_t>(output.tripped);
  state.trip_reason = output.tripped ? core::describe(output.fault) : "";
  state_publisher_.publish(state);
}

void ToolNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const std::lock_guard<std::mutex> lock(mutex_);
  using diagnostic_msgs::DiagnosticStatus;
  if (tools_.empty()) {
    status.summary(DiagnosticStatus::OK, "waiting for a scene with tools");
  } else if (!has_pose_) {
    status.summary(DiagnosticStatus::OK, "waiting for a pose on measured_cp");
  } else if (last_output_.fault != core::ForceFault::kNone) {
    status.summary(DiagnosticStatus::WARN, "no force: " + core::describe(last_output_.fault));
  } else {
    status.summary(DiagnosticStatus::OK, last_output_.contact.touching ? "in contact" : "free");
  }
  if (!tools_.empty())
    status.add("tool", tool().config().id);
  status.add("force on the device [N]", last_output_.device_force_n.norm());
  status.add("penetration [m]", last_output_.contact.penetration_m);
  status.add("coupling stiffness [N/m]", last_output_.coupling_stiffness_n_m);
  status.add("tripped", last_output_.tripped);
  status.add("tool swaps", swaps_);
  incidents_.addTo(status);
}

}  // namespace soft_volume
