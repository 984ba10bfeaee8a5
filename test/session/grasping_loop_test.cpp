// Jaws, a device in a hand and a simulation in one loop.

#include <gtest/gtest.h>

#include <iostream>

#include "small_scene.h"
#include "soft_volume/tool/virtual_device.h"

namespace soft_volume::core {
namespace {

constexpr int kTicksPerPatch = 4;
const Vector3 kSkin(0.0237, 0.0251, 0.0311);

Scene graspScene(double slip_force_n) {
  Scene scene = smallScene();
  scene.max_tool_force_n = 20.0;
  ToolConfig tool = *scene.findTool("probe");
  tool.id = "forceps";
  tool.kind = ToolKind::kGrasper;
  tool.slip_force_n = slip_force_n;
  tool.tip_radius_m = 0.002;
  scene.tools.push_back(tool);
  return scene;
}

/// The hand closes the jaws at the skin, goes to `pulled`, stays, comes back and opens them.
VirtualDeviceConfig pullTo(const Vector3& pulled_m) {
  VirtualDeviceConfig device;
  device.workspace_centre_m = kSkin;
  const Vector3 above = kSkin + Vector3(0.0, 0.0, 0.001);
  Buttons closed;
  closed.set(0);
  device.way_points = {{0.0, kSkin + Vector3(0.0, 0.0, 0.010), {}, {}},
                       {0.5, above, {}, {}},
                       {0.8, above, {}, closed},
                       {1.6, above + pulled_m, {}, closed},
                       {2.6, above + pulled_m, {}, closed},
                       {3.4, above, {}, closed},
                       {3.6, above, {}, {}},
                       {4.2, kSkin + Vector3(0.0, 0.0, 0.010), {}, {}}};
  return device;
}

class GraspingLoop {
 public:
  explicit GraspingLoop(const Vector3& pulled_m, double slip_force_n = 10.0)
      : session_(graspScene(slip_force_n), smallVolume(), nullptr, 5, 1),
        tool_(*session_.scene().findTool("forceps")),
        device_(pullTo(pulled_m)) {
    tool_.setVolume(session_.volume());
    tool_.setTopology(std::make_shared<const Topology>(session_.topology()));
  }

  const ToolOutput& goTo(double time_s) {
    while (device_.time_s() < time_s)
      step();
    return output_;
  }
  Vector3 tip() const { return device_.pose().position_m; }
  /// That the hand put in.
  double work() const { return work_j_; }
  double largestForce() const { return largest_n_; }
  double fastestMove() const { return fastest_m_s_; }
  double time() const { return device_.time_s(); }

 private:
  void step() {
    if (ticks_++ % kTicksPerPatch == 0)
      tool_.setPatch(session_.patch("forceps", tip(), tool_.config().patch_radius_m));
    const Vector3 before = tip();
    device_.step();
    work_j_ -= output_.device_force_n.dot(tip() - before);
    ToolInput input;
    input.time_s = input.pose_time_s = device_.time_s();
    input.pose = device_.pose();
    input.velocity_m_s = device_.velocity_m_s();
    input.buttons = device_.buttons();
    output_ = tool_.update(input);
    device_.setServoForce(output_.device_force_n);
    largest_n_ = std::max(largest_n_, output_.device_force_n.norm());
    fastest_m_s_ = std::max(fastest_m_s_, device_.velocity_m_s().norm());
    if (output_.force) {
      EXPECT_TRUE(session_.apply(toCommand("forceps", *output_.force)).applied);
    }
    session_.step();
  }

  Session session_;
  Tool tool_;
  VirtualDevice device_;
  ToolOutput output_;
  int ticks_ = 0;
  double work_j_ = 0.0;
  double largest_n_ = 0.0;
  double fastest_m_s_ = 0.0;
};

TEST(GraspingLoop, PullsTissueInAnyDirectionAndLetsGo) {
  for (const Vector3& way : {Vector3(0.0, 0.0, 0.012), Vector3(0.010, -0.004, 0.004), Vector3(0.0, 0.006, -0.008)}) {
    GraspingLoop loop(way);
    EXPECT_FALSE(loop.goTo(0.7).gripping);
    const ToolOutput closed = loop.goTo(0.9);
    ASSERT_TRUE(closed.gripping);
    EXPECT_LT(closed.device_force_n.norm(), 0.02);
    EXPECT_LT((closed.grip_point_m - kSkin).norm(), 0.002);
    const ToolOutput pulled = loop.goTo(2.0);
    ASSERT_TRUE(pulled.gripping);
    const Vector3 moved = pulled.grip_point_m - closed.grip_point_m;
    EXPECT_GT(moved.dot(way.normalized()), 0.1 * way.norm());
    EXPECT_LT(pulled.device_force_n.normalized().dot(way.normalized()), -0.9);
    double least = pulled.device_force_n.norm();
    double most = least;
    while (loop.time() < 2.59) {
      const double force = loop.goTo(loop.time() + 0.0005).device_force_n.norm();
      least = std::min(least, force);
      most = std::max(most, force);
    }
    EXPECT_LT(most - least, 0.05 * most);  // no buzz while it is held
    const ToolOutput open = loop.goTo(4.3);
    EXPECT_FALSE(open.gripping);
    EXPECT_EQ(open.device_force_n, Vector3::Zero());
    EXPECT_GT(loop.work(), -0.01 * loop.largestForce() * way.norm());  // the tissue gives back no more than it got
    std::cout << "[ measure  ] pulled " << 1e3 * way.norm() << " mm: tissue follows by " << 1e3 * moved.norm()
              << " mm, " << loop.largestForce() << " N, held within " << 100.0 * (most - least) / most
              << " %, the hand put in " << 1e3 * loop.work() << " mJ\n";
  }
}

TEST(GraspingLoop, SlipsWithoutAJerk) {
  const Vector3 way(0.0, 0.0, 0.020);
  GraspingLoop held(way);
  held.goTo(2.0);
  const double slip_n = 0.5 * held.largestForce();
  GraspingLoop loop(way, slip_n);
  const ToolOutput slipped = loop.goTo(2.0);
  EXPECT_FALSE(slipped.gripping);
  EXPECT_FALSE(slipped.contact.touching);
  EXPECT_LT(loop.largestForce(), 1.001 * slip_n);
  EXPECT_GT(loop.largestForce(), 0.95 * slip_n);
  EXPECT_EQ(slipped.device_force_n, Vector3::Zero());
  EXPECT_FALSE(loop.goTo(3.5).gripping);  // closed jaws do not grip again
  EXPECT_LT(loop.fastestMove(), 0.2);
}

}  // namespace
}  // namespace soft_volume::core
