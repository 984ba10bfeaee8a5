#include "soft_volume/tool/device_streams.h"

#include <algorithm>

namespace soft_volume::core {
namespace {

/// Returns how many were dropped.
template <typename Timed>
std::size_t keepNewest(std::deque<Timed>& waiting, std::size_t most) {
  const std::size_t excess = waiting.size() > most ? waiting.size() - most : 0;
  waiting.erase(waiting.begin(), waiting.begin() + static_cast<std::ptrdiff_t>(excess));
  return excess;
}

std::int64_t nanoseconds(double seconds) {
  return static_cast<std::int64_t>(seconds * 1e9);
}

}  // namespace

DeviceStreams::DeviceStreams(bool has_velocity, std::size_t button_topics)
    : presses_(button_topics), others_(button_topics + (has_velocity ? 1 : 0)), has_velocity_(has_velocity) {}

bool DeviceStreams::isNew(Progress& progress, std::int64_t stamp_ns) {
  if (stamp_ns <= progress.newest_ns) {
    ++dropped_;
    return false;
  }
  progress.newest_ns = stamp_ns;
  late_ += &progress != &pose_progress_ && stamp_ns <= given_ns_ ? 1 : 0;
  return true;
}

void DeviceStreams::addPose(std::int64_t stamp_ns, const Pose& pose) {
  if (isNew(pose_progress_, stamp_ns))
    poses_.push_back({stamp_ns, pose});
}

void DeviceStreams::addVelocity(std::int64_t stamp_ns, const Vector3& velocity_m_s) {
  if (has_velocity_ && isNew(others_.front(), stamp_ns))
    velocities_.push_back({stamp_ns, velocity_m_s});
}

void DeviceStreams::addButtons(std::size_t topic, std::int64_t stamp_ns, const Buttons& mask, const Buttons& pressed) {
  if (isNew(others_[topic + (has_velocity_ ? 1 : 0)], stamp_ns))
    presses_[topic].push_back({stamp_ns, mask, pressed});
}

bool DeviceStreams::blocks(const Progress& progress, std::int64_t stamp_ns) const {
  if (ended_ || progress.newest_ns >= stamp_ns)
    return false;
  return !progress.sparse || pose_progress_.newest_ns < stamp_ns + nanoseconds(kWindow_s);
}

std::size_t DeviceStreams::declareSparse() {
  if (poses_.empty())
    return 0;
  std::size_t count = 0;
  for (Progress& progress : others_) {
    if (progress.sparse || !blocks(progress, poses_.front().stamp_ns))
      continue;
    progress.sparse = true;
    ++count;
  }
  return count;
}

std::size_t DeviceStreams::keepNewestOfOthers(std::size_t most) {
  std::size_t count = keepNewest(velocities_, most);
  for (std::deque<TimedButtons>& presses : presses_)
    count += keepNewest(presses, most);
  dropped_ += count;
  return count;
}

std::optional<Vector3> DeviceStreams::velocityAt(std::int64_t stamp_ns) {
  while (!velocities_.empty() && velocities_.front().stamp_ns <= stamp_ns) {
    velocity_ = velocities_.front();
    velocities_.pop_front();
  }
  if (!velocity_ || stamp_ns - velocity_->stamp_ns >= nanoseconds(kVelocityLife_s))
    return std::nullopt;
  return velocity_->velocity_m_s;
}

void DeviceStreams::pressUntil(std::int64_t stamp_ns) {
  for (std::deque<TimedButtons>& presses : presses_) {
    for (; !presses.empty() && presses.front().stamp_ns <= stamp_ns; presses.pop_front()) {
      const TimedButtons& change = presses.front();
      buttons_ = (buttons_ & ~change.mask) | (change.pressed & change.mask);
    }
  }
}

std::optional<DeviceSample> DeviceStreams::next() {
  if (poses_.empty())
    return std::nullopt;
  const TimedPose pose = poses_.front();
  if (std::any_of(others_.begin(), others_.end(), [&](const Progress& p) { return blocks(p, pose.stamp_ns); }))
    return std::nullopt;
  poses_.pop_front();
  given_ns_ = pose.stamp_ns;
  pressUntil(pose.stamp_ns);
  return DeviceSample{pose.stamp_ns, pose.pose, velocityAt(pose.stamp_ns), buttons_};
}

}  // namespace soft_volume::core
