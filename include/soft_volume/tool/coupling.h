#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>

#include "soft_volume/tool/force_limiter.h"

namespace soft_volume::core {

/// Timing of the loop from the device's pose to the force that answers it.
struct LoopTiming {
  double period_s = 0.0;  ///< T: how long one pose's force is held
  double delay_s = 0.0;   ///< T_d: from the pose to the force's start at the motor
};

/// What bounds the stiffness in use. Values are those of the message ToolState.
enum class StiffnessBound : std::uint8_t { kWish = 0, kDevice = 1, kPassivity = 2, kTissue = 3 };

/// A word for diagnostics.
const char* describe(StiffnessBound bound);

/// A spring and damper between the device and the surface (virtual coupling), as discrete control can render it.
struct CouplingConfig {
  double stiffness_n_m = 200.0;       ///< wish; (0, 20000]
  double damping_n_s_m = 0.0;         ///< along the normal; [0, device_damping_n_s_m)
  double device_damping_n_s_m = 0.2;  ///< physical damping b of device and hand, a low estimate; (0, 100]
  double sample_period_s = 0.001;     ///< least period T of pose and force, a longer one is measured; [1e-4, 0.1]
  double delay_s = 0.001;             ///< from a computed force to the motor; the loop's own is measured; [0, 0.1]

  /// The timing at best: nothing but what is stated.
  LoopTiming statedTiming() const { return {sample_period_s, delay_s}; }
  /// The passive stiffness for a timing: K = (b - |B|) / 2 / (T/2 + T_d). That is half of the bound b > K (T/2 + T_d) +
  /// |B| (Colgate and Schenkel's passivity of a sampled wall, with the delay that a simulation of the loop gave), B
  /// being the rendered damping.
  double passiveStiffness(const LoopTiming& timing) const;
  /// The stiffness that is rendered at best: the wish, at most the device's, at most the passive one.
  double renderedStiffness(const DeviceLimits& limits) const;
  void validate(const std::string& owner, const DeviceLimits& limits) const;
};

/// Measures a loop's timing from the times of its ticks and poses: how old a pose is when it is first used, and how
/// long its force is held until the next pose is used. Of both, the value that only a twentieth of the last half to one
/// second (of time, not of ticks) exceeds: one late tick on a machine without real-time rights changes nothing, three
/// poses at a tenth of the rate do. No allocation; one thread at a time.
class LoopMeter {
 public:
  /// Once per tick. `delay_s`: what is known to have passed between the measurement of the pose and `pose_time_s`.
  void tick(double time_s, double pose_time_s, double delay_s);
  /// There is no pose to be used: a gap of the device is a fault, and no measure of the loop.
  void pause() { started_ = false; }
  /// Zeros before the second pose.
  LoopTiming timing() const;
  void reset() { *this = LoopMeter(); }

 private:
  /// Weighted values in bins of an eighth of an octave, each with its largest value.
  class Histogram {
   public:
    void add(double value, double weight);
    static double quantile(const Histogram& a, const Histogram& b);
    double weight() const { return total_; }

   private:
    static constexpr std::size_t kBins = 112;
    static std::size_t binOf(double value);
    std::array<double, kBins> weights_{};
    std::array<double, kBins> largest_{};
    double total_ = 0.0;
  };
  struct Window {
    Histogram holds;
    Histogram delays;
  };
  void add(double hold_s, double delay_s);

  bool started_ = false;
  double pose_time_s_ = 0.0;
  double first_use_s_ = 0.0;  // of the pose in use
  double first_delay_s_ = 0.0;
  Window now_;
  Window before_;
};

/// Decides the stiffness of the coupling in every tick: the wish, at most the device's, the passive one for the
/// measured timing, and a bound that the tissue gives. It falls at once, and rises only while no force flows: raising a
/// loaded spring's stiffness would make energy of nothing. No allocation; one thread at a time.
class Coupling {
 public:
  /// Needs valid configurations. Starts with what is possible at best.
  Coupling(const CouplingConfig& config, const DeviceLimits& limits);

  /// `tissue_bound_n_m`: infinite without one. `loaded`: a force flows, or would as soon as the ramp lets it.
  void update(const LoopTiming& measured, double tissue_bound_n_m, bool loaded);
  double stiffness_n_m() const { return stiffness_n_m_; }
  /// Of the stiffness in use.
  StiffnessBound bound() const { return bound_; }
  /// Measured and stated together, as of the last update.
  const LoopTiming& timing() const { return timing_; }

 private:
  CouplingConfig config_;
  DeviceLimits limits_;
  LoopTiming timing_;
  double stiffness_n_m_;
  StiffnessBound bound_;
};

}  // namespace soft_volume::core
