#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/grid/patch.h"
#include "soft_volume/incision/cut_tissue.h"
#include "soft_volume/incision/mesh_topology.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/simulation/simulation.h"
#include "soft_volume/tool/tool_command.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core {

/// What became of an input.
struct Verdict {
  bool applied = false;
  std::string reason;  ///< why it was refused; empty when it was applied
};

/// Another integrator from now on.
struct IntegratorCommand {
  Integrator integrator = Integrator::kSymplecticEuler;
  double dt_s = 0.0;  ///< 0: automatic
};

/// Takes away a part of the tissue that is parted from the rest: the one that a cell of the topology belongs to.
struct RemovalCommand {
  std::uint64_t session = 0;
  std::uint32_t cell = 0;
};

/// Simulated time as a function of the step. The time step may change during a run; time goes on.
struct SimulationClock {
  std::uint64_t since_step = 0;  ///< step from which on `dt_s` counts
  double since_time_s = 0.0;     ///< simulated time at that step
  double dt_s = 0.0;

  double at(std::uint64_t step) const { return since_time_s + static_cast<double>(step - since_step) * dt_s; }
};

/// All that a bit-exact continuation needs together with scene and volume; mirrors the message SimulationCheckpoint.
struct Checkpoint {
  std::uint64_t session = 0;
  std::uint32_t revision = 0;
  std::uint64_t scene_hash = 0;
  std::uint64_t volume_hash = 0;
  IncisionState incisions;
  SimulationState state;
  Integrator integrator = Integrator::kSymplecticEuler;
  SimulationClock clock;
  std::map<std::string, std::uint64_t> sequences;  ///< last sequence number accepted, by "topic tool_id"
};

/// What blades did since the session was made.
struct CutCounts {
  std::uint64_t faces_opened = 0;
  /// Stretches of a stroke that opened nothing: outside of the tissue, in fixed tissue, where it was cut before, or too
  /// narrow to cut.
  std::uint64_t in_vain = 0;
};

/// A run of a scene: the only place where inputs meet the simulation. Live nodes and the offline replay call the same
/// functions in the same order, which is why a replay is bit-identical.
///
/// An input that cannot be used is refused with a reason and leaves the state as it was. Not thread-safe.
class Session {
 public:
  /// Builds the lattice and finds the time step where the scene leaves it open. `labels` may be null. `id` is not 0.
  /// Throws SceneError when scene and volume do not fit, or for a time step beyond the stability limit.
  Session(const Scene& scene, std::shared_ptr<const Volume> volume, std::shared_ptr<const Volume> labels,
          std::uint64_t id, int threads);
  Session(const Session&) = delete;
  Session& operator=(const Session&) = delete;

  /// Refused: another session, a revision that was not current within the last 100 steps, an old sequence number, a
  /// tool that the scene does not have, a value that is not finite or out of range, a footprint without tissue, a
  /// pressed cell that the grid does not have, a step that has passed.
  Verdict apply(const ToolForceCommand& command);
  /// Refused for the same reasons, and without quads unless the blade was lifted. A cut that meets no tissue is applied
  /// and changes nothing.
  Verdict apply(const ToolCutCommand& command);
  /// Closes the tool's jaws at the first message, moves them at those that follow, and opens them. Refused for the same
  /// reasons.
  Verdict apply(const ToolGripCommand& command);
  /// Refused: another session, a cell that does not exist or was removed, the largest part. Tools that hold the part
  /// let go.
  Verdict apply(const RemovalCommand& command);
  /// Refused when the step is beyond the integrator's stability limit.
  Verdict apply(const IntegratorCommand& command);
  /// Continues where the checkpoint was taken, in this session; meant for a session that has done no step yet, because
  /// step and revision become those of the checkpoint. Refused when it was taken from another scene or volume, or does
  /// not hold together.
  Verdict apply(const Checkpoint& checkpoint);

  void step();

  std::uint64_t id() const { return id_; }
  std::uint64_t steps() const { return simulation_.state().step; }
  double simulationTime() const { return clock_.at(steps()); }
  /// At a step from the last change of the time step on, if that does not change again.
  double simulationTimeAt(std::uint64_t step) const { return clock_.at(step); }
  double timeStep() const { return clock_.dt_s; }
  /// As it was at the start, with the time step resolved; what changed since is in simulation().settings().
  const Scene& scene() const { return scene_; }
  const std::shared_ptr<const Volume>& volume() const { return volume_; }
  const std::shared_ptr<const Volume>& labels() const { return labels_; }
  const Lattice& lattice() const { return lattice_; }
  const Simulation& simulation() const { return simulation_; }
  std::uint64_t sceneHash() const { return scene_hash_; }
  std::uint64_t volumeHash() const { return volume_hash_; }

  /// What receivers see: the pieces that incisions made of the cells, numbered as those of the cut mesh.
  Topology topology() const { return makeTopology(tissue_.mesh(), lattice_, volume_->geometry(), id_); }
  /// The change that the last cut made to it, from the revision before.
  TopologyDelta topologyChange() const {
    return makeTopologyDelta(tissue_.mesh(), lattice_, volume_->geometry(), id_, before_cut_, changed_pieces_);
  }
  const CutTissue& tissue() const { return tissue_; }
  /// Deformed positions of the topology's vertices, volume frame, metres.
  std::vector<Vector3> drawnPositions() const { return tissue_.drawnPositions(lattice_, simulation_.positions()); }
  /// The pieces of cells with a vertex within `radius_m` of a point; empty when there are none.
  GridPatch patch(const std::string& tool_id, const Vector3& point_m, double radius_m) const;
  Checkpoint checkpoint() const;
  /// The parts that the tissue fell into, the largest first.
  const std::vector<TissuePart>& parts() const;
  /// Largest distance of a vertex of the topology from rest, metres.
  double maxDisplacement() const;
  const CutCounts& cutCounts() const { return cut_counts_; }
  double cutOpening() const { return tissue_.opening(lattice_, simulation_.positions()); }
  /// Largest stable time step of the explicit integrators, seconds; infinite when nothing can move.
  double timeStepLimit() const { return simulation_.stabilityLimit(); }

 private:
  std::string checkHeader(const char* topic, const ToolCommandHeader& header) const;
  void accept(const char* topic, const ToolCommandHeader& header);
  bool nearLattice(const Vector3& point_m) const;

  std::vector<std::uint32_t> carriers(const ToolForceCommand& command) const;
  TopologyMark topologyMark() const;
  std::string grip(const ToolGripCommand& command);

  Scene scene_;
  std::shared_ptr<const Volume> volume_;
  std::shared_ptr<const Volume> labels_;
  std::uint64_t id_;
  std::uint64_t volume_hash_;
  Lattice lattice_;
  CutTissue tissue_;
  TopologyMark before_cut_;                    ///< the last one
  std::vector<std::uint32_t> changed_pieces_;  ///< by it
  Simulation simulation_;
  SimulationClock clock_;
  std::uint64_t scene_hash_;  ///< of the scene with its time step resolved
  std::map<std::string, std::uint64_t> sequences_;
  CutCounts cut_counts_;
  mutable std::vector<TissuePart> parts_;
  mutable std::uint32_t parts_revision_ = 0;           // that parts_ are of
  std::map<std::string, double> blade_resistances_n_;  // of the strokes under way, by tool
};

}  // namespace soft_volume::core
