#include "soft_volume/session/session.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"

namespace soft_volume::core {
namespace {

constexpr char kForceTopic[] = "tool/force";
constexpr char kCutTopic[] = "tool/cut";
constexpr char kGripTopic[] = "tool/grip";
constexpr std::uint32_t kMaxHoldSteps = 10000;
/// Of a footprint and of jaws.
constexpr double kMaxRadius_m = 0.1;
/// Longest time step of an implicit integrator.
constexpr double kMaxTimeStep_s = 10.0;
/// A tool computes on what it saw a moment ago: while it cuts, its messages are one or more revisions behind. Points
/// and forces do not depend on the numbering, so a revision may be old if the patch that it belongs to is not.
constexpr std::uint64_t kMaxRevisionLagSteps = 100;
/// A sweep between two poses of a device is a fraction of a millimetre; this many in one message is no blade.
constexpr std::size_t kMaxQuads = 10000;
/// Metres of travel over which a blade's resistance is averaged. A sweep may open nothing, where it turns or follows
/// what is open already, and the next one twice as much: cells decide that, and no hand should feel them.
constexpr double kResistanceTravel = 0.002;
/// A tip presses one cell, jaws or a plate a few.
constexpr std::size_t kMaxPressedCells = 64;

std::string sequenceKey(const char* topic, const std::string& tool_id) {
  return std::string(topic) + " " + tool_id;
}

std::uint64_t hashText(const std::string& text) {
  return hashBytes(text.data(), text.size());
}

bool isRadius(double radius_m) {
  return radius_m > 0.0 && radius_m <= kMaxRadius_m;
}

bool isHoldTime(std::uint32_t steps) {
  return steps >= 1 && steps <= kMaxHoldSteps;
}

bool allFinite(const ToolCutCommand& command) {
  for (const SweptQuad& quad : command.quads) {
    for (const Vector3& p : quad) {
      if (!isFinite(p))
        return false;
    }
  }
  return true;
}

void checkClock(const Checkpoint& checkpoint) {
  const SimulationClock& clock = checkpoint.clock;
  const bool counts = clock.dt_s > 0.0 && clock.dt_s <= kMaxTimeStep_s && std::isfinite(clock.since_time_s) &&
                      clock.since_time_s >= 0.0 && clock.since_step <= checkpoint.state.step;
  if (!counts)
    throw InputError("the checkpoint's time or time step is out of range");
}

/// The state with some vertices (increasing) at rest, and without the forces and grips that act on any of them.
SimulationState without(const std::vector<std::uint32_t>& gone, SimulationState state) {
  for (const std::uint32_t v : gone)
    state.displacements_m[v] = state.velocities_m_s[v] = Vector3::Zero();
  const auto drop = [&gone](auto& held) {
    for (auto it = held.begin(); it != held.end();) {
      const auto& vertices = it->second.vertices;
      const bool acts = std::any_of(vertices.begin(), vertices.end(),
                                    [&](std::uint32_t v) { return std::binary_search(gone.begin(), gone.end(), v); });
      it = acts ? held.erase(it) : std::next(it);
    }
  };
  drop(state.forces);
  drop(state.grips);
  return state;
}

}  // namespace

Session::Session(const Scene& scene, std::shared_ptr<const Volume> volume, std::shared_ptr<const Volume> labels,
                 std::uint64_t id, int threads)
    : scene_(scene),
      volume_(std::move(volume)),
      labels_(std::move(labels)),
      id_(id),
      volume_hash_(volume_->hash()),
      lattice_(buildLattice(*volume_, labels_.get(), scene_.materials, scene_.lattice)),
      tissue_(lattice_, scene_.incision),
      simulation_(lattice_, scene_.materials, scene_.simulation, threads) {
  // A bag holds the numbers that automatic values came to, so that a replay cannot find others.
  scene_.simulation = simulation_.settings();
  fitTransferFunction(scene_.rendering, *volume_);
  scene_hash_ = hashText(writeScene(scene_));
  clock_.dt_s = scene_.simulation.dt_s;
}

bool Session::nearLattice(const Vector3& point_m) const {
  const Vector3 size = lattice_.spacing_m.cwiseProduct(lattice_.dims.cast<double>());
  const Box3 box(Vector3(lattice_.origin_m - size), Vector3(lattice_.origin_m + 2.0 * size));
  return box.contains(point_m);
}

std::string Session::checkHeader(const char* topic, const ToolCommandHeader& header) const {
  if (header.session != id_)
    return "it is meant for another session";
  const bool existed = header.revision >= 1 && header.revision < lattice_.revision;
  const bool overtaken = existed && header.step + kMaxRevisionLagSteps >= steps();
  if (header.revision != lattice_.revision && !overtaken) {
    return "it was computed on revision " + std::to_string(header.revision) + "; the grid has revision " +
           std::to_string(lattice_.revision);
  }
  if (scene_.findTool(header.tool_id) == nullptr)
    return "the scene has no tool '" + header.tool_id + "'";
  const auto last = sequences_.find(sequenceKey(topic, header.tool_id));
  if (last != sequences_.end() && header.sequence <= last->second) {
    return "sequence " + std::to_string(header.sequence) + " is not newer than " + std::to_string(last->second);
  }
  if (header.apply_at_step != 0 && header.apply_at_step <= steps()) {
    return "it was to be applied at step " + std::to_string(header.apply_at_step) + ", which has passed";
  }
  return "";
}

void Session::accept(const char* topic, const ToolCommandHeader& header) {
  sequences_[sequenceKey(topic, header.tool_id)] = header.sequence;
}

/// The lattice's cells that carry the pieces which a force presses.
std::vector<std::uint32_t> Session::carriers(const ToolForceCommand& command) const {
  std::vector<std::uint32_t> cells;
  for (const std::uint32_t piece : command.cells)
    cells.push_back(tissue_.embedding().cellOf(piece));
  return cells;
}

Verdict Session::apply(const ToolForceCommand& command) {
  const std::string problem = checkHeader(kForceTopic, command.header);
  if (!problem.empty())
    return {false, problem};
  if (!isFinite(command.force_n) || !isFinite(command.point_m))
    return {false, "force or point is not finite"};
  if (command.force_n.norm() > scene_.max_tool_force_n) {
    return {false, "a force beyond the scene's max_tool_force_n of " + std::to_string(scene_.max_tool_force_n) + " N"};
  }
  if (!isRadius(command.footprint_radius_m))
    return {false, "a footprint radius outside (0, 0.1] m"};
  if (!isHoldTime(command.hold_steps))
    return {false, "hold_steps outside [1, 10000]"};
  const std::size_t pieces = tissue_.mesh().pieces().size();
  if (command.cells.size() > kMaxPressedCells ||
      std::any_of(command.cells.begin(), command.cells.end(), [pieces](std::uint32_t c) { return c >= pieces; }))
    return {false, "a pressed cell that the grid does not have, or more than 64"};
  if (command.force_n.isZero(0.0)) {
    simulation_.releaseForce(command.header.tool_id);
  } else if (!nearLattice(command.point_m) ||
             !simulation_.holdForce(command.header.tool_id, command.force_n, command.point_m,
                                    command.footprint_radius_m, steps() + command.hold_steps, carriers(command))) {
    return {false, "no tissue lies within the footprint"};
  }
  accept(kForceTopic, command.header);
  return {true, ""};
}

TopologyMark Session::topologyMark() const {
  return {lattice_.revision, tissue_.mesh().vertexCount(), tissue_.mesh().pieces().size()};
}

Verdict Session::apply(const ToolCutCommand& command) {
  const std::string problem = checkHeader(kCutTopic, command.header);
  if (!problem.empty())
    return {false, problem};
  if (command.quads.size() > kMaxQuads || (command.quads.empty() && !command.lifted))
    return {false, "the number of quads is outside [1, 10000], and the blade was not lifted"};
  if (!allFinite(command))
    return {false, "a point of the blade is not finite"};
  for (const SweptQuad& quad : command.quads) {
    if (!std::all_of(quad.begin(), quad.end(), [this](const Vector3& p) { return nearLattice(p); })) {
      return {false, "a point of the blade is far outside the lattice"};
    }
  }
  const TopologyMark before = topologyMark();
  IncisionResult result = tissue_.cut(lattice_, scene_.materials, simulation_.positions(), simulation_.reach(),
                                      command.header.tool_id, command.quads, command.lifted);
  cut_counts_.faces_opened += result.faces_opened;
  cut_counts_.in_vain += result.travel_m > 0.0 && result.faces_opened == 0 ? 1 : 0;
  if (command.lifted) {
    blade_resistances_n_.erase(command.header.tool_id);
  } else if (result.travel_m > 0.0) {
    double& resistance_n = blade_resistances_n_[command.header.tool_id];
    const double share = 1.0 - std::exp(-result.travel_m / kResistanceTravel);
    resistance_n += share * (result.energy_j / result.travel_m - resistance_n);
  }
  if (!result.changed_pieces.empty()) {
    before_cut_ = before;
    changed_pieces_ = std::move(result.changed_pieces);
    simulation_.adoptTopology();
    simulation_.setLips(std::move(result.lips));
    simulation_.wake(result.rest_box_m);
  }
  accept(kCutTopic, command.header);
  return {true, ""};
}

/// Why closed jaws cannot hold or move, or nothing.
std::string Session::grip(const ToolGripCommand& command) {
  if (!isFinite(command.point_m) || !isUsable(command.pose))
    return "point or pose is not finite, or the orientation is no unit quaternion";
  if (!isRadius(command.radius_m))
    return "a grip radius outside (0, 0.1] m";
  if (!isHoldTime(command.hold_steps))
    return "hold_steps outside [1, 10000]";
  if (!nearLattice(command.pose.position_m))
    return "the jaws are far outside the lattice";
  const std::string& tool_id = command.header.tool_id;
  const Pose pose{command.pose.position_m, command.pose.orientation.normalized()};
  const std::uint64_t expires_at_step = steps() + command.hold_steps;
  if (simulation_.moveGrip(tool_id, pose, expires_at_step))
    return "";
  const bool holds = nearLattice(command.point_m) &&
                     simulation_.closeGrip(tool_id, command.point_m, command.radius_m, pose, expires_at_step);
  return holds ? "" : "no tissue that can move lies between the jaws";
}

Verdict Session::apply(const ToolGripCommand& command) {
  std::string problem = checkHeader(kGripTopic, command.header);
  if (problem.empty() && command.closed)
    problem = grip(command);
  if (!problem.empty())
    return {false, problem};
  if (!command.closed)
    simulation_.releaseGrip(command.header.tool_id);
  accept(kGripTopic, command.header);
  return {true, ""};
}

double Session::maxDisplacement() const {
  const std::vector<Vector3> drawn = drawnPositions();
  const std::vector<Vector3>& rest = tissue_.mesh().restPositions();
  double squared = 0.0;
  for (std::size_t v = 0; v < drawn.size(); ++v)
    squared = std::max(squared, (drawn[v] - rest[v]).squaredNorm());
  return std::sqrt(squared);
}

const std::vector<TissuePart>& Session::parts() const {
  if (parts_revision_ != lattice_.revision) {
    parts_ = tissue_.parts(lattice_);
    parts_revision_ = lattice_.revision;
  }
  return parts_;
}

Verdict Session::apply(const RemovalCommand& command) {
  if (command.session != id_)
    return {false, "it is meant for another session"};
  const std::vector<CutMesh::Piece>& pieces = tissue_.mesh().pieces();
  if (command.cell >= pieces.size() || pieces[command.cell].faces.empty())
    return {false, "the grid has no cell " + std::to_string(command.cell) + ", or it was removed before"};
  const std::vector<std::uint32_t> islands = tissue_.mesh().islands();
  if (islands[command.cell] == islands[parts().front().piece])
    return {false, "cell " + std::to_string(command.cell) + " belongs to the largest part of the tissue, which stays"};
  const std::vector<std::uint32_t> gone = tissue_.removePart(lattice_, command.cell);
  simulation_.adoptTopology();
  simulation_.restore(without(gone, simulation_.state()));
  simulation_.setLips(tissue_.lips(lattice_, scene_.materials));
  return {true, ""};
}

Verdict Session::apply(const IntegratorCommand& command) {
  if (!(command.dt_s >= 0.0 && command.dt_s <= kMaxTimeStep_s))
    return {false, "a time step outside [0, 10] s, where 0 is automatic"};
  try {
    simulation_.setIntegrator(command.integrator, command.dt_s);
  } catch (const Error& error) {
    return {false, error.what()};
  }
  const double now_s = simulationTime();
  clock_ = {steps(), now_s, simulation_.settings().dt_s};
  return {true, ""};
}

Verdict Session::apply(const Checkpoint& checkpoint) {
  if (checkpoint.scene_hash != scene_hash_)
    return {false, "the checkpoint belongs to another scene"};
  if (checkpoint.volume_hash != volume_hash_)
    return {false, "the checkpoint belongs to another volume"};
  if ((checkpoint.revision == 1) != checkpoint.incisions.cells.empty())
    return {false, "the checkpoint's revision does not fit its incisions"};
  const Lattice before = lattice_;
  try {
    checkClock(checkpoint);
    lattice_ = buildLattice(*volume_, labels_.get(), scene_.materials, scene_.lattice);
    CutTissue tissue(checkpoint.incisions, lattice_, scene_.incision);
    lattice_.revision = checkpoint.revision;
    SimulationSettings settings = scene_.simulation;
    settings.integrator = checkpoint.integrator;
    settings.dt_s = checkpoint.clock.dt_s;
    Simulation restored(lattice_, scene_.materials, settings, simulation_.threads());
    restored.restore(checkpoint.state);
    restored.setLips(tissue.lips(lattice_, scene_.materials));
    simulation_ = std::move(restored);
    tissue_ = std::move(tissue);
  } catch (const Error& error) {
    lattice_ = before;
    return {false, error.what()};
  }
  clock_ = checkpoint.clock;
  sequences_ = checkpoint.sequences;
  blade_resistances_n_.clear();
  parts_revision_ = 0;
  return {true, ""};
}

void Session::step() {
  simulation_.step();
}

GridPatch Session::patch(const std::string& tool_id, const Vector3& point_m, double radius_m) const {
  GridPatch patch;
  patch.session = id_;
  patch.revision = lattice_.revision;
  patch.step = steps();
  patch.tool_id = tool_id;
  const auto resistance = blade_resistances_n_.find(tool_id);
  patch.blade_resistance_n = resistance == blade_resistances_n_.end() ? 0.0 : resistance->second;
  const CutMesh& mesh = tissue_.mesh();
  const Embedding& embedding = tissue_.embedding();
  for (const std::uint32_t cell : simulation_.cellsNear(point_m, radius_m)) {
    for (const std::uint32_t piece : mesh.piecesOfCell(lattice_.firstCell(cell))) {
      if (embedding.cellOf(piece) == cell)
        patch.cell_ids.push_back(piece);
    }
  }
  std::sort(patch.cell_ids.begin(), patch.cell_ids.end());
  for (const std::uint32_t piece : patch.cell_ids) {
    const Material& material = scene_.materials[lattice_.materials[mesh.pieces()[piece].cell]];
    patch.stiffness_pa.push_back(static_cast<float>(material.youngs_modulus_pa));
    patch.cut_resistance_j_m2.push_back(static_cast<float>(material.cut_resistance_j_m2));
    const std::vector<std::uint32_t> vertices = mesh.verticesOf(piece);
    patch.vertex_ids.insert(patch.vertex_ids.end(), vertices.begin(), vertices.end());
  }
  std::sort(patch.vertex_ids.begin(), patch.vertex_ids.end());
  patch.vertex_ids.erase(std::unique(patch.vertex_ids.begin(), patch.vertex_ids.end()), patch.vertex_ids.end());
  for (const std::uint32_t v : patch.vertex_ids) {
    patch.positions.push_back(embedding.place(mesh, lattice_, simulation_.positions(), v).cast<float>());
    patch.velocities.push_back(embedding.place(mesh, lattice_, simulation_.velocities(), v).cast<float>());
  }
  return patch;
}

Checkpoint Session::checkpoint() const {
  Checkpoint checkpoint;
  checkpoint.session = id_;
  checkpoint.revision = lattice_.revision;
  checkpoint.scene_hash = scene_hash_;
  checkpoint.volume_hash = volume_hash_;
  checkpoint.incisions = tissue_.state(lattice_);
  checkpoint.state = simulation_.state();
  checkpoint.integrator = simulation_.settings().integrator;
  checkpoint.clock = clock_;
  checkpoint.sequences = sequences_;
  return checkpoint;
}

}  // namespace soft_volume::core
