#include "soft_volume/session/session.h"

#include <gtest/gtest.h>

#include <cmath>

#include "small_scene.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr std::uint64_t kId = 77;
const Vector3 kTop(0.024, 0.024, 0.031);

std::unique_ptr<Session> makeSession(int threads = 1) {
  return std::make_unique<Session>(smallScene(), smallVolume(), nullptr, kId, threads);
}

ToolForceCommand push(const Session& session, std::uint64_t sequence) {
  ToolForceCommand command;
  command.header.session = session.id();
  command.header.revision = session.lattice().revision;
  command.header.step = session.steps();
  command.header.tool_id = "probe";
  command.header.sequence = sequence;
  command.hold_steps = 20;
  command.force_n = Vector3(0.02, 0.0, -0.3);
  command.point_m = kTop;
  command.footprint_radius_m = 0.016;
  return command;
}

/// Jaws that close on the middle of the top and lift by `lift_m`.
ToolGripCommand grasp(const Session& session, std::uint64_t sequence, double lift_m = 0.0) {
  ToolGripCommand command;
  command.header = push(session, sequence).header;
  command.hold_steps = 20;
  command.closed = true;
  command.point_m = kTop;
  command.radius_m = 0.009;
  command.pose.position_m = kTop + Vector3(0, 0, lift_m);
  return command;
}

/// A vertical blade that sweeps through the middle of the block.
ToolCutCommand slice(const Session& session, std::uint64_t sequence) {
  ToolCutCommand command;
  command.header = push(session, sequence).header;
  command.header.tool_id = "scalpel";
  const double x = 0.0235;
  command.quads = {{Vector3(x, 0.01, 0.012), Vector3(x, 0.01, 0.05), Vector3(x, 0.04, 0.05), Vector3(x, 0.04, 0.012)}};
  return command;
}

TEST(Session, ItsSceneHasTheTransferFunctionThatAFileCameTo) {
  Scene scene = smallScene();
  scene.rendering.transfer_file = readTransferFunction("viridis");  // of parts of the range, which is 0 to 100
  const Session session(scene, smallVolume(), nullptr, kId, 1);
  EXPECT_FALSE(session.scene().rendering.transfer_file);
  EXPECT_EQ(session.scene().rendering.transfer_function.points.back().value, 100.0);
  const Scene resolved = parseScene(writeScene(session.scene()), "resolved", "/");
  EXPECT_EQ(resolved.rendering.transfer_function.points.size(), scene.rendering.transfer_file->function.points.size());
}

TEST(Session, APushDentsAndRecovers) {
  const auto session = makeSession();
  for (std::uint64_t n = 0; n < 400; ++n) {
    EXPECT_TRUE(session->apply(push(*session, n + 1)).applied);
    session->step();
  }
  EXPECT_GT(session->simulation().maxDisplacement(), 0.001);
  for (int n = 0; n < 1000; ++n)
    session->step();
  EXPECT_LT(session->simulation().maxDisplacement(), 1e-5);
}

TEST(Session, ADeadToolStopsPushing) {
  const auto session = makeSession();
  session->apply(push(*session, 1));
  for (int n = 0; n < 20; ++n)
    session->step();
  EXPECT_EQ(session->simulation().state().forces.size(), 1U);
  session->step();
  EXPECT_TRUE(session->simulation().state().forces.empty());
}

TEST(Session, ACutOpensRaisesTheRevisionAndIsReplicatedInTheTopology) {
  const auto session = makeSession();
  const std::size_t vertices = session->lattice().vertexCount();
  EXPECT_TRUE(session->apply(slice(*session, 1)).applied);
  EXPECT_EQ(session->lattice().revision, 2U);
  EXPECT_GT(session->lattice().vertexCount(), vertices);
  EXPECT_NO_THROW(session->topology().validate());
  for (int n = 0; n < 500; ++n)
    session->step();
  EXPECT_GT(session->cutOpening(), 0.0002);
}

/// A blade that passes level through the whole block.
ToolCutCommand sliceOff(const Session& session, std::uint64_t sequence) {
  ToolCutCommand command = slice(session, sequence);
  const double z = 0.0255;
  command.quads = {
      {Vector3(-0.01, -0.01, z), Vector3(-0.01, 0.06, z), Vector3(0.06, 0.06, z), Vector3(0.06, -0.01, z)}};
  return command;
}

double totalVolume(const Session& session) {
  double sum = 0.0;
  for (const TissuePart& part : session.parts())
    sum += part.volume_m3;
  return sum;
}

TEST(Session, APartThatIsCutOffMovesOnAndCanBeRemoved) {
  const auto session = makeSession();
  EXPECT_EQ(session->parts().size(), 1U);
  const double volume_m3 = totalVolume(*session);
  ASSERT_TRUE(session->apply(sliceOff(*session, 1)).applied);
  ASSERT_EQ(session->parts().size(), 2U);
  EXPECT_NEAR(totalVolume(*session), volume_m3, 1e-12 * volume_m3);
  const TissuePart loose = session->parts()[1];
  EXPECT_FALSE(session->apply(RemovalCommand{kId + 1, loose.piece}).applied);
  EXPECT_FALSE(session->apply(RemovalCommand{kId, session->parts()[0].piece}).applied);
  EXPECT_FALSE(session->apply(RemovalCommand{kId, 1000000}).applied);
  for (std::uint64_t n = 0; n < 20; ++n) {
    ASSERT_TRUE(session->apply(push(*session, n + 1)).applied);
    session->step();
  }
  ASSERT_TRUE(session->apply(grasp(*session, 1)).applied);
  ASSERT_TRUE(session->apply(RemovalCommand{kId, loose.piece}).applied);
  EXPECT_EQ(session->lattice().revision, 3U);
  ASSERT_EQ(session->parts().size(), 1U);
  EXPECT_NEAR(totalVolume(*session), volume_m3 - loose.volume_m3, 1e-12 * volume_m3);
  EXPECT_TRUE(session->simulation().state().forces.empty());
  EXPECT_TRUE(session->simulation().state().grips.empty());
  EXPECT_FALSE(session->apply(RemovalCommand{kId, loose.piece}).applied);
  ToolCutCommand air = sliceOff(*session, 2);
  for (Vector3& p : air.quads[0])
    p.z() += 0.03;
  const std::uint32_t changed_from = session->topologyChange().base_revision;
  ASSERT_TRUE(session->apply(air).applied);
  EXPECT_EQ(session->lattice().revision, 3U);
  EXPECT_EQ(session->topologyChange().base_revision, changed_from);
  const Topology topology = session->topology();
  EXPECT_NO_THROW(topology.validate());
  EXPECT_EQ(
      static_cast<std::uint32_t>(std::count(topology.cell_types.begin(), topology.cell_types.end(), CellType::kEmpty)),
      loose.pieces);
  for (const std::uint32_t cell : session->patch("probe", kTop, 0.02).cell_ids)
    ASSERT_NE(topology.cell_types[cell], CellType::kEmpty);
}

TEST(Session, ContinuesBitExactlyWithoutARemovedPart) {
  const auto whole = makeSession();
  ASSERT_TRUE(whole->apply(sliceOff(*whole, 1)).applied);
  for (int n = 0; n < 20; ++n)
    whole->step();
  ASSERT_TRUE(whole->apply(RemovalCommand{kId, whole->parts()[1].piece}).applied);
  ToolCutCommand again = slice(*whole, 2);  // through cells that lost a part
  ASSERT_TRUE(whole->apply(again).applied);
  const auto continued = makeSession();
  const Verdict verdict = continued->apply(whole->checkpoint());
  ASSERT_TRUE(verdict.applied) << verdict.reason;
  EXPECT_EQ(continued->parts().size(), whole->parts().size());
  for (int n = 0; n < 200; ++n) {
    whole->step();
    continued->step();
    ASSERT_EQ(whole->simulation().stateHash(), continued->simulation().stateHash()) << n;
  }
  for (const Vector3& p : whole->drawnPositions())
    ASSERT_TRUE(isFinite(p));
  EXPECT_LT(whole->simulation().maxDisplacement(), 0.01);
}

/// Every refusal leaves the state bit for bit as it was.
TEST(Session, RefusesForcesThatItCannotUse) {
  const auto session = makeSession();
  for (std::uint64_t n = 0; n < 150; ++n) {
    session->apply(push(*session, n + 1));
    session->step();
  }
  const std::uint64_t before = session->simulation().stateHash();
  const auto refuses = [&](const char* reason, const auto& damage) {
    ToolForceCommand command = push(*session, 1000);
    damage(command);
    const Verdict verdict = session->apply(command);
    EXPECT_FALSE(verdict.applied) << reason;
    EXPECT_NE(verdict.reason.find(reason), std::string::npos) << verdict.reason;
    EXPECT_EQ(session->simulation().stateHash(), before);
    EXPECT_EQ(session->simulation().state().forces.at("probe").force_n, push(*session, 0).force_n);
  };
  refuses("another session", [](ToolForceCommand& c) { c.header.session = kId + 1; });
  refuses("revision 9", [](ToolForceCommand& c) { c.header.revision = 9; });
  refuses("revision 0", [](ToolForceCommand& c) { c.header.revision = 0; });
  refuses("no tool 'spoon'", [](ToolForceCommand& c) { c.header.tool_id = "spoon"; });
  refuses("not newer", [](ToolForceCommand& c) { c.header.sequence = 150; });
  refuses("has passed", [](ToolForceCommand& c) { c.header.apply_at_step = 150; });
  refuses("not finite", [](ToolForceCommand& c) { c.force_n.x() = NAN; });
  refuses("not finite", [](ToolForceCommand& c) { c.force_n.x() = INFINITY; });
  refuses("not finite", [](ToolForceCommand& c) { c.point_m.z() = NAN; });
  refuses("max_tool_force_n", [](ToolForceCommand& c) { c.force_n.x() = 1e38; });
  refuses("footprint radius", [](ToolForceCommand& c) { c.footprint_radius_m = 0.0; });
  refuses("footprint radius", [](ToolForceCommand& c) { c.footprint_radius_m = 1.0; });
  refuses("footprint radius", [](ToolForceCommand& c) { c.footprint_radius_m = NAN; });
  refuses("hold_steps", [](ToolForceCommand& c) { c.hold_steps = 0; });
  refuses("hold_steps", [](ToolForceCommand& c) { c.hold_steps = 4000000000U; });
  refuses("no tissue", [](ToolForceCommand& c) { c.point_m.z() = 0.1; });
  refuses("no tissue", [](ToolForceCommand& c) { c.point_m.z() = 1e30; });
}

TEST(Session, RefusesCutsThatItCannotUse) {
  const auto session = makeSession();
  const std::uint64_t before = session->simulation().stateHash();
  const auto refuses = [&](const auto& damage) {
    ToolCutCommand command = slice(*session, 1);
    damage(command);
    const Verdict verdict = session->apply(command);
    EXPECT_FALSE(verdict.applied);
    EXPECT_FALSE(verdict.reason.empty());
    EXPECT_EQ(session->lattice().revision, 1U);
    EXPECT_EQ(session->simulation().stateHash(), before);
  };
  refuses([](ToolCutCommand& c) { c.header.session = 0; });
  refuses([](ToolCutCommand& c) { c.header.revision = 2; });
  refuses([](ToolCutCommand& c) { c.quads.clear(); });
  refuses([](ToolCutCommand& c) { c.quads.resize(10001, c.quads[0]); });
  refuses([](ToolCutCommand& c) { c.quads[0][2].y() = NAN; });
  refuses([](ToolCutCommand& c) { c.quads[0][2].y() = 1e6; });
}

/// The piece whose middle is nearest to a point.
std::uint32_t pieceNear(const Session& session, const Vector3& point_m) {
  const CutMesh& mesh = session.tissue().mesh();
  std::uint32_t nearest = 0;
  double least = HUGE_VAL;
  for (std::uint32_t piece = 0; piece < mesh.pieces().size(); ++piece) {
    Vector3 middle = Vector3::Zero();
    const auto vertices = mesh.verticesOf(piece);
    for (const std::uint32_t v : vertices)
      middle += mesh.restPositions()[v] / double(vertices.size());
    if ((middle - point_m).norm() < least) {
      least = (middle - point_m).norm();
      nearest = piece;
    }
  }
  return nearest;
}

/// Cuts a block in two that stand on fixed ground, presses the lip at +x outwards and returns how far either lip has
/// gone: the largest move of the mesh's vertices at its top.
std::array<double, 2> pressLip(bool name_cell) {
  const auto session = makeSession();
  ToolCutCommand cut = slice(*session, 1);
  const double x = 0.0235;
  cut.quads = {{Vector3(x, -0.01, -0.01), Vector3(x, -0.01, 0.05), Vector3(x, 0.06, 0.05), Vector3(x, 0.06, -0.01)}};
  cut.lifted = true;
  EXPECT_TRUE(session->apply(cut).applied);
  for (int n = 0; n < 800; ++n)
    session->step();  // the lips open and rest
  const auto before = session->drawnPositions();
  for (std::uint64_t n = 0; n < 400; ++n) {
    ToolForceCommand force = push(*session, n + 1);
    force.force_n = Vector3(0.1, 0.0, 0.0);
    force.point_m = Vector3(x, 0.024, 0.026);
    if (name_cell)
      force.cells = {pieceNear(*session, force.point_m + Vector3(0.003, 0.0, 0.0))};
    EXPECT_TRUE(session->apply(force).applied);
    session->step();
  }
  const auto after = session->drawnPositions();
  std::array<double, 2> moved = {0.0, 0.0};
  for (std::size_t v = 0; v < after.size(); ++v) {
    if (session->tissue().mesh().restPositions()[v].z() < 0.020)
      continue;  // the front moves with either lip
    const std::uint32_t piece = session->tissue().mesh().piecesAround(std::uint32_t(v)).front();
    double middle = 0.0;
    const auto vertices = session->tissue().mesh().verticesOf(piece);
    for (const std::uint32_t w : vertices)
      middle += session->tissue().mesh().restPositions()[w].x() / double(vertices.size());
    double& side = moved[middle < x ? 0 : 1];
    side = std::max(side, (after[v] - before[v]).norm());
  }
  return moved;
}

TEST(Session, AForceOnOneLipLeavesTheOtherAlone) {
  const auto named = pressLip(true);
  EXPECT_GT(named[1], 0.001);
  EXPECT_LT(named[0], 0.05 * named[1]);
  const auto nameless = pressLip(false);
  EXPECT_GT(nameless[0], 0.3 * nameless[1]);  // the footprint spans the gap
}

TEST(Session, PressedCellsHaveToBeOfTheGrid) {
  const auto session = makeSession();
  ToolForceCommand force = push(*session, 1);
  force.cells = {std::uint32_t(session->tissue().mesh().pieces().size())};
  EXPECT_FALSE(session->apply(force).applied);
  force.cells.assign(65, 0);
  EXPECT_FALSE(session->apply(force).applied);
  force.cells = {pieceNear(*session, kTop)};
  EXPECT_TRUE(session->apply(force).applied);
}

TEST(Session, TheEndOfAStrokeNeedsNoQuads) {
  const auto session = makeSession();
  ToolCutCommand command = slice(*session, 1);
  command.quads.clear();
  command.lifted = true;
  EXPECT_TRUE(session->apply(command).applied);
  EXPECT_EQ(session->lattice().revision, 1U);
}

TEST(Session, CountsWhatBladesOpenAndWhatTheyMiss) {
  const auto session = makeSession();
  ASSERT_TRUE(session->apply(slice(*session, 1)).applied);
  EXPECT_GT(session->cutCounts().faces_opened, 0U);
  EXPECT_EQ(session->cutCounts().in_vain, 0U);
  ToolCutCommand miss = slice(*session, 2);
  for (Vector3& p : miss.quads[0])
    p.z() += 0.03;
  const std::uint32_t revision = session->lattice().revision;
  EXPECT_TRUE(session->apply(miss).applied);
  EXPECT_EQ(session->cutCounts().in_vain, 1U);
  EXPECT_EQ(session->lattice().revision, revision);
}

TEST(Session, AToolThatCutsMayBeARevisionBehindForAMoment) {
  const auto session = makeSession();
  ToolForceCommand late = push(*session, 1);
  session->apply(slice(*session, 1));
  EXPECT_TRUE(session->apply(late).applied);
  for (int n = 0; n < 101; ++n)
    session->step();
  late.header.sequence = 2;
  EXPECT_FALSE(session->apply(late).applied);
}

TEST(Session, BitIdenticalForAnyNumberOfThreads) {
  const auto run = [](int threads) {
    const auto session = makeSession(threads);
    for (std::uint64_t n = 0; n < 300; ++n) {
      if (n % 3 == 0)
        session->apply(push(*session, n + 1));
      if (n == 100)
        session->apply(slice(*session, 1));
      session->step();
    }
    return session->simulation().stateHash();
  };
  const std::uint64_t one = run(1);
  EXPECT_EQ(run(2), one);
  EXPECT_EQ(run(5), one);
}

TEST(Session, ContinuesBitExactlyFromACheckpointThroughACut) {
  const auto whole = makeSession();
  for (std::uint64_t n = 0; n < 120; ++n) {
    whole->apply(push(*whole, n + 1));
    if (n == 60)
      whole->apply(slice(*whole, 1));
    if (n == 80) {
      ASSERT_TRUE(whole->apply(IntegratorCommand{Integrator::kRungeKutta4, 0.0005}).applied);
    }
    if (n >= 100) {
      ASSERT_TRUE(whole->apply(grasp(*whole, n + 1, 0.0001 * double(n - 100))).applied);
    }
    whole->step();
  }
  auto continued = std::make_unique<Session>(smallScene(), smallVolume(), nullptr, kId, 1);
  ASSERT_TRUE(continued->apply(whole->checkpoint()).applied);
  EXPECT_EQ(continued->steps(), 120U);
  EXPECT_EQ(continued->lattice().revision, whole->lattice().revision);
  EXPECT_EQ(continued->timeStep(), 0.0005);
  EXPECT_EQ(continued->simulation().settings().integrator, Integrator::kRungeKutta4);
  for (std::uint64_t n = 120; n < 240; ++n) {
    for (Session* session : {whole.get(), continued.get()}) {
      EXPECT_TRUE(session->apply(push(*session, n + 1)).applied);
      session->step();
    }
    ASSERT_EQ(whole->simulation().stateHash(), continued->simulation().stateHash()) << n;
    ASSERT_EQ(whole->simulationTime(), continued->simulationTime());
  }
  EXPECT_TRUE(whole->simulation().state().grips.empty());
}

TEST(Session, RefusesCheckpointsThatDoNotFit) {
  const auto session = makeSession();
  session->apply(slice(*session, 1));
  ASSERT_TRUE(session->apply(push(*session, 1)).applied);
  ASSERT_TRUE(session->apply(grasp(*session, 1)).applied);
  const Checkpoint good = session->checkpoint();
  const std::uint64_t before = session->simulation().stateHash();
  const auto refuses = [&](const auto& damage) {
    Checkpoint bad = good;
    damage(bad);
    EXPECT_FALSE(session->apply(bad).applied);
    EXPECT_EQ(session->simulation().stateHash(), before);
    EXPECT_EQ(session->lattice().revision, 2U);
  };
  refuses([](Checkpoint& c) { ++c.scene_hash; });
  refuses([](Checkpoint& c) { ++c.volume_hash; });
  refuses([](Checkpoint& c) { c.revision = 1; });
  refuses([](Checkpoint& c) { c.incisions = {}; });
  refuses([](Checkpoint& c) { c.incisions.cells.pop_back(); });
  refuses([](Checkpoint& c) { c.incisions.cells[0][3] = 100000; });
  refuses([](Checkpoint& c) { std::swap(c.incisions.cells[0][3], c.incisions.cells[0][4]); });
  refuses([](Checkpoint& c) { c.incisions.parent_cells[0] = 1; });
  refuses([](Checkpoint& c) { c.incisions.parent_cells.back() = 100000; });
  refuses([](Checkpoint& c) { c.incisions.shares.back() *= 2.0; });
  refuses([](Checkpoint& c) { c.incisions.shares[0] = NAN; });
  refuses([](Checkpoint& c) { c.incisions.surface_shares[0][3] = -0.5; });
  refuses([](Checkpoint& c) { c.incisions.face_neighbours[0][0] = 100000; });
  refuses([](Checkpoint& c) { c.incisions.face_neighbours[0][0] = -2; });
  refuses([](Checkpoint& c) { c.incisions.face_neighbours[0][0] = 0; });
  refuses([](Checkpoint& c) { c.incisions.cut_faces.pop_back(); });
  refuses([](Checkpoint& c) { c.incisions.rest_stretch[0].x() = 0.0; });
  refuses([](Checkpoint& c) { c.incisions.rest_stretch[0].x() = NAN; });
  refuses([](Checkpoint& c) { c.incisions.origin_vertices.back() = 100000; });
  refuses([](Checkpoint& c) { c.incisions.origin_vertices[0] = 1; });
  refuses([](Checkpoint& c) { c.incisions.fixed.pop_back(); });
  refuses([](Checkpoint& c) { c.incisions.sources[0].a = 100000; });
  refuses([](Checkpoint& c) { c.incisions.sources[0].share = NAN; });
  refuses([](Checkpoint& c) { c.incisions.faces.pop_back(); });
  refuses([](Checkpoint& c) { c.incisions.faces[0].loop.pop_back(); });
  refuses([](Checkpoint& c) { c.incisions.faces[0].loop[1] = 100000; });
  refuses([](Checkpoint& c) { c.incisions.faces[0].loop.clear(); });
  refuses([](Checkpoint& c) { c.incisions.faces[0].pieces[0] = -1; });
  refuses([](Checkpoint& c) { c.incisions.faces[0].pieces[1] = 100000; });
  refuses([](Checkpoint& c) { c.incisions.pieces.pop_back(); });
  refuses([](Checkpoint& c) { c.incisions.pieces[0].cell = 1; });
  refuses([](Checkpoint& c) { c.incisions.pieces.back().origin = 100000; });
  refuses([](Checkpoint& c) { c.incisions.cells_of_pieces.back() = 0; });
  refuses([](Checkpoint& c) { c.incisions.cells_of_pieces.pop_back(); });
  refuses([](Checkpoint& c) { c.incisions.strokes.at("scalpel").stroke.blade.tip.x() = NAN; });
  refuses([](Checkpoint& c) { c.incisions.strokes.at("scalpel").stroke.lips.side_of_piece[100000] = 1; });
  refuses([](Checkpoint& c) { c.incisions.strokes.at("scalpel").joint[0].vertices.push_back(3); });
  refuses([](Checkpoint& c) { c.state.displacements_m.pop_back(); });
  refuses([](Checkpoint& c) { c.state.displacements_m[0].x() = NAN; });
  refuses([](Checkpoint& c) { c.state.displacements_m[0].x() = 1e38; });
  refuses([](Checkpoint& c) { c.state.velocities_m_s.pop_back(); });
  refuses([](Checkpoint& c) { c.state.velocities_m_s[0].z() = INFINITY; });
  refuses([](Checkpoint& c) { c.state.lifetimes.clear(); });
  refuses([](Checkpoint& c) { c.state.forces.at("probe").vertices.back() = 100000; });
  refuses([](Checkpoint& c) { c.state.forces.at("probe").weights.pop_back(); });
  refuses([](Checkpoint& c) { c.state.forces.at("probe").weights[0] = NAN; });
  refuses([](Checkpoint& c) { c.state.forces.at("probe").force_n.x() = NAN; });
  refuses([](Checkpoint& c) { c.state.grips.at("probe").vertices.back() = 100000; });
  refuses([](Checkpoint& c) { c.state.grips.at("probe").anchors_m.pop_back(); });
  refuses([](Checkpoint& c) { c.state.grips.at("probe").anchors_m[0].y() = NAN; });
  refuses([](Checkpoint& c) { c.state.grips.at("probe").pose.position_m.y() = NAN; });
  refuses([](Checkpoint& c) { c.state.grips.at("probe").pose.orientation.coeffs().setZero(); });
  refuses([](Checkpoint& c) { c.clock.dt_s = 0.0; });
  refuses([](Checkpoint& c) { c.clock.dt_s = NAN; });
  refuses([](Checkpoint& c) { c.clock.since_time_s = INFINITY; });
  refuses([](Checkpoint& c) { c.clock.since_step = c.state.step + 1; });
}

TEST(Session, PatchHoldsWholeCellsAroundTheTool) {
  const auto session = makeSession();
  const GridPatch patch = session->patch("probe", kTop, 0.012);
  ASSERT_FALSE(patch.cell_ids.empty());
  EXPECT_LT(patch.cell_ids.size(), session->lattice().cellCount());
  EXPECT_TRUE(std::is_sorted(patch.vertex_ids.begin(), patch.vertex_ids.end()));
  for (const std::uint32_t cell : patch.cell_ids) {
    for (const std::uint32_t v : session->tissue().mesh().verticesOf(cell)) {
      EXPECT_TRUE(std::binary_search(patch.vertex_ids.begin(), patch.vertex_ids.end(), v));
    }
  }
  EXPECT_EQ(patch.stiffness_pa.size(), patch.cell_ids.size());
  EXPECT_TRUE(session->patch("probe", Vector3(9, 9, 9), 0.01).cell_ids.empty());
}

TEST(Session, RefusesATimeStepBeyondTheLimitAndNamesIt) {
  Scene scene = smallScene();
  const double limit_s = makeSession()->timeStepLimit();
  EXPECT_GT(limit_s, 0.001);
  EXPECT_LT(limit_s, 0.004);  // 0.88 h sqrt(rho / E) = 3.1 ms in the bulk
  scene.simulation.dt_s = 1.01 * limit_s;
  try {
    Session(scene, smallVolume(), nullptr, 1, 1);
    ADD_FAILURE() << "accepted";
  } catch (const SceneError& error) {
    EXPECT_NE(std::string(error.what()).find("stability limit"), std::string::npos) << error.what();
  }
  scene.simulation.substeps = true;
  EXPECT_GT(Session(scene, smallVolume(), nullptr, 1, 1).simulation().substeps(), 1);
  scene.simulation.substeps = false;
  scene.simulation.dt_s = 0.95 * limit_s;
  EXPECT_EQ(Session(scene, smallVolume(), nullptr, 1, 1).simulation().substeps(), 1);
}

/// A replay gets the number from the recorded scene, so both must be the same scene.
TEST(Session, AnAutomaticTimeStepBecomesANumberOfTheScene) {
  Scene scene = smallScene();
  scene.simulation.dt_s = 0.0;
  const Session live(scene, smallVolume(), nullptr, 1, 1);
  EXPECT_GT(live.timeStep(), 0.9 * scene.simulation.dt_fraction * live.timeStepLimit());
  EXPECT_LT(live.timeStep(), 1.1 * scene.simulation.dt_fraction * live.timeStepLimit());
  EXPECT_EQ(live.scene().simulation.dt_s, live.timeStep());
  const Session replayed(parseScene(writeScene(live.scene()), "resolved", "/"), smallVolume(), nullptr, 1, 1);
  EXPECT_EQ(replayed.timeStep(), live.timeStep());
  EXPECT_EQ(replayed.sceneHash(), live.sceneHash());
}

TEST(Session, TheIntegratorCanBeChangedAndTimeGoesOn) {
  const auto session = makeSession();
  const Scene before = session->scene();
  for (std::uint64_t n = 0; n < 100; ++n) {
    session->apply(push(*session, n + 1));
    session->step();
  }
  EXPECT_DOUBLE_EQ(session->simulationTime(), 0.1);
  const std::uint64_t hash = session->simulation().stateHash();
  ASSERT_TRUE(session->apply(IntegratorCommand{Integrator::kBackwardEuler, 0.01}).applied);
  EXPECT_EQ(session->simulation().stateHash(), hash);
  EXPECT_EQ(session->timeStep(), 0.01);
  EXPECT_DOUBLE_EQ(session->simulationTime(), 0.1);
  for (int n = 0; n < 10; ++n)
    session->step();
  EXPECT_DOUBLE_EQ(session->simulationTime(), 0.2);
  EXPECT_NE(session->simulation().stateHash(), hash);
  EXPECT_GT(session->simulation().stats().solver_iterations, 0U);
  ASSERT_TRUE(session->apply(IntegratorCommand{Integrator::kSymplecticEuler, 0.0}).applied);
  EXPECT_LT(session->timeStep(), session->timeStepLimit());
  EXPECT_EQ(writeScene(session->scene()), writeScene(before));
}

TEST(Session, RefusesIntegratorsThatItCannotUse) {
  const auto session = makeSession();
  const double limit_s = session->timeStepLimit();
  for (const double dt_s : {double(NAN), double(INFINITY), -0.001, 11.0, 2.0 * limit_s}) {
    const Verdict verdict = session->apply(IntegratorCommand{Integrator::kSymplecticEuler, dt_s});
    EXPECT_FALSE(verdict.applied) << dt_s;
    EXPECT_FALSE(verdict.reason.empty());
    EXPECT_EQ(session->timeStep(), 0.001);
    EXPECT_EQ(session->simulation().settings().dt_s, 0.001);
    EXPECT_EQ(session->simulation().settings().integrator, Integrator::kSymplecticEuler);
  }
  EXPECT_TRUE(session->apply(IntegratorCommand{Integrator::kBackwardEuler, 2.0 * limit_s}).applied);
}

/// Highest place of the vertices that a tool holds.
double gripHeight(const Session& session) {
  double height_m = -1.0;
  for (const std::uint32_t v : session.simulation().state().grips.at("probe").vertices)
    height_m = std::max(height_m, session.simulation().positions()[v].z());
  return height_m;
}

TEST(Session, JawsLiftTissueUntilTheyOpen) {
  const auto session = makeSession();
  std::uint64_t sequence = 0;
  ASSERT_TRUE(session->apply(grasp(*session, ++sequence)).applied);
  const double before_m = gripHeight(*session);
  for (int n = 0; n < 300; ++n) {
    const Verdict verdict = session->apply(grasp(*session, ++sequence, 0.006 * std::min(1.0, n / 200.0)));
    ASSERT_TRUE(verdict.applied) << verdict.reason;
    session->step();
  }
  EXPECT_NEAR(gripHeight(*session), before_m + 0.006, 1e-4);
  EXPECT_LT(session->simulation().stats().grip_lag_m, 1e-4);
  ToolGripCommand open = grasp(*session, ++sequence);
  open.closed = false;
  open.radius_m = 0.0;
  EXPECT_TRUE(session->apply(open).applied);
  EXPECT_TRUE(session->simulation().state().grips.empty());
  for (int n = 0; n < 1500; ++n)
    session->step();
  EXPECT_LT(session->simulation().maxDisplacement(), 1e-4);
}

TEST(Session, JawsFollowTheTurnOfTheirPoseAndDriversMayRound) {
  const auto session = makeSession();
  ToolGripCommand command = grasp(*session, 1);
  command.hold_steps = 1000;
  ASSERT_TRUE(session->apply(command).applied);
  const auto held = session->simulation().state().grips.at("probe").vertices;
  std::vector<Vector3> before;
  for (const std::uint32_t v : held)
    before.push_back(session->simulation().positions()[v]);
  const Quaternion turn(Eigen::AngleAxisd(0.2, Vector3::UnitZ()));
  command.header.sequence = 2;
  command.pose.orientation = turn;
  command.pose.orientation.coeffs() *= 1.004;
  ASSERT_TRUE(session->apply(command).applied);
  for (int n = 0; n < 400; ++n)
    session->step();
  for (std::size_t n = 0; n < held.size(); ++n) {
    const Vector3 wanted = kTop + turn * (before[n] - kTop);
    EXPECT_LT((session->simulation().positions()[held[n]] - wanted).norm(), 1e-4);
  }
}

TEST(Session, ADeadGripOpens) {
  const auto session = makeSession();
  session->apply(grasp(*session, 1));
  for (int n = 0; n < 20; ++n)
    session->step();
  EXPECT_EQ(session->simulation().state().grips.size(), 1U);
  session->step();
  EXPECT_TRUE(session->simulation().state().grips.empty());
}

TEST(Session, RefusesGripsThatItCannotUse) {
  const auto session = makeSession();
  const auto refuses = [&](const char* reason, const auto& damage) {
    const std::uint64_t before = session->simulation().stateHash();
    const std::size_t grips = session->simulation().state().grips.size();
    ToolGripCommand command = grasp(*session, 1000);
    damage(command);
    const Verdict verdict = session->apply(command);
    EXPECT_FALSE(verdict.applied) << reason;
    EXPECT_NE(verdict.reason.find(reason), std::string::npos) << verdict.reason;
    EXPECT_EQ(session->simulation().stateHash(), before);
    ASSERT_EQ(session->simulation().state().grips.size(), grips);
    if (grips > 0) {
      EXPECT_EQ(session->simulation().state().grips.at("probe").pose.position_m, kTop);
    }
  };
  const auto refusesAll = [&] {
    refuses("another session", [](ToolGripCommand& c) { c.header.session = 0; });
    refuses("another session", [](ToolGripCommand& c) { c.header.session = 0, c.closed = false; });
    refuses("revision 9", [](ToolGripCommand& c) { c.header.revision = 9; });
    refuses("no tool 'spoon'", [](ToolGripCommand& c) { c.header.tool_id = "spoon"; });
    refuses("not finite", [](ToolGripCommand& c) { c.point_m.x() = NAN; });
    refuses("not finite", [](ToolGripCommand& c) { c.pose.position_m.x() = INFINITY; });
    refuses("unit quaternion", [](ToolGripCommand& c) { c.pose.orientation.coeffs().setZero(); });
    refuses("unit quaternion", [](ToolGripCommand& c) { c.pose.orientation.w() = NAN; });
    refuses("far outside", [](ToolGripCommand& c) { c.pose.position_m.x() = 1e38; });
    refuses("grip radius", [](ToolGripCommand& c) { c.radius_m = 0.0; });
    refuses("grip radius", [](ToolGripCommand& c) { c.radius_m = NAN; });
    refuses("hold_steps", [](ToolGripCommand& c) { c.hold_steps = 0; });
  };
  refusesAll();
  refuses("between the jaws", [](ToolGripCommand& c) { c.point_m.z() = 0.06; });
  refuses("between the jaws", [](ToolGripCommand& c) { c.point_m.z() = 1e38; });
  ASSERT_TRUE(session->apply(grasp(*session, 10)).applied);
  refusesAll();
  refuses("not newer", [](ToolGripCommand& c) { c.header.sequence = 10; });
}

}  // namespace
}  // namespace soft_volume::core
