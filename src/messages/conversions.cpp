#include "soft_volume/messages/conversions.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <utility>

#include "flat_arrays.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/grid/cell_shape.h"
#include "soft_volume/simulation/kernel.h"
#include "soft_volume/simulation/setting_names.h"

#ifndef SOFT_VOLUME_VERSION
#error "the build defines SOFT_VOLUME_VERSION"
#endif

namespace soft_volume {
namespace {

constexpr std::size_t kMostPartsTold = 100;
constexpr std::size_t kPublishedButtons = 8;

geometry_msgs::Point32 toPoint32(const core::Vector3f& p) {
  geometry_msgs::Point32 point;
  point.x = p.x();
  point.y = p.y();
  point.z = p.z();
  return point;
}

core::Vector3f fromPoint32(const geometry_msgs::Point32& p) {
  return {p.x, p.y, p.z};
}

std::vector<geometry_msgs::Point32> toPoints32(const std::vector<core::Vector3f>& points) {
  std::vector<geometry_msgs::Point32> result;
  result.reserve(points.size());
  for (const core::Vector3f& p : points)
    result.push_back(toPoint32(p));
  return result;
}

std::vector<core::Vector3f> fromPoints32(const std::vector<geometry_msgs::Point32>& points) {
  std::vector<core::Vector3f> result;
  result.reserve(points.size());
  for (const geometry_msgs::Point32& p : points)
    result.push_back(fromPoint32(p));
  return result;
}

core::VolumeGeometry geometryOf(const Volume& message) {
  core::VolumeGeometry geometry;
  for (int d = 0; d < 3; ++d) {
    if (message.dims[d] > static_cast<std::uint32_t>(std::numeric_limits<int>::max())) {
      throw core::InputError("volume: dims are out of range");
    }
    geometry.dims[d] = static_cast<int>(message.dims[d]);
    geometry.spacing_m[d] = message.spacing[d];
    geometry.origin_m[d] = message.origin[d];
    for (int c = 0; c < 3; ++c)
      geometry.direction(d, c) = message.direction[3 * d + c];
  }
  return geometry;
}

core::ScalarType scalarType(std::uint8_t value) {
  const auto type = static_cast<core::ScalarType>(value);
  core::scalarSize(type);  // throws on a value that is no type
  return type;
}

HeldForce toMessage(const std::string& tool_id, const core::HeldForce& held) {
  HeldForce message;
  message.tool_id = tool_id;
  message.force = toVector(held.force_n);
  message.point = toPoint(held.point_m);
  message.expires_at_step = held.expires_at_step;
  message.vertices = held.vertices;
  message.weights = held.weights;
  return message;
}

core::HeldForce fromMessage(const HeldForce& message) {
  core::HeldForce held;
  held.force_n = fromVector(message.force);
  held.point_m = fromPoint(message.point);
  held.expires_at_step = message.expires_at_step;
  held.vertices = message.vertices;
  held.weights = message.weights;
  return held;
}

HeldGrip toMessage(const std::string& tool_id, const core::HeldGrip& held) {
  HeldGrip message;
  message.tool_id = tool_id;
  message.pose = toPose(held.pose);
  message.expires_at_step = held.expires_at_step;
  message.vertices = held.vertices;
  message.anchors = flatten(held.anchors_m);
  return message;
}

core::HeldGrip fromMessage(const HeldGrip& message) {
  core::HeldGrip held;
  held.pose = fromPose(message.pose);
  held.expires_at_step = message.expires_at_step;
  held.vertices = message.vertices;
  held.anchors_m = unflatten(message.anchors, "anchors");
  return held;
}

core::Integrator integratorNamed(const std::string& name) {
  if (const auto integrator = core::choiceNamed<core::Integrator>(name))
    return *integrator;
  std::string list;
  for (const std::string& known : core::choiceNames<core::Integrator>())
    list += (list.empty() ? "" : ", ") + known;
  throw core::InputError("there is no integrator '" + name + "'; it must be one of: " + list);
}

template <typename Message>
core::ToolCommandHeader commandHeader(const Message& message) {
  core::ToolCommandHeader header;
  header.session = message.session;
  header.revision = message.revision;
  header.step = message.step;
  header.tool_id = message.tool_id;
  header.sequence = message.sequence;
  header.apply_at_step = message.apply_at_step;
  return header;
}

template <typename Message>
void setCommandHeader(const core::ToolCommandHeader& header, Message& message) {
  message.session = header.session;
  message.revision = header.revision;
  message.step = header.step;
  message.tool_id = header.tool_id;
  message.sequence = header.sequence;
  message.apply_at_step = header.apply_at_step;
}

}  // namespace

geometry_msgs::Point toPoint(const core::Vector3& p) {
  geometry_msgs::Point point;
  point.x = p.x();
  point.y = p.y();
  point.z = p.z();
  return point;
}

geometry_msgs::Vector3 toVector(const core::Vector3& v) {
  geometry_msgs::Vector3 vector;
  vector.x = v.x();
  vector.y = v.y();
  vector.z = v.z();
  return vector;
}

geometry_msgs::Pose toPose(const core::Pose& pose) {
  geometry_msgs::Pose message;
  message.position = toPoint(pose.position_m);
  message.orientation.w = pose.orientation.w();
  message.orientation.x = pose.orientation.x();
  message.orientation.y = pose.orientation.y();
  message.orientation.z = pose.orientation.z();
  return message;
}

core::Vector3 fromPoint(const geometry_msgs::Point& p) {
  return {p.x, p.y, p.z};
}

core::Vector3 fromVector(const geometry_msgs::Vector3& v) {
  return {v.x, v.y, v.z};
}

core::Pose fromPose(const geometry_msgs::Pose& pose) {
  const auto& q = pose.orientation;
  return {fromPoint(pose.position), core::Quaternion(q.w, q.x, q.y, q.z)};
}

Volume toMessage(const core::Session& session) {
  const core::Volume& volume = *session.volume();
  const core::VolumeGeometry& geometry = volume.geometry();
  Volume message;
  message.session = session.id();
  message.revision = session.lattice().revision;
  message.step = session.steps();
  for (int d = 0; d < 3; ++d) {
    message.dims[d] = static_cast<std::uint32_t>(geometry.dims[d]);
    message.spacing[d] = geometry.spacing_m[d];
    message.origin[d] = geometry.origin_m[d];
    for (int c = 0; c < 3; ++c)
      message.direction[3 * d + c] = geometry.direction(d, c);
  }
  message.scalar_type = static_cast<std::uint8_t>(volume.type());
  message.data = volume.data();
  if (session.labels()) {
    message.label_type = static_cast<std::uint8_t>(session.labels()->type());
    message.labels = session.labels()->data();
  }
  message.hash = session.volumeHash();
  return message;
}

VolumeAndLabels fromMessage(const Volume& message) {
  const core::VolumeGeometry geometry = geometryOf(message);
  VolumeAndLabels result;
  result.volume = std::make_shared<core::Volume>(geometry, scalarType(message.scalar_type), message.data);
  if (result.volume->hash() != message.hash)
    throw core::InputError("volume: the content does not have the stated hash");
  if (!message.labels.empty()) {
    result.labels = std::make_shared<core::Volume>(geometry, scalarType(message.label_type), message.labels);
  }
  return result;
}

Scene sceneMessage(const core::Session& session) {
  Scene message;
  message.session = session.id();
  message.revision = session.lattice().revision;
  message.step = session.steps();
  message.name = session.scene().name;
  message.yaml = core::writeScene(session.scene());
  message.scene_hash = session.sceneHash();
  message.volume_hash = session.volumeHash();
  message.label_hash = session.labels() ? session.labels()->hash() : 0;
  message.package_version = SOFT_VOLUME_VERSION;
  message.kernel = core::kernelName();
  message.precision = core::nameOf(session.scene().simulation.precision);
  return message;
}

namespace {

/// The message lists the vertices of a polyhedron beside its face stream; the core keeps the stream alone.
void putCells(const core::Topology& topology, GridTopology& message) {
  for (const core::CellType type : topology.cell_types)
    message.cell_types.push_back(static_cast<std::uint8_t>(type));
  const auto& types = topology.cell_types;
  if (std::find(types.begin(), types.end(), core::CellType::kPolyhedron) == types.end()) {
    message.cell_offsets = topology.cell_offsets;
    message.connectivity = topology.connectivity;
    return;
  }
  message.cell_offsets = message.face_stream_offsets = {0};
  for (std::size_t cell = 0; cell < types.size(); ++cell) {
    const bool is_polyhedron = types[cell] == core::CellType::kPolyhedron;
    const std::uint32_t* begin = topology.connectivity.data() + topology.cell_offsets[cell];
    const std::uint32_t* end = topology.connectivity.data() + topology.cell_offsets[cell + 1];
    auto& numbers = is_polyhedron ? message.face_stream : message.connectivity;
    numbers.insert(numbers.end(), begin, end);
    if (is_polyhedron) {
      const auto vertices = core::verticesOfPolyhedron(begin);
      message.connectivity.insert(message.connectivity.end(), vertices.begin(), vertices.end());
    }
    message.cell_offsets.push_back(static_cast<std::uint32_t>(message.connectivity.size()));
    message.face_stream_offsets.push_back(static_cast<std::uint32_t>(message.face_stream.size()));
  }
}

}  // namespace

namespace {

GridTopology entriesMessage(const core::Topology& topology, std::uint64_t step) {
  GridTopology message;
  message.session = topology.session;
  message.revision = topology.revision;
  message.step = step;
  message.rest_positions = toPoints32(topology.rest_positions);
  message.texture_coordinates = toPoints32(topology.texture_coordinates);
  message.fixed = topology.fixed;
  message.origin_vertices = topology.origin_vertices;
  putCells(topology, message);
  message.parent_cells = topology.parent_cells;
  message.materials = topology.materials;
  message.face_neighbours = topology.face_neighbours;
  message.cut_faces = topology.cut_faces;
  return message;
}

}  // namespace

GridTopology toMessage(const core::Topology& topology, std::uint64_t step) {
  GridTopology message = entriesMessage(topology, step);
  message.base_revision = topology.revision;
  message.vertex_count = static_cast<std::uint32_t>(topology.vertexCount());
  message.cell_count = static_cast<std::uint32_t>(topology.cellCount());
  return message;
}

GridTopology toMessage(const core::TopologyDelta& delta, std::uint64_t step) {
  GridTopology message = entriesMessage(delta.entries, step);
  message.delta = 1;
  message.base_revision = delta.base_revision;
  message.vertex_count = delta.vertex_count;
  message.cell_count = delta.cell_count;
  message.vertex_ids = delta.vertex_ids;
  message.cell_ids = delta.cell_ids;
  return message;
}

GridTopology topologyMessage(const core::Session& session) {
  return toMessage(session.topology(), session.steps() + 1);
}

namespace {

/// Of a full message, about.
std::size_t topologyBytes(const core::Session& session) {
  constexpr std::size_t kVertexBytes = 29;
  constexpr std::size_t kCellBytes = 73;  // of a hexahedron
  const core::CutMesh& mesh = session.tissue().mesh();
  return kVertexBytes * mesh.vertexCount() + kCellBytes * mesh.pieces().size();
}

}  // namespace

GridTopology TopologyEncoder::encode(const core::Session& session, bool full) {
  last_was_delta_ = false;
  if (!full && session_ == session.id() && topologyBytes(session) >= delta_from_bytes_) {
    const core::TopologyDelta change = session.topologyChange();
    last_was_delta_ = change.base_revision == revision_ && change.entries.revision > revision_;
    if (last_was_delta_) {
      revision_ = change.entries.revision;
      return toMessage(change, session.steps() + 1);
    }
  }
  session_ = session.id();
  revision_ = session.lattice().revision;
  return topologyMessage(session);
}

namespace {

template <typename T>
void appendRange(const std::vector<T>& from, std::uint32_t begin, std::uint32_t end, std::vector<T>& to) {
  to.insert(to.end(), from.begin() + begin, from.begin() + end);
}

bool spans(const std::vector<std::uint32_t>& offsets, std::size_t cells, std::size_t size) {
  return offsets.size() == cells + 1 && offsets.front() == 0 && offsets.back() == size &&
         std::is_sorted(offsets.begin(), offsets.end());
}

/// The core keeps the face stream of a polyhedron in place of the vertices that the message lists beside it.
void takeFaceStreams(const GridTopology& message, core::Topology& topology) {
  constexpr auto kPolyhedron = core::CellType::kPolyhedron;
  const auto& types = topology.cell_types;
  if (std::find(types.begin(), types.end(), kPolyhedron) == types.end())
    return;
  if (!spans(message.cell_offsets, types.size(), message.connectivity.size()) ||
      !spans(message.face_stream_offsets, types.size(), message.face_stream.size())) {
    throw core::InputError(
        "grid topology: with polyhedra cell_offsets must span connectivity and face_stream_offsets face_stream");
  }
  topology.connectivity.clear();
  topology.cell_offsets = {0};
  for (std::size_t cell = 0; cell < types.size(); ++cell) {
    const bool is_polyhedron = types[cell] == kPolyhedron;
    const auto& offsets = is_polyhedron ? message.face_stream_offsets : message.cell_offsets;
    appendRange(is_polyhedron ? message.face_stream : message.connectivity, offsets[cell], offsets[cell + 1],
                topology.connectivity);
    topology.cell_offsets.push_back(static_cast<std::uint32_t>(topology.connectivity.size()));
  }
}

}  // namespace

namespace {

core::Topology entriesOf(const GridTopology& message) {
  core::Topology topology;
  topology.session = message.session;
  topology.revision = message.revision;
  topology.rest_positions = fromPoints32(message.rest_positions);
  topology.texture_coordinates = fromPoints32(message.texture_coordinates);
  topology.fixed = message.fixed;
  topology.origin_vertices = message.origin_vertices;
  for (const std::uint8_t type : message.cell_types)
    topology.cell_types.push_back(static_cast<core::CellType>(type));
  topology.cell_offsets = message.cell_offsets;
  topology.connectivity = message.connectivity;
  takeFaceStreams(message, topology);
  topology.parent_cells = message.parent_cells;
  topology.materials = message.materials;
  topology.face_neighbours = message.face_neighbours;
  topology.cut_faces = message.cut_faces;
  return topology;
}

core::Topology fullTopology(const GridTopology& message) {
  if (message.delta)
    throw core::InputError("grid topology: a delta, where a full message is needed");
  if (message.rest_positions.size() != message.vertex_count || message.cell_types.size() != message.cell_count) {
    throw core::InputError("grid topology: the arrays do not have vertex_count and cell_count entries");
  }
  return entriesOf(message);
}

}  // namespace

core::Topology fromMessage(const GridTopology& message) {
  core::Topology topology = fullTopology(message);
  topology.validate();
  return topology;
}

core::TopologyDecoder::Result takeMessage(const GridTopology& message, core::TopologyDecoder& decoder) {
  if (!message.delta)
    return decoder.apply(fullTopology(message));
  core::TopologyDelta delta;
  delta.base_revision = message.base_revision;
  delta.vertex_count = message.vertex_count;
  delta.cell_count = message.cell_count;
  delta.vertex_ids = message.vertex_ids;
  delta.cell_ids = message.cell_ids;
  delta.entries = entriesOf(message);
  return decoder.apply(delta);
}

GridState toMessage(const core::GridStateFrame& frame) {
  GridState message;
  message.session = frame.session;
  message.revision = frame.revision;
  message.step = frame.step;
  message.simulation_time = frame.simulation_time_s;
  message.key_frame = static_cast<std::uint8_t>(frame.key_frame);
  message.base_step = frame.base_step;
  message.vertex_count = frame.vertex_count;
  message.vertex_ids = frame.vertex_ids;
  message.positions = toPoints32(frame.positions_m);
  message.moved_min = toPoint32(frame.moved_m.min());
  message.moved_max = toPoint32(frame.moved_m.max());
  message.state_hash = frame.state_hash;
  return message;
}

core::GridStateFrame fromMessage(const GridState& message) {
  core::GridStateFrame frame;
  frame.session = message.session;
  frame.revision = message.revision;
  frame.step = message.step;
  frame.simulation_time_s = message.simulation_time;
  frame.key_frame = message.key_frame != 0;
  frame.base_step = message.base_step;
  frame.vertex_count = message.vertex_count;
  frame.vertex_ids = message.vertex_ids;
  frame.positions_m = fromPoints32(message.positions);
  frame.moved_m = Eigen::AlignedBox3f(fromPoint32(message.moved_min), fromPoint32(message.moved_max));
  frame.state_hash = message.state_hash;
  return frame;
}

GridPatch toMessage(const core::GridPatch& patch) {
  GridPatch message;
  message.session = patch.session;
  message.revision = patch.revision;
  message.step = patch.step;
  message.tool_id = patch.tool_id;
  message.vertex_ids = patch.vertex_ids;
  message.positions = toPoints32(patch.positions);
  message.velocities = toPoints32(patch.velocities);
  message.cell_ids = patch.cell_ids;
  message.stiffness = patch.stiffness_pa;
  message.cut_resistance = patch.cut_resistance_j_m2;
  message.blade_resistance = patch.blade_resistance_n;
  return message;
}

core::GridPatch fromMessage(const GridPatch& message) {
  core::GridPatch patch;
  patch.session = message.session;
  patch.revision = message.revision;
  patch.step = message.step;
  patch.tool_id = message.tool_id;
  patch.vertex_ids = message.vertex_ids;
  patch.positions = fromPoints32(message.positions);
  patch.velocities = fromPoints32(message.velocities);
  patch.cell_ids = message.cell_ids;
  patch.stiffness_pa = message.stiffness;
  patch.cut_resistance_j_m2 = message.cut_resistance;
  patch.blade_resistance_n = message.blade_resistance;
  return patch;
}

ToolForce toMessage(const core::ToolForceCommand& command) {
  ToolForce message;
  setCommandHeader(command.header, message);
  message.hold_steps = command.hold_steps;
  message.force = toVector(command.force_n);
  message.point = toPoint(command.point_m);
  message.footprint_radius = command.footprint_radius_m;
  message.cells = command.cells;
  return message;
}

core::ToolForceCommand fromMessage(const ToolForce& message) {
  core::ToolForceCommand command;
  command.header = commandHeader(message);
  command.hold_steps = message.hold_steps;
  command.force_n = fromVector(message.force);
  command.point_m = fromPoint(message.point);
  command.footprint_radius_m = message.footprint_radius;
  command.cells = message.cells;
  return command;
}

ToolCut toMessage(const core::ToolCutCommand& command) {
  ToolCut message;
  setCommandHeader(command.header, message);
  for (const core::SweptQuad& quad : command.quads) {
    for (const core::Vector3& p : quad)
      message.quads.push_back(toPoint(p));
  }
  message.lifted = static_cast<std::uint8_t>(command.lifted);
  return message;
}

core::ToolCutCommand fromMessage(const ToolCut& message) {
  if (message.quads.size() % 4 != 0)
    throw core::InputError("a cut needs four points per quad");
  core::ToolCutCommand command;
  command.header = commandHeader(message);
  command.quads.resize(message.quads.size() / 4);
  for (std::size_t n = 0; n < message.quads.size(); ++n)
    command.quads[n / 4][n % 4] = fromPoint(message.quads[n]);
  command.lifted = message.lifted != 0;
  return command;
}

ToolState toMessage(const core::ToolOutput& output) {
  ToolState state;
  state.session = output.patch.session;
  state.revision = output.patch.revision;
  state.step = output.patch.step;
  state.twist.linear = toVector(output.velocity_m_s);
  state.in_contact = static_cast<std::uint8_t>(output.contact.touching);
  state.surface_point = toPoint(output.contact.surface_point_m);
  state.surface_normal = toVector(output.contact.normal);
  state.penetration = output.contact.penetration_m;
  state.proxy.position = toPoint(output.contact.proxy_m);
  state.gripping = static_cast<std::uint8_t>(output.gripping);
  state.grip_point = toPoint(output.grip_point_m);
  state.device_force = toVector(output.device_force_n);
  state.coupling_stiffness = output.coupling_stiffness_n_m;
  state.stiffness_bound = static_cast<std::uint8_t>(output.stiffness_bound);
  state.loop_period = output.timing.period_s;
  state.loop_delay = output.timing.delay_s;
  state.patch_interval = output.patch_interval_s;
  state.made_energy = output.made_energy_j;
  state.passivity_damping = output.passivity_damping_n_s_m;
  state.pose_stale = static_cast<std::uint8_t>(output.pose_stale);
  state.patch_stale = static_cast<std::uint8_t>(output.patch_stale);
  state.saturated = static_cast<std::uint8_t>(output.saturated);
  state.slew_limited = static_cast<std::uint8_t>(output.slew_limited);
  state.tripped = static_cast<std::uint8_t>(output.tripped);
  state.trip_reason = output.tripped ? core::describe(output.fault) : "";
  state.fault = core::describe(output.fault);
  return state;
}

ToolState toMessage(const core::HandTick& tick, const core::ToolConfig& config) {
  ToolState state = toMessage(tick.output);
  state.tool_id = config.id;
  state.kind = static_cast<std::uint8_t>(config.kind);
  state.pose = toPose(tick.tip);
  if (state.in_contact == 0)
    state.proxy = state.pose;
  state.proxy.orientation = state.pose.orientation;
  for (std::size_t b = 0; b < kPublishedButtons; ++b)
    state.buttons.push_back(static_cast<std::uint8_t>(tick.buttons[b]));
  state.patch_radius = config.patch_radius_m;
  return state;
}

ToolProgress toMessage(const core::ToolNotice& notice) {
  ToolProgress message;
  message.session = notice.session;
  message.hand = notice.hand;
  message.tool_id = notice.tool_id;
  message.point = toPoint(notice.point_m);
  message.patch_radius = notice.patch_radius_m;
  for (const auto& sent : notice.sent) {
    message.tools.push_back(sent.first);
    message.forces.push_back(sent.second.force);
    message.cuts.push_back(sent.second.cut);
  }
  return message;
}

core::ToolNotice fromMessage(const ToolProgress& message) {
  if (message.forces.size() != message.tools.size() || message.cuts.size() != message.tools.size())
    throw core::InputError("tool progress: not as many numbers as tools");
  core::ToolNotice notice;
  notice.hand = message.hand;
  notice.session = message.session;
  notice.until_ns = static_cast<std::int64_t>(message.header.stamp.toNSec());
  notice.tool_id = message.tool_id;
  notice.point_m = fromPoint(message.point);
  notice.patch_radius_m = message.patch_radius;
  for (std::size_t n = 0; n < message.tools.size(); ++n)
    notice.sent[message.tools[n]] = {message.forces[n], message.cuts[n]};
  return notice;
}

ToolGrip toMessage(const core::ToolGripCommand& command) {
  ToolGrip message;
  setCommandHeader(command.header, message);
  message.hold_steps = command.hold_steps;
  message.closed = static_cast<std::uint8_t>(command.closed);
  message.point = toPoint(command.point_m);
  message.radius = command.radius_m;
  message.pose = toPose(command.pose);
  return message;
}

core::ToolGripCommand fromMessage(const ToolGrip& message) {
  core::ToolGripCommand command;
  command.header = commandHeader(message);
  command.hold_steps = message.hold_steps;
  command.closed = message.closed != 0;
  command.point_m = fromPoint(message.point);
  command.radius_m = message.radius;
  command.pose = fromPose(message.pose);
  return command;
}

core::RemovalCommand fromMessage(const PartRemoval& message) {
  return {message.session, message.cell};
}

core::IntegratorCommand fromMessage(const SimulationControl& message) {
  return {integratorNamed(message.integrator), message.dt};
}

SimulationStats statsMessage(const core::Session& session) {
  const core::Simulation& simulation = session.simulation();
  const core::SimulationSettings& settings = simulation.settings();
  const core::SimulationStats stats = simulation.stats();
  SimulationStats message;
  message.session = session.id();
  message.revision = session.lattice().revision;
  message.step = session.steps();
  message.dt = session.timeStep();
  message.dt_limit = session.timeStepLimit();
  message.substeps = static_cast<std::uint32_t>(simulation.substeps());
  message.integrator = core::nameOf(settings.integrator);
  message.precision = core::nameOf(settings.precision);
  message.transients_physical = static_cast<std::uint8_t>(settings.integrator != core::Integrator::kQuasiStatic);
  message.simulation_time = session.simulationTime();
  message.cells = static_cast<std::uint32_t>(session.lattice().cellCount());
  message.vertices = static_cast<std::uint32_t>(session.lattice().vertexCount());
  message.active_cells = stats.active_cells;
  message.active_vertices = stats.active_vertices;
  message.threads = static_cast<std::uint32_t>(simulation.threads());
  message.max_displacement = session.maxDisplacement();
  message.max_speed = simulation.maxSpeed();
  const core::Mechanics mechanics = simulation.mechanics();
  message.kinetic_energy = mechanics.kinetic_j;
  message.elastic_energy = mechanics.elastic_j;
  message.cut_opening = session.cutOpening();
  message.faces_opened = session.cutCounts().faces_opened;
  message.cuts_in_vain = session.cutCounts().in_vain;
  const std::vector<core::TissuePart>& parts = session.parts();
  message.parts = static_cast<std::uint32_t>(parts.size());
  for (std::size_t n = 0; n < std::min(parts.size(), kMostPartsTold); ++n) {
    message.part_cells.push_back(parts[n].piece);
    message.part_volumes.push_back(parts[n].volume_m3);
  }
  message.frontier_error = stats.frontier_error_m;
  message.grip_lag = stats.grip_lag_m;
  message.limited_moves = stats.limited_moves;
  message.guard_fallbacks = stats.guard_fallbacks;
  message.saturated_forces = stats.saturated_forces;
  message.rejected_steps = stats.rejected_steps;
  message.solver_iterations = stats.solver_iterations;
  return message;
}

SimulationCheckpoint toMessage(const core::Session& session, const core::Checkpoint& checkpoint) {
  SimulationCheckpoint message;
  message.session = checkpoint.session;
  message.revision = checkpoint.revision;
  message.step = checkpoint.state.step;
  message.scene_hash = checkpoint.scene_hash;
  message.volume_hash = checkpoint.volume_hash;
  message.incisions = toMessage(checkpoint.incisions);
  message.displacements = flatten(checkpoint.state.displacements_m);
  message.velocities = flatten(checkpoint.state.velocities_m_s);
  message.lifetimes = checkpoint.state.lifetimes;
  message.deformation = checkpoint.state.deformation_m;
  for (const auto& force : checkpoint.state.forces)
    message.forces.push_back(toMessage(force.first, force.second));
  for (const auto& grip : checkpoint.state.grips)
    message.grips.push_back(toMessage(grip.first, grip.second));
  message.integrator = core::nameOf(checkpoint.integrator);
  message.dt = checkpoint.clock.dt_s;
  message.dt_since_step = checkpoint.clock.since_step;
  message.dt_since_time = checkpoint.clock.since_time_s;
  for (const auto& sequence : checkpoint.sequences) {
    message.sequence_tools.push_back(sequence.first);
    message.sequences.push_back(sequence.second);
  }
  message.state_hash = session.simulation().stateHash();
  return message;
}

core::Checkpoint fromMessage(const SimulationCheckpoint& message) {
  core::Checkpoint checkpoint;
  checkpoint.session = message.session;
  checkpoint.revision = message.revision;
  checkpoint.scene_hash = message.scene_hash;
  checkpoint.volume_hash = message.volume_hash;
  checkpoint.incisions = fromMessage(message.incisions);
  checkpoint.state.step = message.step;
  checkpoint.state.displacements_m = unflatten(message.displacements, "displacements");
  checkpoint.state.velocities_m_s = unflatten(message.velocities, "velocities");
  checkpoint.state.lifetimes = message.lifetimes;
  checkpoint.state.deformation_m = message.deformation;
  for (const HeldForce& force : message.forces)
    checkpoint.state.forces[force.tool_id] = fromMessage(force);
  for (const HeldGrip& grip : message.grips)
    checkpoint.state.grips[grip.tool_id] = fromMessage(grip);
  checkpoint.integrator = integratorNamed(message.integrator);
  checkpoint.clock = {message.dt_since_step, message.dt_since_time, message.dt};
  if (message.sequence_tools.size() != message.sequences.size()) {
    throw core::InputError("the checkpoint's sequence numbers do not fit their tools");
  }
  for (std::size_t n = 0; n < message.sequences.size(); ++n) {
    checkpoint.sequences[message.sequence_tools[n]] = message.sequences[n];
  }
  return checkpoint;
}

}  // namespace soft_volume
