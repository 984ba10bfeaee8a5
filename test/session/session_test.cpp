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

/// A vertical blade that sweeps through the middle of the block.
ToolCutCommand slice(const Session& session, std::uint64_t sequence) {
  ToolCutCommand command;
  command.header = push(session, sequence).header;
  command.header.tool_id = "scalpel";
  const double x = 0.0235;
  command.quads = {{Vector3(x, 0.01, 0.012), Vector3(x, 0.01, 0.05), Vector3(x, 0.04, 0.05), Vector3(x, 0.04, 0.012)}};
  return command;
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
  EXPECT_GT(session->cutOpening(), 0.001);
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
    whole->step();
  }
  auto continued = std::make_unique<Session>(smallScene(), smallVolume(), nullptr, kId, 1);
  ASSERT_TRUE(continued->apply(whole->checkpoint()).applied);
  EXPECT_EQ(continued->steps(), 120U);
  EXPECT_EQ(continued->lattice().revision, whole->lattice().revision);
  for (std::uint64_t n = 120; n < 240; ++n) {
    for (Session* session : {whole.get(), continued.get()}) {
      EXPECT_TRUE(session->apply(push(*session, n + 1)).applied);
      session->step();
    }
    ASSERT_EQ(whole->simulation().stateHash(), continued->simulation().stateHash()) << n;
  }
}

TEST(Session, RefusesCheckpointsThatDoNotFit) {
  const auto session = makeSession();
  session->apply(slice(*session, 1));
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
  refuses([](Checkpoint& c) { c.cells.pop_back(); });
  refuses([](Checkpoint& c) { c.cells[0][3] = 100000; });
  refuses([](Checkpoint& c) { c.face_neighbours[0][0] = 100000; });
  refuses([](Checkpoint& c) { c.face_neighbours[0][0] = -2; });
  refuses([](Checkpoint& c) { c.cut_faces.pop_back(); });
  refuses([](Checkpoint& c) { c.rest_stretch[0].x() = 0.0; });
  refuses([](Checkpoint& c) { c.rest_stretch[0].x() = NAN; });
  refuses([](Checkpoint& c) { c.origin_vertices.back() = 100000; });
  refuses([](Checkpoint& c) { c.origin_vertices[0] = 1; });
  refuses([](Checkpoint& c) { c.state.positions_m.pop_back(); });
  refuses([](Checkpoint& c) { c.state.positions_m[0].x() = NAN; });
  refuses([](Checkpoint& c) { c.state.lifetimes.clear(); });
}

TEST(Session, PatchHoldsWholeCellsAroundTheTool) {
  const auto session = makeSession();
  const GridPatch patch = session->patch("probe", kTop, 0.012);
  ASSERT_FALSE(patch.cell_ids.empty());
  EXPECT_LT(patch.cell_ids.size(), session->lattice().cellCount());
  EXPECT_TRUE(std::is_sorted(patch.vertex_ids.begin(), patch.vertex_ids.end()));
  for (const std::uint32_t cell : patch.cell_ids) {
    for (const std::uint32_t v : session->lattice().cells[cell]) {
      EXPECT_TRUE(std::binary_search(patch.vertex_ids.begin(), patch.vertex_ids.end(), v));
    }
  }
  EXPECT_EQ(patch.stiffness_pa.size(), patch.cell_ids.size());
  EXPECT_TRUE(session->patch("probe", Vector3(9, 9, 9), 0.01).cell_ids.empty());
}

TEST(Session, RefusesATimeStepBeyondTheLimit) {
  Scene scene = smallScene();
  scene.simulation.dt_s = 0.05;
  EXPECT_THROW(Session(scene, smallVolume(), nullptr, 1, 1), SceneError);
}

}  // namespace
}  // namespace soft_volume::core
