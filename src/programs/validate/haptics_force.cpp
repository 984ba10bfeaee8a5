// How true a force is: what a tool shows when it presses 3 x 3 vertices of a homogeneous block slowly, against what the
// whole lattice says under the same force.

#include "haptics_force.h"

#include <memory>
#include <sstream>

#include "blocks.h"
#include "haptic_block.h"
#include "soft_volume/session/session.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kTip_m = 0.002;         // small, so that a sphere that rests on the dent's flanks tells of the dent
constexpr double kFootprint_m = 0.0119;  // 3 x 3 vertices of cells of 6 mm
constexpr double kMostError = 0.05;
constexpr double kTick_s = 0.001;
constexpr int kTicksPerPatch = 4;
constexpr int kSettle = 3000;  // ticks

struct Point {
  double force_n;
  double proxy_depth_m;
  double device_depth_m;
  double stiffness_n_m;
};

/// A hand that presses as slowly as one likes: steps of a depth, each held until all is at rest.
std::vector<Point> press(const HapticBlock& block, double damping_n_s_m, const std::vector<double>& depths_m) {
  Session session(block.scene, block.volume, nullptr, 1, 1);
  ToolConfig config;
  config.tissue_threshold = block.threshold;
  config.tip_radius_m = kTip_m;
  config.footprint_radius_m = kFootprint_m;
  config.coupling.device_damping_n_s_m = damping_n_s_m;
  config.coupling.stiffness_n_m = config.device.max_stiffness_n_m;
  Tool tool(config);
  tool.setVolume(session.volume());
  tool.setTopology(std::make_shared<const Topology>(session.topology()));
  ToolInput input;
  ToolOutput output;
  int tick = 0;
  double depth_m = -0.005;
  const auto run = [&](int ticks, double to_m) {
    const double from_m = depth_m;
    for (int n = 1; n <= ticks; ++n, ++tick) {
      depth_m = from_m + (to_m - from_m) * n / ticks;
      input.time_s = input.pose_time_s = kTick_s * tick;
      input.pose.position_m = block.top_m + (kTip_m - depth_m) * Vector3::UnitZ();
      if (tick % kTicksPerPatch == 0)
        tool.setPatch(session.patch(config.id, input.pose.position_m, config.patch_radius_m));
      output = tool.update(input);
      if (output.force)
        session.apply(toCommand(config.id, *output.force));
      while (session.simulationTime() < input.time_s)
        session.step();
    }
  };
  std::vector<Point> points;
  run(500, -0.005);
  for (const double to_m : depths_m) {
    run(kSettle, to_m);
    run(kSettle, to_m);
    points.push_back({output.device_force_n.z(), block.top_m.z() + kTip_m - output.contact.proxy_m.z(), to_m,
                      output.coupling_stiffness_n_m});
  }
  return points;
}

/// How deep the middle of the top lies when the whole lattice carries the force.
double latticeDepth(const HapticBlock& block, double force_n) {
  const Lattice lattice = buildLattice(*block.volume, nullptr, block.scene.materials, block.scene.lattice);
  Simulation simulation(lattice, block.scene.materials, staticSettings(), 1);
  Vector3 point_m = block.top_m;
  double depth_m = 0.0;
  // The footprint lies on the deformed surface: once more where the first answer has it.
  for (int round = 0; round < 2; ++round) {
    simulation.holdForce("probe", -force_n * Vector3::UnitZ(), point_m, kFootprint_m, 1U << 30U);
    settle(simulation, 1e-8, 20000);
    const std::vector<std::uint32_t> below = simulation.verticesNear(point_m, 0.005);
    for (const std::uint32_t v : below) {
      if ((lattice.rest_positions[v] - block.top_m).norm() < 1e-6)
        depth_m = block.top_m.z() - simulation.positions()[v].z();
    }
    point_m = block.top_m - depth_m * Vector3::UnitZ();
  }
  return depth_m;
}

}  // namespace

void forceAgainstDepth(const Options& options, Report& report) {
  const HapticBlock block = makeHapticBlock(TissueKind::kMuscle);
  for (const double damping : options.quick ? std::vector<double>{0.2} : std::vector<double>{0.2, 1.0}) {
    for (const Point& point : press(block, damping, {0.005, 0.010, 0.015})) {
      std::ostringstream name;
      name << "3x3 vertices, b " << damping << ", device " << 1e3 * point.device_depth_m << " mm deep: ";
      const double depth_m = latticeDepth(block, point.force_n);
      report.row(name.str() + "force, N", point.force_n, 0.0, point.force_n);
      report.equal(name.str() + "depth of the proxy, m", point.proxy_depth_m, depth_m, kMostError);
      report.equal(name.str() + "depth of the device, m: lattice and coupling in series", point.device_depth_m,
                   depth_m + point.force_n / point.stiffness_n_m, kMostError);
    }
  }
}

}  // namespace soft_volume::core::validate
