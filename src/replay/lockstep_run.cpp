#include "lockstep_run.h"

#include <geometry_msgs/WrenchStamped.h>
#include <soft_volume/SimulationJournal.h>
#include <time.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numeric>
#include <type_traits>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/messages/topics.h"

namespace soft_volume {
namespace {

constexpr double kJournalInterval_s = 0.02;
constexpr double kStatsInterval_s = 0.1;
/// Stamps that went through seconds in doubles and back.
constexpr std::int64_t kRounding_ns = 2000;

ros::Time rosTime(std::int64_t stamp_ns) {
  return ros::Time().fromNSec(static_cast<std::uint64_t>(stamp_ns));
}

/// Of this thread: what other programs take does not count.
double processorTime() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

float median(std::vector<float> values) {
  if (values.empty())
    return 0.0F;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

float largest(const std::vector<float>& values) {
  return values.empty() ? 0.0F : *std::max_element(values.begin(), values.end());
}

}  // namespace

LockstepRun::LockstepRun(LockstepPlan plan, Publish publish)
    : plan_(std::move(plan)),
      publish_(std::move(publish)),
      session_(plan_.scene, plan_.volume.volume, plan_.volume.labels, plan_.session, plan_.threads),
      journal_(session_),
      epoch_ns_(plan_.epoch_ns) {
  if (plan_.start) {
    const JournalEntry& entry = journal_.apply(*plan_.start);
    if (entry.outcome != JournalEntry::APPLIED)
      throw core::InputError(entry.reason);
  }
  journaled_step_ = session_.steps();
  setRates();
  if (plan_.samples.empty())
    return;
  // As every receiver has it, from the message: with the time step resolved.
  hand_.emplace("hand", session_.scene(), plan_.profile ? &*plan_.profile : nullptr, plan_.rate_hz, session_.id(),
                session_.volume());
}

LockstepRun::Every LockstepRun::every(double interval_s) const {
  return {static_cast<std::uint64_t>(std::max(1.0, std::round(interval_s / session_.timeStep())))};
}

void LockstepRun::setRates() {
  const core::SimulationOutput& output = session_.scene().output;
  state_every_ = every(1.0 / output.state_rate_hz);
  patch_every_ = every(1.0 / output.patch_rate_hz);
  key_frame_every_ = every(output.key_frame_interval_s);
  checkpoint_every_ = every(output.checkpoint_interval_s);
  journal_every_ = every(kJournalInterval_s);
  stats_every_ = every(kStatsInterval_s);
}

std::int64_t LockstepRun::stampOf(std::uint64_t step) const {
  return core::lockstepStamp(epoch_ns_, session_.simulationTimeAt(step));
}

template <typename Message>
void LockstepRun::publishAt(std::int64_t stamp_ns, const std::string& topic, const Message& message, bool latched) {
  publish_(plan_.prefix + topic, rosTime(stamp_ns), anyMessage(message), latched);
}

template <typename Message>
void LockstepRun::publish(const char* topic, Message message, bool latched) {
  message.header.stamp = rosTime(stampNow());
  message.header.frame_id = plan_.frame_id;
  publishAt(stampNow(), topic, message, latched);
}

void LockstepRun::run(const Progress& progress) {
  const double total = static_cast<double>(plan_.samples.size());
  if (!hand_) {
    begin();
    const std::int64_t begin_ns = stampNow();
    const auto span = static_cast<double>(std::max<std::int64_t>(1, plan_.end_ns - begin_ns));
    while (!ended()) {
      advance();
      progress(static_cast<double>(stampNow() - begin_ns), span);
    }
  }
  for (const core::DeviceSample& sample : plan_.samples) {
    useSample(sample);
    progress(static_cast<double>(++counts_.samples), total);
  }
  if (hand_) {
    while (gate_.complete(stampNow()))
      advance();
  }
  publishJournal();
  publishStats();
  counts_.step_ms_median = median(all_step_ms_);
  counts_.step_ms_max = largest(all_step_ms_);
}

void LockstepRun::begin() {
  if (!plan_.start && gate_.epoch())
    epoch_ns_ = *gate_.epoch();
  publish(topics::kScene, sceneMessage(session_), true);
  publish(topics::kVolume, toMessage(session_), true);
  publishTopology(true);
  publishJournal();
  publishState(true);
  publishCheckpoint();
}

void LockstepRun::useSample(const core::DeviceSample& sample) {
  const bool first = !gate_.epoch();
  gate_.hear(hand_->take(sample), session_.id());
  if (first)
    begin();
  // What is not complete has to wait for later samples, and so would the patch: a run that starts in the middle.
  while (!hand_->ready() && gate_.complete(stampNow()))
    advance();
  for (const core::HandTick& tick : hand_->tick())
    send(tick);
}

void LockstepRun::send(const core::HandTick& tick) {
  const core::ToolConfig& config = hand_->config(tick.tool);
  std_msgs::Header header;
  header.stamp = rosTime(tick.stamp_ns);
  header.frame_id = plan_.frame_id;
  using Kind = core::LockstepInputs<Input>::Kind;
  if (tick.output.cut) {
    ToolCut cut = toMessage(core::toCommand(config.id, *tick.output.cut));
    cut.header = header;
    publishAt(tick.stamp_ns, topics::kToolCut, cut);
    gate_.countCut(config.id, cut.sequence);
    inputs_.add(tick.stamp_ns, config.id, Kind::kCut, cut.sequence, [this, cut] { applyMessage(cut); });
  }
  if (tick.put_down)
    return;
  geometry_msgs::WrenchStamped servo;
  servo.header = header;
  servo.header.frame_id = plan_.device_frame_id;
  servo.wrench.force = toVector(tick.servo_n);
  publishAt(tick.stamp_ns, plan_.profile ? plan_.profile->topics.servo_cf : topics::kServoForce, servo);
  if (tick.output.force) {
    ToolForce force = toMessage(core::toCommand(config.id, *tick.output.force));
    force.header = header;
    publishAt(tick.stamp_ns, topics::kToolForce, force);
    gate_.countForce(config.id, force.sequence);
    inputs_.add(tick.stamp_ns, config.id, Kind::kForce, force.sequence, [this, force] { applyMessage(force); });
  }
  ToolState state = toMessage(tick, config);
  state.header = header;
  state.sequence = ++state_sequence_;
  publishAt(tick.stamp_ns, topics::kToolState, state);
}

void LockstepRun::count(const JournalEntry& entry) {
  ++(entry.outcome == JournalEntry::REFUSED ? counts_.inputs_refused : counts_.inputs_applied);
  if (entry.outcome == JournalEntry::REFUSED && counts_.first_refusal.empty())
    counts_.first_refusal = entry.topic + ": " + entry.reason;
  if (session_.lattice().revision != published_revision_)
    publishTopology(false);
}

template <typename Message>
void LockstepRun::applyMessage(const Message& message) {
  count(journal_.apply(message));
}

void LockstepRun::applyInputs(std::int64_t time_ns) {
  applyEntries(time_ns);
  for (const Input& input : inputs_.take(time_ns))
    input();
}

bool LockstepRun::ended() const {
  return plan_.entries_by_step ? session_.steps() >= plan_.end_step : stampNow() >= plan_.end_ns;
}

bool LockstepRun::isDue(const TimedEntry& entry, std::int64_t time_ns) const {
  return plan_.entries_by_step ? entry.entry.step <= session_.steps() : entry.stamp_ns <= time_ns + kRounding_ns;
}

void LockstepRun::applyEntries(std::int64_t time_ns) {
  for (; next_entry_ < plan_.entries.size() && isDue(plan_.entries[next_entry_], time_ns); ++next_entry_)
    applyEntry(plan_.entries[next_entry_].entry);
}

/// As it was, but of no run, so that nothing that was not usable then is usable here.
template <typename Message>
void LockstepRun::applyRefused(const JournalEntry& entry) {
  if (counts_.first_refusal.empty())
    counts_.first_refusal = entry.topic + ": " + entry.reason;
  auto message = fromPayload<Message>(entry.payload);
  message.session = 0;
  if constexpr (!std::is_same_v<Message, PartRemoval>)
    publishAt(stampNow(), entry.topic, message);
  applyMessage(message);
}

/// For this session and the grid as it is now. Cells of another grid mean nothing here.
template <typename Message>
void LockstepRun::applyAdapted(const JournalEntry& entry) {
  if (entry.outcome == JournalEntry::REFUSED)
    return applyRefused<Message>(entry);
  auto message = fromPayload<Message>(entry.payload);
  message.header.stamp = rosTime(stampNow());
  message.session = session_.id();
  message.revision = session_.lattice().revision;
  message.step = session_.steps();
  if constexpr (std::is_same_v<Message, ToolForce>) {
    if (!plan_.same_grid || message.revision != fromPayload<Message>(entry.payload).revision)
      message.cells.clear();
  }
  if constexpr (!std::is_same_v<Message, SimulationControl> && !std::is_same_v<Message, PartRemoval>) {
    message.apply_at_step = 0;
    publishAt(stampNow(), entry.topic, message);
  }
  applyMessage(message);
}

void LockstepRun::applyEntry(const JournalEntry& entry) {
  // A change of the integrator is not asked for its session, so it would not be refused for that.
  const bool only_noted = entry.topic == topics::kSetIntegrator && entry.outcome == JournalEntry::REFUSED;
  if (entry.outcome == JournalEntry::NOTED || only_noted)
    journal_.note(entry.topic, entry.type, entry.payload, entry.reason);
  else if (entry.topic == topics::kToolForce)
    applyAdapted<ToolForce>(entry);
  else if (entry.topic == topics::kToolCut)
    applyAdapted<ToolCut>(entry);
  else if (entry.topic == topics::kToolGrip)
    applyAdapted<ToolGrip>(entry);
  else if (entry.topic == topics::kRemovePart)
    applyAdapted<PartRemoval>(entry);
  else if (entry.topic == topics::kSetIntegrator)
    applyAdapted<SimulationControl>(entry);
  if (entry.topic == topics::kSetIntegrator)
    setRates();
}

void LockstepRun::makePatches(std::int64_t time_ns) {
  if (!hand_)
    return;
  const std::int64_t next_ns = stampOf(session_.steps() + patch_every_.steps);
  for (const core::ToolNotice& notice : gate_.noticesAt(time_ns))
    hand_->addPatch(session_.patch(notice.tool_id, notice.point_m, notice.patch_radius_m), time_ns, next_ns);
}

void LockstepRun::advance() {
  const std::int64_t time_ns = stampNow();
  applyInputs(time_ns);
  if (patch_every_.due(session_.steps()))
    makePatches(time_ns);
  const auto begin = std::chrono::steady_clock::now();
  const double processor_begin_s = processorTime();
  session_.step();
  counts_.processor_s += processorTime() - processor_begin_s;
  const double spent_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  counts_.stepping_s += spent_s;
  step_ms_.push_back(static_cast<float>(1e3 * spent_s));
  all_step_ms_.push_back(step_ms_.back());
  active_cells_max_ = std::max(active_cells_max_, static_cast<std::uint32_t>(session_.simulation().activeCells()));
  ++counts_.steps;
  counts_.simulated_s += session_.timeStep();
  publishStep();
}

/// The steps before and after a wanted time, or the one that falls on it.
bool LockstepRun::stateIsDue() {
  const std::uint64_t step = session_.steps();
  if (plan_.states_ns.empty())
    return state_every_.due(step);
  while (next_state_ < plan_.states_ns.size() && plan_.states_ns[next_state_] <= stampOf(step - 1) + kRounding_ns)
    ++next_state_;
  return next_state_ < plan_.states_ns.size() && plan_.states_ns[next_state_] < stampOf(step + 1) - kRounding_ns;
}

void LockstepRun::publishStep() {
  const std::uint64_t step = session_.steps();
  if (journal_every_.due(step) || checkpoint_every_.due(step))
    publishJournal();
  const bool key_frame = key_frame_every_.due(step);
  if (key_frame && topologies_.lastWasDelta())
    publishTopology(true);
  if (stateIsDue() || key_frame)
    publishState(key_frame);
  if (checkpoint_every_.due(step))
    publishCheckpoint();
  if (stats_every_.due(step))
    publishStats();
}

void LockstepRun::publishTopology(bool full) {
  const GridTopology message = topologies_.encode(session_, full);
  if (hand_ && message.revision != published_revision_)
    hand_->addTopology(std::make_shared<core::Topology>(session_.topology()));
  published_revision_ = message.revision;
  publish(topics::kTopology, message, true);
  key_frame_wanted_ = true;
}

void LockstepRun::publishState(bool key_frame) {
  core::GridStateFrame frame;
  frame.session = session_.id();
  frame.revision = session_.lattice().revision;
  frame.step = session_.steps();
  frame.simulation_time_s = session_.simulationTime();
  frame.state_hash = session_.simulation().stateHash();
  encoder_.encode(session_.drawnPositions(), std::exchange(key_frame_wanted_, false) || key_frame, frame);
  publish(topics::kState, toMessage(frame));
  ++states_published_;
  max_displacement_ever_m_ = std::max(max_displacement_ever_m_, session_.maxDisplacement());
  cut_opening_max_m_ = std::max(cut_opening_max_m_, session_.cutOpening());
}

void LockstepRun::publishJournal() {
  SimulationJournal message;
  message.session = session_.id();
  message.revision = session_.lattice().revision;
  message.step = message.last_step = session_.steps();
  message.first_step = journaled_step_;
  message.entries = journal_.take();
  message.state_hash = session_.simulation().stateHash();
  publish(topics::kJournal, message);
  journaled_step_ = message.last_step;
}

void LockstepRun::publishCheckpoint() {
  publish(topics::kCheckpoint, toMessage(session_, session_.checkpoint()), true);
}

void LockstepRun::publishStats() {
  SimulationStats stats = statsMessage(session_);
  const double spent_s = 1e-3 * std::accumulate(step_ms_.begin(), step_ms_.end(), 0.0);
  stats.real_time_factor = spent_s > 0.0 ? static_cast<double>(step_ms_.size()) * stats.dt / spent_s : 0.0;
  stats.step_ms_median = median(step_ms_);
  stats.step_ms_max = largest(step_ms_);
  stats.active_cells_max = active_cells_max_;
  stats.max_displacement_ever = max_displacement_ever_m_ = std::max(max_displacement_ever_m_, stats.max_displacement);
  stats.cut_opening_max = cut_opening_max_m_ = std::max(cut_opening_max_m_, stats.cut_opening);
  stats.states_published = states_published_;
  stats.inputs_applied = journal_.applied();
  stats.inputs_refused = journal_.refused();
  publish(topics::kSimulationStats, stats);
  step_ms_.clear();
}

}  // namespace soft_volume
