#include "haptic_rig.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>

#include "soft_volume/scene/scene.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kTipRadius_m = 0.004;
constexpr double kTouch_m = kBlockTop_m + kTipRadius_m;  // of the tip's centre
constexpr double kPatchDelay_s = 0.001;                  // from the simulation to the tool
constexpr double kTrend_s = 0.1;                         // oscillation is what is faster than this
constexpr std::uint64_t kSession = 1;
constexpr double kRestart_s = 0.3;  // from a simulation's death to the next one

struct Grip {
  double stiffness_n_m;
  double damping_n_s_m;
};

Grip gripOf(Hand hand) {
  switch (hand) {
    case Hand::kStiffGrip:
      return {1000.0, 15.0};
    case Hand::kLooseGrip:
      return {60.0, 2.0};
    case Hand::kTapping:
      return {400.0, 5.0};
    case Hand::kSliding:
    case Hand::kRelease:
      return {600.0, 8.0};
  }
  return {};
}

constexpr double kReleased_s = 1.2;

struct Window {
  double begin_s;
  double end_s;
};

/// While the hand rests or slides, after the press has settled.
Window steadyWindow(Hand hand) {
  switch (hand) {
    case Hand::kStiffGrip:
      return {0.9, 1.5};
    case Hand::kLooseGrip:
      return {1.4, 2.0};
    case Hand::kTapping:
      return {0.0, 0.0};
    case Hand::kSliding:
      return {0.7, 2.0};
    case Hand::kRelease:
      return {0.8, kReleased_s};
  }
  return {};
}

WayPoint at(double time_s, double x_m, double height_m) {
  WayPoint point;
  point.time_s = time_s;
  point.position_m = {x_m, kBlockMiddle_m, kTouch_m + height_m};
  return point;
}

std::vector<WayPoint> scriptOf(Hand hand) {
  constexpr double kX = kBlockMiddle_m;
  constexpr double kFree = 0.008;
  std::vector<WayPoint> script{at(0.0, kX, kFree)};
  switch (hand) {
    case Hand::kStiffGrip:
      script.insert(script.end(), {at(0.5, kX, -0.012), at(1.5, kX, -0.012), at(1.9, kX, kFree), at(2.2, kX, kFree)});
      break;
    case Hand::kLooseGrip:
      script.insert(script.end(), {at(0.6, kX, -0.025), at(2.0, kX, -0.025), at(2.4, kX, kFree), at(2.6, kX, kFree)});
      break;
    case Hand::kTapping:
      script.push_back(at(0.3, kX, kFree));
      for (int tap = 0; tap < 4; ++tap) {
        script.push_back(at(0.425 + 0.25 * tap, kX, -0.008));
        script.push_back(at(0.55 + 0.25 * tap, kX, kFree));
      }
      script.push_back(at(1.6, kX, kFree));
      break;
    case Hand::kSliding:
      script = {at(0.0, kX - 0.008, kFree),  at(0.5, kX - 0.008, -0.010), at(0.9, kX - 0.008, -0.010),
                at(1.7, kX + 0.007, -0.010), at(2.0, kX + 0.007, -0.010), at(2.4, kX + 0.007, kFree)};
      script.push_back(at(2.6, kX + 0.007, kFree));
      break;
    case Hand::kRelease:
      script.insert(script.end(), {at(0.5, kX, -0.012), at(2.0, kX, -0.012)});
      break;
  }
  return script;
}

/// A blade that stands upright goes in beside the block's middle, through it and out at the side where it started.
std::vector<WayPoint> cutScript() {
  const Quaternion upright = Quaternion::Identity();
  std::vector<WayPoint> script{at(0.0, 0.004, 0.008),  at(0.4, 0.004, 0.008), at(0.9, 0.010, -0.015),
                               at(2.4, 0.048, -0.015), at(2.8, 0.050, 0.012), at(3.0, 0.050, 0.012)};
  for (std::size_t i = 0; i < script.size(); ++i) {
    script[i].orientation = upright;
    script[i].buttons[0] = i >= 1 && i + 2 < script.size();
  }
  return script;
}

VirtualDeviceConfig deviceOf(const HapticSetup& setup, double step_s) {
  const DeviceMechanics mechanics = deviceMechanics(setup.device);
  const Grip grip = gripOf(setup.hand);
  VirtualDeviceConfig config;
  config.limits = deviceLimits(setup.device);
  config.mass_kg = mechanics.mass_kg;
  config.friction_n = mechanics.friction_n;
  config.position_resolution_m = mechanics.position_resolution_m;
  config.damping_n_s_m = setup.damping_n_s_m;
  config.step_s = step_s;
  config.hand_stiffness_n_m = grip.stiffness_n_m;
  config.hand_damping_n_s_m = grip.damping_n_s_m;
  config.workspace_centre_m = {kBlockMiddle_m, kBlockMiddle_m, kTouch_m};
  config.way_points = setup.cuts ? cutScript() : scriptOf(setup.hand);
  return config;
}

ToolConfig toolOf(const HapticSetup& setup) {
  ToolConfig config;
  config.id = setup.cuts ? "scalpel" : "probe";
  config.kind = setup.cuts ? ToolKind::kScalpel : ToolKind::kProbe;
  config.tissue_threshold = kBlockThreshold;
  config.tip_radius_m = setup.cuts ? 0.001 : kTipRadius_m;
  config.device = deviceLimits(setup.device);
  // Without a wish, passivity alone decides.
  config.coupling.stiffness_n_m = setup.wish_n_m > 0.0 ? setup.wish_n_m : config.device.max_stiffness_n_m;
  config.friction_coefficient = setup.friction;
  config.coupling.device_damping_n_s_m = setup.damping_n_s_m;
  config.coupling.sample_period_s = 1.0 / setup.rate_hz;
  config.coupling.delay_s = setup.delay_samples / setup.rate_hz;
  config.cutting_drag_n_s_m = std::min(config.cutting_drag_n_s_m, setup.damping_n_s_m);
  return config;
}

double energyOf(const Session& session) {
  const Mechanics mechanics = session.simulation().mechanics();
  return mechanics.elastic_j + mechanics.kinetic_j;
}

/// Part of a force that is new, in any direction: what lies between zero and the force before it is none.
double growth(const Vector3& before_n, const Vector3& now_n) {
  const double squared = before_n.squaredNorm();
  const double share = squared > 0.0 ? std::clamp(now_n.dot(before_n) / squared, 0.0, 1.0) : 0.0;
  return (now_n - share * before_n).norm();
}

/// Largest distance of the values from their running mean over kTrend_s, within the window.
double swing(const std::vector<HapticSample>& trace, const Window& window) {
  std::vector<double> sums{0.0};
  for (const HapticSample& sample : trace)
    sums.push_back(sums.back() + sample.force_n.norm());
  double largest = 0.0;
  std::size_t begin = 0;
  std::size_t end = 0;
  for (std::size_t i = 0; i < trace.size(); ++i) {
    const double time_s = trace[i].time_s;
    while (trace[begin].time_s < time_s - 0.5 * kTrend_s)
      ++begin;
    while (end < trace.size() && trace[end].time_s <= time_s + 0.5 * kTrend_s)
      ++end;
    if (time_s < window.begin_s || time_s > window.end_s - 0.5 * kTrend_s)
      continue;
    const double trend = (sums[end] - sums[begin]) / double(end - begin);
    largest = std::max(largest, std::abs(trace[i].force_n.norm() - trend));
  }
  return largest;
}

}  // namespace

std::string nameOf(Hand hand) {
  constexpr const char* kNames[] = {"stiff grip", "loose grip", "tapping", "sliding", "release"};
  return kNames[int(hand)];
}

std::string nameOf(Sabotage sabotage) {
  constexpr const char* kNames[] = {"none",       "poses stop",     "poses not a number", "teleport",
                                    "10x jitter", "loop at 100 Hz", "simulation killed",  "simulation restarted"};
  return kNames[int(sabotage)];
}

std::string HapticSetup::text() const {
  std::ostringstream text;
  text << device << ", " << (cuts ? "cut" : nameOf(hand)) << ", " << nameOf(tissue) << ", b " << damping_n_s_m
       << ", delay " << delay_samples << ", jitter " << 1e3 * jitter_s << " ms, " << rate_hz << " Hz, patches "
       << patch_rate_hz << " Hz, friction " << friction;
  return text.str();
}

HapticRig::HapticRig(const HapticSetup& setup)
    : setup_(setup),
      random_(1),
      device_(deviceOf(setup, kStep_s)),
      tool_(toolOf(setup)),
      loop_period_s_(1.0 / setup.rate_hz),
      sample_period_s_(1.0 / deviceMechanics(setup.device).rate_hz) {
  end_s_ = device_.config().way_points.back().time_s;
  next_tick_s_ = nominal_tick_s_ = 0.37 * loop_period_s_;  // device and tool keep no common time
  makeSession();
  tissue_energy_at_start_j_ = energyOf(*session_);
  tool_.setVolume(session_->volume());
  last_encoder_m_ = device_.pose().position_m;
}

void HapticRig::makeSession() {
  const std::uint64_t id = session_ ? session_->id() + 1 : kSession;
  const HapticBlock block =
      makeHapticBlock(setup_.tissue, setup_.tissue_damping_ratio, setup_.cuts ? kToughness_j_m2 : 0);
  session_ = std::make_unique<Session>(block.scene, block.volume, nullptr, id, 1);
  next_step_s_ = now_s_ + session_->timeStep();
  next_patch_s_ = now_s_;
}

bool HapticRig::simulationRuns() const {
  const bool killed =
      setup_.sabotage == Sabotage::kSimulationKilled || setup_.sabotage == Sabotage::kSimulationRestarts;
  if (!killed || now_s_ < setup_.sabotage_s)
    return true;
  return setup_.sabotage == Sabotage::kSimulationRestarts && now_s_ >= setup_.sabotage_s + kRestart_s;
}

double HapticRig::late() {
  const double jitter_s = setup_.sabotage == Sabotage::kTenfoldJitter && now_s_ >= setup_.sabotage_s
                              ? 10.0 * setup_.jitter_s
                              : setup_.jitter_s;
  return jitter_s * double(random_() >> 11U) * 0x1p-53;
}

// A driver that knows positions alone: the difference of encoder readings, smoothed over 5 ms.
void HapticRig::sample() {
  Sample sample;
  sample.pose = device_.pose();
  const double share = sample_period_s_ / (sample_period_s_ + 0.005);
  encoder_velocity_m_s_ +=
      share * ((sample.pose.position_m - last_encoder_m_) / sample_period_s_ - encoder_velocity_m_s_);
  last_encoder_m_ = sample.pose.position_m;
  sample.velocity_m_s = encoder_velocity_m_s_;
  sample.buttons = device_.buttons();
  sample.arrives_s = now_s_ + late();
  if (!samples_under_way_.empty())  // a connection keeps the order
    sample.arrives_s = std::max(sample.arrives_s, samples_under_way_.back().arrives_s);
  spoil(sample);
  samples_under_way_.push_back(sample);
}

void HapticRig::spoil(Sample& sample) const {
  if (now_s_ < setup_.sabotage_s)
    return;
  if (setup_.sabotage == Sabotage::kPoseStops)
    sample.arrives_s = std::numeric_limits<double>::infinity();
  if (setup_.sabotage == Sabotage::kNotANumber)
    sample.pose.position_m.z() = std::numeric_limits<double>::quiet_NaN();
  if (setup_.sabotage == Sabotage::kTeleport)
    sample.pose.position_m.z() -= 0.02;
}

void HapticRig::deliver() {
  while (!samples_under_way_.empty() && samples_under_way_.front().arrives_s <= now_s_) {
    newest_ = samples_under_way_.front();
    samples_under_way_.pop_front();
  }
  while (!patches_under_way_.empty() && patches_under_way_.front().arrives_s <= now_s_) {
    const Patch& patch = patches_under_way_.front();
    if (patch.topology)
      tool_.setTopology(patch.topology);
    tool_.setPatch(patch.patch);
    patches_under_way_.pop_front();
  }
  while (!forces_under_way_.empty() && forces_under_way_.front().arrives_s <= now_s_) {
    device_.setServoForce(forces_under_way_.front().force_n);
    forces_under_way_.pop_front();
  }
}

void HapticRig::tick() {
  if (!newest_)
    return;
  ToolInput input;
  input.time_s = now_s_;
  input.pose_time_s = newest_->arrives_s;
  input.pose = newest_->pose;
  input.velocity_m_s = newest_->velocity_m_s;
  input.buttons = newest_->buttons;
  const ToolOutput output = tool_.update(input);
  Force force{now_s_ + setup_.delay_samples * loop_period_s_ + late(), output.device_force_n};
  if (!forces_under_way_.empty())
    force.arrives_s = std::max(force.arrives_s, forces_under_way_.back().arrives_s);
  forces_under_way_.push_back(force);
  if (simulationRuns()) {
    if (output.force && !session_->apply(toCommand(tool_.config().id, *output.force)).applied)
      ++result_.refused;
    if (output.cut && !session_->apply(toCommand(tool_.config().id, *output.cut)).applied)
      ++result_.refused;
  }
  judgeTick(output);
  record(output);
}

void HapticRig::judgeTick(const ToolOutput& output) {
  const Vector3& force_n = output.device_force_n;
  if (output.fault != ForceFault::kNone && fault_before_ == ForceFault::kNone)
    ++result_.trips;
  fault_before_ = output.fault;
  result_.peak_force_n = std::max(result_.peak_force_n, force_n.norm());
  result_.over_limit_n = std::max(result_.over_limit_n, force_n.norm() - device_.config().limits.max_force_n);
  if (now_s_ > tick_before_s_)
    result_.growth_n_ms =
        std::max(result_.growth_n_ms, 1e-3 * growth(force_before_n_, force_n) / (now_s_ - tick_before_s_));
  force_before_n_ = force_n;
  tick_before_s_ = now_s_;
  if (setup_.sabotage == Sabotage::kNone || now_s_ < setup_.sabotage_s)
    return;
  if (setup_.sabotage == Sabotage::kSimulationRestarts && simulationRuns()) {
    result_.force_again_n = std::max(result_.force_again_n, force_n.norm());
  } else if (!force_n.isZero(0.0)) {
    result_.zero_after_s = now_s_ + loop_period_s_ - setup_.sabotage_s;
  }
}

void HapticRig::record(const ToolOutput& output) {
  HapticSample sample;
  sample.time_s = now_s_;
  sample.device_m = newest_->pose.position_m;
  sample.force_n = output.device_force_n;
  sample.contact = output.contact;
  sample.stiffness_n_m = output.coupling_stiffness_n_m;
  sample.fault = output.fault;
  sample.cutting = output.cutting;
  result_.trace.push_back(sample);
}

void HapticRig::showTissue() {
  Patch patch;
  patch.arrives_s = now_s_ + kPatchDelay_s;
  if (session_->lattice().revision != shown_revision_ || session_->id() != shown_session_)
    patch.topology = std::make_shared<const Topology>(session_->topology());
  shown_revision_ = session_->lattice().revision;
  shown_session_ = session_->id();
  const ToolConfig& config = tool_.config();
  patch.patch = session_->patch(config.id, device_.position_m(), config.patch_radius_m);
  patches_under_way_.push_back(std::move(patch));
  if (setup_.tissue == TissueKind::kPrestressed)  // other tissue starts with nothing to release
    result_.released_j = std::max(result_.released_j, tissue_energy_at_start_j_ - energyOf(*session_));
}

void HapticRig::simulate() {
  session_->step();
  next_step_s_ += session_->timeStep();
  if (now_s_ < next_patch_s_)
    return;
  next_patch_s_ += 1.0 / setup_.patch_rate_hz;
  showTissue();
}

void HapticRig::account() {
  const PortWork& motor = device_.motorWork();
  const PortWork& hand = device_.handWork();
  result_.put_in_j = motor.out_of_device_j;
  result_.put_out_j = motor.into_device_j;
  result_.hand_put_in_j = hand.into_device_j;
  const double motor_j = motor.into_device_j - motor.out_of_device_j;
  const double hand_j = hand.into_device_j - hand.out_of_device_j;
  result_.port_surplus_j = std::max(result_.port_surplus_j, motor_j - result_.released_j);
  result_.surplus_j = std::max(result_.surplus_j, motor_j - hand_j - result_.released_j);
  result_.hand_surplus_j = std::max(result_.hand_surplus_j, -hand_j - result_.released_j);
}

void HapticRig::finish() {
  const Window window = setup_.cuts ? Window{0.0, 0.0} : steadyWindow(setup_.hand);
  double sum = 0.0;
  int count = 0;
  for (const HapticSample& sample : result_.trace) {
    if (sample.time_s < window.begin_s || sample.time_s > window.end_s)
      continue;
    sum += sample.force_n.norm();
    ++count;
    result_.stiffness_n_m = sample.stiffness_n_m;
  }
  if (count == 0)
    return;
  result_.mean_force_n = sum / count;
  result_.oscillation = swing(result_.trace, window) / std::max(result_.mean_force_n, 1e-3);
}

HapticResult HapticRig::run() {
  const bool restarts = setup_.sabotage == Sabotage::kSimulationRestarts;
  bool restarted = false;
  bool slow = false;
  while (now_s_ < end_s_) {
    now_s_ = double(++n_) * kStep_s;
    device_.step();
    if (setup_.hand == Hand::kRelease && !setup_.cuts && now_s_ >= kReleased_s)
      device_.setGrip(0.0, 0.0);
    if (!slow && setup_.sabotage == Sabotage::kSlowLoop && now_s_ >= setup_.sabotage_s) {
      slow = true;
      loop_period_s_ = sample_period_s_ = 0.01;
    }
    if (now_s_ >= next_sample_s_) {
      sample();
      next_sample_s_ += sample_period_s_;
    }
    if (restarts && !restarted && now_s_ >= setup_.sabotage_s && simulationRuns()) {
      makeSession();
      restarted = true;
    }
    if (simulationRuns() && now_s_ >= next_step_s_)
      simulate();
    deliver();
    if (now_s_ >= next_tick_s_) {
      tick();
      nominal_tick_s_ += loop_period_s_;
      next_tick_s_ = nominal_tick_s_ + late();
    }
    account();
  }
  finish();
  return std::move(result_);
}

}  // namespace soft_volume::core::validate
