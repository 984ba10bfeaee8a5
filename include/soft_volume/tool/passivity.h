#pragma once

#include <array>
#include <cstddef>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// Passivity observer and controller of a virtual coupling (Hannaford and Ryu, "Time-domain passivity control of haptic
/// interfaces", 2002), on its two ports.
///
/// The observer adds up the work that the motors did on the device, the held force times the device's way while the
/// motors hold it, which is later than the tick by the stated delay; less what the tissue put in by moving under the
/// force; and what the coupling's spring can still give back. Above zero this is energy that sampling and delay have
/// made. What prestressed tissue releases when it moves comes in by its port and is no such energy.
///
/// The controller takes it out by a damper between device and tissue, no stronger than stated (a sampled damper is one
/// only while it is weak). Losses (friction) are forgotten within 50 ms, so that they do not pay for what comes later;
/// what was made, within two seconds, because a device's own damping takes it by then.
///
/// No allocation; one thread at a time.
class PassivityControl {
 public:
  /// `delay_s`: from a force's computation to the motors.
  explicit PassivityControl(double delay_s) : delay_s_(delay_s) {}

  /// What a tick computed and saw.
  struct Tick {
    double time_s = 0.0;
    double measured_s = 0.0;                         ///< when the device was at `device_m`; any clock of the forces
    Vector3 device_m = Vector3::Zero();              ///< tip
    Vector3 stretch_m = Vector3::Zero();             ///< from the tip to the coupling's end on the tissue
    Vector3 surface_velocity_m_s = Vector3::Zero();  ///< of the tissue there
    double stiffness_n_m = 0.0;                      ///< of the coupling; 0 when there is none
    Vector3 force_n = Vector3::Zero();               ///< sent to the device
  };
  /// At the end of every tick with a usable pose.
  void observe(const Tick& tick);
  /// Damping that the next tick is to render on the velocity between device and tissue, at most `most` [N s/m].
  double damping(const Vector3& velocity_m_s, double most_n_s_m) const;
  /// Energy that was made and not taken out yet, joule; below zero: losses of late.
  double energy() const { return made_j_; }
  void reset() { *this = PassivityControl(delay_s_); }

 private:
  struct Sent {
    double from_s = 0.0;
    Vector3 force_n = Vector3::Zero();
  };
  void remember(const Tick& tick);
  Vector3 meanForce(double begin_s, double end_s) const;

  double delay_s_;

  static constexpr std::size_t kKept = 128;  // ticks: 100 ms at 1 kHz
  std::array<Sent, kKept> sent_{};
  std::size_t newest_ = 0;
  std::size_t count_ = 0;

  bool started_ = false;
  Tick last_;
  double stored_j_ = 0.0;
  double made_j_ = 0.0;
};

}  // namespace soft_volume::core
