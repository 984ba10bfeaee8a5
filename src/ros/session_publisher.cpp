#include "soft_volume/ros/session_publisher.h"

#include <ros/console.h>
#include <rosgraph_msgs/Clock.h>
#include <soft_volume/GridPatch.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/Volume.h>

#include <algorithm>
#include <boost/make_shared.hpp>
#include <cmath>
#include <utility>

#include "graph_api.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

/// A resumed run repeats what came after the checkpoint, so this is how long that takes at most.
constexpr double kKeepInterval_s = 2.0;
constexpr double kClockInterval_s = 0.001;
const ros::WallDuration kListenerWait(2.0);

}  // namespace

SessionPublisher::SessionPublisher(ros::NodeHandle& node, Settings settings, const SimulationRun& run,
                                   IncidentLog& incidents)
    : settings_(std::move(settings)), run_(run), incidents_(incidents) {
  advertise(node);
}

void SessionPublisher::advertise(ros::NodeHandle& node) {
  scene_publisher_ = node.advertise<Scene>(topics::kScene, 1, true);
  volume_publisher_ = node.advertise<Volume>(topics::kVolume, 1, true);
  const ros::SubscriberStatusCallback topology_joined = [this](const ros::SingleSubscriberPublisher&) {
    settings_.post([this] { sendFullTopology(); });
  };
  topology_publisher_ = node.advertise<GridTopology>(topics::kTopology, 100, topology_joined,
                                                     ros::SubscriberStatusCallback(), ros::VoidConstPtr(), true);
  // A new receiver cannot use deltas until it has a key frame.
  const auto joined = [this](const ros::SingleSubscriberPublisher&) { key_frame_wanted_ = true; };
  state_publisher_ = node.advertise<GridState>(topics::kState, 100, joined);
  patch_publisher_ = node.advertise<GridPatch>(topics::kPatch, settings_.patch_queue);
  // Who comes later can replay from a checkpoint on.
  const auto journal_joined = [this](const ros::SingleSubscriberPublisher&) {
    settings_.post([this] {
      publishJournal();
      publishCheckpoint();
    });
  };
  journal_publisher_ = node.advertise<SimulationJournal>(topics::kJournal, 1000, journal_joined);
  checkpoint_publisher_ = node.advertise<SimulationCheckpoint>(topics::kCheckpoint, 1, true);
  stats_publisher_ = node.advertise<SimulationStats>(topics::kSimulationStats, 10, true);
  if (settings_.clock)
    clock_publisher_ = node.advertise<rosgraph_msgs::Clock>("/clock", 100);
}

void SessionPublisher::waitForListeners() const {
  const std::size_t listeners = master_api::subscribers(journal_publisher_.getTopic()).size();
  const ros::WallTime end = ros::WallTime::now() + kListenerWait;
  while (journal_publisher_.getNumSubscribers() < listeners && ros::WallTime::now() < end)
    ros::WallDuration(0.01).sleep();
}

SessionPublisher::Every SessionPublisher::every(double interval_s) const {
  return {static_cast<std::uint64_t>(std::max(1.0, std::round(interval_s / run_.session->timeStep())))};
}

void SessionPublisher::setRates() {
  state_every_ = every(1.0 / settings_.output.state_rate_hz);
  patch_every_ = every(1.0 / settings_.output.patch_rate_hz);
  key_frame_every_ = every(settings_.output.key_frame_interval_s);
  checkpoint_every_ = every(settings_.output.checkpoint_interval_s);
  journal_every_ = every(kJournalInterval_s);
  clock_every_ = every(kClockInterval_s);
  keep_every_ = every(kKeepInterval_s);
}

void SessionPublisher::beginSession() {
  setRates();
  encoder_ = core::StateEncoder();
  journaled_step_ = run_.session->steps();
  statistics_.beginSession();
}

void SessionPublisher::publishSession() {
  Scene scene = sceneMessage(*run_.session);
  run_.stamp(scene);
  scene_publisher_.publish(scene);
  auto volume = boost::make_shared<Volume>(toMessage(*run_.session));
  run_.stamp(*volume);
  volume_publisher_.publish(volume);
  publishTopology(true);
  if (run_.begun)
    publishBeginning();
  ROS_INFO("session %llu: %zu cells, %zu vertices, time step %g s (limit %.3g s)",
           static_cast<unsigned long long>(run_.session->id()), run_.session->lattice().cellCount(),
           run_.session->lattice().vertexCount(), run_.session->timeStep(), run_.session->timeStepLimit());
}

void SessionPublisher::publishBeginning() {
  publishJournal();
  publishState(true);
  publishCheckpoint();
}

void SessionPublisher::countStep(std::chrono::steady_clock::duration duration) {
  statistics_.countStep(duration, static_cast<std::uint32_t>(run_.session->simulation().activeCells()));
}

void SessionPublisher::publishDueClock() {
  if (!settings_.clock || !clock_every_.due(run_.session->steps()))
    return;
  rosgraph_msgs::Clock message;
  message.clock = run_.stampNow();
  clock_publisher_.publish(message);
}

void SessionPublisher::publishDue() {
  const std::uint64_t step = run_.session->steps();
  // The journal after a checkpoint begins with it.
  const bool keep = settings_.resume_file != nullptr && keep_every_.due(step);
  if (journal_every_.due(step) || checkpoint_every_.due(step) || keep)
    publishJournal();
  const bool key_frame = key_frame_every_.due(step);
  if (key_frame)
    sendFullTopology();
  if (state_every_.due(step) || key_frame)
    publishState(key_frame);
  if (checkpoint_every_.due(step))
    publishCheckpoint();
  else if (keep)
    keepCheckpoint(makeCheckpoint());
}

void SessionPublisher::publishTopology(bool full) {
  auto message = boost::make_shared<GridTopology>(topologies_.encode(*run_.session, full));
  run_.stamp(*message);
  published_revision_ = message->revision;
  topology_publisher_.publish(message);
  key_frame_wanted_ = true;
}

void SessionPublisher::publishChangedTopology() {
  if (run_.session->lattice().revision != published_revision_)
    publishTopology(false);
}

void SessionPublisher::sendFullTopology() {
  if (topologies_.lastWasDelta())
    publishTopology(true);
}

void SessionPublisher::publishState(bool key_frame) {
  const core::Session& session = *run_.session;
  core::GridStateFrame frame;
  frame.session = session.id();
  frame.revision = session.lattice().revision;
  frame.step = session.steps();
  frame.simulation_time_s = session.simulationTime();
  frame.state_hash = session.simulation().stateHash();
  encoder_.encode(session.drawnPositions(), key_frame_wanted_.exchange(false) || key_frame, frame);
  auto message = boost::make_shared<GridState>(toMessage(frame));
  run_.stamp(*message);
  state_publisher_.publish(message);
  statistics_.countState(session);
}

void SessionPublisher::publishJournal() {
  SimulationJournal message;
  message.session = run_.session->id();
  message.revision = run_.session->lattice().revision;
  message.step = message.last_step = run_.session->steps();
  message.first_step = journaled_step_;
  message.entries = run_.journal->take();
  message.state_hash = run_.session->simulation().stateHash();
  run_.stamp(message);
  if (settings_.resume_file != nullptr)
    settings_.resume_file->append(message);  // first: what others have seen is never lost
  journal_publisher_.publish(message);
  journaled_step_ = message.last_step;
}

void SessionPublisher::publishPatch(const std::string& tool_id, const core::Vector3& point_m, double radius_m) {
  auto message = boost::make_shared<GridPatch>(toMessage(run_.session->patch(tool_id, point_m, radius_m)));
  run_.stamp(*message);
  message->next_stamp = run_.stampOf(run_.session->steps() + patch_every_.steps);
  patch_publisher_.publish(message);
}

SimulationCheckpoint SessionPublisher::publishAskedCheckpoint() {
  SimulationCheckpoint message = toMessage(*run_.session, run_.session->checkpoint());
  run_.stamp(message);
  checkpoint_publisher_.publish(message);
  return message;
}

boost::shared_ptr<const SimulationCheckpoint> SessionPublisher::makeCheckpoint() const {
  auto message = boost::make_shared<SimulationCheckpoint>(toMessage(*run_.session, run_.session->checkpoint()));
  run_.stamp(*message);
  return message;
}

void SessionPublisher::publishCheckpoint() {
  const auto message = makeCheckpoint();
  checkpoint_publisher_.publish(message);
  keepCheckpoint(message);
}

void SessionPublisher::keepCheckpoint(boost::shared_ptr<const SimulationCheckpoint> checkpoint) {
  if (settings_.resume_file == nullptr)
    return;
  settings_.resume_file->begin(std::move(checkpoint), run_.paused);
  const std::string error = settings_.resume_file->takeError();
  if (!error.empty())
    incidents_.report(topics::kResume, error);
}

void SessionPublisher::publishStats() {
  SimulationStats stats = statistics_.make(run_);
  run_.stamp(stats);
  stats_publisher_.publish(stats);
  statistics_.beginPeriod();
  const std::lock_guard<std::mutex> lock(stats_mutex_);
  stats_ = stats;
}

void SessionPublisher::publishDueStats() {
  if (statistics_.periodLength() >= std::chrono::seconds(1))
    publishStats();
}

SimulationStats SessionPublisher::lastStats() const {
  const std::lock_guard<std::mutex> lock(stats_mutex_);
  return stats_;
}

}  // namespace soft_volume
