#include "soft_volume/ros/simulation_node.h"

#include <ros/console.h>
#include <ros/init.h>
#include <soft_volume/PartRemoval.h>
#include <soft_volume/SimulationControl.h>
#include <std_srvs/SetBool.h>
#include <std_srvs/Trigger.h>

#include <algorithm>
#include <chrono>
#include <utility>

#include "soft_volume/messages/conversions.h"
#include "soft_volume/messages/topics.h"
#include "soft_volume/ros/checked_subscription.h"
#include "soft_volume/ros/parameters.h"
#include "soft_volume/ros/run_node.h"

namespace soft_volume {
namespace {

/// A tool that said nothing for this long gets no patches.
constexpr double kToolSilence_s = 0.5;
/// With simulated time the simulation runs at most this far ahead of the tools, well below the age at which a tool
/// takes a pose for stale.
constexpr double kToolLead_s = 0.01;
/// Messages that may wait in lockstep, where none may be lost.
constexpr std::uint32_t kLockstepQueue = 100000;
/// A clock that jumps back by more was started anew.
constexpr double kClockJump_s = 0.1;

/// Never 0 and new for every session on this machine.
std::uint64_t newSessionId() {
  return ros::WallTime::now().toNSec();
}

}  // namespace

SimulationNode::SimulationNode(const ros::NodeHandle& node, const ros::NodeHandle& private_node)
    : node_(node), private_node_(private_node), inbox_(scene_, incidents_), diagnostics_(node, private_node) {
  const auto scene_file = requiredParameter<std::string>(private_node_, "scene", "the scene file (YAML) to simulate");
  threads_ = parameter<int>(private_node_, "threads", 1, 1, 256);
  real_time_factor_ = parameter<double>(private_node_, "real_time_factor", 1.0, 0.0, 1000.0);
  stop_after_s_ = parameter<double>(private_node_, "stop_after_s", 0.0, 0.0, 1e9);
  publish_clock_ = parameter<bool>(private_node_, "publish_clock", false);
  run_.paused = parameter<bool>(private_node_, "start_paused", false);
  run_.frame_id = parameter<std::string>(private_node_, "frame_id", "volume");

  lockstep_ = parameter<bool>(private_node_, "lockstep", false);
  lockstep_tools_ = parameter<int>(private_node_, "lockstep_tools", 1, 1, 64);
  lockstep_timeout_s_ = parameter<double>(private_node_, "lockstep_timeout_s", 5.0, 0.1, 3600.0);
  if (lockstep_ && publish_clock_)
    throw core::InputError(
        "lockstep and publish_clock: in lockstep time comes from the device's samples; set one only");
  follow_clock_ = !lockstep_ && !publish_clock_ && real_time_factor_ > 0.0 && !ros::Time::useSystemTime();

  scene_ = core::loadScene(scene_file);
  volumes_ = core::readVolumes(scene_);
  run_.epoch = publish_clock_ ? ros::Time(1.0) : ros::Time::now();
  const auto resume_file = parameter<std::string>(private_node_, "resume_file", "");
  if (!resume_file.empty())
    resume_file_ = std::make_unique<ResumeFile>(resume_file);
  makePublisher();
  publisher_->waitForListeners();
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
  inbox_.stop();
  thread_.join();
  // A nodelet is also destroyed when its loader was killed: then another one goes on.
  if (resume_file_ && (stopRequested() != 0 || !ros::ok()))
    resume_file_->remove();
}

void SimulationNode::makePublisher() {
  SessionPublisher::Settings settings;
  settings.output = scene_.output;
  settings.clock = publish_clock_;
  if (lockstep_)
    settings.patch_queue = kLockstepQueue;
  settings.resume_file = resume_file_.get();
  settings.post = [this](std::function<void()> work) { inbox_.post(std::move(work)); };
  publisher_ = std::make_unique<SessionPublisher>(node_, std::move(settings), run_, incidents_);
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
    refuseKeptRun(error);
  }
  return std::nullopt;
}

void SimulationNode::refuseKeptRun(const core::Error& error) {
  incidents_.report(topics::kResume, std::string(error.what()) + ": the kept run cannot go on and starts from rest (" +
                                         resume_file_->setAside() + " is what was kept)");
}

void SimulationNode::startOrResume() {
  const std::optional<ResumedRun> run = keptRun();
  const bool paused = run_.paused;
  const ros::Time epoch = run_.epoch;
  if (run) {
    try {
      return goOn(*run);
    } catch (const core::Error& error) {
      refuseKeptRun(error);
    }
  }
  run_.paused = paused;
  run_.epoch = epoch;
  resumed_.clear();
  startSession(nullptr);
}

void SimulationNode::goOn(const ResumedRun& run) {
  run_.paused = run.paused;
  // The clock that others saw last is at most a journal's interval later than the journal.
  const double earlier_s =
      run.simulation_time_s - (publish_clock_ ? SessionPublisher::kJournalInterval_s + run.checkpoint.dt : 0.0);
  const ros::Time now = publish_clock_ ? run.checkpoint.header.stamp : ros::Time::now();
  run_.epoch = ros::Time(std::max(0.0, (now - ros::Time(0.0)).toSec() - earlier_s));
  resumed_ = "session " + std::to_string(run.checkpoint.session) + ", step " + std::to_string(run.checkpoint.step);
  startSession(&run.checkpoint, "goes on from " + resumed_ + ", where a simulation ended without being stopped; " +
                                    std::to_string(run.steps_repeated) + " steps were repeated");
  ROS_WARN("the simulation goes on from %s, where another one ended without being stopped", resumed_.c_str());
}

template <typename Service>
void SimulationNode::serve(const std::string& name, void (SimulationNode::*work)(const typename Service::Request&,
                                                                                 typename Service::Response&)) {
  using Request = typename Service::Request;
  using Response = typename Service::Response;
  services_.push_back(
      node_.advertiseService<Request, Response>(name, [this, work](Request& request, Response& response) {
        inbox_.inLoop([&] { (this->*work)(request, response); });
        return true;
      }));
}

void SimulationNode::advertiseServices() {
  using Trigger = std_srvs::Trigger;
  services_.push_back(node_.advertiseService<Trigger::Request, Trigger::Response>(
      topics::kReset, [this](Trigger::Request&, Trigger::Response& response) {
        response.success = inbox_.inLoop([this] { startSession(nullptr); });
        response.message = "a new session starts from rest";
        return true;
      }));
  services_.push_back(node_.advertiseService<std_srvs::SetBool::Request, std_srvs::SetBool::Response>(
      topics::kPause, [this](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) {
        const bool pause = request.data != 0;
        response.success = inbox_.inLoop([this, pause] { setPaused(pause); });
        response.message = pause ? "paused" : "running";
        return true;
      }));
  services_.push_back(node_.advertiseService<Trigger::Request, Trigger::Response>(
      topics::kRequestKeyFrame, [this](Trigger::Request&, Trigger::Response& response) {
        response.success = inbox_.inLoop([this] {
          publisher_->sendFullTopology();
          publisher_->publishState(true);
        });
        response.message = "a key frame was published";
        return true;
      }));
  services_.push_back(node_.advertiseService<StepSimulation::Request, StepSimulation::Response>(
      topics::kStep, [this](StepSimulation::Request& request, StepSimulation::Response& response) {
        response.success = 0;
        response.message = "the simulation runs: pause it first (" + std::string(topics::kPause) + ")";
        if (request.steps < 1 || request.steps > 1000000) {
          response.message = "steps must be within [1, 1000000]";
          return true;
        }
        inbox_.inLoop([this, &request, &response] { step(request, response); });
        return true;
      }));
  serve<SetIntegrator>(topics::kSetIntegrator, &SimulationNode::setIntegrator);
  serve<RemovePart>(topics::kRemovePart, &SimulationNode::removePart);
  services_.push_back(node_.advertiseService<SaveCheckpoint::Request, SaveCheckpoint::Response>(
      topics::kSaveCheckpoint, [this](SaveCheckpoint::Request&, SaveCheckpoint::Response& response) {
        response.success =
            inbox_.inLoop([this, &response] { response.checkpoint = publisher_->publishAskedCheckpoint(); });
        return true;
      }));
  serve<RestoreCheckpoint>(topics::kRestoreCheckpoint, &SimulationNode::restore);
}

void SimulationNode::subscribe() {
  const std::uint32_t queue = lockstep_ ? kLockstepQueue : 1000;
  subscribers_ = {
      subscribeChecked<ToolForce>(
          node_, topics::kToolForce, queue, [this](const ToolForce::ConstPtr& m) { inbox_.queueInput(m); }, incidents_),
      subscribeChecked<ToolCut>(
          node_, topics::kToolCut, queue, [this](const ToolCut::ConstPtr& m) { inbox_.queueInput(m); }, incidents_),
      subscribeChecked<ToolGrip>(
          node_, topics::kToolGrip, queue, [this](const ToolGrip::ConstPtr& m) { inbox_.queueInput(m); }, incidents_),
      subscribeChecked<ToolState>(
          node_, topics::kToolState, 100, [this](const ToolState::ConstPtr& m) { inbox_.hearTool(*m); }, incidents_)};
  if (lockstep_) {
    subscribers_.push_back(subscribeChecked<ToolProgress>(
        node_, topics::kToolProgress, queue, [this](const ToolProgress::ConstPtr& m) { inbox_.hearProgress(*m); },
        incidents_));
  }
}

void SimulationNode::run() {
  pacer_.begin();
  publisher_->beginStats();
  while (inbox_.running() && ros::ok()) {
    inbox_.runPosted(run_.paused);
    if (!run_.paused) {
      if (readyForStep()) {
        applyInputs();
        advance();
      }
    } else if (publisher_->keyFrameWanted() && run_.begun) {
      publisher_->publishState(true);  // somebody joined, and no step will bring a state
    }
    publisher_->publishDueStats();
    if (stop_after_s_ > 0.0 && run_.session->simulationTime() >= stop_after_s_)
      return complete();
  }
}

void SimulationNode::complete() {
  publisher_->publishState(true);
  publisher_->publishJournal();
  publisher_->publishStats();
  ROS_INFO("%.3f s were simulated: the run is complete", run_.session->simulationTime());
  // Subscribers have to read the last messages before the connections close.
  ros::WallDuration(0.5).sleep();
  ros::requestShutdown();
}

/// Waits for the time of the next step; false when something else is to be seen to first.
bool SimulationNode::readyForStep() {
  if (!run_.begun && !waitForStart())
    return false;
  if (inbox_.inLockstep())
    return readyInLockstep();
  if (follow_clock_)
    return waitForClock();
  pacer_.wait(run_.session->timeStep(), real_time_factor_);
  // A slow machine slows the simulation down instead of starving the hand.
  if (publish_clock_)
    inbox_.waitForTools(run_.stampNow() - ros::Duration(kToolLead_s));
  return true;
}

/// What a session begins with needs its time zero: of the first sample, or of the clock.
bool SimulationNode::waitForStart() {
  if (inbox_.inLockstep()) {
    const std::optional<std::int64_t> epoch_ns = inbox_.waitForEpoch();
    if (epoch_ns)
      beginAt(ros::Time().fromNSec(static_cast<std::uint64_t>(*epoch_ns)));
  } else if (ros::Time::now().isZero()) {
    std::this_thread::sleep_for(SimulationInbox::kPatience);
  } else {
    beginAt(ros::Time::now());
  }
  return run_.begun;
}

void SimulationNode::beginAt(const ros::Time& now) {
  run_.epoch = now - ros::Duration(run_.session->simulationTime());
  run_.begun = true;
  publisher_->publishBeginning();
}

/// Steps of a clock that somebody else drives: it may stand still, and begin anew.
bool SimulationNode::waitForClock() {
  const ros::Time due = run_.stampNow() + ros::Duration(run_.session->timeStep());
  const ros::Time now = ros::Time::now();
  if (now >= due)
    return true;
  if ((due - now).toSec() > kClockJump_s)
    run_.epoch = now - ros::Duration(run_.session->simulationTime());
  std::this_thread::sleep_for(std::chrono::microseconds(200));
  return false;
}

bool SimulationNode::readyInLockstep() {
  const SimulationInbox::Readiness hands = inbox_.waitForHands(run_.now_ns(), lockstep_timeout_s_);
  if (!hands.end_reason.empty())
    leaveLockstep(hands.end_reason);
  return hands.complete;
}

void SimulationNode::leaveLockstep(const std::string& reason) {
  inbox_.endLockstep();
  pacer_.begin();
  incidents_.report(topics::kLockstep, reason + ": the run goes on out of lockstep until the next session");
  run_.journal->note(topics::kLockstep, "std_msgs/Empty", {}, "left: " + reason);
}

void SimulationNode::publishLockstepPatches() {
  for (const core::ToolNotice& notice : inbox_.noticesAt(run_.now_ns()))
    publisher_->publishPatch(notice.tool_id, notice.point_m, notice.patch_radius_m);
}

void SimulationNode::applyInputs() {
  for (const SimulationInput& input : inbox_.takeInputs(run_.now_ns(), run_.session->steps() + 1))
    applyInput(input);
}

void SimulationNode::applyInput(const SimulationInput& input) {
  std::visit(
      [this](const auto& message) {
        const JournalEntry& entry = run_.journal->apply(*message);
        if (entry.outcome == JournalEntry::REFUSED)
          incidents_.report(entry.topic, entry.reason);
      },
      input);
  publisher_->publishChangedTopology();
}

void SimulationNode::advance() {
  // In lockstep patches follow the inputs of their time; otherwise they go as early as they can.
  if (inbox_.inLockstep() && publisher_->patchDue())
    publishLockstepPatches();
  const auto start = std::chrono::steady_clock::now();
  run_.session->step();
  publisher_->countStep(std::chrono::steady_clock::now() - start);
  publisher_->publishDueClock();
  if (!inbox_.inLockstep() && publisher_->patchDue())
    publishPatches();
  publisher_->publishDue();
}

void SimulationNode::step(const StepSimulation::Request& request, StepSimulation::Response& response) {
  if (!run_.paused)
    return;
  for (std::uint32_t n = 0; n < request.steps && inbox_.running(); ++n) {
    applyInputs();
    advance();
  }
  publisher_->publishState(false);
  publisher_->publishJournal();
  response.success = 1;
  response.message = "";
  response.step = run_.session->steps();
}

void SimulationNode::restore(const RestoreCheckpoint::Request& request, RestoreCheckpoint::Response& response) {
  try {
    startSession(&request.checkpoint);
    response.success = 1;
    response.message = "a new session continues from step " + std::to_string(run_.session->steps());
  } catch (const core::Error& error) {
    response.success = 0;
    response.message = error.what();
    incidents_.report(topics::kRestoreCheckpoint, error.what());
  }
}

void SimulationNode::setPaused(bool paused) {
  run_.paused = paused;
  pacer_.begin();
  run_.journal->note(topics::kPause, "std_srvs/SetBool", {static_cast<std::uint8_t>(paused)});
  if (resume_file_)
    resume_file_->setPaused(paused);
}

void SimulationNode::setIntegrator(const SetIntegrator::Request& request, SetIntegrator::Response& response) {
  SimulationControl control;
  run_.stamp(control);
  control.session = run_.session->id();
  control.revision = run_.session->lattice().revision;
  control.step = run_.session->steps();
  control.integrator = request.integrator;
  control.dt = request.dt;
  const JournalEntry& entry = run_.journal->apply(control);
  response.success = static_cast<std::uint8_t>(entry.outcome == JournalEntry::APPLIED);
  response.message = entry.reason;
  response.dt = run_.session->timeStep();
  publisher_->setRates();
  publisher_->publishStats();
}

void SimulationNode::removePart(const RemovePart::Request& request, RemovePart::Response& response) {
  PartRemoval removal;
  run_.stamp(removal);
  removal.session = run_.session->id();
  removal.revision = run_.session->lattice().revision;
  removal.step = run_.session->steps();
  removal.cell = request.cell;
  const JournalEntry& entry = run_.journal->apply(removal);
  response.success = static_cast<std::uint8_t>(entry.outcome == JournalEntry::APPLIED);
  response.message = entry.reason;
  if (response.success != 0)
    publisher_->publishTopology(true);
  publisher_->publishStats();
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
  if (run_.session) {
    publisher_->publishJournal();                                            // what the old session still has to say
    run_.epoch = run_.stampNow() + ros::Duration(run_.session->timeStep());  // no two states with one stamp
    if (checkpoint != nullptr)
      run_.epoch -= ros::Duration(session->simulationTime());
  }
  run_.session = std::move(session);
  run_.journal = std::move(journal);
  startLockstep();
  inbox_.forgetLaterInputs();
  publisher_->beginSession();
  publisher_->publishSession();
}

/// Every session begins in it, where it is wanted.
void SimulationNode::startLockstep() {
  run_.begun = !lockstep_ && (run_.begun || !(follow_clock_ && ros::Time::now().isZero()));
  if (lockstep_)
    inbox_.beginLockstep(run_.session->id(), static_cast<std::size_t>(lockstep_tools_));
}

void SimulationNode::publishPatches() {
  for (const auto& [tool_id, request] : inbox_.patchRequests()) {
    if ((ros::WallTime::now() - request.heard).toSec() <= kToolSilence_s)
      publisher_->publishPatch(tool_id, request.point_m, request.radius_m);
  }
}

void SimulationNode::diagnose(diagnostic_updater::DiagnosticStatusWrapper& status) {
  const SimulationStats stats = publisher_->lastStats();
  status.summary(diagnostic_msgs::DiagnosticStatus::OK, stats.paused ? "paused" : "running");
  status.add("step", stats.step);
  if (!resumed_.empty())
    status.add("resumed from", resumed_);
  status.add("real-time factor", stats.real_time_factor);
  status.add("step time, median [ms]", stats.step_ms_median);
  status.add("integrator", stats.integrator);
  status.add("active cells", stats.active_cells);
  status.add("largest displacement [m]", stats.max_displacement);
  status.add("estimated error of the active set [m]", stats.frontier_error);
  status.add("parts of the tissue", stats.parts);
  status.add("stretches of strokes that cut nothing", stats.cuts_in_vain);
  status.add("moves shortened by the safe-move rule", stats.limited_moves);
  status.add("forces cut to what the tissue can carry", stats.saturated_forces);
  incidents_.addTo(status);
}

}  // namespace soft_volume
