#include "soft_volume/scene/scene_override.h"

#include <gtest/gtest.h>

#include "small_scene.h"
#include "soft_volume/common/error.h"
#include "soft_volume/simulation/presets.h"

namespace soft_volume::core {
namespace {

std::string resolved() {
  return writeScene(smallScene());
}

Scene changed(const std::string& changes) {
  return parseScene(overrideScene(resolved(), parseOverrides(changes)), "test", "/");
}

TEST(SceneOverride, ChangesKeysByPathNameAndPlace) {
  const Scene scene = changed(
      "simulation.gravity_m_s2=[0, 0, -9.8],materials.tissue.youngs_modulus_pa=5050,tools.1.tip_radius_m=0.003,"
      "tools.probe.friction_coefficient=0.5");
  EXPECT_EQ(scene.simulation.gravity_m_s2, Vector3(0, 0, -9.8));
  EXPECT_EQ(scene.materials[0].youngs_modulus_pa, 5050.0);
  EXPECT_EQ(scene.tools[1].tip_radius_m, 0.003);
  EXPECT_EQ(scene.tools[0].friction_coefficient, 0.5);
  EXPECT_EQ(scene.simulation.dt_s, 0.001);
}

TEST(SceneOverride, FindsTheTimeStepAnewWhereTheMethodChanges) {
  EXPECT_EQ(changed("simulation.integrator=runge_kutta_4").simulation.dt_s, 0.0);
  EXPECT_EQ(changed("lattice.spacing_m=0.01").simulation.dt_s, 0.0);
  EXPECT_EQ(changed("simulation.integrator=backward_euler,simulation.dt_s=0.004").simulation.dt_s, 0.004);
}

TEST(SceneOverride, APresetTakesThePlaceOfTheMethodAlone) {
  const Scene scene = changed("simulation.preset=reed1997,simulation.gravity_m_s2=[0,0,-1],simulation.lifetime_s=2");
  const SimulationSettings preset = simulationPreset("reed1997");
  EXPECT_EQ(scene.simulation.integrator, preset.integrator);
  EXPECT_EQ(scene.simulation.active_set, preset.active_set);
  EXPECT_EQ(scene.simulation.dt_s, 0.0);
  EXPECT_EQ(scene.simulation.lifetime_s, 2.0);
  EXPECT_EQ(scene.simulation.gravity_m_s2.z(), -1.0);
}

TEST(SceneOverride, NothingChangedIsTheSameScene) {
  EXPECT_EQ(writeScene(parseScene(overrideScene(resolved(), {}), "test", "/")), resolved());
}

TEST(SceneOverride, RefusesWhatIsNoKeyOrNoValue) {
  for (const char* text : {"simulation", "=1", "simulation.dt_s=", "a=1,,b=2"})
    EXPECT_THROW(parseOverrides(text), InputError) << text;
  for (const char* text : {"simulaton.dt_s=1", "simulation.speed=1", "materials.bone.poisson_ratio=0.4",
                           "materials.tissue=[", "tools.7={}", "simulation.integrator=euler"})
    EXPECT_THROW(changed(text), SceneError) << text;
}

}  // namespace
}  // namespace soft_volume::core
