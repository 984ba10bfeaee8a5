#include "soft_volume/ros/simulation_node.h"

#include <ros/console.h>
#include <ros/init.h>
#include <rosgraph_msgs/Clock.h>
#include <soft_volume/GridPatch.h>
#include <soft_volume/GridState.h>
#include <soft_volume/GridTopology.h>
#include <soft_volume/PartRemoval.h>
#include <soft_volume/Scene.h>
#include <soft_volume/SimulationCheckpoint.h>
#include <soft_volume/SimulationControl.h>
#include <soft_volume/SimulationJournal.h>
#include <soft_volume/Volume.h>

#include <algorithm>
#include <cmath>
#include <future>
#include <utility>

#include "graph_api.h"
#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/parameters.h"
#include "soft_volume/ros/run_node.h"

namespace soft_volume {
namespace {

/// A tool that said nothing for this long gets no patches.
constexpr double kToolSilence_s = 0.5;
constexpr double kJournalInterval_s = 0.02;
/// A resumed run repeats what came after the checkpoint, so this is how long that takes at most.
constexpr double kKeepInterval_s = 2.0;
const ros::WallDuration kListenerWait(2.0);
/// With simulated time the simulation runs at most this far ahead of the tools, well below the age at which a tool
/// takes a pose for stale; a tool that stays behind for longer than the timeout is not waited for any more.
constexpr double kToolLead_s = 0.01;
constexpr std::chrono::milliseconds kToolTimeout(200);
/// A device delivers at most some thousand inputs a second; more than this at once is a fault, not a hand.
constexpr std::size_t kMaxQueuedInputs = 100000;
constexpr std::size_t kMaxLaterInputs = 10000;
/// Messages that may wait in lockstep, where none may be lost.
constexpr std::uint32_t kLockstepQueue = 100000;
/// Waits are cut in pieces, so that services and the end of the node are not held up.
constexpr std::chrono::milliseconds kPatience(20);
/// A clock that jumps back by more was started anew.
constexpr double kClockJump_s = 0.1;

double milliseconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double, std::milli>(duration).count();
}

/// Never 0 and new for every session on this machine.
std::uint64_t newSessionId() {
  return ros::WallTime::now().toNSec();
}

std::uint64_t applyAtStep(const std::variant<ToolForce::ConstPtr, ToolCut::ConstPtr, ToolGrip::ConstPtr>& input) {
  return std::visit([](const auto& message) { return message->apply_at_step; }, input);
}

}  // namespace

SimulationNode::SimulationNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node), private_node_(private_node), diagnostics_(node, private_node) {
  const auto scene_file = requiredParameter<std::string>(private_node_, "scene", "the scene file (YAML) to simulate");
  threads_ = parameter<int>(private_node_, "threads", 1, 1, 256);
  real_time_factor_ = parameter<double>(private_node_, "real_time_factor", 1.0, 0.0, 1000.0);
  stop_after_s_ = parameter<double>(private_node_, "stop_after_s", 0.0, 0.0, 1e9);
  publish_clock_ = parameter<bool>(private_node_, "publish_clock", false);
  paused_ = parameter<bool>(private_node_, "start_paused", false);
  frame_id_ = parameter<std::string>(private_node_, "frame_id", "volume");

  lockstep_ = parameter<bool>(private_node_, "lockstep", false);
  lockstep_tools_ = parameter<int>(private_node_, "lockstep_tools", 1, 1, 64);
  lockstep_timeout_s_ = parameter<double>(private_node_, "lockstep_timeout_s", 5.0, 0.1, 3600.0);
  if (lockstep_ && publish_clock_)
    throw core::InputError(
        "lockstep and publish_clock: in lockstep time comes from the device's samples; set one only");
  follow_clock_ = !lockstep_ && !publish_clock_ && real_time_factor_ > 0.0 && !ros::Time::useSystemTime();

  scene_ = core::loadScene(scene_file);
  volumes_ = core::readVolumes(scene_);
  epoch_ = publish_clock_ ? ros::Time(1.0) : ros::Time::now();
  const auto resume_file = parameter<std::string>(private_node_, "resume_file", "");
  if (!resume_file.empty())
    resume_file_ = std::make_unique<ResumeFile>(resume_file);
  advertise();
  waitForListeners();
  startOrResume();
  advertiseServices();
  subscribe();
  diagnostics_.setHardwareID("none");
  diagnostics_.add("simulation", this, &SimulationNode::diagnose);
  diagnostics_timer_ = node_.createWallTimer(ros::WallDuration(1.0),
                                             [this](const ros::WallTimerEvent&) { diagnostics_.force_update(); });
  thread_ = std::thread([this] { run(); });
}

SimulationNode::~SimulationNode() {
  running_ = false;
  wake_.notify_all();
  thread_.join();
  // A nodelet is also destroyed when its loader was killed: then another one goes on.
  if (resume_file_ && (stopRequested() != 0 || !ros::ok()))
    resume_file_->remove();
}

/// The journal is not latched, and who misses its beginning cannot replay the session: those that are there already,
/// because this is not their first simulation, are to be connected.
void SimulationNode::waitForListeners() const {
  const std::size_t listeners = master_api::subscribers(journal_publisher_.getTopic()).size();
  const ros::WallTime end = ros::WallTime::now() + kListenerWait;
  while (journal_publisher_.getNumSubscribers() < listeners && ros::WallTime::now() < end)
    ros::WallDuration(0.01).sleep();
}

/// What a killed simulation kept, brought to its last journaled state. What cannot be used is set aside and told.
std::optional<ResumedRun> SimulationNode::keptRun() {
  if (!resume_file_)
    return std::nullopt;
  try {
    const std::optional<KeptRun> kept = resume_file_->read();
    if (!kept)
      return std::nullopt;
    if (!kept->damage.empty())
      incidents_.report(topics::kResume, "the end of the kept run is lost: " + kept->damage);
    return resume(*kept, scene_, volumes_, threads_);
  } catch (const core::Error& error) {
    incidents_.report(topics::kResume, std::string(error.what()) +
                                           ": the kept run cannot go on and starts from rest (" +
                                           resume_file_->setAside() + " is what was kept)");
  }
  return std::nullopt;
}

void SimulationNode::startOrResume() {
  const std::optional<ResumedRun> run = keptRun();
  if (!run) {
    startSession(nullptr);
    return;
  }
  paused_ = run->paused;
  // The clock that others saw last is at most a journal's interval later than the journal.
  const double earlier_s = run->simulation_time_s - (publish_clock_ ? kJournalInterval_s + run->checkpoint.dt : 0.0);
  const ros::Time now = publish_clock_ ? run->checkpoint.header.stamp : ros::Time::now();
  epoch_ = ros::Time(std::max(0.0, (now - ros::Time(0.0)).toSec() - earlier_s));
  resumed_ = "session " + std::to_string(run->checkpoint.session) + ", step " + std::to_string(run->checkpoint.step);
  startSession(&run->checkpoint, "goes on from " + resumed_ + ", where a simulation ended without being stopped; " +
                                     std::to_string(run->steps_repeated) + " steps were repeated");
  ROS_WARN("the simulation goes on from %s, where another one ended without being stopped", resumed_.c_str());
}

SimulationNode::Every SimulationNode::every(double interval_s) const {
  return {static_cast<std::uint64_t>(std::max(1.0, std::round(interval_s / session_->timeStep())))};
}

void SimulationNode::setRates() {
  state_every_ = every(1.0 / scene_.output.state_rate_hz);
  patch_every_ = every(1.0 / scene_.output.patch_rate_hz);
  key_frame_every_ = every(scene_.output.key_frame_interval_s);
  checkpoint_every_ = every(scene_.output.checkpoint_interval_s);
  journal_every_ = every(kJournalInterval_s);
  clock_every_ = every(0.001);
  keep_every_ = every(kKeepInterval_s);
}

void SimulationNode::advertise() {
  scene_publisher_ = node_.advertise<Scene>(topics::kScene, 1, true);
  volume_publisher_ = node_.advertise<Volume>(topics::kVolume, 1, true);
  const ros::SubscriberStatusCallback topology_joined = [this](const ros::SingleSubscriberPublisher&) {
    const std::lock_guard<std::mutex> lock(mutex_);
    commands_.push_back([this] { sendFullTopology(); });
    wake_.notify_all();
  };
  topology_publisher_ = node_.advertise<GridTopology>(topics::kTopology, 100, topology_joined,
                                                      ros::SubscriberStatusCallback(), ros::VoidConstPtr(), true);
  // A new receiver cannot use deltas until it has a key frame.
  const auto joined = [this](const ros::SingleSubscriberPublisher&) { key_frame_wanted_ = true; };
  state_publisher_ = node_.advertise<GridState>(topics::kState, 100, joined);
  patch_publisher_ = node_.advertise<GridPatch>(topics::kPatch, lockstep_ ? kLockstepQueue : 100);
  // Who comes later can replay from a checkpoint on.
  const auto journal_joined = [this](const ros::SingleSubscriberPublisher&) {
    const std::lock_guard<std::mutex> lock(mutex_);
    commands_.emplace_back([this] {
      publishJournal();
      publishCheckpoint();
    });
    wake_.notify_all();
  };
  journal_publisher_ = node_.advertise<SimulationJournal>(topics::kJournal, 1000, journal_joined);
  checkpoint_publisher_ = node_.advertise<SimulationCheckpoint>(topics::kCheckpoint, 1, true);
  stats_publisher_ = node_.advertise<SimulationStats>(topics::kSimulationStats, 10, true);
  if (publish_clock_)
    clock_publisher_ = node_.advertise<rosgraph_msgs::Clock>("/clock", 100);
}

void SimulationNode::advertiseServices() {
  using Trigger = std_srvs::Trigger;
  using Ok = bool;
  services_.push_back(node_.advertiseService<Trigger::Request, Trigger::Response>(
      topics::kReset, [this](Trigger::Request&, Trigger::Response& response) -> Ok {
        response.success = inLoop([this] { startSession(nullptr); });
        response.message = "a new session starts from rest";
        return true;
      }));
  services_.push_back(node_.advertiseService<std_srvs::SetBool::Request, std_srvs::SetBool::Response>(
      topics::kPause, [this](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) -> Ok {
        const bool pause = request.data != 0;
        response.success = inLoop([this, pause] { setPaused(pause); });
        response.message = pause ? "paused" : "running";
        return true;
      }));
  services_.push_back(node_.advertiseService<Trigger::Request, Trigger::Response>(
      topics::kRequestKeyFrame, [this](Trigger::Request&, Trigger::Response& response) -> Ok {
        response.success = inLoop([this] {
          sendFullTopology();
          publishState(true);
        });
        response.message = "a key frame was published";
        return true;
      }));
  services_.push_back(node_.advertiseService<StepSimulation::Request, StepSimulation::Response>(
      topics::kStep, [this](StepSimulation::Request& request, StepSimulation::Response& response) -> Ok {
        response.success = 0;
        response.message = "the simulation runs: pause it first (" + std::string(topics::kPause) + ")";
        if (request.steps < 1 || request.steps > 1000000) {
          response.message = "steps must be within [1, 1000000]";
          return true;
        }
        inLoop([this, &request, &response] {
          if (!paused_)
            return;
          for (std::uint32_t n = 0; n < request.steps && running_; ++n) {
            applyInputs();
            advance();
          }
          publishState(false);
          publishJournal();
          response.success = 1;
          response.message = "";
          response.step = session_->steps();
        });
        return true;
      }));
  services_.push_back(node_.advertiseService<SetIntegrator::Request, SetIntegrator::Response>(
      topics::kSetIntegrator, [this](SetIntegrator::Request& request, SetIntegrator::Response& response) -> Ok {
        inLoop([this, &request, &response] { setIntegrator(request, response); });
        return true;
      }));
  services_.push_back(node_.advertiseService<RemovePart::Request, RemovePart::Response>(
      topics::kRemovePart, [this](RemovePart::Request& request, RemovePart::Response& response) -> Ok {
        inLoop([this, &request, &response] { removePart(request, response); });
        return true;
      }));
  services_.push_back(node_.advertiseService<SaveCheckpoint::Request, SaveCheckpoint::Response>(
      topics::kSaveCheckpoint, [this](SaveCheckpoint::Request&, SaveCheckpoint::Response& response) -> Ok {
        response.success = inLoop([this, &response] {
          response.checkpoint = toMessage(*session_, session_->checkpoint());
          stamp(response.checkpoint);
          checkpoint_publisher_.publish(response.checkpoint);
        });
        return true;
      }));
  services_.push_back(node_.advertiseService<RestoreCheckpoint::Request, RestoreCheckpoint::Response>(
      topics::kRestoreCheckpoint,
      [this](RestoreCheckpoint::Request& request, RestoreCheckpoint::Response& response) -> Ok {
        inLoop([this, &request, &response] {
          try {
            startSession(&request.checkpoint);
            response.success = 1;
            response.message = "a new session continues from step " + std::to_string(session_->steps());
          } catch (const core::Error& error) {
            response.success = 0;
            response.message = error.what();
            incidents_.report(topics::kRestoreCheckpoint, error.what());
          }
        });
        return true;
      }));
}

void SimulationNode::subscribe() {
  const std::uint32_t queue = lockstep_ ? kLockstepQueue : 1000;
  subscribers_ = {
      subscribeChecked<ToolForce>(
          node_, topics::kToolForce, queue, [this](const ToolForce::ConstPtr& m) { queueInput(m); }, incidents_),
      subscribeChecked<ToolCut>(
          node_, topics::kToolCut, queue, [this](const ToolCut::ConstPtr& m) { queueInput(m); }, incidents_),
      subscribeChecked<ToolGrip>(
          node_, topics::kToolGrip, queue, [this](const ToolGrip::ConstPtr& m) { queueInput(m); }, incidents_),
      subscribeChecked<ToolState>(
          node_, topics::kToolState, 100, [this](const ToolState::ConstPtr& m) { hearTool(m); }, incidents_)};
  if (lockstep_) {
    subscribers_.push_back(subscribeChecked<ToolProgress>(
        node_, topics::kToolProgress, queue, [this](const ToolProgress::ConstPtr& m) { hearProgress(m); }, incidents_));
  }
}

void SimulationNode::queueInput(Input input) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (in_lockstep_)
    return queueLockstepInput(input);
  if (inputs_.size() >= kMaxQueuedInputs) {
    incidents_.report("tool inputs", "more came than the simulation can take; some were dropped");
    return;
  }
  inputs_.push_back(std::move(input));
}

void SimulationNode::hearTool(const ToolState::ConstPtr& message) {
  const core::Vector3 point = fromPoint(message->pose.position);
  if (scene_.findTool(message->tool_id) == nullptr || !core::isFinite(point) ||
      !(message->patch_radius > 0.0 && message->patch_radius <= 1.0)) {
    incidents_.report(topics::kToolState, "a tool that the scene does not have, or a pose or radius out of range");
    return;
  }
  // A tool whose device fell silent repeats its last pose: nothing newer will come, so it is not waited for.
  const ros::Time stamp = message->pose_stale != 0 ? ros::TIME_MAX : message->header.stamp;
  const std::lock_guard<std::mutex> lock(mutex_);
  patch_requests_[message->tool_id] = {point, message->patch_radius, stamp, ros::WallTime::now()};
  wake_.notify_all();
}

void SimulationNode::queueLockstepInput(const Input& input) {
  using Kind = core::LockstepInputs<Input>::Kind;
  const auto add = [this, &input](const auto& message, Kind kind) {
    timed_inputs_.add(static_cast<std::int64_t>(message.header.stamp.toNSec()), message.tool_id, kind, message.sequence,
                      input);
  };
  if (const auto* force = std::get_if<ToolForce::ConstPtr>(&input)) {
    add(**force, Kind::kForce);
    gate_.countForce((*force)->tool_id, (*force)->sequence);
  } else if (const auto* cut = std::get_if<ToolCut::ConstPtr>(&input)) {
    add(**cut, Kind::kCut);
    gate_.countCut((*cut)->tool_id, (*cut)->sequence);
  } else {
    add(*std::get<ToolGrip::ConstPtr>(input), Kind::kGrip);
  }
  wake_.notify_all();
}

void SimulationNode::hearProgress(const ToolProgress::ConstPtr& message) {
  try {
    const core::ToolNotice notice = fromMessage(*message);
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!in_lockstep_ || notice.session != lockstep_session_)
      return;
    progress_heard_ = Clock::now();
    wake_.notify_all();
    if (message->left != 0) {
      lockstep_end_ = notice.hand + " has left it";
      return;
    }
    const bool usable = scene_.findTool(notice.tool_id) != nullptr && core::isFinite(notice.point_m) &&
                        notice.patch_radius_m > 0.0 && notice.patch_radius_m <= 1.0;
    if (!usable)
      incidents_.report(topics::kToolProgress,
                        "a tool that the scene does not have, or a place or radius out of range");
    else if (!gate_.hear(notice, lockstep_session_))
      lockstep_end_ = notice.hand + " joined it later, or its stamps went back";
  } catch (const core::Error& error) {
    incidents_.report(topics::kToolProgress, error.what());
  }
}

/// Runs `work` in the simulation's thread between two steps and waits for it; false when the node is shutting down.
bool SimulationNode::inLoop(const std::function<void()>& work) {
  auto done = std::make_shared<std::promise<void>>();
  std::future<void> result = done->get_future();
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    commands_.emplace_back([work, done] {
      work();
      done->set_value();
    });
  }
  wake_.notify_all();
  while (result.wait_for(std::chrono::milliseconds(100)) != std::future_status::ready) {
    if (!running_ || !ros::ok())
      return false;
  }
  return true;
}

void SimulationNode::run() {
  due_ = stats_time_ = Clock::now();
  while (running_ && ros::ok()) {
    runCommands();
    if (!paused_) {
      if (readyForStep()) {
        applyInputs();
        advance();
      }
    } else if (key_frame_wanted_ && begun_) {
      publishState(true);  // somebody joined, and no step will bring a state
    }
    if (Clock::now() - stats_time_ >= std::chrono::seconds(1))
      publishStats();
    if (stop_after_s_ > 0.0 && session_->simulationTime() >= stop_after_s_) {
      publishState(true);
      publishJournal();
      publishStats();
      ROS_INFO("%.3f s were simulated: the run is complete", session_->simulationTime());
      // Subscribers have to read the last messages before the connections close.
      ros::WallDuration(0.5).sleep();
      ros::requestShutdown();
      return;
    }
  }
}

/// Waits for the time of the next step; false when something else is to be seen to first.
bool SimulationNode::readyForStep() {
  if (!begun_ && !waitForStart())
    return false;
  if (in_lockstep_)
    return readyInLockstep();
  if (follow_clock_)
    return waitForClock();
  waitForDueTime();
  waitForTools();
  return true;
}

/// What a session begins with needs its time zero: of the first sample, or of the clock.
bool SimulationNode::waitForStart() {
  if (!in_lockstep_) {
    if (ros::Time::now().isZero())
      std::this_thread::sleep_for(kPatience);
    else
      beginAt(ros::Time::now());
    return begun_;
  }
  std::optional<std::int64_t> epoch_ns;
  {
    std::unique_lock<std::mutex> lock(mutex_);
    wake_.wait_for(lock, kPatience,
                   [this] { return !running_ || !commands_.empty() || gate_.epoch() || !lockstep_end_.empty(); });
    epoch_ns = gate_.epoch();
  }
  if (epoch_ns)
    beginAt(ros::Time().fromNSec(static_cast<std::uint64_t>(*epoch_ns)));
  return begun_;
}

void SimulationNode::beginAt(const ros::Time& now) {
  epoch_ = now - ros::Duration(session_->simulationTime());
  begun_ = true;
  publishJournal();
  publishState(true);
  publishCheckpoint();
}

/// Steps of a clock that somebody else drives: it may stand still, and begin anew.
bool SimulationNode::waitForClock() {
  const ros::Time due = stampNow() + ros::Duration(session_->timeStep());
  const ros::Time now = ros::Time::now();
  if (now >= due)
    return true;
  if ((due - now).toSec() > kClockJump_s)
    epoch_ = now - ros::Duration(session_->simulationTime());
  std::this_thread::sleep_for(std::chrono::microseconds(200));
  return false;
}

bool SimulationNode::readyInLockstep() {
  const std::int64_t time_ns = static_cast<std::int64_t>(stampNow().toNSec());
  std::string reason;
  {
    std::unique_lock<std::mutex> lock(mutex_);
    const bool ready = wake_.wait_for(lock, kPatience, [&] {
      return !running_ || !commands_.empty() || !lockstep_end_.empty() || gate_.complete(time_ns);
    });
    if (ready && gate_.complete(time_ns))
      return true;
    reason = lockstep_end_;
    if (reason.empty() && Clock::now() - progress_heard_ > std::chrono::duration<double>(lockstep_timeout_s_))
      reason = "nothing came from " + gate_.waitsFor(time_ns);
  }
  if (!reason.empty())
    leaveLockstep(reason);
  return false;
}

void SimulationNode::leaveLockstep(const std::string& reason) {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    in_lockstep_ = false;
    inputs_ = timed_inputs_.take(INT64_MAX);
  }
  due_ = Clock::now();
  incidents_.report(topics::kLockstep, reason + ": the run goes on out of lockstep until the next session");
  journal_->note(topics::kLockstep, "std_msgs/Empty", {}, "left: " + reason);
}

void SimulationNode::publishLockstepPatches() {
  std::vector<core::ToolNotice> notices;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    notices = gate_.noticesAt(static_cast<std::int64_t>(stampNow().toNSec()));
  }
  for (const core::ToolNotice& notice : notices)
    publishPatch(notice.tool_id, notice.point_m, notice.patch_radius_m);
}

void SimulationNode::runCommands() {
  std::vector<std::function<void()>> commands;
  {
    std::unique_lock<std::mutex> lock(mutex_);
    if (paused_ && commands_.empty())
      wake_.wait_for(lock, std::chrono::milliseconds(20));
    commands.swap(commands_);
  }
  for (const auto& command : commands)
    command();
}

void SimulationNode::waitForDueTime() {
  if (real_time_factor_ <= 0.0)
    return;
  due_ += std::chrono::duration_cast<Clock::duration>(
      std::chrono::duration<double>(session_->timeStep() / real_time_factor_));
  const Clock::time_point now = Clock::now();
  if (due_ > now) {
    std::this_thread::sleep_until(due_);
  } else if (now - due_ > std::chrono::milliseconds(100)) {
    due_ = now;  // too slow for the wished factor: do not race to make up for it later
  }
}

/// With simulated time a slow machine slows the simulation down instead of starving the hand.
void SimulationNode::waitForTools() {
  if (!publish_clock_)
    return;
  const ros::Time needed = stampNow() - ros::Duration(kToolLead_s);
  const auto behind = [&needed](const auto& entry) { return entry.second.stamp < needed; };
  std::unique_lock<std::mutex> lock(mutex_);
  const bool caught_up = wake_.wait_for(lock, kToolTimeout, [&] {
    return !running_ || std::none_of(patch_requests_.begin(), patch_requests_.end(), behind);
  });
  if (caught_up)
    return;
  for (auto it = patch_requests_.begin(); it != patch_requests_.end();) {
    it = behind(*it) ? patch_requests_.erase(it) : std::next(it);
  }
}

void SimulationNode::applyInputs() {
  std::vector<Input> inputs;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (in_lockstep_)
      inputs = timed_inputs_.take(static_cast<std::int64_t>(stampNow().toNSec()));
    else
      inputs.swap(inputs_);
  }
  for (const Input& input : inputs) {
    const std::uint64_t at = applyAtStep(input);
    if (at <= session_->steps() + 1) {
      applyInput(input);
    } else if (later_.size() < kMaxLaterInputs) {
      later_.emplace(at, input);
    } else {
      incidents_.report("tool inputs", "too many are waiting for a later step; one was dropped");
    }
  }
  while (!later_.empty() && later_.begin()->first <= session_->steps() + 1) {
    applyInput(later_.begin()->second);
    later_.erase(later_.begin());
  }
}

void SimulationNode::applyInput(const Input& input) {
  std::visit(
      [this](const auto& message) {
        const JournalEntry& entry = journal_->apply(*message);
        if (entry.outcome == JournalEntry::REFUSED)
          incidents_.report(entry.topic, entry.reason);
      },
      input);
  if (session_->lattice().revision != published_revision_)
    publishTopology(false);
}

void SimulationNode::advance() {
  // In lockstep patches follow the inputs of their time; otherwise they go as early as they can.
  if (in_lockstep_ && patch_every_.due(session_->steps()))
    publishLockstepPatches();
  const Clock::time_point start = Clock::now();
  session_->step();
  step_ms_.push_back(static_cast<float>(milliseconds(Clock::now() - start)));
  active_cells_max_ = std::max(active_cells_max_, static_cast<std::uint32_t>(session_->simulation().activeCells()));
  const std::uint64_t step = session_->steps();
  if (publish_clock_ && clock_every_.due(step))
    publishClock();
  if (!in_lockstep_ && patch_every_.due(step))
    publishPatches();
  // The journal after a checkpoint begins with it.
  const bool keep = resume_file_ && keep_every_.due(step);
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

void SimulationNode::setPaused(bool paused) {
  paused_ = paused;
  due_ = Clock::now();
  journal_->note(topics::kPause, "std_srvs/SetBool", {static_cast<std::uint8_t>(paused)});
  if (resume_file_)
    resume_file_->setPaused(paused);
}

void SimulationNode::setIntegrator(const SetIntegrator::Request& request, SetIntegrator::Response& response) {
  SimulationControl control;
  stamp(control);
  control.session = session_->id();
  control.revision = session_->lattice().revision;
  control.step = session_->steps();
  control.integrator = request.integrator;
  control.dt = request.dt;
  const JournalEntry& entry = journal_->apply(control);
  response.success = static_cast<std::uint8_t>(entry.outcome == JournalEntry::APPLIED);
  response.message = entry.reason;
  response.dt = session_->timeStep();
  setRates();
  publishStats();
}

void SimulationNode::removePart(const RemovePart::Request& request, RemovePart::Response& response) {
  PartRemoval removal;
  stamp(removal);
  removal.session = session_->id();
  removal.revision = session_->lattice().revision;
  removal.step = session_->steps();
  removal.cell = request.cell;
  const JournalEntry& entry = journal_->apply(removal);
  response.success = static_cast<std::uint8_t>(entry.outcome == JournalEntry::APPLIED);
  response.message = entry.reason;
  if (response.success != 0)
    publishTopology(true);
  publishStats();
}

void SimulationNode::startSession(const SimulationCheckpoint* checkpoint, const std::string& resumed) {
  auto session = std::make_unique<core::Session>(scene_, volumes_.volume, volumes_.labels, newSessionId(), threads_);
  auto journal = std::make_unique<Journal>(*session);
  if (checkpoint != nullptr) {
    const JournalEntry& entry = journal->apply(*checkpoint);
    if (entry.outcome != JournalEntry::APPLIED)
      throw core::InputError(entry.reason);
  }
  if (!resumed.empty())
    journal->note(topics::kResume, "std_msgs/Empty", {}, resumed);
  if (session_) {
    publishJournal();                                           // what the old session still has to say
    epoch_ = stampNow() + ros::Duration(session_->timeStep());  // no two states with one stamp
    if (checkpoint != nullptr)
      epoch_ -= ros::Duration(session->simulationTime());
  }
  session_ = std::move(session);
  journal_ = std::move(journal);
  setRates();
  startLockstep();
  later_.clear();
  encoder_ = core::StateEncoder();
  journaled_step_ = session_->steps();
  active_cells_max_ = 0;
  max_displacement_ever_m_ = cut_opening_max_m_ = 0.0;
  states_published_ = 0;
  publishSession();
}

/// Every session begins in it, where it is wanted.
void SimulationNode::startLockstep() {
  begun_ = begun_ || (!lockstep_ && !(follow_clock_ && ros::Time::now().isZero()));
  if (!lockstep_)
    return;
  const std::lock_guard<std::mutex> lock(mutex_);
  begun_ = false;
  in_lockstep_ = true;
  gate_ = core::LockstepGate(static_cast<std::size_t>(lockstep_tools_));
  timed_inputs_.clear();
  lockstep_session_ = session_->id();
  lockstep_end_.clear();
  progress_heard_ = Clock::now();
}

void SimulationNode::publishSession() {
  Scene scene = sceneMessage(*session_);
  stamp(scene);
  scene_publisher_.publish(scene);
  auto volume = boost::make_shared<Volume>(toMessage(*session_));
  stamp(*volume);
  volume_publisher_.publish(volume);
  publishTopology(true);
  if (begun_) {
    publishJournal();
    publishState(true);
    publishCheckpoint();
  }
  ROS_INFO("session %llu: %zu cells, %zu vertices, time step %g s (limit %.3g s)",
           static_cast<unsigned long long>(session_->id()), session_->lattice().cellCount(),
           session_->lattice().vertexCount(), session_->timeStep(), session_->timeStepLimit());
}

void SimulationNode::publishTopology(bool full) {
  auto message = boost::make_shared<GridTopology>(topologies_.encode(*session_, full));
  stamp(*message);
  published_revision_ = message->revision;
  topology_publisher_.publish(message);
  key_frame_wanted_ = true;
}

/// The latched message is enough unless it is a delta.
void SimulationNode::sendFullTopology() {
  if (topologies_.lastWasDelta())
    publishTopology(true);
}

void SimulationNode::publishState(bool key_frame) {
  core::GridStateFrame frame;
  frame.session = session_->id();
  frame.revision = session_->lattice().revision;
  frame.step = session_->steps();
  frame.simulation_time_s = session_->simulationTime();
  frame.state_hash = session_->simulation().stateHash();
  encoder_.encode(session_->drawnPositions(), key_frame_wanted_.exchange(false) || key_frame, frame);
  auto message = boost::make_shared<GridState>(toMessage(frame));
  stamp(*message);
  state_publisher_.publish(message);
  ++states_published_;
  trackExtremes();
}

void SimulationNode::publishJournal() {
  SimulationJournal message;
  message.session = session_->id();
  message.revision = session_->lattice().revision;
  message.step = message.last_step = session_->steps();
  message.first_step = journaled_step_;
  message.entries = journal_->take();
  message.state_hash = session_->simulation().stateHash();
  stamp(message);
  if (resume_file_)
    resume_file_->append(message);  // first: what others have seen is never lost
  journal_publisher_.publish(message);
  journaled_step_ = message.last_step;
}

void SimulationNode::publishPatches() {
  std::map<std::string, PatchRequest> requests;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    requests = patch_requests_;
  }
  for (const auto& entry : requests) {
    const PatchRequest& request = entry.second;
    if ((ros::WallTime::now() - request.heard).toSec() > kToolSilence_s)
      continue;
    publishPatch(entry.first, request.point_m, request.radius_m);
  }
}

void SimulationNode::publishPatch(const std::string& tool_id, const core::Vector3& point_m, double radius_m) {
  auto message = boost::make_shared<GridPatch>(toMessage(session_->patch(tool_id, point_m, radius_m)));
  stamp(*message);
  message->next_stamp = stampOf(session_->steps() + patch_every_.steps);
  patch_publisher_.publish(message);
}

boost::shared_ptr<const SimulationCheckpoint> SimulationNode::makeCheckpoint() const {
  auto message = boost::make_shared<SimulationCheckpoint>(toMessage(*session_, session_->checkpoint()));
  stamp(*message);
  return message;
}

void SimulationNode::publishCheckpoint() {
  const auto message = makeCheckpoint();
  checkpoint_publisher_.publish(message);
  keepCheckpoint(message);
}

void SimulationNode::keepCheckpoint(boost::shared_ptr<const SimulationCheckpoint> checkpoint) {
  if (!resume_file_)
    return;
  resume_file_->begin(std::move(checkpoint), paused_);
  const std::string error = resume_file_->takeError();
  if (!error.empty())
    incidents_.report(topics::kResume, error);
}

void SimulationNode::publishClock() {
  rosgraph_msgs::Clock message;
  message.clock = stampNow();
  clock_publisher_.publish(message);
}

ros::Time SimulationNode::stampOf(std::uint64_t step) const {
  const auto epoch_ns = static_cast<std::int64_t>(epoch_.toNSec());
  return ros::Time().fromNSec(
      static_cast<std::uint64_t>(core::lockstepStamp(epoch_ns, session_->simulationTimeAt(step))));
}

ros::Time SimulationNode::stampNow() const {
  return stampOf(session_->steps());
}

template <typename Message>
void SimulationNode::stamp(Message& message) const {
  message.header.stamp = stampNow();
  message.header.frame_id = frame_id_;
}

void SimulationNode::trackExtremes() {
  max_displacement_ever_m_ = std::max(max_displacement_ever_m_, session_->maxDisplacement());
  cut_opening_max_m_ = std::max(cut_opening_max_m_, session_->cutOpening());
}

SimulationStats SimulationNode::makeStats() {
  const Clock::time_point now = Clock::now();
  SimulationStats stats = statsMessage(*session_);
  const double wall_s = std::chrono::duration<double>(now - stats_time_).count();
  const double steps = static_cast<double>(step_ms_.size());
  stats.real_time_factor = wall_s > 0.0 ? steps * stats.dt / wall_s : 0.0;
  if (!step_ms_.empty()) {
    std::nth_element(step_ms_.begin(), step_ms_.begin() + step_ms_.size() / 2, step_ms_.end());
    stats.step_ms_median = step_ms_[step_ms_.size() / 2];
    stats.step_ms_max = *std::max_element(step_ms_.begin(), step_ms_.end());
  }
  stats.active_cells_max = active_cells_max_;
  trackExtremes();
  stats.max_displacement_ever = max_displacement_ever_m_;
  stats.cut_opening_max = cut_opening_max_m_;
  stats.states_published = states_published_;
  stats.inputs_applied = journal_->applied();
  stats.inputs_refused = journal_->refused();
  stats.paused = static_cast<std::uint8_t>(paused_);
  return stats;
}

void SimulationNode::publishStats() {
  SimulationStats stats = makeStats();
  stamp(stats);
  stats_publisher_.publish(stats);
  stats_time_ = Clock::now();
  step_ms_.clear();
  const std::lock_guard<std::mutex> lock(stats_mutex_);
  stats_ = stats;
}

void SimulationNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const std::lock_guard<std::mutex> lock(stats_mutex_);
  status.summary(diagnostic_msgs::DiagnosticStatus::OK, stats_.paused ? "paused" : "running");
  status.add("step", stats_.step);
  if (!resumed_.empty())
    status.add("resumed from", resumed_);
  status.add("real-time factor", stats_.real_time_factor);
  status.add("step time, median [ms]", stats_.step_ms_median);
  status.add("integrator", stats_.integrator);
  status.add("active cells", stats_.active_cells);
  status.add("largest displacement [m]", stats_.max_displacement);
  status.add("estimated error of the active set [m]", stats_.frontier_error);
  status.add("parts of the tissue", stats_.parts);
  status.add("stretches of strokes that cut nothing", stats_.cuts_in_vain);
  status.add("moves shortened by the safe-move rule", stats_.limited_moves);
  status.add("forces cut to what the tissue can carry", stats_.saturated_forces);
  incidents_.addTo(status);
}

}  // namespace soft_volume
