#include "soft_volume/session/lockstep.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace soft_volume::core {
namespace {

constexpr std::int64_t kPatchLatency_ns = static_cast<std::int64_t>(kPatchLatency_s * 1e9);

}  // namespace

std::int64_t lockstepStamp(std::int64_t epoch_ns, double simulation_time_s) {
  return epoch_ns + static_cast<std::int64_t>(std::llround(1e9 * simulation_time_s));
}

LockstepHand::LockstepHand(std::string name, const Scene& scene, const DeviceProfile* profile, double rate_hz,
                           std::uint64_t session, std::shared_ptr<const Volume> volume)
    : name_(std::move(name)), scene_(scene), rate_hz_(rate_hz), session_(session), volume_(std::move(volume)) {
  if (profile != nullptr)
    profile_ = *profile;
}

void LockstepHand::addTopology(std::shared_ptr<const Topology> topology) {
  if (topology->session == session_)
    topologies_[topology->revision] = std::move(topology);
}

void LockstepHand::addPatch(GridPatch patch, std::int64_t stamp_ns, std::int64_t next_ns) {
  const bool follows = patches_.empty() || stamp_ns > patches_.back().stamp_ns;
  if (patch.session == session_ && follows && held_.count(patch.tool_id) > 0)
    patches_.push_back({std::move(patch), stamp_ns, next_ns});
}

/// Numbers begin at the stamp, so that they go on when a hand begins again later in the same session.
void LockstepHand::makeRig(std::int64_t first_ns) {
  first_ns_ = first_ns;
  rig_ = makeToolRig(scene_, profile_ ? &*profile_ : nullptr, rate_hz_, static_cast<std::uint64_t>(first_ns));
  for (const auto& tool : rig_.tools)
    tool->setVolume(volume_);
}

void LockstepHand::putDown() {
  const std::optional<TissueCut> cut = tool().reset();
  if (!cut)
    return;
  HandTick tick;
  tick.stamp_ns = stamp_ns_;
  tick.tool = selected_;
  tick.put_down = true;
  tick.output.cut = cut;
  ticks_.push_back(tick);
}

/// The tool that is put down lets go of the tissue. A trip is the device's, and stays in the hand.
void LockstepHand::swap(const Buttons& before, const Buttons& now) {
  const bool pressed = now[rig_.swap_button] && !before[rig_.swap_button];
  if (!pressed || rig_.tools.size() < 2 || tool().tripped())
    return;
  putDown();
  selected_ = (selected_ + 1) % rig_.tools.size();
  tool().reset();
}

ToolNotice LockstepHand::take(const DeviceSample& sample) {
  assert(!has_sample_);
  if (rig_.tools.empty())
    makeRig(sample.stamp_ns);
  has_sample_ = true;
  stamp_ns_ = sample.stamp_ns;
  if (std::exchange(reset_wanted_, false))
    putDown();
  swap(std::exchange(buttons_, sample.buttons), sample.buttons);
  const WorkspaceMapping::Tip tip = rig_.mapping.toVolume(sample.pose, sample.velocity_m_s, sample.buttons);
  input_.time_s = input_.pose_time_s = seconds(sample.stamp_ns);
  input_.pose_stamp_s = input_.time_s;
  input_.pose = tip.pose;
  input_.velocity_m_s = tip.velocity_m_s;
  input_.buttons = sample.buttons;
  engaged_ = tip.engaged;
  if (isFinite(tip.pose.position_m))
    usable_point_m_ = tip.pose.position_m;
  const ToolConfig& config = tool().config();
  held_.insert(config.id);
  return {name_, session_, sample.stamp_ns, config.id, usable_point_m_, config.patch_radius_m, sent_};
}

/// The newest patch of the time that the sample is to use; null when there is none.
const LockstepHand::TimedPatch* LockstepHand::wanted() const {
  const auto later = std::find_if(patches_.begin(), patches_.end(),
                                  [&](const TimedPatch& p) { return p.stamp_ns > stamp_ns_ - kPatchLatency_ns; });
  return later == patches_.begin() ? nullptr : &*std::prev(later);
}

/// Before the first sample's own patch there is none to wait for.
bool LockstepHand::ready() const {
  assert(has_sample_);
  const std::int64_t time_ns = stamp_ns_ - kPatchLatency_ns;
  if (time_ns < first_ns_)
    return true;
  const TimedPatch* patch = wanted();
  if (patch == nullptr)
    return false;
  const bool is_newest = time_ns < patch->next_ns || patch != &patches_.back();
  return is_newest && topologies_.count(patch->patch.revision) > 0;
}

/// Takes a patch once, and if it is for the tool in the hand.
void LockstepHand::usePatch() {
  const TimedPatch* patch = wanted();
  if (patch == nullptr || patch->stamp_ns == used_ns_)
    return;
  used_ns_ = patch->stamp_ns;
  while (&patches_.front() != patch)
    patches_.pop_front();
  const auto topology = topologies_.find(patch->patch.revision);
  if (topology == topologies_.end())
    return;
  topologies_.erase(topologies_.begin(), topology);
  if (patch->patch.tool_id != tool().config().id)
    return;
  tool().setTopology(topology->second);
  tool().setPatch(patch->patch);
}

HandTick LockstepHand::makeTick(const ToolInput& input) {
  HandTick tick;
  tick.output = tool().update(input);
  tick.stamp_ns = stamp_ns_;
  tick.tool = selected_;
  tick.tip = input.pose;
  tick.buttons = input.buttons;
  tick.servo_n = rig_.mapping.forceToDevice(tick.output.device_force_n);
  return tick;
}

std::vector<HandTick> LockstepHand::tick(bool forces_allowed) {
  assert(has_sample_);
  usePatch();
  input_.forces_allowed = engaged_ && forces_allowed;
  ticks_.push_back(makeTick(input_));
  for (const HandTick& tick : ticks_) {
    ToolNotice::Sent& sent = sent_[config(tick.tool).id];
    if (tick.output.cut)
      sent.cut = tick.output.cut->header.sequence;
    if (tick.output.force)
      sent.force = tick.output.force->header.sequence;
  }
  has_sample_ = false;
  return std::exchange(ticks_, {});
}

HandTick LockstepHand::tickSilence(double silent_s) {
  ToolInput input = input_;
  input.time_s += silent_s;
  return makeTick(input);
}

bool LockstepGate::hear(const ToolNotice& notice, std::uint64_t session) {
  if (notice.session != session || (epoch_ns_ && notices_.count(notice.hand) == 0))
    return false;
  std::deque<ToolNotice>& notices = notices_[notice.hand];
  if (!notices.empty() && notice.until_ns <= notices.back().until_ns)
    return false;
  notices.push_back(notice);
  if (epoch_ns_ || notices_.size() < hands_wanted_)
    return true;
  epoch_ns_ = INT64_MAX;
  for (const auto& hand : notices_)
    epoch_ns_ = std::min(*epoch_ns_, hand.second.front().until_ns);
  return true;
}

void LockstepGate::countForce(const std::string& tool_id, std::uint64_t sequence) {
  received_[tool_id].force = std::max(received_[tool_id].force, sequence);
}

void LockstepGate::countCut(const std::string& tool_id, std::uint64_t sequence) {
  received_[tool_id].cut = std::max(received_[tool_id].cut, sequence);
}

bool LockstepGate::hasSent(const ToolNotice& notice) const {
  return std::all_of(notice.sent.begin(), notice.sent.end(), [&](const auto& sent) {
    const auto received = received_.find(sent.first);
    const ToolNotice::Sent counts = received == received_.end() ? ToolNotice::Sent() : received->second;
    return counts.force >= sent.second.force && counts.cut >= sent.second.cut;
  });
}

/// The first notice beyond the time says what had been sent until then; later ones may tell of later inputs.
std::string LockstepGate::waitsFor(std::int64_t time_ns) const {
  for (const auto& hand : notices_) {
    const auto beyond = std::find_if(hand.second.begin(), hand.second.end(),
                                     [&](const ToolNotice& notice) { return notice.until_ns > time_ns; });
    if (beyond == hand.second.end() || !hasSent(*beyond))
      return hand.first;
  }
  return "";
}

bool LockstepGate::complete(std::int64_t time_ns) const {
  return epoch_ns_ && waitsFor(time_ns).empty();
}

std::vector<ToolNotice> LockstepGate::noticesAt(std::int64_t time_ns) {
  std::vector<ToolNotice> notices;
  for (auto& hand : notices_) {
    while (hand.second.size() > 1 && hand.second[1].until_ns <= time_ns)
      hand.second.pop_front();
    notices.push_back(hand.second.front());
  }
  return notices;
}

}  // namespace soft_volume::core
