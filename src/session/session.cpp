#include "soft_volume/session/session.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/incision/incision.h"

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

/// Throws InputError unless the checkpoint's lattice is one that incisions can make of `pristine`.
void checkLattice(const Checkpoint& checkpoint, const Lattice& pristine, std::size_t pristine_vertices) {
  const std::size_t cells = pristine.cellCount();
  if (checkpoint.cells.size() != cells || checkpoint.face_neighbours.size() != cells ||
      checkpoint.cut_faces.size() != cells || checkpoint.rest_stretch.size() != cells ||
      checkpoint.origin_vertices.size() < pristine_vertices) {
    throw InputError("the checkpoint belongs to another lattice: its cell or vertex count differs");
  }
  const std::size_t vertices = checkpoint.origin_vertices.size();
  for (std::uint32_t v = 0; v < vertices; ++v) {
    const std::uint32_t origin = checkpoint.origin_vertices[v];
    if (v < pristine_vertices ? origin != v : origin >= v) {
      throw InputError("the checkpoint replicates a vertex that does not exist");
    }
  }
  for (std::size_t c = 0; c < cells; ++c) {
    for (const std::uint32_t v : checkpoint.cells[c]) {
      if (v >= vertices)
        throw InputError("the checkpoint's cells name a vertex that does not exist");
    }
    for (const std::int32_t n : checkpoint.face_neighbours[c]) {
      if (n < Lattice::kNone || n >= static_cast<std::int64_t>(cells)) {
        throw InputError("the checkpoint's cells name a neighbour that does not exist");
      }
    }
    const Vector3& stretch = checkpoint.rest_stretch[c];
    if (!isFinite(stretch) || stretch.minCoeff() <= 0.0) {
      throw InputError("the checkpoint's rest stretch is not positive");
    }
  }
}

void checkClock(const Checkpoint& checkpoint) {
  const SimulationClock& clock = checkpoint.clock;
  const bool counts = clock.dt_s > 0.0 && clock.dt_s <= kMaxTimeStep_s && std::isfinite(clock.since_time_s) &&
                      clock.since_time_s >= 0.0 && clock.since_step <= checkpoint.state.step;
  if (!counts)
    throw InputError("the checkpoint's time or time step is out of range");
}

Lattice restoredLattice(const Lattice& current, const Checkpoint& checkpoint) {
  Lattice lattice = current;
  lattice.revision = checkpoint.revision;
  lattice.cells = checkpoint.cells;
  lattice.face_neighbours = checkpoint.face_neighbours;
  lattice.cut_faces = checkpoint.cut_faces;
  lattice.rest_stretch = checkpoint.rest_stretch;
  lattice.origin_vertices = checkpoint.origin_vertices;
  const std::size_t vertices = lattice.origin_vertices.size();
  lattice.rest_positions.resize(vertices);
  lattice.fixed.resize(vertices);
  lattice.lattice_nodes.resize(vertices);
  for (std::size_t v = 0; v < vertices; ++v) {
    const std::uint32_t origin = lattice.origin_vertices[v];
    lattice.rest_positions[v] = lattice.rest_positions[origin];
    lattice.fixed[v] = lattice.fixed[origin];
    lattice.lattice_nodes[v] = lattice.lattice_nodes[origin];
  }
  return lattice;
}

std::size_t pristineVertices(const Lattice& lattice) {
  std::size_t count = 0;
  while (count < lattice.vertexCount() && lattice.origin_vertices[count] == count)
    ++count;
  return count;
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
  if (command.force_n.isZero(0.0)) {
    simulation_.releaseForce(command.header.tool_id);
  } else if (!nearLattice(command.point_m) ||
             !simulation_.holdForce(command.header.tool_id, command.force_n, command.point_m,
                                    command.footprint_radius_m, steps() + command.hold_steps)) {
    return {false, "no tissue lies within the footprint"};
  }
  accept(kForceTopic, command.header);
  return {true, ""};
}

Verdict Session::apply(const ToolCutCommand& command) {
  const std::string problem = checkHeader(kCutTopic, command.header);
  if (!problem.empty())
    return {false, problem};
  if ((command.quads.empty() && !command.lifted) || command.quads.size() > kMaxQuads)
    return {false, "the number of quads is outside [1, 10000]"};
  if (!allFinite(command))
    return {false, "a point of the blade is not finite"};
  for (const SweptQuad& quad : command.quads) {
    if (!std::all_of(quad.begin(), quad.end(), [this](const Vector3& p) { return nearLattice(p); })) {
      return {false, "a point of the blade is far outside the lattice"};
    }
  }
  const IncisionResult result = cutLattice(lattice_, scene_.materials, simulation_.positions(), simulation_.reach(),
                                           command.quads, scene_.incision);
  if (result.faces_opened > 0) {
    simulation_.adoptTopology();
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
  const Lattice before = lattice_;
  try {
    checkLattice(checkpoint, lattice_, pristineVertices(lattice_));
    checkClock(checkpoint);
    lattice_ = restoredLattice(lattice_, checkpoint);
    SimulationSettings settings = scene_.simulation;
    settings.integrator = checkpoint.integrator;
    settings.dt_s = checkpoint.clock.dt_s;
    Simulation restored(lattice_, scene_.materials, settings, simulation_.threads());
    restored.restore(checkpoint.state);
    simulation_ = std::move(restored);
  } catch (const Error& error) {
    lattice_ = before;
    return {false, error.what()};
  }
  clock_ = checkpoint.clock;
  sequences_ = checkpoint.sequences;
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
  patch.cell_ids = simulation_.cellsNear(point_m, radius_m);
  for (const std::uint32_t cell : patch.cell_ids) {
    const Material& material = scene_.materials[lattice_.materials[cell]];
    patch.stiffness_pa.push_back(static_cast<float>(material.youngs_modulus_pa));
    patch.cut_resistance_j_m2.push_back(static_cast<float>(material.cut_resistance_j_m2));
    patch.vertex_ids.insert(patch.vertex_ids.end(), lattice_.cells[cell].begin(), lattice_.cells[cell].end());
  }
  std::sort(patch.vertex_ids.begin(), patch.vertex_ids.end());
  patch.vertex_ids.erase(std::unique(patch.vertex_ids.begin(), patch.vertex_ids.end()), patch.vertex_ids.end());
  for (const std::uint32_t v : patch.vertex_ids) {
    patch.positions.push_back(simulation_.positions()[v].cast<float>());
    patch.velocities.push_back(simulation_.velocities()[v].cast<float>());
  }
  return patch;
}

Checkpoint Session::checkpoint() const {
  Checkpoint checkpoint;
  checkpoint.session = id_;
  checkpoint.revision = lattice_.revision;
  checkpoint.scene_hash = scene_hash_;
  checkpoint.volume_hash = volume_hash_;
  checkpoint.cells = lattice_.cells;
  checkpoint.face_neighbours = lattice_.face_neighbours;
  checkpoint.cut_faces = lattice_.cut_faces;
  checkpoint.rest_stretch = lattice_.rest_stretch;
  checkpoint.origin_vertices = lattice_.origin_vertices;
  checkpoint.state = simulation_.state();
  checkpoint.integrator = simulation_.settings().integrator;
  checkpoint.clock = clock_;
  checkpoint.sequences = sequences_;
  return checkpoint;
}

}  // namespace soft_volume::core
