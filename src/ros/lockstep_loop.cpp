#include "soft_volume/ros/lockstep_loop.h"

#include <chrono>
#include <utility>

#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

/// A topic that stays behind the poses for this long is sent on change only.
constexpr std::chrono::milliseconds kSparseTime(250);
constexpr double kFadeStep_s = 0.001;
constexpr int kFadeTicks = 1000;
/// Minutes at 1 kHz; a device that is so far ahead will not be caught up with.
constexpr std::size_t kMostWaiting = 200000;

std::chrono::duration<double> seconds(double s) {
  return std::chrono::duration<double>(s);
}

}  // namespace

LockstepLoop::LockstepLoop(Settings settings)
    : settings_(std::move(settings)), streams_(settings_.has_velocity, settings_.button_topics) {
  thread_ = std::thread([this] { run(); });
}

LockstepLoop::~LockstepLoop() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    running_ = false;
  }
  wake_.notify_all();
  thread_.join();
}

void LockstepLoop::give(std::unique_ptr<core::LockstepHand> hand, std::uint64_t generation) {
  const std::lock_guard<std::mutex> lock(mutex_);
  hand_ = std::move(hand);
  generation_ = generation;
  has_heard_ = left_ = false;
  wake_.notify_all();
}

void LockstepLoop::addTopology(std::shared_ptr<const core::Topology> topology) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (hand_)
    hand_->addTopology(std::move(topology));
  wake_.notify_all();
}

void LockstepLoop::addPatch(core::GridPatch patch, std::int64_t stamp_ns, std::int64_t next_ns) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (hand_)
    hand_->addPatch(std::move(patch), stamp_ns, next_ns);
  wake_.notify_all();
}

void LockstepLoop::hear(const std::function<void(core::DeviceStreams&)>& hear) {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (streams_.waiting() >= kMostWaiting)
    return settings_.warn("the device is minutes ahead of the simulation; samples are dropped");
  hear(streams_);
  // These keep no pose out, which would use them up.
  if (streams_.keepNewestOfOthers(kMostWaiting) > 0)
    settings_.warn("the device sends no poses for minutes of other messages; the oldest of those are dropped");
  wake_.notify_all();
}

void LockstepLoop::reset() {
  const std::lock_guard<std::mutex> lock(mutex_);
  if (hand_)
    hand_->reset();
}

LockstepLoop::Counts LockstepLoop::counts() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return {ticks_, streams_.waiting(), streams_.late(), has_heard_ && !left_};
}

void LockstepLoop::run() {
  Lock lock(mutex_);
  while (running_) {
    if (takeSample(lock))
      work(lock);
  }
}

/// Waits for the next sample of a session; false when there is none yet.
bool LockstepLoop::takeSample(Lock& lock) {
  const auto begin = std::chrono::steady_clock::now();
  const auto waited = [&] { return std::chrono::steady_clock::now() - begin; };
  bool has_sample = false;
  const auto next = [&] {
    if (!hand_ || has_sample)
      return has_sample;
    const auto sample = streams_.next();
    if (sample)
      sample_ = *sample;
    return has_sample = sample.has_value();
  };
  while (running_ && waited() < seconds(settings_.timeout_s)) {
    if (wake_.wait_for(lock, kSparseTime, [&] { return !running_ || next(); }))
      return has_sample;
    const std::size_t sparse = hand_ ? streams_.declareSparse() : 0;
    if (sparse > 0)
      settings_.warn("topics of the device that stay behind its poses are taken to be sent on change only: " +
                     std::to_string(sparse));
  }
  if (running_ && hand_ && has_heard_ && !left_)
    leaveLockstep(lock, "the device fell silent");
  return false;
}

void LockstepLoop::work(Lock& lock) {
  has_heard_ = true;
  const std::uint64_t generation = generation_;
  const core::ToolNotice notice = hand_->take(sample_);
  const auto isCurrent = [&] { return running_ && generation == generation_; };
  if (!left_) {
    lock.unlock();
    settings_.publish_notice(notice);
    lock.lock();
    const bool ready =
        wake_.wait_for(lock, seconds(settings_.timeout_s), [&] { return !isCurrent() || hand_->ready(); });
    if (!isCurrent())
      return;
    if (!ready)
      leaveLockstep(lock, "the simulation sends no patches");
    if (!isCurrent())
      return;
  }
  std::vector<core::HandTick> ticks;
  try {
    ticks = hand_->tick(settings_.forces_allowed());
  } catch (const core::Error& error) {
    settings_.warn(error.what());
  }
  ++ticks_;
  lock.unlock();
  for (const core::HandTick& tick : ticks)
    settings_.publish_tick(generation, tick);
  lock.lock();
}

void LockstepLoop::leaveLockstep(Lock& lock, const std::string& reason) {
  left_ = true;
  const std::uint64_t generation = generation_;
  const std::uint64_t session = hand_->session();
  lock.unlock();
  settings_.leave(session, reason);
  lock.lock();
  if (generation == generation_)
    fadeForces(lock);
}

/// Nobody will say that the motors are to rest, so this is done now, in the time that a stale pose has for it.
void LockstepLoop::fadeForces(Lock& lock) {
  const std::uint64_t generation = generation_;
  for (int n = 1; n <= kFadeTicks && running_ && generation == generation_; ++n) {
    const core::HandTick tick = hand_->tickSilence(kFadeStep_s * n);
    lock.unlock();
    settings_.publish_tick(generation, tick);
    lock.lock();
    if (tick.output.fault != core::ForceFault::kNone && tick.servo_n.isZero())
      return;
  }
}

}  // namespace soft_volume
