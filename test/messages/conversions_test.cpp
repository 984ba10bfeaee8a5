#include "soft_volume/messages/conversions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>

#include "message_session.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/simulation/kernel.h"

namespace soft_volume {
namespace {

/// Says that a message with one damage is refused with a reason that holds `part`.
template <typename Message>
void expectRefused(Message message, const std::function<void(Message&)>& damage, const std::string& part) {
  damage(message);
  try {
    fromMessage(message);
    ADD_FAILURE() << "accepted; expected: " << part;
  } catch (const core::InputError& error) {
    EXPECT_NE(std::string(error.what()).find(part), std::string::npos) << error.what() << "\nexpected: " << part;
  }
}

TEST(Conversions, PointsVectorsAndPosesSurviveTheRoundTrip) {
  const core::Vector3 v(1.0 / 3.0, -2e-9, 7e12);
  EXPECT_EQ(fromPoint(toPoint(v)), v);
  EXPECT_EQ(fromVector(toVector(v)), v);
  const core::Pose pose{v, core::Quaternion(0.1, -0.2, 0.3, 0.4)};  // not normalised: it is taken as it is
  const core::Pose back = fromPose(toPose(pose));
  EXPECT_EQ(back.position_m, pose.position_m);
  EXPECT_EQ(back.orientation.coeffs(), pose.orientation.coeffs());
  EXPECT_EQ(toPose(pose).orientation.w, 0.1);
  EXPECT_EQ(toPose(pose).orientation.x, -0.2);
}

TEST(Conversions, UnusableNumbersAreCarriedForTheCoreToJudge) {
  ToolForce message = pushMessage(1);
  message.force.y = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(std::isnan(fromMessage(message).force_n.y()));
}

TEST(Conversions, VolumeSurvivesTheRoundTrip) {
  const auto session = makeSession(kSession, true);
  const Volume message = toMessage(*session);
  EXPECT_EQ(message.session, kSession);
  EXPECT_EQ(message.scalar_type, Volume::FLOAT32);
  EXPECT_EQ(message.data.size(), std::size_t(24 * 24 * 24 * 4));
  EXPECT_EQ(message.hash, session->volumeHash());
  const VolumeAndLabels content = fromMessage(message);
  EXPECT_EQ(content.volume->data(), session->volume()->data());
  EXPECT_EQ(content.volume->hash(), session->volume()->hash());
  ASSERT_TRUE(content.labels);
  EXPECT_EQ(content.labels->hash(), session->labels()->hash());
  EXPECT_FALSE(fromMessage(toMessage(*makeSession())).labels);
}

TEST(Conversions, AnOrientedVolumeKeepsItsGeometry) {
  core::VolumeGeometry geometry;
  geometry.dims = {2, 3, 4};
  geometry.spacing_m = {0.001, 0.002, 0.003};
  geometry.origin_m = {-0.1, 0.2, 0.3};
  geometry.direction << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  std::vector<std::uint8_t> data(24 * 2);
  for (std::size_t n = 0; n < data.size(); ++n)
    data[n] = static_cast<std::uint8_t>(5 * n);
  const core::Volume volume(geometry, core::ScalarType::kInt16, data);

  Volume message;
  message.dims = {2, 3, 4};
  message.spacing = {0.001, 0.002, 0.003};
  message.origin = {-0.1, 0.2, 0.3};
  message.direction = {0, -1, 0, 1, 0, 0, 0, 0, 1};
  message.scalar_type = Volume::INT16;
  message.data = data;
  message.hash = volume.hash();  // of geometry, type and scalars: it only fits when all three do
  EXPECT_EQ(fromMessage(message).volume->geometry().direction, geometry.direction);
}

TEST(Conversions, RefusesVolumesThatDoNotHoldTogether) {
  const Volume good = toMessage(*makeSession(kSession, true));
  const auto refused = [&good](const std::function<void(Volume&)>& damage, const std::string& part) {
    expectRefused<Volume>(good, damage, part);
  };
  refused([](Volume& m) { m.data.pop_back(); }, "");
  refused([](Volume& m) { m.data.clear(); }, "");
  refused([](Volume& m) { m.dims[0] = 25; }, "");
  refused([](Volume& m) { m.dims[2] = 0; }, "");
  refused([](Volume& m) { m.dims[1] = 0x80000000U; }, "dims");
  refused([](Volume& m) { m.dims = {0x7fffffffU, 0x7fffffffU, 0x7fffffffU}; }, "");
  refused([](Volume& m) { m.scalar_type = 8; }, "");
  refused([](Volume& m) { m.scalar_type = Volume::INT32; }, "hash");  // the same size, other scalars
  refused([](Volume& m) { m.spacing[1] = -0.002; }, "");
  refused([](Volume& m) { m.spacing[1] = std::numeric_limits<double>::quiet_NaN(); }, "");
  refused([](Volume& m) { m.spacing[1] = 0.003; }, "hash");
  refused([](Volume& m) { m.direction[0] = 2.0; }, "");
  refused([](Volume& m) { m.data[7] ^= 1; }, "hash");
  refused([](Volume& m) { m.hash ^= 1; }, "hash");
  refused([](Volume& m) { m.label_type = 200; }, "");
  refused([](Volume& m) { m.labels.pop_back(); }, "");
}

TEST(Conversions, SceneMessageRebuildsTheScene) {
  const auto session = makeSession(kSession, true);
  const Scene message = sceneMessage(*session);
  EXPECT_EQ(message.session, kSession);
  EXPECT_EQ(message.name, "block");
  EXPECT_EQ(core::writeScene(core::parseScene(message.yaml, "message", "/")), message.yaml);
  EXPECT_EQ(message.scene_hash, core::hashBytes(message.yaml.data(), message.yaml.size()));
  EXPECT_EQ(message.volume_hash, session->volumeHash());
  EXPECT_EQ(message.label_hash, session->labels()->hash());
  EXPECT_EQ(sceneMessage(*makeSession()).label_hash, 0U);
  EXPECT_FALSE(message.package_version.empty());
  EXPECT_EQ(message.kernel, core::kernelName());
  EXPECT_EQ(message.precision, "float");
}

TEST(Conversions, TopologySurvivesTheRoundTripAlsoWithACut) {
  const auto session = makeUsedSession();
  const core::Topology before = session->topology();
  const GridTopology message = topologyMessage(*session);
  EXPECT_EQ(message.revision, 2U);
  EXPECT_EQ(message.step, 16U);  // 15 steps are done
  EXPECT_FALSE(message.delta);
  const core::Topology after = fromMessage(message);
  EXPECT_EQ(after.session, before.session);
  EXPECT_EQ(after.revision, before.revision);
  EXPECT_EQ(after.rest_positions, before.rest_positions);
  EXPECT_EQ(after.texture_coordinates, before.texture_coordinates);
  EXPECT_EQ(after.fixed, before.fixed);
  EXPECT_EQ(after.origin_vertices, before.origin_vertices);
  EXPECT_EQ(after.parent_cells, before.parent_cells);
  EXPECT_EQ(after.cell_types, before.cell_types);
  EXPECT_EQ(after.cell_offsets, before.cell_offsets);
  EXPECT_EQ(after.connectivity, before.connectivity);
  EXPECT_EQ(after.materials, before.materials);
  EXPECT_EQ(after.face_neighbours, before.face_neighbours);
  EXPECT_EQ(after.cut_faces, before.cut_faces);
  EXPECT_NE(std::count(after.cut_faces.begin(), after.cut_faces.end(), 1), 0);
}

TEST(Conversions, RefusesTopologiesThatDoNotHoldTogether) {
  const GridTopology good = topologyMessage(*makeUsedSession());
  const auto refused = [&good](const std::function<void(GridTopology&)>& damage, const std::string& part = "") {
    expectRefused<GridTopology>(good, damage, part);
  };
  refused([](GridTopology& m) { m.delta = 1; }, "delta");
  refused([](GridTopology& m) { ++m.vertex_count; }, "vertex_count");
  refused([](GridTopology& m) { --m.cell_count; }, "cell_count");
  refused([](GridTopology& m) { m.rest_positions.pop_back(); }, "vertex_count");
  refused([](GridTopology& m) { m.rest_positions[3].y = std::numeric_limits<float>::infinity(); });
  refused([](GridTopology& m) { m.texture_coordinates.pop_back(); });
  refused([](GridTopology& m) { m.fixed.clear(); });
  refused([](GridTopology& m) { m.cell_offsets.pop_back(); });
  refused([](GridTopology& m) { m.cell_offsets[1] = 1000000; });
  refused([](GridTopology& m) { m.connectivity[0] = m.vertex_count; });
  refused([](GridTopology& m) { m.connectivity.pop_back(); });
  refused([](GridTopology& m) { m.cell_types[0] = 7; });
  refused([](GridTopology& m) { m.materials.pop_back(); });
  refused([](GridTopology& m) { m.face_neighbours[0] = -2; });
  refused([](GridTopology& m) { m.face_neighbours[0] = static_cast<std::int32_t>(m.cell_count); });
  refused([](GridTopology& m) { m.cut_faces.pop_back(); });
}

/// A tetrahedron as a polyhedron, and one of VTK's own beside it.
GridTopology polyhedronMessage() {
  GridTopology message;
  message.vertex_count = 5;
  message.cell_count = 2;
  message.rest_positions.resize(5);
  message.texture_coordinates.resize(5);
  message.fixed.assign(5, 0);
  message.cell_types = {42, 10};
  message.cell_offsets = {0, 4, 8};
  message.connectivity = {0, 1, 2, 3, 1, 2, 3, 4};
  message.face_stream_offsets = {0, 17, 17};
  message.face_stream = {4, 3, 0, 1, 3, 3, 1, 2, 3, 3, 2, 0, 3, 3, 0, 2, 1};
  message.materials = {0, 0};
  message.face_neighbours.assign(8, -1);
  message.cut_faces.assign(8, 0);
  return message;
}

TEST(Conversions, PolyhedraAreFaceStreamsInTheCore) {
  const core::Topology topology = fromMessage(polyhedronMessage());
  EXPECT_EQ(topology.cell_types,
            (std::vector<core::CellType>{core::CellType::kPolyhedron, core::CellType::kTetrahedron}));
  EXPECT_EQ(topology.cell_offsets, (std::vector<std::uint32_t>{0, 17, 21}));
  EXPECT_EQ(topology.connectivity, (std::vector<std::uint32_t>{4, 3, 0, 1, 3, 3, 1, 2, 3, 3, 2, 0, 3, 3, 0, 2, 1,  //
                                                               1, 2, 3, 4}));
}

TEST(Conversions, CellsOfAllKindsSurviveTheRoundTrip) {
  core::Topology before = fromMessage(polyhedronMessage());
  before.cell_types.push_back(core::CellType::kEmpty);
  before.cell_offsets.push_back(before.cell_offsets.back());
  before.materials.push_back(0);
  const GridTopology message = toMessage(before, 3);
  EXPECT_EQ(message.step, 3U);
  EXPECT_EQ(message.connectivity, polyhedronMessage().connectivity);
  EXPECT_EQ(message.face_stream, polyhedronMessage().face_stream);
  const core::Topology after = fromMessage(message);
  EXPECT_EQ(after.cell_types, before.cell_types);
  EXPECT_EQ(after.cell_offsets, before.cell_offsets);
  EXPECT_EQ(after.connectivity, before.connectivity);
}

TEST(Conversions, ADeltaBringsAReceiverUpToDate) {
  core::TopologyDecoder decoder;
  using Result = core::TopologyDecoder::Result;
  const GridTopology full = polyhedronMessage();
  core::TopologyDelta delta;
  delta.base_revision = full.revision;
  delta.vertex_count = 6;
  delta.cell_count = 3;
  delta.vertex_ids = {5};
  delta.cell_ids = {1, 2};
  const core::Topology before = fromMessage(full);
  delta.entries = before;  // the tetrahedron is taken away, and the polyhedron's twin is new
  delta.entries.revision = full.revision + 1;
  delta.entries.rest_positions = {core::Vector3f(1, 2, 3)};
  delta.entries.texture_coordinates.resize(1);
  delta.entries.fixed = {1};
  delta.entries.cell_types = {core::CellType::kEmpty, core::CellType::kPolyhedron};
  delta.entries.cell_offsets = {0, 0, 17};
  delta.entries.connectivity.resize(17);
  delta.entries.face_neighbours.assign(4, 0);
  delta.entries.cut_faces.assign(4, 1);
  const GridTopology message = toMessage(delta, 8);
  EXPECT_TRUE(message.delta);
  EXPECT_EQ(message.step, 8U);
  EXPECT_EQ(takeMessage(message, decoder), Result::kNeedsFull);
  EXPECT_EQ(takeMessage(full, decoder), Result::kApplied);
  EXPECT_EQ(takeMessage(message, decoder), Result::kApplied);
  EXPECT_EQ(takeMessage(message, decoder), Result::kKnown);
  const core::Topology& after = *decoder.topology();
  EXPECT_EQ(after.revision, full.revision + 1);
  EXPECT_EQ(after.rest_positions[5], core::Vector3f(1, 2, 3));
  EXPECT_EQ(after.cell_types, (std::vector<core::CellType>{core::CellType::kPolyhedron, core::CellType::kEmpty,
                                                           core::CellType::kPolyhedron}));
  EXPECT_EQ(after.cell_offsets, (std::vector<std::uint32_t>{0, 17, 17, 34}));
  EXPECT_EQ(after.face_neighbours, (std::vector<std::int32_t>{-1, -1, -1, -1, 0, 0, 0, 0}));
  GridTopology bad = message;
  bad.face_stream_offsets.pop_back();
  EXPECT_THROW(takeMessage(bad, decoder), core::InputError);
  EXPECT_EQ(decoder.topology()->revision, full.revision + 1);
}

TEST(Conversions, RefusesPolyhedraWithoutTheirFaces) {
  const auto refused = [](const std::function<void(GridTopology&)>& damage) {
    expectRefused<GridTopology>(polyhedronMessage(), damage, "");
  };
  refused([](GridTopology& m) { m.face_stream_offsets.clear(); });
  refused([](GridTopology& m) { m.face_stream_offsets = {0, 99, 17}; });
  refused([](GridTopology& m) { m.face_stream_offsets = {0, 0, 17}; });
  refused([](GridTopology& m) { m.face_stream.pop_back(); });
  refused([](GridTopology& m) { m.face_stream[0] = 5; });
  refused([](GridTopology& m) { m.face_stream[2] = 5; });
  refused([](GridTopology& m) { m.cell_offsets = {0, 99, 8}; });
  refused([](GridTopology& m) { m.face_neighbours.pop_back(); });
}

TEST(Conversions, StatesSurviveTheRoundTripAsKeyFrameAndAsDelta) {
  std::vector<core::Vector3> positions = {{0, 0, 0}, {1, 0, 0}, {0, 1.0 / 3.0, 0}};
  core::StateEncoder encoder;
  for (const bool key_frame : {true, false}) {
    core::GridStateFrame frame;
    frame.session = 7;
    frame.revision = 3;
    frame.step = key_frame ? 10 : 12;
    frame.simulation_time_s = 0.012;
    frame.state_hash = 0x1234567890abcdefULL;
    if (!key_frame)
      positions[2].z() = 0.1;
    encoder.encode(positions, key_frame, frame);
    ASSERT_EQ(frame.key_frame, key_frame);
    const core::GridStateFrame back = fromMessage(toMessage(frame));
    EXPECT_EQ(back.session, 7U);
    EXPECT_EQ(back.revision, 3U);
    EXPECT_EQ(back.step, frame.step);
    EXPECT_EQ(back.base_step, 10U);
    EXPECT_EQ(back.simulation_time_s, frame.simulation_time_s);
    EXPECT_EQ(back.key_frame, frame.key_frame);
    EXPECT_EQ(back.vertex_count, 3U);
    EXPECT_EQ(back.vertex_ids, frame.vertex_ids);
    EXPECT_EQ(back.positions_m, frame.positions_m);
    EXPECT_EQ(back.moved_m.min(), frame.moved_m.min());
    EXPECT_EQ(back.moved_m.max(), frame.moved_m.max());
    EXPECT_EQ(back.state_hash, frame.state_hash);
  }
}

TEST(Conversions, AnEmptyMovedBoxStaysEmpty) {
  core::GridStateFrame frame;
  frame.moved_m.setEmpty();
  const GridState message = toMessage(frame);
  EXPECT_GT(message.moved_min.x, message.moved_max.x);
  EXPECT_TRUE(fromMessage(message).moved_m.isEmpty());
}

TEST(Conversions, PatchesSurviveTheRoundTrip) {
  core::GridPatch before = makeUsedSession()->patch("probe", {0.024, 0.024, 0.031}, 0.01);
  before.blade_resistance_n = 0.75;
  ASSERT_FALSE(before.cell_ids.empty());
  const core::GridPatch after = fromMessage(toMessage(before));
  EXPECT_EQ(after.session, kSession);
  EXPECT_EQ(after.revision, 2U);
  EXPECT_EQ(after.step, 15U);
  EXPECT_EQ(after.tool_id, "probe");
  EXPECT_EQ(after.vertex_ids, before.vertex_ids);
  EXPECT_EQ(after.positions, before.positions);
  EXPECT_EQ(after.velocities, before.velocities);
  EXPECT_EQ(after.cell_ids, before.cell_ids);
  EXPECT_EQ(after.stiffness_pa, before.stiffness_pa);
  EXPECT_EQ(after.cut_resistance_j_m2, before.cut_resistance_j_m2);
  EXPECT_EQ(after.blade_resistance_n, 0.75);
}

TEST(Conversions, ForcesAndCutsSurviveTheRoundTrip) {
  ToolForce force = pushMessage(9);
  force.revision = 4;
  force.step = 123;
  force.apply_at_step = 130;
  force.cells = {4, 17};
  EXPECT_EQ(toMessage(fromMessage(force)), force);
  EXPECT_EQ(fromMessage(force).cells, force.cells);
  EXPECT_EQ(fromMessage(force).force_n, core::Vector3(0.02, 0.0, -0.3));

  ToolCut cut = cutMessage(9);
  cut.step = 123;
  cut.apply_at_step = 130;
  for (int n = 0; n < 4; ++n)
    cut.quads.push_back(toPoint({0.1 * n, 0.2, 0.3}));
  EXPECT_FALSE(fromMessage(cut).lifted);
  cut.lifted = 1;
  EXPECT_EQ(toMessage(fromMessage(cut)), cut);
  EXPECT_EQ(fromMessage(cut).quads[1][3], core::Vector3(0.1 * 3, 0.2, 0.3));
  EXPECT_TRUE(fromMessage(cut).lifted);
}

TEST(Conversions, GripsSurviveTheRoundTrip) {
  ToolGrip grip = gripMessage(9);
  grip.step = 123;
  grip.apply_at_step = 130;
  EXPECT_EQ(toMessage(fromMessage(grip)), grip);
  const core::ToolGripCommand command = fromMessage(grip);
  EXPECT_TRUE(command.closed);
  EXPECT_EQ(command.header.apply_at_step, 130U);
  EXPECT_EQ(command.hold_steps, 30U);
  EXPECT_EQ(command.radius_m, 0.009);
  EXPECT_EQ(command.point_m, core::Vector3(0.024, 0.024, 0.031));
  EXPECT_EQ(command.pose.orientation.y(), 0.6);
  grip.closed = 0;
  EXPECT_FALSE(fromMessage(grip).closed);
}

TEST(Conversions, IntegratorsAreNamed) {
  SimulationControl control;
  control.integrator = "quasi_static";
  control.dt = 0.02;
  EXPECT_EQ(fromMessage(control).integrator, core::Integrator::kQuasiStatic);
  EXPECT_EQ(fromMessage(control).dt_s, 0.02);
  expectRefused<SimulationControl>(
      control, [](SimulationControl& m) { m.integrator = "magic"; }, "runge_kutta_4");
}

TEST(Conversions, StatsSayWhatTheSimulationDoesAndHowWrongItIs) {
  const auto session = makeUsedSession();
  const SimulationStats stats = statsMessage(*session);
  EXPECT_EQ(stats.session, kSession);
  EXPECT_EQ(stats.revision, 2U);
  EXPECT_EQ(stats.step, 15U);
  EXPECT_EQ(stats.dt, 0.0005);
  EXPECT_EQ(stats.dt_limit, session->timeStepLimit());
  EXPECT_EQ(stats.substeps, 1U);
  EXPECT_EQ(stats.integrator, "runge_kutta_4");
  EXPECT_EQ(stats.precision, "float");
  EXPECT_TRUE(stats.transients_physical);
  EXPECT_DOUBLE_EQ(stats.simulation_time, 0.0125);
  EXPECT_EQ(stats.cells, session->lattice().cellCount());
  EXPECT_EQ(stats.vertices, session->lattice().vertexCount());
  EXPECT_GT(stats.active_cells, 0U);
  EXPECT_GT(stats.active_vertices, 0U);
  EXPECT_GT(stats.max_displacement, 0.0);
  EXPECT_GT(stats.max_speed, 0.0);
  EXPECT_GT(stats.cut_opening, 0.0);
  session->apply(core::IntegratorCommand{core::Integrator::kQuasiStatic, 0.0});
  EXPECT_FALSE(statsMessage(*session).transients_physical);
}

TEST(Conversions, RefusesAnIncompleteQuad) {
  expectRefused<ToolCut>(
      cutMessage(1), [](ToolCut& m) { m.quads.pop_back(); }, "four points per quad");
}

TEST(Conversions, CheckpointsContinueBitForBit) {
  const auto session = makeUsedSession();
  const SimulationCheckpoint message = toMessage(*session, session->checkpoint());
  EXPECT_EQ(message.session, kSession);
  EXPECT_EQ(message.step, 15U);
  EXPECT_EQ(message.state_hash, session->simulation().stateHash());
  ASSERT_EQ(message.forces.size(), 1U);
  EXPECT_EQ(message.forces[0].tool_id, "probe");
  EXPECT_EQ(message.forces[0].expires_at_step, 20U);
  ASSERT_EQ(message.grips.size(), 1U);
  EXPECT_EQ(message.grips[0].tool_id, "probe");
  EXPECT_EQ(message.grips[0].expires_at_step, 40U);
  EXPECT_FALSE(message.grips[0].vertices.empty());
  EXPECT_EQ(message.grips[0].anchors.size(), 3 * message.grips[0].vertices.size());
  EXPECT_EQ(message.displacements.size(), 3 * session->lattice().vertexCount());
  EXPECT_EQ(message.integrator, "runge_kutta_4");
  EXPECT_EQ(message.dt, 0.0005);
  EXPECT_EQ(message.dt_since_step, 10U);
  EXPECT_DOUBLE_EQ(message.dt_since_time, 0.01);
  EXPECT_EQ(message.sequence_tools,
            (std::vector<std::string>{"tool/cut scalpel", "tool/force probe", "tool/grip probe"}));
  EXPECT_EQ(message.sequences, (std::vector<std::uint64_t>{6, 5, 7}));

  const auto continued = makeSession(kSession + 1);
  const core::Verdict verdict = continued->apply(fromMessage(message));
  ASSERT_TRUE(verdict.applied) << verdict.reason;
  EXPECT_EQ(continued->simulation().stateHash(), message.state_hash);
  SimulationCheckpoint again = toMessage(*continued, continued->checkpoint());
  again.session = kSession;
  EXPECT_EQ(again, message);
  for (int n = 0; n < 40; ++n) {
    session->step();
    continued->step();
    ASSERT_EQ(continued->simulation().stateHash(), session->simulation().stateHash()) << "step " << session->steps();
  }
}

TEST(Conversions, RefusesCheckpointsWithIncompleteRows) {
  const auto session = makeUsedSession();
  const SimulationCheckpoint good = toMessage(*session, session->checkpoint());
  const auto refused = [&good](const std::function<void(SimulationCheckpoint&)>& damage, const std::string& part) {
    expectRefused<SimulationCheckpoint>(good, damage, part);
  };
  refused([](SimulationCheckpoint& m) { m.displacements.pop_back(); }, "displacements");
  refused([](SimulationCheckpoint& m) { m.grips[0].anchors.pop_back(); }, "anchors");
  refused([](SimulationCheckpoint& m) { m.integrator = "magic"; }, "magic");
  refused([](SimulationCheckpoint& m) { m.velocities.push_back(0.0); }, "velocities");
  refused([](SimulationCheckpoint& m) { m.incisions.rest_stretch.pop_back(); }, "rest_stretch");
  refused([](SimulationCheckpoint& m) { m.incisions.cells.pop_back(); }, "cells");
  refused([](SimulationCheckpoint& m) { m.incisions.surface_shares.pop_back(); }, "surface_shares");
  refused([](SimulationCheckpoint& m) { m.incisions.face_neighbours.pop_back(); }, "face_neighbours");
  refused([](SimulationCheckpoint& m) { m.incisions.cut_faces.pop_back(); }, "cut_faces");
  refused([](SimulationCheckpoint& m) { m.incisions.vertex_ends.pop_back(); }, "vertex_ends");
  refused([](SimulationCheckpoint& m) { m.incisions.vertex_shares.pop_back(); }, "vertex_shares");
  refused([](SimulationCheckpoint& m) { m.incisions.face_offsets.pop_back(); }, "face_offsets");
  refused([](SimulationCheckpoint& m) { m.incisions.face_offsets[5] = 1000000; }, "face_offsets");
  refused([](SimulationCheckpoint& m) { m.incisions.face_pieces.pop_back(); }, "face_pieces");
  refused([](SimulationCheckpoint& m) { m.incisions.face_opened.pop_back(); }, "face_opened");
  refused([](SimulationCheckpoint& m) { m.incisions.piece_origins.pop_back(); }, "piece_origins");
  refused([](SimulationCheckpoint& m) { m.sequences.pop_back(); }, "sequence");
}

}  // namespace
}  // namespace soft_volume
