#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "soft_volume/grid/patch.h"
#include "soft_volume/grid/topology.h"
#include "soft_volume/scene/device_profile.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/scene/tool_rig.h"
#include "soft_volume/tool/device_streams.h"

/// Lockstep: a run in which everything that a device does enters the simulation at the time of its stamp, so that the
/// run is a function of scene, volume and device samples alone, however late messages come and however fast the
/// machine is. A live graph and the offline replay use the two classes below in the same way, and give the same bits.
///
/// - Simulated time zero is the stamp of the first sample: the epoch.
/// - The tool ticks once per sample, at the time of its stamp. Before it ticks, it tells the simulation (ToolNotice)
///   that all it sent of earlier samples is on its way, and where it is.
/// - The simulation does the step that begins at time t once every hand has told that it sent all inputs up to t. Those
///   that are stamped up to t are applied before it, in the order of their stamps.
/// - Patches are made before the step that begins at a patch's time, after the inputs of that time, around the place
///   that the newest sample up to then had. The tick at time t uses the newest patch up to t - kPatchLatency_s, and
///   waits for it.
///
/// Neither waits for the other: the patch of a sample needs only inputs of earlier samples.
namespace soft_volume::core {

/// Between a patch's state and the first tick that uses it: as long as it takes at least in a graph that does not wait.
inline constexpr double kPatchLatency_s = 0.001;

/// Nanoseconds of a time of the simulation, which begins at `epoch_ns`.
std::int64_t lockstepStamp(std::int64_t epoch_ns, double simulation_time_s);

/// Mirrors the message ToolProgress.
struct ToolNotice {
  std::string hand;                   ///< who tells; there is one tool in a hand
  std::uint64_t session = 0;          ///< run that it works in
  std::int64_t until_ns = 0;          ///< all inputs with an earlier stamp were sent
  std::string tool_id;                ///< in the hand now
  Vector3 point_m = Vector3::Zero();  ///< tip of that tool at until_ns, volume frame
  double patch_radius_m = 0.0;
  struct Sent {
    std::uint64_t force = 0;  ///< sequence number of the last one; 0 before the first
    std::uint64_t cut = 0;
  };
  std::map<std::string, Sent> sent;  ///< by tool
};

/// What a hand's tick gives.
struct HandTick {
  std::int64_t stamp_ns = 0;
  std::size_t tool = 0;   ///< of the scene's list
  bool put_down = false;  ///< the tool left the hand: only `output.cut` counts
  Pose tip;
  Buttons buttons;
  ToolOutput output;
  Vector3 servo_n = Vector3::Zero();  ///< as the driver wants it
};

/// The tools in a hand, ticked once per sample of the device. Not thread-safe.
class LockstepHand {
 public:
  /// `profile` may be null; `volume` must not be.
  LockstepHand(std::string name, const Scene& scene, const DeviceProfile* profile, double rate_hz,
               std::uint64_t session, std::shared_ptr<const Volume> volume);

  /// The grid's revisions, in order.
  void addTopology(std::shared_ptr<const Topology> topology);
  /// Patches in the order of their time; `next_ns` is the time of the one that follows. Those for other hands and of
  /// other sessions are not wanted.
  void addPatch(GridPatch patch, std::int64_t stamp_ns, std::int64_t next_ns);

  /// The next sample; before the simulation may be waited for, it has to hear the notice. Only when no other waits.
  ToolNotice take(const DeviceSample& sample);
  bool hasSample() const { return has_sample_; }
  /// The patch that the sample needs is there.
  bool ready() const;
  /// Ticks at the sample that was taken, with the patch that is there if it is not ready. `forces_allowed`: by the
  /// device. Throws InputError when the patch does not fit the grid.
  std::vector<HandTick> tick(bool forces_allowed = true);
  /// The device has been silent until now: a tick without a new sample, after which the hand is not in lockstep.
  HandTick tickSilence(double silent_s);
  /// Ends a trip; forces start at zero with the next tick.
  void reset() { reset_wanted_ = true; }

  const ToolConfig& config(std::size_t tool) const { return scene_.tools[tool]; }
  std::uint64_t session() const { return session_; }

 private:
  struct TimedPatch {
    GridPatch patch;
    std::int64_t stamp_ns;
    std::int64_t next_ns;
  };
  Tool& tool() { return *rig_.tools[selected_]; }
  void makeRig(std::int64_t first_ns);
  void swap(const Buttons& before, const Buttons& now);
  void putDown();
  const TimedPatch* wanted() const;
  void usePatch();
  double seconds(std::int64_t stamp_ns) const { return 1e-9 * static_cast<double>(stamp_ns - first_ns_); }
  HandTick makeTick(const ToolInput& input);

  std::string name_;
  Scene scene_;
  std::optional<DeviceProfile> profile_;
  double rate_hz_;
  std::uint64_t session_;
  std::shared_ptr<const Volume> volume_;
  std::map<std::uint32_t, std::shared_ptr<const Topology>> topologies_;  // by revision, from that in use on
  std::deque<TimedPatch> patches_;                                       // from that in use on
  std::int64_t used_ns_ = INT64_MIN;                                     // time of the patch in use
  std::set<std::string> held_;                                           // tools that were in the hand
  std::map<std::string, ToolNotice::Sent> sent_;

  ToolRig rig_;
  std::int64_t first_ns_ = 0;  // of the first sample
  std::size_t selected_ = 0;
  Vector3 usable_point_m_ = Vector3::Zero();
  Buttons buttons_;
  bool reset_wanted_ = false;
  bool has_sample_ = false;    // taken and not ticked yet
  std::int64_t stamp_ns_ = 0;  // of the newest one
  ToolInput input_;
  bool engaged_ = true;
  std::vector<HandTick> ticks_;  // of the sample that was taken
};

/// What the simulation knows of the hands. Not thread-safe.
class LockstepGate {
 public:
  /// Waits for so many hands before it begins.
  explicit LockstepGate(std::size_t hands = 1) : hands_wanted_(hands) {}

  /// From a hand. False when it belongs to another session, or tells of a hand that is not one of those that began.
  bool hear(const ToolNotice& notice, std::uint64_t session);
  /// An input of a tool has come.
  void countForce(const std::string& tool_id, std::uint64_t sequence);
  void countCut(const std::string& tool_id, std::uint64_t sequence);

  /// Time zero; nothing until every hand has told its first sample.
  std::optional<std::int64_t> epoch() const { return epoch_ns_; }
  /// Everything that is stamped up to this time is here.
  bool complete(std::int64_t time_ns) const;
  /// The newest notice of every hand up to a time, or its first; forgets older ones.
  std::vector<ToolNotice> noticesAt(std::int64_t time_ns);
  /// A hand that complete() waits for; empty when there is none.
  std::string waitsFor(std::int64_t time_ns) const;

 private:
  bool hasSent(const ToolNotice& notice) const;

  std::size_t hands_wanted_;
  std::optional<std::int64_t> epoch_ns_;
  std::map<std::string, std::deque<ToolNotice>> notices_;
  std::map<std::string, ToolNotice::Sent> received_;
};

/// Inputs in the order in which they are applied: by stamp, tool, kind (cuts before forces before grips) and number.
template <typename Input>
class LockstepInputs {
 public:
  enum class Kind { kCut, kForce, kGrip, kOther };

  void add(std::int64_t stamp_ns, const std::string& tool_id, Kind kind, std::uint64_t sequence, Input input) {
    inputs_.emplace(Key{stamp_ns, tool_id, kind, sequence}, std::move(input));
  }
  /// Those that are stamped up to a time.
  std::vector<Input> take(std::int64_t time_ns) {
    std::vector<Input> taken;
    while (!inputs_.empty() && std::get<0>(inputs_.begin()->first) <= time_ns) {
      taken.push_back(std::move(inputs_.begin()->second));
      inputs_.erase(inputs_.begin());
    }
    return taken;
  }
  std::size_t size() const { return inputs_.size(); }
  void clear() { inputs_.clear(); }

 private:
  using Key = std::tuple<std::int64_t, std::string, Kind, std::uint64_t>;
  std::multimap<Key, Input> inputs_;
};

}  // namespace soft_volume::core
