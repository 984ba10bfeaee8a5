#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "haptic_block.h"
#include "soft_volume/session/session.h"
#include "soft_volume/tool/tool.h"
#include "soft_volume/tool/virtual_device.h"

namespace soft_volume::core::validate {

/// How the device is held, and what the hand does.
enum class Hand { kStiffGrip, kLooseGrip, kTapping, kSliding, kRelease };
/// What goes wrong on the way, at HapticSetup::sabotage_s.
enum class Sabotage {
  kNone,
  kPoseStops,
  kNotANumber,
  kTeleport,
  kTenfoldJitter,
  kSlowLoop,           ///< poses and ticks at 100 Hz from then on
  kSimulationKilled,   ///< no patch any more
  kSimulationRestarts  ///< another session a while after the first one was killed
};

std::string nameOf(Hand hand);
std::string nameOf(Sabotage sabotage);

/// One row of the suite: a device in a hand, on tissue, in a loop of these delays.
struct HapticSetup {
  std::string device = "touch";
  Hand hand = Hand::kStiffGrip;
  TissueKind tissue = TissueKind::kMuscle;
  double damping_n_s_m = 0.2;  ///< the device's physical one
  int delay_samples = 1;       ///< from the tool's tick to the motor, in periods of the loop
  double jitter_s = 1e-4;      ///< every sample, tick and force is late by up to this
  double rate_hz = 1000.0;     ///< of the tool's loop
  double patch_rate_hz = 250.0;
  double wish_n_m = 0.0;              ///< stiffness of the coupling that is asked for; 0: the device's largest
  double friction = 0.0;              ///< between tip and tissue
  double tissue_damping_ratio = 0.5;  ///< that of the shipped scenes by default
  bool cuts = false;                  ///< with a scalpel, through prestressed tissue
  Sabotage sabotage = Sabotage::kNone;
  double sabotage_s = 0.9;

  std::string text() const;
};

/// A moment of the loop, at a tick of the tool.
struct HapticSample {
  double time_s = 0.0;
  Vector3 device_m = Vector3::Zero();
  Vector3 force_n = Vector3::Zero();  ///< that the tool asked for
  Contact contact;
  double stiffness_n_m = 0.0;
  ForceFault fault = ForceFault::kNone;
  bool cutting = false;
};

/// What a run showed. Energies in joule.
struct HapticResult {
  double peak_force_n = 0.0;
  double mean_force_n = 0.0;    ///< while it is held
  double oscillation = 0.0;     ///< largest swing about the trend while it is held or slid, of the mean force
  double put_in_j = 0.0;        ///< into the virtual tissue, through the motors
  double put_out_j = 0.0;       ///< of it, in all
  double port_surplus_j = 0.0;  ///< most that it had put out, less what was put in and what the tissue released
  double hand_put_in_j = 0.0;   ///< by the hand, into the device, in all
  double surplus_j = 0.0;       ///< most that the motors had put out net, less what the hand put in net and `released`
  double hand_surplus_j = 0.0;  ///< most that the hand had got out net, less `released`
  double released_j = 0.0;      ///< by the tissue, of its own energy
  double stiffness_n_m = 0.0;   ///< of the coupling, at the end of the hold
  int trips = 0;                ///< ticks that began a fault
  int refused = 0;              ///< inputs that the session did not take
  double over_limit_n = 0.0;    ///< largest force beyond the device's
  double growth_n_ms = 0.0;     ///< fastest growth of the force between two ticks
  double zero_after_s = 0.0;    ///< from the sabotage until the force is zero, counted in the loop's ticks
  double force_again_n = 0.0;   ///< largest force after it was zero
  std::vector<HapticSample> trace;
};

/// Device, loop and tissue in virtual time, in steps of 50 microseconds: samples of the encoders, ticks of the tool,
/// messages under way and steps of the simulation each at their own time. Deterministic.
class HapticRig {
 public:
  explicit HapticRig(const HapticSetup& setup);
  HapticResult run();

 private:
  static constexpr double kStep_s = 5e-5;

  struct Sample {
    double arrives_s;
    Pose pose;
    Vector3 velocity_m_s;
    Buttons buttons;
  };
  struct Force {
    double arrives_s;
    Vector3 force_n;
  };
  struct Patch {
    double arrives_s;
    std::shared_ptr<const Topology> topology;  // null where it is that of the patch before
    GridPatch patch;
  };

  void makeSession();
  bool simulationRuns() const;
  double late();
  void sample();
  void spoil(Sample& sample) const;
  void tick();
  void record(const ToolOutput& output);
  void judgeTick(const ToolOutput& output);
  void simulate();
  void showTissue();
  void deliver();
  void account();
  void finish();

  HapticSetup setup_;
  double end_s_;
  std::mt19937_64 random_;
  std::unique_ptr<Session> session_;
  VirtualDevice device_;
  Tool tool_;
  std::uint64_t n_ = 0;
  double now_s_ = 0.0;
  double next_sample_s_ = 0.0, next_tick_s_ = 0.0, nominal_tick_s_ = 0.0, next_step_s_ = 0.0, next_patch_s_ = 0.0;
  double loop_period_s_, sample_period_s_;
  std::deque<Sample> samples_under_way_;
  std::deque<Force> forces_under_way_;
  std::deque<Patch> patches_under_way_;
  std::optional<Sample> newest_;
  std::uint32_t shown_revision_ = 0;
  std::uint64_t shown_session_ = 0;
  Vector3 last_encoder_m_ = Vector3::Zero();
  Vector3 encoder_velocity_m_s_ = Vector3::Zero();
  double tissue_energy_at_start_j_ = 0.0;
  ForceFault fault_before_ = ForceFault::kNone;
  Vector3 force_before_n_ = Vector3::Zero();
  double tick_before_s_ = 0.0;
  HapticResult result_;
};

}  // namespace soft_volume::core::validate
