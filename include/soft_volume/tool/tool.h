#pragma once

#include <array>
#include <bitset>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "soft_volume/common/geometry.h"
#include "soft_volume/common/named_choice.h"
#include "soft_volume/grid/patch.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/tool/contact.h"
#include "soft_volume/tool/coupling.h"
#include "soft_volume/tool/cut_resistance.h"
#include "soft_volume/tool/force_limiter.h"
#include "soft_volume/tool/grasp.h"
#include "soft_volume/tool/passivity.h"
#include "soft_volume/tool/patch_intake.h"
#include "soft_volume/tool/proxy.h"
#include "soft_volume/tool/scalpel.h"
#include "soft_volume/tool/tool_command.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// The device's buttons, bit i for button i.
using Buttons = std::bitset<32>;

/// Values are those of the message ToolState.
enum class ToolKind : std::uint8_t { kProbe = 0, kScalpel = 1, kGrasper = 2 };
template <>
inline constexpr std::array<NamedChoice<ToolKind>, 3> kChoices<ToolKind>{
    {{"probe", ToolKind::kProbe}, {"scalpel", ToolKind::kScalpel}, {"grasper", ToolKind::kGrasper}}};

/// A tool of the scene.
struct ToolConfig {
  std::string id = "probe";  ///< not empty
  ToolKind kind = ToolKind::kProbe;
  double tissue_threshold = 0.0;  ///< intensity from which on there is tissue, in the volume's unit; finite
  double tip_radius_m = 0.004;    ///< sphere that touches; [0.0005, 0.05]
  /// Radius over which the tissue takes the force; [0.001, 0.1]. Below twice the lattice's spacing only a few vertices
  /// carry it, and the loop of device, tool and a lightly damped lattice buzzes.
  double footprint_radius_m = 0.016;
  double patch_radius_m = 0.03;       ///< cells within this distance of the tip are asked for; [0.005, 0.2]
  double friction_coefficient = 0.0;  ///< of Coulomb's friction between tip and tissue; [0, 2]
  std::uint32_t hold_steps = 50;      ///< steps for which the tissue holds a force without a successor; [1, 10000]
  CouplingConfig coupling;
  DeviceLimits device;
  SafetyConfig safety;

  // Scalpel only.
  double blade_length_m = 0.02;      ///< edge from the tip along the tool's +z axis; [0.001, 0.1]
  double blade_min_move_m = 0.0005;  ///< a blade that moves less cuts nothing yet; [0.00005, 0.01]
  double cutting_drag_n_s_m = 0.1;   ///< drag on the blade while it cuts; [0, coupling.device_damping_n_s_m]
  std::uint32_t cut_button = 0;      ///< button that cuts while held; [0, 31]

  // Grasper only.
  double grasp_reach_m = 0.005;    ///< closing jaws grip tissue that is no farther from the tip; [0.0005, 0.05]
  double slip_force_n = 3.0;       ///< the jaws let go when they pull harder; (0, 100]
  std::uint32_t grasp_button = 0;  ///< button that keeps the jaws closed while held; [0, 31]

  /// Throws SceneError with the tool, the field and its range.
  void validate() const;
};

/// What a driver reports. Call at the device's rate or faster, also when nothing new came.
struct ToolInput {
  double time_s = 0.0;        ///< now, on the caller's clock; finite
  double pose_time_s = 0.0;   ///< when the newest pose was received (or stamped, if the clock is the same one)
  double pose_delay_s = 0.0;  ///< from its measurement to pose_time_s, where that is known; finite, not negative
  std::optional<double> pose_stamp_s;   ///< of its measurement on the device's own clock, where it has one
  Pose pose;                            ///< tip of the tool, volume frame; any values: unusable ones are a fault
  std::optional<Vector3> velocity_m_s;  ///< of the tip, where the device measures it; estimated otherwise
  Buttons buttons;
  bool forces_allowed = true;  ///< false: the device is not enabled or clutched, and force goes to zero as in a fault
};

/// What follows from one input; everything that the messages ToolForce, ToolCut, ToolState and servo_cf need. Of a
/// fixed size: copying it takes no memory. toCommand() makes full commands of `force` and `cut`.
struct ToolOutput {
  std::optional<TissueForce> force;          ///< to the tissue; sent once with zero force when a contact ends
  std::optional<TissueCut> cut;              ///< to the tissue; also, without a quad, once a stroke ends
  Vector3 device_force_n = Vector3::Zero();  ///< to the device; opposes the push
  Vector3 velocity_m_s = Vector3::Zero();    ///< of the tip, as used
  Contact contact;                           ///< none during a fault
  TickHeader patch;                          ///< session, revision and step of the patch in use; zeros before one came
  bool cutting = false;                      ///< the blade is in tissue and the button is held
  bool gripping = false;                     ///< the jaws hold tissue
  Vector3 grip_point_m = Vector3::Zero();    ///< point of the tissue that they hold
  double coupling_stiffness_n_m = 0.0;       ///< rendered
  StiffnessBound stiffness_bound = StiffnessBound::kWish;  ///< what it is bounded by
  LoopTiming timing;                                       ///< that the coupling allows for
  double patch_interval_s = 0.0;                           ///< usual one; 0 before two patches came
  double made_energy_j = 0.0;  ///< by sampling and delay, not taken out yet (passivity.h); losses of late below zero
  double passivity_damping_n_s_m = 0.0;  ///< that takes it out
  ForceFault fault = ForceFault::kNone;
  bool pose_stale = false;   ///< no usable pose: stale or not finite
  bool patch_stale = false;  ///< no patch from the simulation within the time limit
  bool saturated = false;
  bool slew_limited = false;
  bool tripped = false;
};

/// A probe, a scalpel or a grasper between a haptic device and the tissue.
///
/// The tissue gets exactly the opposite of the force that the device is asked to render, after all limits (Newton's
/// third law): a limited, ramping or dead device never pushes the tissue harder than the hand feels.
///
/// A scalpel presses like a probe until its button is held. While it cuts, the blade passes through the tissue and
/// feels a small viscous drag and the resistance of the tissue to being cut (cut_resistance.h), as far as the
/// simulation measures it and the device can render it. After a cut it presses again once its tip has been free: until
/// then it stays in the incision that it made.
///
/// One call of update() is one tick of the haptic loop: it takes no memory and no lock. So do takePatch() and reset();
/// the other functions take time and memory. Not thread safe: the caller serialises all calls.
class Tool {
 public:
  /// Needs a valid configuration (of a device with scaled motions the limits may be beyond their ranges). Sequence
  /// numbers start at `first_sequence`; give a larger one than before when a tool restarts while its simulation goes
  /// on, because older numbers are refused.
  explicit Tool(const ToolConfig& config, std::uint64_t first_sequence = 1);

  const ToolConfig& config() const { return config_; }

  /// The volume of the session; forgets grid and patch. Must not be null or empty.
  void setVolume(std::shared_ptr<const Volume> volume);
  /// The grid's newest revision; the patch is kept until the next one, but a new session forgets it.
  void setTopology(std::shared_ptr<const Topology> topology);
  /// The cells near the tool. Throws InputError, with the state unchanged, when the patch is for another tool, does not
  /// fit the newest topology, or came before volume and topology.
  void setPatch(const GridPatch& patch);

  /// Instead of the three above, for a loop that must not wait: takes a patch that a PatchIntake made ready, and gives
  /// back the one before (null at first). One of another session forgets the old session's contact.
  std::unique_ptr<ReadyPatch> takePatch(std::unique_ptr<ReadyPatch> patch);

  ToolOutput update(const ToolInput& input);

  /// Ends a trip, a contact and a stroke; forces start at zero again. Returns the end of the stroke where one was under
  /// way, to be sent to the tissue.
  std::optional<TissueCut> reset();
  bool tripped() const { return limiter_.tripped(); }
  /// The device tripped in the hand of another tool.
  void trip() { limiter_.trip(); }
  /// Session, revision and step of the patch in use; zeros before one came.
  const TickHeader& patchHeader() const { return header_; }
  /// Deformed cells in use; null before a volume came.
  const PatchContact* field() const { return patch_ ? &patch_->field : nullptr; }

 private:
  struct CutPose {
    Vector3 position_m;
    double time_s;
  };

  /// The coupling's spring, from the tip to the tissue.
  struct Spring {
    bool loaded = false;
    Vector3 stretch_m = Vector3::Zero();
    Vector3 surface_velocity_m_s = Vector3::Zero();
  };

  void forgetSession();
  void forgetContact();
  void watchTime(const ToolInput& input);
  void estimateVelocity(const ToolInput& input);
  Vector3 wishedForce(const ToolInput& input, ToolOutput& output);
  Vector3 cut(const ToolInput& input, ToolOutput& output);
  Vector3 resistance(const ToolInput& input, double resistance_n);
  std::optional<TissueCut> lift();
  bool grip(const ToolInput& input, ToolOutput& output);
  void press(const ToolInput& input);
  Vector3 springForce(ToolOutput& output) const;
  double tissueBound() const;
  double dampingBound() const;
  bool poseFault() const;
  void observe(const ToolInput& input, const Vector3& force_n);
  void commandForce(ToolOutput& output);
  void report(ToolOutput& output) const;
  TickHeader nextHeader(std::uint64_t& sequence) const;

  ToolConfig config_;
  PatchIntake intake_;                 // of setVolume(), setTopology() and setPatch()
  std::unique_ptr<ReadyPatch> spare_;  // that setPatch() fills next
  std::unique_ptr<ReadyPatch> patch_;  // in use
  bool patch_is_new_ = false;          // since the last tick
  PatchWatch patches_;
  TickHeader header_;
  Proxy proxy_;
  Grasp grasp_;
  Scalpel scalpel_;
  CutResistance resistance_;
  LoopMeter meter_;
  Coupling coupling_;
  PassivityControl passivity_;
  ForceLimiter limiter_;

  std::uint64_t force_sequence_;
  std::uint64_t cut_sequence_;
  Contact contact_;
  Spring spring_;
  Vector3 push_point_m_ = Vector3::Zero();  // where the tissue feels the force
  std::optional<std::uint32_t> push_cell_;  // the topology's number of the cell that is pressed
  bool pushing_ = false;                    // the tissue's last command was not zero
  bool in_incision_ = false;
  std::optional<CutPose> cut_pose_;  // of the newest update
  std::optional<double> clock_s_;    // of the newest update
  bool has_pose_ = false;
  double pose_time_s_ = 0.0;
  Vector3 position_m_ = Vector3::Zero();
  Vector3 velocity_m_s_ = Vector3::Zero();
};

}  // namespace soft_volume::core
