#include "soft_volume/tool/coupling.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "range_check.h"

namespace soft_volume::core {
namespace {

constexpr double kTiny = 1e-9;  // stands for an open end of a range

constexpr double kWindow = 0.5;  // seconds; the window before counts, too
constexpr double kQuantile = 0.95;
constexpr double kFirstBin = 1e-5;  // seconds; what is shorter is in it, too
constexpr double kBinsPerOctave = 8.0;

struct Choice {
  double stiffness_n_m;
  StiffnessBound bound;
};

Choice stiffest(const CouplingConfig& config, const DeviceLimits& limits, const LoopTiming& timing,
                double tissue_bound_n_m) {
  const std::array<Choice, 4> choices{{{config.stiffness_n_m, StiffnessBound::kWish},
                                       {limits.max_stiffness_n_m, StiffnessBound::kDevice},
                                       {config.passiveStiffness(timing), StiffnessBound::kPassivity},
                                       {tissue_bound_n_m, StiffnessBound::kTissue}}};
  return *std::min_element(choices.begin(), choices.end(),
                           [](const Choice& a, const Choice& b) { return a.stiffness_n_m < b.stiffness_n_m; });
}

}  // namespace

const char* describe(StiffnessBound bound) {
  switch (bound) {
    case StiffnessBound::kWish:
      return "the scene's wish";
    case StiffnessBound::kDevice:
      return "the device's largest stiffness";
    case StiffnessBound::kPassivity:
      return "passivity at the measured timing";
    case StiffnessBound::kTissue:
      return "softness of the tissue at the rate of the patches";
  }
  return "unknown";
}

double CouplingConfig::passiveStiffness(const LoopTiming& timing) const {
  return std::max(0.0,
                  0.5 * (device_damping_n_s_m - std::abs(damping_n_s_m)) / (0.5 * timing.period_s + timing.delay_s));
}

double CouplingConfig::renderedStiffness(const DeviceLimits& limits) const {
  return stiffest(*this, limits, statedTiming(), std::numeric_limits<double>::infinity()).stiffness_n_m;
}

void CouplingConfig::validate(const std::string& owner, const DeviceLimits& limits) const {
  checkRange(owner + ": stiffness_n_m", stiffness_n_m, kTiny, 20000.0);
  checkRange(owner + ": device_damping_n_s_m", device_damping_n_s_m, kTiny, 100.0);
  checkRange(owner + ": damping_n_s_m", damping_n_s_m, 0.0,
             std::min(0.99 * device_damping_n_s_m, limits.max_damping_n_s_m));
  checkRange(owner + ": sample_period_s", sample_period_s, 1e-4, 0.1);
  checkRange(owner + ": delay_s", delay_s, 0.0, 0.1);
}

std::size_t LoopMeter::Histogram::binOf(double value) {
  if (!(value > kFirstBin))
    return 0;
  return std::min(kBins - 1, std::size_t(1.0 + kBinsPerOctave * std::log2(value / kFirstBin)));
}

void LoopMeter::Histogram::add(double value, double weight) {
  const std::size_t bin = binOf(value);
  weights_[bin] += weight;
  largest_[bin] = std::max(largest_[bin], value);
  total_ += weight;
}

double LoopMeter::Histogram::quantile(const Histogram& a, const Histogram& b) {
  double left = (1.0 - kQuantile) * (a.total_ + b.total_);
  for (std::size_t bin = kBins; bin-- > 0;) {
    left -= a.weights_[bin] + b.weights_[bin];
    if (left < 0.0)
      return std::max(a.largest_[bin], b.largest_[bin]);
  }
  return 0.0;
}

void LoopMeter::add(double hold_s, double delay_s) {
  if (now_.holds.weight() >= kWindow) {
    before_ = now_;
    now_ = Window();
  }
  now_.holds.add(hold_s, hold_s);
  now_.delays.add(delay_s, hold_s);
}

void LoopMeter::tick(double time_s, double pose_time_s, double delay_s) {
  if (started_ && pose_time_s == pose_time_s_)
    return;
  if (started_ && time_s > first_use_s_)
    add(time_s - first_use_s_, first_delay_s_);
  started_ = true;
  pose_time_s_ = pose_time_s;
  first_use_s_ = time_s;
  first_delay_s_ = std::max(0.0, time_s - pose_time_s + delay_s);
}

LoopTiming LoopMeter::timing() const {
  return {Histogram::quantile(now_.holds, before_.holds), Histogram::quantile(now_.delays, before_.delays)};
}

Coupling::Coupling(const CouplingConfig& config, const DeviceLimits& limits)
    : config_(config), limits_(limits), timing_(config.statedTiming()), stiffness_n_m_(0.0) {
  update({}, std::numeric_limits<double>::infinity(), false);
}

void Coupling::update(const LoopTiming& measured, double tissue_bound_n_m, bool loaded) {
  timing_.period_s = std::max(config_.sample_period_s, measured.period_s);
  timing_.delay_s = config_.delay_s + measured.delay_s;
  const Choice choice = stiffest(config_, limits_, timing_, tissue_bound_n_m);
  if (loaded && choice.stiffness_n_m >= stiffness_n_m_)
    return;
  stiffness_n_m_ = choice.stiffness_n_m;
  bound_ = choice.bound;
}

}  // namespace soft_volume::core
