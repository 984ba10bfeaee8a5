// Extreme 11: values that are no numbers, or absurd ones, must be refused and change nothing.

#include <cmath>
#include <limits>
#include <sstream>

#include "extremes.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kBad[] = {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), 1e38};

/// Counts inputs that were taken, or that changed something although they were refused.
class Refusals {
 public:
  template <typename Attempt>
  void expect(const std::string& what, const Attempt& attempt) {
    ++tried_;
    try {
      attempt();
      taken_ += (taken_.empty() ? "" : ", ") + what;
      ++count_;
    } catch (const Error&) {
      // as it should be
    }
  }

  /// The same for a call to a living simulation.
  template <typename Attempt>
  void expectUnchanged(const std::string& what, Simulation& simulation, const Attempt& attempt) {
    const std::uint64_t hash = simulation.stateHash();
    const SimulationState state = simulation.state();
    expect(what, attempt);
    const bool same = simulation.stateHash() == hash && simulation.state().forces.size() == state.forces.size() &&
                      simulation.state().grips.size() == state.grips.size() &&
                      simulation.state().loads.size() == state.loads.size();
    count_ += same ? 0 : 1;
    taken_ += same ? "" : " (" + what + " changed the state)";
  }

  void reportAs(const std::string& name, Report& report) const {
    std::ostringstream text;
    text << "11 inputs: " << name << ": not refused of " << tried_ << (taken_.empty() ? "" : ": ") << taken_;
    report.atMost(text.str(), count_, 0.0, std::nullopt);
  }

 private:
  int tried_ = 0;
  int count_ = 0;
  std::string taken_;
};

std::string nameOf(const char* what, double bad) {
  std::ostringstream name;
  name << what << " " << bad;
  return name.str();
}

/// A block with a force, a grip and some motion, so that there is a state to lose.
std::unique_ptr<Block> makeTarget() {
  Experiment experiment;
  experiment.cells = Vector3i::Constant(4);
  return makeExtremeBlock(experiment, false);
}

void busyState(const Block& block, Simulation& simulation) {
  const std::uint32_t top = block.vertex(2, 2, 4);
  simulation.holdForce("tool", Vector3(0.01, 0, 0), block.lattice.rest_positions[top], 1.5 * block.edge(), kForever);
  simulation.gripVertices("jaws", {block.vertex(0, 0, 4)}, Pose(), kForever);
  for (int n = 0; n < 20; ++n)
    simulation.step();
}

void badForces(const Block& block, Simulation& simulation, Report& report) {
  Refusals refusals;
  const Vector3 top = block.lattice.rest_positions[block.vertex(2, 2, 4)];
  for (const double bad : kBad) {
    refusals.expectUnchanged(nameOf("force", bad), simulation,
                             [&] { simulation.holdForce("tool", Vector3(0, bad, 0), top, 0.01, kForever); });
    refusals.expectUnchanged(nameOf("load", bad), simulation, [&] {
      simulation.setLoads({{block.vertex(2, 2, 4), Vector3(0, 0, bad)}});
    });
    refusals.expectUnchanged(nameOf("point", bad), simulation, [&] {
      simulation.holdForce("tool", Vector3(0, 1, 0), Vector3(bad, 0, 0), 0.01, kForever);
    });
    refusals.expectUnchanged(nameOf("radius", bad), simulation,
                             [&] { simulation.holdForce("tool", Vector3(0, 1, 0), top, bad, kForever); });
  }
  refusals.reportAs("forces", report);
}

void badPoses(const Block& block, Simulation& simulation, Report& report) {
  Refusals refusals;
  const std::uint32_t corner = block.vertex(0, 0, 4);
  for (const double bad : kBad) {
    Pose place;
    place.position_m.x() = bad;
    Pose turn;
    turn.orientation.x() = bad;
    for (const Pose& pose : {place, turn}) {
      refusals.expectUnchanged(nameOf("closed jaws", bad), simulation, [&] {
        simulation.closeGrip("jaws", block.lattice.rest_positions[corner], 0.01, pose, kForever);
      });
      refusals.expectUnchanged(nameOf("gripped", bad), simulation,
                               [&] { simulation.gripVertices("jaws", {corner}, pose, kForever); });
      refusals.expectUnchanged(nameOf("moved jaws", bad), simulation,
                               [&] { simulation.moveGrip("jaws", pose, kForever); });
    }
    refusals.expectUnchanged(nameOf("led", bad), simulation,
                             [&] { simulation.leadVertices("jaws", {corner}, {Vector3(0, bad, 0)}, kForever); });
  }
  refusals.reportAs("poses", report);
}

void badStates(Simulation& simulation, Report& report) {
  Refusals refusals;
  for (const double bad : kBad) {
    refusals.expectUnchanged(nameOf("displacement", bad), simulation, [&] {
      SimulationState state = simulation.state();
      state.displacements_m[30].y() = bad;
      simulation.restore(state);
    });
    refusals.expectUnchanged(nameOf("velocity", bad), simulation, [&] {
      SimulationState state = simulation.state();
      state.velocities_m_s[30].y() = bad;
      simulation.restore(state);
    });
  }
  refusals.reportAs("states", report);
}

void badSteps(const Block& block, Simulation& simulation, Report& report) {
  Refusals refusals;
  for (const double bad : {kBad[0], kBad[1], kBad[2], -1e-3}) {
    for (const Integrator integrator : {Integrator::kSymplecticEuler, Integrator::kBackwardEuler}) {
      refusals.expectUnchanged(nameOf("set dt", bad), simulation, [&] { simulation.setIntegrator(integrator, bad); });
      refusals.expect(nameOf("dt", bad), [&] {
        SimulationSettings settings;
        settings.integrator = integrator;
        settings.dt_s = bad;
        Simulation(block.lattice, block.materials, settings, 1);
      });
    }
  }
  refusals.reportAs("steps", report);
}

void badMaterials(const Block& block, Report& report) {
  Refusals refusals;
  const auto attempt = [&](const std::string& what, double Material::*field, double bad) {
    refusals.expect(what, [&] {
      Material material = tissue();
      material.*field = bad;
      Simulation(block.lattice, {material}, SimulationSettings(), 1);
    });
  };
  for (const double bad : {kBad[0], kBad[1], kBad[2], 0.0, -1.0}) {
    attempt(nameOf("stiffness", bad), &Material::youngs_modulus_pa, bad);
    attempt(nameOf("density", bad), &Material::density_kg_m3, bad);
  }
  for (const double bad : {kBad[0], kBad[1], kBad[2], 0.5, 0.2}) {
    attempt(nameOf("nu", bad), &Material::poisson_ratio, bad);
  }
  for (const double bad : {kBad[0], kBad[1], kBad[2], -0.1})
    attempt(nameOf("damping", bad), &Material::damping_ratio, bad);
  refusals.reportAs("materials", report);
}

void badSurroundings(const Block& block, Report& report) {
  Refusals refusals;
  for (const double bad : kBad) {
    refusals.expect(nameOf("gravity", bad), [&] {
      SimulationSettings settings;
      settings.gravity_m_s2.z() = bad;
      Simulation(block.lattice, block.materials, settings, 1);
    });
    refusals.expect(nameOf("pressure", bad), [&] {
      SimulationSettings settings;
      settings.pressures.push_back({Box3(Vector3(0, 0, 0), Vector3(1, 1, 1)), bad});
      Simulation(block.lattice, block.materials, settings, 1);
    });
  }
  refusals.reportAs("gravity and pressure", report);
}

}  // namespace

void refusedInputs(const Options& options, Report& report) {
  const std::unique_ptr<Block> block = makeTarget();
  Simulation simulation(block->lattice, block->materials, SimulationSettings(), options.threads);
  busyState(*block, simulation);
  badForces(*block, simulation, report);
  badPoses(*block, simulation, report);
  badStates(simulation, report);
  badSteps(*block, simulation, report);
  badMaterials(*block, report);
  badSurroundings(*block, report);
}

}  // namespace soft_volume::core::validate
