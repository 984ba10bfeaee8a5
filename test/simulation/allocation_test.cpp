#include <gtest/gtest.h>

#include "common/count_allocations.h"
#include "simulation_cases.h"
#include "soft_volume/simulation/setting_names.h"

namespace soft_volume::core {
namespace {

std::size_t allocationsOfSteps(Simulation& simulation, int steps) {
  const std::size_t before = allocations;
  run(simulation, steps);
  return allocations - before;
}

TEST(Allocation, IsCounted) {
  const std::size_t before = allocations;
  const std::vector<int> memory(100);
  EXPECT_EQ(allocations - before, 1U);
}

TEST(Allocation, ExplicitStepsTakeNoMemory) {
  for (const Integrator integrator : {Integrator::kSymplecticEuler, Integrator::kDissertation, Integrator::kRungeKutta4,
                                      Integrator::kAdaptive, Integrator::kQuasiStatic}) {
    for (const auto& precision : kChoices<Precision>) {
      for (const auto& active_set : kChoices<ActiveSet>) {
        SCOPED_TRACE(std::string(nameOf(integrator)) + " " + precision.name + " " + active_set.name);
        const Lattice lattice = standing(makeBlock(5, 5, 4, kH));
        const std::vector<Material> materials = oneMaterial(kModulus, 0.3, 0.4);
        SimulationSettings settings;
        settings.integrator = integrator;
        settings.precision = precision.choice;
        settings.active_set = active_set.choice;
        settings.lifetime_s = 10.0;
        settings.gravity_m_s2 = Vector3(0, 0, -1);  // all is awake from the start
        Simulation simulation(lattice, materials, settings, 1);
        simulation.holdForce("a", Vector3(0.1, 0, -0.3), Vector3(2, 2, 4) * kH, 1.6 * kH, 1000000);
        simulation.closeGrip("b", Vector3(5, 5, 4) * kH, 1.1 * kH, Pose(), 1000000);
        simulation.moveGrip("b", {Vector3(0, 0, 0.3 * kH), Quaternion::Identity()}, 1000000);
        run(simulation, 20);
        EXPECT_EQ(allocationsOfSteps(simulation, 40), 0U);
      }
    }
  }
}

/// While moves are shortened again and again, nothing is taken once the lists have their size.
TEST(Allocation, AViolentStepTakesNoMemory) {
  const Lattice lattice = standing(makeBlock(4, 4, 4, kH));
  const std::vector<Material> materials = oneMaterial(kModulus);
  Simulation simulation(lattice, materials, wholeLattice(Precision::kFloat), 1);
  simulation.holdForce("a", Vector3(30.0, 0, -1e3), Vector3(2, 2, 4) * kH, 1.6 * kH, 1000000);
  run(simulation, 300);
  const std::uint64_t limited = simulation.limitedMoves();
  EXPECT_GT(limited, 0U);
  EXPECT_EQ(allocationsOfSteps(simulation, 50), 0U);
}

}  // namespace
}  // namespace soft_volume::core
