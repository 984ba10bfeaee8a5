#include "soft_volume/ros/haptic_loop.h"

#include <sched.h>
#include <time.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <utility>

namespace soft_volume {
namespace {

constexpr double kFirstBin = 1e-6;  // seconds
constexpr double kBinsPerOctave = 16.0;
constexpr double kPatience = 0.005;     // seconds after which there is a tick without a pose, in simulated time
constexpr double kFresh = 0.02;         // seconds behind simulated time in which a pose is as if new
constexpr double kVelocityLife = 0.02;  // seconds that a measured velocity may be older than its pose
constexpr double kWantedPhase = 0.25;   // of a period, from a pose to its tick
constexpr double kLargestShift = 0.02;  // of a period, per tick
constexpr double kShiftShare = 0.05;    // of what is missing, per tick
constexpr double kLate = 0.5;           // of a period

timespec toTime(double seconds) {
  const double whole = std::floor(seconds);
  return {static_cast<time_t>(whole), static_cast<long>((seconds - whole) * 1e9)};
}

void sleepUntil(double seconds) {
  const timespec time = toTime(seconds);
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) == EINTR) {
  }
}

void waitFor(sem_t& semaphore, double seconds) {
  const timespec time = toTime(HapticLoop::now() + seconds);
  while (sem_clockwait(&semaphore, CLOCK_MONOTONIC, &time) != 0 && errno == EINTR) {
  }
}

}  // namespace

void TimeCounts::add(double seconds) {
  const double bin = kBinsPerOctave * std::log2(std::max(seconds, kFirstBin) / kFirstBin);
  bins_[std::min(kBins - 1, static_cast<std::size_t>(bin))].fetch_add(1, std::memory_order_relaxed);
}

TimeCounts::Counts TimeCounts::counts() const {
  Counts counts{};
  for (std::size_t bin = 0; bin < kBins; ++bin)
    counts[bin] = bins_[bin].load(std::memory_order_relaxed);
  return counts;
}

double TimeCounts::quantile(const Counts& counts, double share) {
  std::uint64_t total = 0;
  for (const std::uint64_t count : counts)
    total += count;
  const double wanted = share * static_cast<double>(total);
  double sum = 0.0;
  for (std::size_t bin = 0; bin < kBins && total > 0; ++bin) {
    sum += static_cast<double>(counts[bin]);
    if (sum >= wanted)
      return kFirstBin * std::exp2(static_cast<double>(bin + 1) / kBinsPerOctave);
  }
  return 0.0;
}

double HapticLoop::now() {
  timespec time{};
  clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

HapticLoop::HapticLoop(Settings settings) : settings_(std::move(settings)) {
  sem_init(&work_, 0, 0);
  sem_init(&published_, 0, 0);
  thread_ = std::thread([this] { run(); });
}

HapticLoop::~HapticLoop() {
  running_ = false;
  sem_post(&work_);
  thread_.join();
  delete new_rig_.load();
  ToolRig* old = nullptr;
  while (old_rigs_.pop(old))
    delete old;
  sem_destroy(&work_);
  sem_destroy(&published_);
}

void HapticLoop::give(std::unique_ptr<ToolRig> rig) {
  delete new_rig_.exchange(rig.release());
  ToolRig* old = nullptr;
  while (old_rigs_.pop(old))
    delete old;
}

void HapticLoop::give(PatchParcel parcel) {
  parcels_.push(std::move(parcel));
}

void HapticLoop::hear(const HeardPose& pose) {
  poses_.push(pose);
  if (settings_.simulated_time)
    sem_post(&work_);
}

void HapticLoop::hear(const core::Vector3& velocity_m_s, double heard_s) {
  velocities_.push({velocity_m_s, heard_s});
}

bool HapticLoop::next(LoopTick& tick, double wait_s) {
  waitFor(published_, wait_s);  // one for every tick
  return ticks_.pop(tick);
}

void HapticLoop::wantRealTime() {
  sched_param parameters{};
  parameters.sched_priority = settings_.priority;
  real_time_ = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters) == 0;
}

void HapticLoop::run() {
  if (settings_.simulated_time) {
    runSimulated();
  } else {
    wantRealTime();
    runLive();
  }
}

void HapticLoop::runLive() {
  const double period_s = 1.0 / settings_.rate_hz;
  next_s_ = now() + period_s;
  double before_s = now();
  while (running_) {
    sleepUntil(next_s_);
    const double start_s = now();
    if (start_s - next_s_ > kLate * period_s)
      ++statistics_.late;
    takeAll();
    if (ready()) {
      statistics_.periods.add(start_s - before_s);
      tick(start_s);
      statistics_.work.add(now() - start_s);
    }
    before_s = start_s;
    next_s_ += period_s + phaseShift(start_s);
    if (next_s_ < now())  // what was missed is not made up for
      next_s_ = now();
  }
}

double HapticLoop::phaseShift(double time_s) const {
  if (!has_pose_)
    return 0.0;
  const double period_s = 1.0 / settings_.rate_hz;
  const double age = (time_s - pose_.heard_s) / period_s;
  const double missing = kWantedPhase - age;
  const double shift = kShiftShare * (missing - std::round(missing));
  return period_s * std::clamp(shift, -kLargestShift, kLargestShift);
}

void HapticLoop::runSimulated() {
  while (running_) {
    waitFor(work_, kPatience);
    takeRig();
    takeReset();
    takePatches();
    bool ticked = false;
    while (takePose()) {
      takePatches();
      takeButtons();
      if (ready())
        tick(input_.time_s);
      ticked = true;
    }
    const double ago_s = now() - pose_.heard_s;
    if (ticked || !ready() || !isSilent(ago_s))
      continue;
    takeButtons();
    tick(simulatedSilenceTime(ago_s));
  }
}

/// A pose that is late by the wall clock alone, because the machine is busy, is none that the device owes.
bool HapticLoop::isSilent(double ago_s) const {
  const double stamp_s = 1e-9 * static_cast<double>(pose_.stamp_ns);
  return ago_s > settings_.wall_timeout_s || (ago_s > kPatience && settings_.simulated_time() - stamp_s > kFresh);
}

double HapticLoop::simulatedPoseTime() const {
  const double stamp_s = 1e-9 * static_cast<double>(pose_.stamp_ns);
  const double now_s = settings_.simulated_time();
  const double time_s = now_s - stamp_s <= kFresh ? stamp_s : now_s;
  const double back_s = input_.time_s - time_s;  // ticks of a silence may have been later
  return back_s > 0.0 && back_s <= kFresh ? input_.time_s : time_s;
}

/// Simulated time stands still when the simulation dies; the motor must not stay on then.
double HapticLoop::simulatedSilenceTime(double silent_s) const {
  const double stamp_s = 1e-9 * static_cast<double>(pose_.stamp_ns);
  return std::max(settings_.simulated_time(), stamp_s) + std::max(0.0, silent_s - settings_.wall_timeout_s);
}

void HapticLoop::takeAll() {
  takeRig();
  takeReset();
  takePatches();
  takeButtons();
  while (takePose()) {
  }
}

void HapticLoop::takeRig() {
  if (new_rig_.load(std::memory_order_relaxed) == nullptr)
    return;
  ToolRig* rig = new_rig_.exchange(nullptr);
  if (rig == nullptr)
    return;
  const bool tripped = rig_ && !rig_->tools.empty() && tool().tripped();
  ToolRig* old = rig_.release();
  if (old != nullptr && !old_rigs_.push(old))
    delete old;  // only if nobody has taken any back for eight scenes
  rig_.reset(rig);
  selected_ = 0;
  has_pose_ = false;  // the last one was mapped by the old rig
  if (tripped && !rig_->tools.empty())
    tool().trip();
}

void HapticLoop::takePatches() {
  PatchParcel parcel;
  while (parcels_.pop(parcel)) {
    if (rig_ && parcel.generation == rig_->generation)
      parcel.patch = rig_->tools[parcel.tool]->takePatch(std::move(parcel.patch));
    if (parcel.patch)
      returned_.push(std::move(parcel));
  }
}

void HapticLoop::takeReset() {
  const std::uint64_t asked = resets_asked_.load();
  if (asked == resets_done_)
    return;
  resets_done_ = asked;
  if (rig_ && !rig_->tools.empty())
    putDown(tool().reset());
}

void HapticLoop::takeButtons() {
  const core::Buttons before = input_.buttons;
  input_.buttons = settings_.buttons();
  if (rig_ && input_.buttons[rig_->swap_button] && !before[rig_->swap_button])
    swapTool();
}

/// The tool that is put down lets go of the tissue: reset() ends its contact, and the simulation lets its last force
/// expire. A trip is the device's, and stays in the hand.
void HapticLoop::swapTool() {
  if (rig_->tools.size() < 2 || tool().tripped())
    return;
  putDown(tool().reset());
  selected_ = (selected_ + 1) % rig_->tools.size();
  tool().reset();
  ++statistics_.swaps;
}

bool HapticLoop::takePose() {
  HeardVelocity velocity;
  while (velocities_.pop(velocity))
    velocity_ = velocity;
  if (!poses_.pop(pose_))
    return false;
  has_pose_ = true;
  std::optional<core::Vector3> speed;
  if (pose_.heard_s - velocity_.heard_s < kVelocityLife || settings_.simulated_time)
    speed = velocity_.velocity_m_s;
  if (velocity_.heard_s == 0.0)
    speed.reset();
  input_.pose_stamp_s = 1e-9 * static_cast<double>(pose_.stamp_ns);
  input_.pose = pose_.pose;
  input_.velocity_m_s = speed;
  if (rig_) {
    const core::WorkspaceMapping::Tip tip = rig_->mapping.toVolume(pose_.pose, speed, input_.buttons);
    input_.pose = tip.pose;
    input_.velocity_m_s = tip.velocity_m_s;
    engaged_ = tip.engaged;
  }
  if (settings_.simulated_time) {
    input_.pose_time_s = 1e-9 * static_cast<double>(pose_.stamp_ns);
    input_.time_s = simulatedPoseTime();
  } else {
    input_.pose_time_s = pose_.heard_s;
    input_.pose_delay_s = pose_.delay_s;
  }
  return true;
}

void HapticLoop::tick(double time_s) {
  input_.time_s = time_s;
  input_.forces_allowed = engaged_ && settings_.forces_allowed();
  LoopTick tick;
  tick.output = tool().update(input_);
  tick.generation = rig_->generation;
  tick.tool = selected_;
  tick.stamp_ns = pose_.stamp_ns;
  tick.tip = input_.pose;
  tick.buttons = input_.buttons;
  tick.servo_n = rig_->mapping.forceToDevice(tick.output.device_force_n);
  count(tick.output);
  publish(tick);
}

void HapticLoop::count(const core::ToolOutput& output) {
  ++statistics_.ticks;
  if (output.fault != fault_)
    ++statistics_.faults[static_cast<std::size_t>(output.fault)];
  fault_ = output.fault;
}

void HapticLoop::putDown(std::optional<core::TissueCut> cut) {
  if (!cut)
    return;
  LoopTick tick;
  tick.generation = rig_->generation;
  tick.tool = selected_;
  tick.put_down = true;
  tick.stamp_ns = pose_.stamp_ns;
  tick.output.cut = cut;
  publish(tick);
}

void HapticLoop::publish(const LoopTick& tick) {
  if (ticks_.push(tick))
    sem_post(&published_);
  else
    ++statistics_.lost;
}

}  // namespace soft_volume
