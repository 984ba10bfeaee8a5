#include "soft_volume/render/camera.h"

#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

TEST(Camera, LooksAtTheTargetWithUpUpwardsInTheImage) {
  const Camera camera = Camera::lookAt({0, -2, 1}, {0, 3, 1}, {0, 0, 1}, 0.6, 640, 480);
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  EXPECT_TRUE((T_camera_volume * Vector3(0, 3, 1)).isApprox(Vector3(0, 0, 5), 1e-12));
  EXPECT_TRUE((T_camera_volume * Vector3(1, 0, 1)).isApprox(Vector3(1, 0, 2), 1e-12)) << "x is right";
  EXPECT_TRUE((T_camera_volume * Vector3(0, 0, 2)).isApprox(Vector3(0, -1, 2), 1e-12)) << "y is down";
}

TEST(Camera, VerticalFieldOfViewReachesTheOuterPixelEdges) {
  const Camera camera = Camera::lookAt({0, 0, 0}, {1, 0, 0}, {0, 0, 1}, 0.8, 320, 200);
  EXPECT_NEAR(camera.fy * std::tan(-0.4) + camera.cy, -0.5, 1e-12);
  EXPECT_NEAR(camera.fy * std::tan(0.4) + camera.cy, 199.5, 1e-12);
  EXPECT_EQ(camera.fx, camera.fy);
  EXPECT_EQ(camera.cx, 159.5);
}

TEST(Camera, LookAtRefusesWhatGivesNoView) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(Camera::lookAt({1, 1, 1}, {1, 1, 1}, {0, 0, 1}, 0.5, 64, 48), SceneError);
  EXPECT_THROW(Camera::lookAt({0, 0, 0}, {0, 0, 1}, {0, 0, 3}, 0.5, 64, 48), SceneError);
  EXPECT_THROW(Camera::lookAt({0, 0, 0}, {1, 0, 0}, {0, 0, 0}, 0.5, 64, 48), SceneError);
  EXPECT_THROW(Camera::lookAt({nan, 0, 0}, {1, 0, 0}, {0, 0, 1}, 0.5, 64, 48), SceneError);
  EXPECT_THROW(Camera::lookAt({0, 0, 0}, {1, 0, 0}, {0, 0, 1}, 0.0, 64, 48), SceneError);
  EXPECT_THROW(Camera::lookAt({0, 0, 0}, {1, 0, 0}, {0, 0, 1}, 3.2, 64, 48), SceneError);
  EXPECT_THROW(Camera::lookAt({0, 0, 0}, {1, 0, 0}, {0, 0, 1}, 0.5, 0, 48), SceneError);
}

TEST(Camera, EveryFieldIsValidated) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_NO_THROW(Camera{}.validate());
  const std::vector<std::function<void(Camera&)>> spoilers = {
      [](Camera& c) { c.width = 0; },
      [](Camera& c) { c.width = 8193; },
      [](Camera& c) { c.height = 0; },
      [](Camera& c) { c.height = 8193; },
      [](Camera& c) { c.fx = 0.0; },
      [nan](Camera& c) { c.fx = nan; },
      [](Camera& c) { c.fy = -1.0; },
      [nan](Camera& c) { c.fy = nan; },
      [nan](Camera& c) { c.cx = nan; },
      [nan](Camera& c) { c.cy = nan; },
      [](Camera& c) { c.near_m = 0.0; },
      [nan](Camera& c) { c.near_m = nan; },
      [](Camera& c) { c.far_m = 0.01; },
      [nan](Camera& c) { c.far_m = nan; },
      [nan](Camera& c) { c.T_volume_camera.position_m.y() = nan; },
      [](Camera& c) { c.T_volume_camera.orientation.coeffs().setZero(); },
      [nan](Camera& c) { c.T_volume_camera.orientation.x() = nan; },
  };
  for (std::size_t i = 0; i < spoilers.size(); ++i) {
    Camera camera;
    spoilers[i](camera);
    EXPECT_THROW(camera.validate(), SceneError) << "spoiler " << i;
  }
}

}  // namespace
}  // namespace soft_volume::core
