#include "programs/scripted_run.h"

#include <gtest/gtest.h>

#include "small_scene.h"

namespace soft_volume::core {
namespace {

constexpr double kDepth_m = 0.012;

WayPoint wayPoint(double time_s, const Vector3& position_m, bool cuts, bool passes) {
  WayPoint point;
  point.time_s = time_s;
  point.position_m = position_m;
  point.buttons[0] = cuts;
  point.pass = passes;
  return point;
}

/// A scalpel cuts along an arc into the top of the block, from one side of it to the other.
Scene incisionScene() {
  Scene scene = smallScene();
  scene.tools = {*scene.findTool("scalpel")};
  const double z = 0.031 - kDepth_m;
  scene.device.way_points = {
      wayPoint(0.0, {-0.006, 0.018, z}, true, false),   wayPoint(0.2, {0.010, 0.026, z}, true, true),
      wayPoint(0.4, {0.024, 0.029, z}, true, true),     wayPoint(0.6, {0.038, 0.026, z}, true, true),
      wayPoint(0.8, {0.054, 0.018, z}, true, false),    wayPoint(1.0, {0.054, 0.018, 0.06}, false, false),
      wayPoint(1.4, {0.054, 0.018, 0.06}, false, false)};
  scene.device.workspace_centre_m = {0.024, 0.024, 0.03};
  return scene;
}

struct Outcome {
  double opening_m;
  double largest_move_m;
  std::uint32_t revisions;
  std::uint64_t hash;
  std::size_t refused;
  bool operator==(const Outcome& other) const {
    return opening_m == other.opening_m && revisions == other.revisions && hash == other.hash;
  }
};

Outcome play(const Scene& scene, int threads) {
  Session session(scene, smallVolume(), nullptr, 1, threads);
  ScriptedRun run(session);
  while (!run.scriptEnded()) {
    run.move();
    session.step();
  }
  const Simulation& simulation = session.simulation();
  return {session.cutOpening(), simulation.maxDisplacement(), session.topology().revision, simulation.stateHash(),
          run.refused()};
}

TEST(ScriptedRun, AnArcOfTheScalpelOpensTheTissue) {
  const Outcome outcome = play(incisionScene(), 1);
  EXPECT_EQ(outcome.refused, 0U);
  EXPECT_GT(outcome.revisions, 3U);  // it cut on the way, not all at once
  EXPECT_GT(outcome.opening_m, 0.001);
  EXPECT_LT(outcome.largest_move_m, 0.008);
}

TEST(ScriptedRun, ABladeInTheAirCutsNothing) {
  Scene scene = incisionScene();
  for (WayPoint& point : scene.device.way_points)
    point.position_m.z() = 0.04;
  const Outcome outcome = play(scene, 1);
  EXPECT_EQ(outcome.revisions, 1U);
  EXPECT_EQ(outcome.largest_move_m, 0.0);
}

TEST(ScriptedRun, RepeatsBitForBitWithAnyNumberOfThreads) {
  const Outcome first = play(incisionScene(), 1);
  EXPECT_EQ(play(incisionScene(), 1), first);
  EXPECT_EQ(play(incisionScene(), 2), first);
}

}  // namespace
}  // namespace soft_volume::core
