#include "gl_canvas.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <limits>
#include <random>
#include <string>
#include <thread>

#include "light.h"
#include "render/canvas_scene.h"
#include "render/cell_grids.h"
#include "render/render_scenes.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"

namespace soft_volume::core {
namespace {

/// A volume over a block of cells.
struct Scene : CanvasScene {
  Scene(const Box3& box, const Vector3i& cells, std::shared_ptr<const Volume> volume, const TransferFunction& function,
        int max_texture_side = 0)
      : CanvasScene(std::make_unique<GlCanvas>(max_texture_side), makeBlock(box, cells), std::move(volume), function) {}
};

std::shared_ptr<const Volume> constantVolume() {
  return makeVolume(Vector3i(4, 4, 4), Vector3::Ones(), [](const Vector3&) { return 1.0; });
}

/// White everywhere with one opacity.
TransferFunction makeFog(float opacity, double unit_distance_m) {
  TransferFunction function;
  function.points = {{-1.0, Vector3f::Ones(), opacity}, {2.0, Vector3f::Ones(), opacity}};
  function.unit_distance_m = unit_distance_m;
  return function;
}

/// Grey of the value, opaque.
TransferFunction makeRamp(double low, double high) {
  TransferFunction function;
  function.points = {{low, Vector3f::Zero(), 1.0F}, {high, Vector3f::Ones(), 1.0F}};
  function.unit_distance_m = 1e-4;
  return function;
}

RenderOptions plain(int slices, bool depth = false) {
  RenderOptions options;
  options.slices = slices;
  options.shading = 0.0;
  options.depth = depth;
  return options;
}

/// Opaque sheet around z = 1 m, drawn with one slice at exactly z = 1 m.
Box3 sheet(double x0, double x1, double y0, double y1) {
  return {Vector3(x0, y0, 0.9995), Vector3(x1, y1, 1.0005)};
}

/// How far the ray of a pixel runs inside a box, metres.
double wayInside(const Camera& camera, int u, int v, const Box3& box) {
  const Vector3 slope((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0);
  const Vector3 direction = camera.T_volume_camera.orientation * slope;
  double enter = 0.0;
  double leave = 1e9;
  for (int axis = 0; axis < 3; ++axis) {
    const double a = (box.min()[axis] - camera.T_volume_camera.position_m[axis]) / direction[axis];
    const double b = (box.max()[axis] - camera.T_volume_camera.position_m[axis]) / direction[axis];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return std::max(0.0, leave - enter) * slope.norm();
}

TEST(GlCanvas, FogHasTheAnalyticOpacityForAnyNumberOfSlices) {
  const Box3 box(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));
  Scene scene(box, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  const Camera camera = straightCamera(Vector3::Zero());
  for (const int slices : {50, 100, 200}) {
    const Frame frame = scene.render(camera, plain(slices));
    EXPECT_EQ(frame.slices, slices);
    for (int v = 0; v < frame.height; v += 7) {
      for (int u = 0; u < frame.width; u += 7) {
        // Every ray crosses front and back face, so the slabs fill its way exactly; 2e-5 is the driver's exp2.
        const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, box) / 0.05);
        EXPECT_NEAR(pixelOf(frame, u, v)[3], exact, 1e-4) << slices << " slices, pixel " << u << " " << v;
        EXPECT_NEAR(pixelOf(frame, u, v)[0], exact, 1e-4);
      }
    }
  }
}

TEST(GlCanvas, OpaquePixelsTakeNothingMoreAndNobodySeesIt) {
  const Box3 box(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));
  // Each slab of 2 mm lets 0.7 through: 1 - 0.7^100 in all, and 0.999 is passed in the 20th slab.
  Scene scene(box, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.002));
  const Frame frame = scene.render(straightCamera(Vector3::Zero()), plain(100));
  const float alpha = pixelOf(frame, frame.width / 2, frame.height / 2)[3];
  EXPECT_GE(alpha, 0.999F);
  EXPECT_LT(alpha, 1.0 - std::pow(0.7, 40)) << "no pixel was masked: the rest of the grid was drawn for nothing";
}

TEST(GlCanvas, ObliqueFogErrsByLessThanTwoSlabs) {
  const Box3 box(Vector3(-0.1, -0.1, -0.1), Vector3(0.1, 0.1, 0.1));
  Scene scene(box, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  const Camera camera = Camera::lookAt({0.5, 0.8, 0.6}, {0, 0, 0}, {0, 0, 1}, 0.4, 64, 48);
  double former_mean = 1.0;
  for (const int slices : {50, 100, 200}) {
    const Frame frame = scene.render(camera, plain(slices));
    double sum = 0.0;
    for (int v = 0; v < frame.height; ++v) {
      for (int u = 0; u < frame.width; ++u) {
        const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, box) / 0.05);
        const double error = std::abs(pixelOf(frame, u, v)[3] - exact);
        // Both ends of the way are off by up to half a slab; the box's depth is at most its diagonal.
        const double slab = 0.2 * std::sqrt(3.0) / slices * 1.1;
        EXPECT_LT(error, 1.0 - std::pow(0.7, slab / 0.05)) << "pixel " << u << " " << v;
        sum += error;
      }
    }
    const double mean = sum / (frame.width * frame.height);
    EXPECT_LT(mean, 0.7 * former_mean);
    former_mean = mean;
  }
  EXPECT_LT(former_mean, 1e-3);
}

TEST(GlCanvas, PixelCentresAreWholeNumbers) {
  const Camera camera = straightCamera(Vector3::Zero());
  for (const double shift : {-0.25, 0.25}) {
    const double left = 20.5 + shift, right = 40.5 + shift, top = 10.5 + shift, bottom = 30.5 + shift;
    const Box3 box = sheet((left - camera.cx) / camera.fx, (right - camera.cx) / camera.fx,
                           (top - camera.cy) / camera.fy, (bottom - camera.cy) / camera.fy);
    Scene scene(box, Vector3i(1, 1, 1), constantVolume(), makeFog(0.9F, 1e-4));
    const Frame frame = scene.render(camera, plain(1));
    for (int v = 0; v < frame.height; ++v) {
      for (int u = 0; u < frame.width; ++u) {
        const bool inside = u > left && u < right && v > top && v < bottom;
        EXPECT_EQ(pixelOf(frame, u, v)[3] > 0.5F, inside) << "shift " << shift << " pixel " << u << " " << v;
      }
    }
  }
}

TEST(GlCanvas, PrincipalPointAndBothFocalLengthsCount) {
  Camera camera = straightCamera(Vector3::Zero());
  camera.fx = 80.0;
  camera.fy = 120.0;
  camera.cx = 25.0;
  camera.cy = 30.0;
  Scene scene(sheet(0.05, 0.15, -0.1, 0.05), Vector3i(1, 1, 1), constantVolume(), makeFog(0.9F, 1e-4));
  const Frame frame = scene.render(camera, plain(1));
  for (int v = 0; v < frame.height; ++v) {
    for (int u = 0; u < frame.width; ++u) {
      const double x = (u - 25.0) / 80.0, y = (v - 30.0) / 120.0;
      if (std::min(std::abs(x - 0.05), std::abs(x - 0.15)) < 1e-6 || std::abs(y + 0.1) < 1e-6 ||
          std::abs(y - 0.05) < 1e-6) {
        continue;  // a pixel centre on the border may go to either side
      }
      EXPECT_EQ(pixelOf(frame, u, v)[3] > 0.5F, x > 0.05 && x < 0.15 && y > -0.1 && y < 0.05) << u << " " << v;
    }
  }
}

TEST(GlCanvas, DepthOfAnOpaqueFaceIsWithinHalfASlab) {
  const Box3 box(Vector3(-0.2, -0.1, 1.0), Vector3(0.2, 0.1, 1.2));
  Scene scene(box, Vector3i(2, 2, 2), constantVolume(), makeFog(0.999F, 1e-4));
  const Camera camera = straightCamera(Vector3::Zero());
  for (const int slices : {50, 100}) {
    const Frame frame = scene.render(camera, plain(slices, true));
    for (int v = 0; v < frame.height; ++v) {
      for (int u = 0; u < frame.width; ++u) {
        const float depth = frame.depth_m[std::size_t(v) * 64 + std::size_t(u)];
        if (pixelOf(frame, u, v)[3] == 0.0F) {
          EXPECT_TRUE(std::isnan(depth));
        } else if (std::abs(u - 31.5) < 19.0 && std::abs(v - 23.5) < 9.0) {
          EXPECT_NEAR(depth, 1.0, 0.5 * 0.2 / slices) << "along z, not along the ray";
        }
      }
    }
  }
}

TEST(GlCanvas, DepthOfASurfaceInsideTheVolumeIsWithinASlab) {
  const Box3 box(Vector3(-0.2, -0.2, 1.0), Vector3(0.2, 0.2, 1.2));
  const auto volume = makeVolume(Vector3i(4, 4, 100), Vector3(1, 1, 1), [](const Vector3& t) { return t.z() > 0.4; });
  Scene scene(box, Vector3i(2, 2, 2), volume, makeStep(0.5, 0.999F, 1e-4));
  const Frame frame = scene.render(straightCamera(Vector3::Zero()), plain(50, true));
  // The value passes 0.5 at t = 0.4, which is z = 1.08 m.
  EXPECT_NEAR(frame.depth_m[24 * 64 + 32], 1.08, 0.2 / 50);
}

TEST(GlCanvas, DepthInFogIsWhereTheThresholdIsPassed) {
  const Box3 box(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));
  Scene scene(box, Vector3i(2, 2, 2), constantVolume(), makeFog(0.3F, 0.05));
  const Camera camera = straightCamera(Vector3::Zero());
  for (const double threshold : {0.2, 0.5}) {
    RenderOptions options = plain(50, true);
    options.depth_threshold = threshold;
    const Frame frame = scene.render(camera, options);
    for (const int u : {2, 20, 31, 60}) {
      const double slope = std::hypot((u - camera.cx) / camera.fx, (24 - camera.cy) / camera.fy);
      const double way = 0.05 * std::log(1.0 - threshold) / std::log(0.7);
      const double exact = 1.0 + way / std::hypot(1.0, slope);
      EXPECT_NEAR(frame.depth_m[24 * 64 + std::size_t(u)], exact, 0.01 * 0.2 / 50);
    }
  }
  RenderOptions options = plain(50, true);
  options.depth_threshold = 0.95;  // more than the fog ever reaches
  EXPECT_TRUE(std::isnan(scene.render(camera, options).depth_m[24 * 64 + 32]));
}

/// A ball of value 1 with a soft border, and a deformed lattice around it.
struct BallScene : Scene {
  BallScene()
      : Scene(Box3(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1)), Vector3i(8, 8, 8),
              makeVolume(Vector3i(40, 40, 40), Vector3::Constant(0.2),
                         [](const Vector3& t) {
                           return 1.0 / (1.0 + std::exp(60.0 * ((t - Vector3::Constant(0.5)).norm() - 0.3)));
                         }),
              makeStep(0.5, 0.5F, 0.005)) {}
};

RenderOptions shaded(bool depth) {
  RenderOptions options;
  options.depth = depth;
  return options;
}

std::uint64_t hashOfFrame(const Frame& frame) {
  return hashBytes(frame.depth_m.data(), frame.depth_m.size() * 4, hashVector(frame.rgba));
}

TEST(GlCanvas, RepeatedFramesAreTheSameBits) {
  BallScene scene;
  const Camera camera = straightCamera(Vector3::Zero(), 160, 120, 400.0);
  const std::uint64_t first = hashOfFrame(scene.render(camera, shaded(true)));
  scene.render(straightCamera(Vector3(0.02, 0, 0.1), 100, 90, 200.0), plain(33));
  EXPECT_EQ(hashOfFrame(scene.render(camera, shaded(true))), first);
  BallScene other;
  EXPECT_EQ(hashOfFrame(other.render(camera, shaded(true))), first);
}

TEST(GlCanvas, ColoursDoNotDependOnDepth) {
  BallScene scene;
  const Camera camera = straightCamera(Vector3::Zero(), 160, 120, 400.0);
  EXPECT_EQ(scene.render(camera, shaded(false)).rgba, scene.render(camera, shaded(true)).rgba);
  EXPECT_TRUE(scene.render(camera, shaded(false)).depth_m.empty());
}

/// Run by the test below in processes of their own, as the driver reads its number of threads once.
TEST(GlCanvas, DISABLED_PrintHash) {
  BallScene scene;
  const Camera camera = straightCamera(Vector3::Zero(), 320, 240, 800.0);
  std::printf("hash %s\n", hashToString(hashOfFrame(scene.render(camera, shaded(true)))).c_str());
}

std::string hashWithThreads(const char* threads) {
  const std::string command = std::string("LP_NUM_THREADS=") + threads + " /proc/" + std::to_string(getpid()) +
                              "/exe --gtest_also_run_disabled_tests --gtest_filter=GlCanvas.DISABLED_PrintHash";
  FILE* pipe = popen(command.c_str(), "r");
  std::string output;
  std::array<char, 256> line{};
  while (pipe != nullptr && fgets(line.data(), int(line.size()), pipe) != nullptr) {
    if (std::strncmp(line.data(), "hash ", 5) == 0)
      output = line.data();
  }
  if (pipe != nullptr)
    pclose(pipe);
  return output;
}

TEST(GlCanvas, NumberOfThreadsChangesNothing) {
  const std::string one = hashWithThreads("1");
  EXPECT_EQ(one.size(), 22U) << one;
  EXPECT_EQ(hashWithThreads("2"), one);
  EXPECT_EQ(hashWithThreads("0"), one);
}

TEST(GlCanvas, WorksFromOneThreadAfterAnother) {
  BallScene scene;
  const Camera camera = straightCamera(Vector3::Zero());
  const std::uint64_t here = hashOfFrame(scene.render(camera, shaded(false)));
  std::uint64_t there = 0;
  std::thread([&] { there = hashOfFrame(scene.render(camera, shaded(false))); }).join();
  EXPECT_EQ(there, here);
}

TEST(GlCanvas, MovedCellsMoveThePicture) {
  Scene scene(sheet(-0.1, 0.1, -0.1, 0.1), Vector3i(2, 2, 1), constantVolume(), makeFog(0.9F, 1e-4));
  const Camera camera = straightCamera(Vector3::Zero());
  const Frame before = scene.render(camera, plain(1));
  std::vector<Vector3f> positions = scene.rest();
  for (Vector3f& p : positions)
    p += Vector3f(0.07F, -0.04F, 0.0F);  // 7 pixels right, 4 up at z = 1 m
  const Frame after = scene.render(camera, positions, plain(1));
  for (int v = 4; v < 44; ++v) {
    for (int u = 7; u < 64; ++u)
      EXPECT_NEAR(pixelOf(after, u, v - 4)[3], pixelOf(before, u - 7, v)[3], 1e-5);
  }
}

TEST(GlCanvas, TextureSticksToTheDeformedCells) {
  const Box3 box = sheet(-0.2, 0.2, -0.1, 0.1);
  const auto volume = makeVolume(Vector3i(200, 4, 4), Vector3::Ones(), [](const Vector3& t) { return t.x(); });
  Scene scene(box, Vector3i(2, 1, 1), volume, makeRamp(0.0, 1.0));
  std::vector<Vector3f> positions = scene.rest();
  for (Vector3f& p : positions) {
    if (std::abs(p.x()) < 1e-6F)
      p.x() = 0.1F;  // the left cell is stretched, the right one squeezed
  }
  const Camera camera = straightCamera(Vector3::Zero());
  const Frame frame = scene.render(camera, positions, plain(1));
  for (int u = 13; u < 50; ++u) {
    const double x = (u - camera.cx) / camera.fx;
    const double texture = x < 0.1 ? 0.5 * (x + 0.2) / 0.3 : 0.5 + 0.5 * (x - 0.1) / 0.1;
    const float* pixel = pixelOf(frame, u, 24);
    EXPECT_NEAR(pixel[0] / pixel[3], texture, 1e-3) << "pixel " << u;
  }
}

TEST(GlCanvas, ImageChangesOnlyWhereTheGridMoved) {
  BallScene scene;
  const Camera camera = straightCamera(Vector3::Zero(), 160, 120, 400.0);
  const Frame before = scene.render(camera, shaded(true));
  std::vector<Vector3f> positions = scene.rest();
  for (Vector3f& p : positions) {
    if (p.x() > 0.04F)
      p += Vector3f(0.02F, 0.0F, -0.05F);  // deeper than the grid at rest, so there are more slices
  }
  const Frame after = scene.render(camera, positions, shaded(true));
  EXPECT_GT(after.slices, before.slices);
  EXPECT_NE(after.rgba, before.rgba);
  const int untouched = 80;  // x = 0; the cells between x = 0.025 and 0.05 m changed, and the directions around them
  for (int v = 0; v < 120; ++v) {
    EXPECT_TRUE(std::equal(pixelOf(before, 0, v), pixelOf(before, untouched, v), pixelOf(after, 0, v))) << "row " << v;
  }
}

TEST(GlCanvas, CameraInsideTheGridSeesNoHolesAtTheBorder) {
  Scene scene(Box3(Vector3::Constant(-1), Vector3::Constant(1)), Vector3i(5, 5, 5), constantVolume(),
              makeFog(0.5F, 0.1));
  Camera camera = Camera::lookAt({0.1, 0.2, -0.1}, {1, 0.4, 0.3}, {0, 0, 1}, 1.2, 160, 120);
  std::mt19937 random(5);
  std::uniform_real_distribution<float> offset(-0.08F, 0.08F);
  std::vector<Vector3f> positions = scene.rest();
  for (Vector3f& p : positions)
    p += Vector3f(offset(random), offset(random), offset(random));
  const Frame frame = scene.render(camera, positions, plain(100));
  for (std::size_t i = 3; i < frame.rgba.size(); i += 4)
    ASSERT_GT(frame.rgba[i], 0.8F) << "pixel " << i / 4;
}

TEST(GlCanvas, GridOutOfSightGivesATransparentFrame) {
  BallScene scene;
  const Camera away = Camera::lookAt({0, 0, 0}, {0, 0, -1}, {0, 1, 0}, 0.5, 64, 48);
  const Frame frame = scene.render(away, shaded(true));
  EXPECT_EQ(frame.rgba, std::vector<float>(64 * 48 * 4, 0.0F));
  for (const float depth : frame.depth_m)
    EXPECT_TRUE(std::isnan(depth));
}

TEST(GlCanvas, FoldedAndCollapsedGridsGiveFiniteFrames) {
  BallScene scene;
  const Camera camera = straightCamera(Vector3(0, 0, 0.85));  // in front of and inside the grid
  std::mt19937 random(11);
  for (const float size_m : {0.0F, 1e-20F, 0.1F}) {
    std::uniform_real_distribution<float> coordinate(-size_m, size_m);
    std::vector<Vector3f> positions = scene.rest();
    for (Vector3f& p : positions)
      p = Vector3f(0, 0, 1) + Vector3f(coordinate(random), coordinate(random), 0.9F * coordinate(random));
    const Frame frame = scene.render(camera, positions, shaded(true));
    for (const float value : frame.rgba)
      ASSERT_TRUE(std::isfinite(value)) << "size " << size_m;
    for (const float depth : frame.depth_m)
      ASSERT_FALSE(std::isinf(depth)) << "size " << size_m;
  }
}

template <typename Scalar>
std::shared_ptr<const Volume> convert(const Volume& floats, ScalarType type, double scale, double offset) {
  const auto* values = reinterpret_cast<const float*>(floats.data().data());
  const std::size_t count = floats.geometry().voxelCount();
  std::vector<std::uint8_t> data(count * sizeof(Scalar));
  auto* scalars = reinterpret_cast<Scalar*>(data.data());
  for (std::size_t i = 0; i < count; ++i)
    scalars[i] = Scalar(values[i] * scale + offset);
  return std::make_shared<const Volume>(floats.geometry(), type, std::move(data));
}

TEST(GlCanvas, EveryScalarTypeIsLookedUpExactly) {
  // Values on a coarse grid, so that interpolation between voxels does most of the work.
  const auto floats = makeVolume(Vector3i(11, 4, 4), Vector3::Ones(), [](const Vector3& t) {
    return std::round((t.x() * 11.0 - 0.5) * 12.0);  // 0 to 120
  });
  const Camera camera = straightCamera(Vector3::Zero());
  const Box3 box = sheet(-0.2, 0.2, -0.1, 0.1);
  const auto expectRamp = [&](std::shared_ptr<const Volume> volume, double low, double high) {
    const std::string name = scalarName(volume->type());
    Scene scene(box, Vector3i(1, 1, 1), std::move(volume), makeRamp(low, high));
    const Frame frame = scene.render(camera, plain(1));
    for (int u = 14; u < 50; ++u) {
      const double texture = ((u - camera.cx) / camera.fx + 0.2) / 0.4;
      const double exact = std::clamp((texture * 11.0 - 0.5) / 10.0, 0.0, 1.0);
      // The table has 4096 entries; their nearest is at most 1 / 8190 away.
      EXPECT_NEAR(pixelOf(frame, u, 24)[0] / pixelOf(frame, u, 24)[3], exact, 3e-4) << name << " pixel " << u;
    }
  };
  expectRamp(floats, 0, 120);
  expectRamp(convert<std::int8_t>(*floats, ScalarType::kInt8, 2.0, -120.0), -120, 120);
  expectRamp(convert<std::uint8_t>(*floats, ScalarType::kUInt8, 2.0, 10.0), 10, 250);
  expectRamp(convert<std::int16_t>(*floats, ScalarType::kInt16, 30.0, -1024.0), -1024, 2576);
  expectRamp(convert<std::uint16_t>(*floats, ScalarType::kUInt16, 500.0, 0.0), 0, 60000);
  expectRamp(convert<std::int32_t>(*floats, ScalarType::kInt32, 100000.0, -5e6), -5e6, 7e6);
  expectRamp(convert<std::uint32_t>(*floats, ScalarType::kUInt32, 1e7, 0.0), 0, 1.2e9);
  expectRamp(convert<double>(*floats, ScalarType::kFloat64, 0.25, 3.0), 3, 33);
}

TEST(GlCanvas, NanScalarsDrawAsNothing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto volume =
      makeVolume(Vector3i(20, 4, 4), Vector3::Ones(), [nan](const Vector3& t) { return t.x() < 0.5 ? nan : 1.0; });
  Scene scene(Box3(Vector3(-0.2, -0.1, 0.95), Vector3(0.2, 0.1, 1.05)), Vector3i(4, 2, 2), volume, makeFog(0.9F, 0.01));
  const Frame frame = scene.render(straightCamera(Vector3::Zero()), shaded(true));
  EXPECT_EQ(pixelOf(frame, 20, 24)[3], 0.0F);
  EXPECT_GT(pixelOf(frame, 44, 24)[3], 0.9F);
  for (const float value : frame.rgba)
    ASSERT_TRUE(std::isfinite(value));
}

/// A soft step across the plane t.z = 0.5 + tilt (t.x - 0.5).
std::shared_ptr<const Volume> tiltedStep(double tilt) {
  return makeVolume(Vector3i(64, 64, 64), Vector3::Constant(0.2), [tilt](const Vector3& t) {
    return 1.0 / (1.0 + std::exp(-80.0 * (t.z() - 0.5 - tilt * (t.x() - 0.5))));
  });
}

TEST(GlCanvas, ShadingFollowsTheDeformation) {
  const Box3 box(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1));
  const Camera camera = straightCamera(Vector3::Zero());
  RenderOptions options;
  options.shading = 1.0;
  const auto brightness = [&](double volume_tilt, float shear) {
    Scene scene(box, Vector3i(4, 4, 4), tiltedStep(volume_tilt), makeStep(0.5, 0.999F, 1e-3));
    std::vector<Vector3f> positions = scene.rest();
    for (Vector3f& p : positions)
      p.z() += shear * p.x();
    const Frame frame = scene.render(camera, positions, options);
    return pixelOf(frame, 32, 24)[1] / pixelOf(frame, 32, 24)[3];
  };
  // The light comes from the left (-x): a surface that falls back to the right turns away from it.
  EXPECT_GT(brightness(-0.5, 0.0F), brightness(0.0, 0.0F));
  EXPECT_LT(brightness(0.8, 0.0F), brightness(0.0, 0.0F) - 0.1F);
  EXPECT_NEAR(brightness(0.0, 0.8F), brightness(0.8, 0.0F), 0.04);
  EXPECT_NEAR(brightness(0.0, -0.5F), brightness(-0.5, 0.0F), 0.04);
}

TEST(GlCanvas, ShadingOffDrawsTheColoursOfTheTransferFunction) {
  BallScene scene;
  const Frame frame = scene.render(straightCamera(Vector3::Zero()), plain(100));
  for (std::size_t i = 0; i < frame.rgba.size(); i += 4)
    ASSERT_NEAR(frame.rgba[i], frame.rgba[i + 3], 1e-5);
}

/// The depths at which a pixel's ray is inside [low, high] and the clip planes, as a length along the ray.
double wayBetween(const Camera& camera, int u, int v, double low, double high, const std::vector<ClipPlane>& planes) {
  const Eigen::Vector2d slope = camera.raySlope(u, v);
  const bool parallel = camera.projection == Projection::kParallel;
  const Vector3 start_camera =
      parallel ? Vector3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0.0) : Vector3(Vector3::Zero());
  const Vector3 start = camera.T_volume_camera * start_camera;
  const Vector3 direction = camera.T_volume_camera.orientation * Vector3(slope.x(), slope.y(), 1.0);
  for (const ClipPlane& plane : planes) {
    const double gain = plane.normal.dot(direction);
    const double room = plane.offset_m - plane.normal.dot(start);
    if (gain > 1e-12)
      high = std::min(high, room / gain);
    else if (gain < -1e-12)
      low = std::max(low, room / gain);
    else if (room < 0.0)
      return 0.0;
  }
  return std::max(0.0, high - low) * direction.norm();
}

Camera parallelCamera(double pixels_per_m) {
  Camera camera = straightCamera(Vector3::Zero(), 64, 48, pixels_per_m);
  camera.projection = Projection::kParallel;
  return camera;
}

TEST(GlCanvas, ClipPlanesAreExact) {
  const Box3 box(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));
  Scene scene(box, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  RenderOptions options = plain(13);
  options.clip_planes = {{Vector3(0.3, -0.2, 1.0).normalized(), 1.07},
                         {Vector3(-0.5, 0.1, -1.0).normalized(), -0.93},
                         {Vector3::UnitX(), 0.15}};
  int cut = 0;
  for (const Camera& camera : {straightCamera(Vector3::Zero()), parallelCamera(80.0)}) {
    const Frame frame = scene.render(camera, options);
    for (int v = 0; v < frame.height; ++v) {
      for (int u = 0; u < frame.width; ++u) {
        const double way = wayBetween(camera, u, v, 1.0, 1.2, options.clip_planes);
        cut += way > 0.0 && way < 0.15;
        ASSERT_NEAR(pixelOf(frame, u, v)[3], 1.0 - std::pow(0.7, way / 0.05), 1e-4) << "pixel " << u << " " << v;
      }
    }
  }
  EXPECT_GT(cut, 1000) << "the planes cut hardly anything";
}

TEST(GlCanvas, EightClipPlanesWorkTogether) {
  const Box3 box(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));
  Scene scene(box, Vector3i(2, 2, 2), constantVolume(), makeFog(0.3F, 0.05));
  RenderOptions options = plain(20);
  for (int i = 0; i < RenderOptions::kMaxClipPlanes; ++i) {
    const Vector3 outwards(std::cos(i * M_PI / 4), std::sin(i * M_PI / 4), 0.05 * i);
    options.clip_planes.push_back({outwards.normalized(), outwards.normalized().dot(Vector3(0, 0, 1.1)) + 0.15});
  }
  const Camera camera = parallelCamera(80.0);
  const Frame frame = scene.render(camera, options);
  for (int v = 0; v < frame.height; ++v) {
    for (int u = 0; u < frame.width; ++u) {
      const double way = wayBetween(camera, u, v, 1.0, 1.2, options.clip_planes);
      ASSERT_NEAR(pixelOf(frame, u, v)[3], 1.0 - std::pow(0.7, way / 0.05), 1e-4) << "pixel " << u << " " << v;
    }
  }
}

TEST(GlCanvas, NearAndFarAreExact) {
  const Box3 box(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));
  Scene scene(box, Vector3i(2, 2, 2), constantVolume(), makeFog(0.3F, 0.05));
  Camera camera = straightCamera(Vector3::Zero());
  camera.near_m = 1.0503;
  camera.far_m = 1.1273;
  RenderOptions options = plain(1);
  options.step_m = 0.02;  // the last slab reaches beyond far
  const Frame frame = scene.render(camera, options);
  const double way = wayBetween(camera, 32, 24, camera.near_m, camera.far_m, {});
  EXPECT_NEAR(pixelOf(frame, 32, 24)[3], 1.0 - std::pow(0.7, way / 0.05), 1e-4);
}

TEST(GlCanvas, ParallelRaysAllHaveTheSameWay) {
  // The depth is 0.2 m whatever the pixel; x = 0.1 m lies 8 pixels right of the centre at any depth.
  Scene scene(Box3(Vector3(-0.1, -0.1, 1.0), Vector3(0.1, 0.1, 1.2)), Vector3i(3, 3, 3), constantVolume(),
              makeFog(0.3F, 0.05));
  const Frame frame = scene.render(parallelCamera(80.0), plain(20));
  for (int v = 0; v < frame.height; ++v) {
    for (int u = 0; u < frame.width; ++u) {
      const bool inside = std::abs(u - 31.5) < 8.0 && std::abs(v - 23.5) < 8.0;
      ASSERT_NEAR(pixelOf(frame, u, v)[3], inside ? 1.0 - std::pow(0.7, 4.0) : 0.0, 1e-4) << u << " " << v;
    }
  }
}

TEST(GlCanvas, ParallelAndDistantPerspectiveViewsAgree) {
  BallScene scene;
  Camera near = parallelCamera(200.0);
  Camera far = straightCamera(Vector3(0, 0, 1.0 - 400.0), 64, 48, 200.0 * 400.0);
  far.far_m = 1000.0;
  RenderOptions options;
  options.depth = true;
  const Frame a = scene.render(near, options);
  const Frame b = scene.render(far, options);
  for (std::size_t i = 0; i < a.rgba.size(); ++i)
    ASSERT_NEAR(a.rgba[i], b.rgba[i], 0.02) << i;
  EXPECT_NEAR(a.depth_m[24 * 64 + 32], b.depth_m[24 * 64 + 32] - 399.0, 1e-3);
}

RenderOptions everything() {
  RenderOptions options;
  options.slices = 60;
  options.depth = true;
  options.labels = true;
  options.jitter = true;
  options.clip_planes = {{Vector3(1, 1, 0.5).normalized(), 0.55}};
  return options;
}

std::shared_ptr<const Volume> layers() {
  return makeVolume(Vector3i(3, 3, 7), Vector3::Ones(),
                    [](const Vector3& t) { return std::floor(t.z() * 7.0) * 100.0; });
}

TEST(GlCanvas, RectanglesAndRunsOfPlanesHaveTheSameBits) {
  BallScene scene;
  scene.setLabels(layers());
  const Camera camera = straightCamera(Vector3::Zero(), 160, 120, 500.0);
  const RenderOptions options = everything();
  const Frame whole = scene.render(camera, options);
  for (const PixelRect rect : {PixelRect{60, 50, 101, 73}, PixelRect{0, 0, 80, 120}, PixelRect{80, 60, 81, 61}}) {
    Frame part = CanvasScene::blankFrame(camera, options);
    std::fill(part.rgba.begin(), part.rgba.end(), -1.0F);
    scene.renderInto(part, camera, scene.rest(), options, rect, 7);
    for (int v = 0; v < camera.height; ++v) {
      for (int u = 0; u < camera.width; ++u) {
        const std::size_t pixel = std::size_t(v) * 160 + std::size_t(u);
        const bool inside = u >= rect.begin_x && u < rect.end_x && v >= rect.begin_y && v < rect.end_y;
        for (std::size_t channel = 0; channel < 4; ++channel)
          ASSERT_EQ(part.rgba[4 * pixel + channel], inside ? whole.rgba[4 * pixel + channel] : -1.0F) << u << " " << v;
        ASSERT_EQ(std::memcmp(&part.depth_m[pixel], inside ? &whole.depth_m[pixel] : &part.depth_m[0], 4), 0);
        ASSERT_EQ(part.labels[pixel], inside ? whole.labels[pixel] : 0) << u << " " << v;
      }
    }
  }
}

TEST(GlCanvas, JitterMovesTheSamplesByItsPattern) {
  // One slab from 1 to 1.2 m; its mean value is that of its middle, moved by the jitter along z.
  const auto volume = makeVolume(Vector3i(4, 4, 200), Vector3(0.4, 0.4, 0.4), [](const Vector3& t) { return t.z(); });
  const Box3 box(Vector3(-0.5, -0.5, 0.9), Vector3(0.5, 0.5, 1.3));
  Scene scene(box, Vector3i(1, 1, 1), volume, makeRamp(0.0, 1.0));
  RenderOptions options = plain(2);
  options.jitter = true;
  const Camera camera = straightCamera(Vector3::Zero());
  const Frame frame = scene.render(camera, options);
  for (int v = 0; v < frame.height; ++v) {
    for (int u = 0; u < frame.width; ++u) {
      const double middle = 0.25 + 0.5 * double(jitterAt(std::uint32_t(u), std::uint32_t(v)));
      // Below the first voxel's centre the value stays; the slabs are opaque, so only the first one shows.
      if (middle > 0.25) {
        ASSERT_NEAR(pixelOf(frame, u, v)[0] / pixelOf(frame, u, v)[3], middle, 2e-3) << u << " " << v;
      }
    }
  }
  EXPECT_EQ(frame.rgba, scene.render(camera, options).rgba);
}

TEST(GlCanvas, LabelsAreThoseAtTheDepth) {
  const Box3 box(Vector3(-0.2, -0.2, 1.0), Vector3(0.2, 0.2, 1.2));
  // The left half becomes opaque at t.z = 0.4, the right one at 0.8; labels change every seventh.
  const auto volume = makeVolume(Vector3i(40, 4, 100), Vector3::Ones(),
                                 [](const Vector3& t) { return t.z() > (t.x() < 0.5 ? 0.4 : 0.8) ? 1.0 : 0.0; });
  Scene scene(box, Vector3i(2, 2, 2), volume, makeStep(0.5, 0.999F, 1e-4));
  RenderOptions options = plain(50);
  options.labels = true;
  const Camera camera = straightCamera(Vector3::Zero());
  EXPECT_EQ(scene.render(camera, options).labels, std::vector<std::uint16_t>(64 * 48, 0)) << "no segmentation yet";
  scene.setLabels(layers());
  const Frame frame = scene.render(camera, options);
  EXPECT_TRUE(frame.depth_m.empty());
  EXPECT_EQ(frame.labels[24 * 64 + 20], 200);
  EXPECT_EQ(frame.labels[24 * 64 + 44], 500);
  EXPECT_EQ(frame.labels[0], 0);
}

TEST(GlCanvas, HighlightsAreOnShadedSurfacesOnly) {
  // A gradient half way between light and viewer, as steep as a full surface: 20 times the range within a voxel.
  const Box3 box(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1));
  const Vector3 half = highlightDirection().cast<double>();
  const auto mirror = makeVolume(Vector3i(64, 64, 64), box.sizes(),
                                 [&](const Vector3& t) { return 8.0 * (t - Vector3::Constant(0.5)).dot(half); });
  TransferFunction function;
  const Vector3f grey = Vector3f::Constant(0.4F);
  function.points = {{-0.5, grey, 0.9F}, {0.5, grey, 0.9F}};
  function.unit_distance_m = 0.01;
  Scene scene(box, Vector3i(4, 4, 4), mirror, function);
  Camera camera = straightCamera(Vector3::Zero(), 64, 48, 1000.0);  // pixels are finer than voxels
  camera.near_m = 0.95;                                             // texture coordinates clamp at the volume's border
  const auto brightness = [&](double shading, double specular) {
    RenderOptions options;
    options.shading = shading;
    options.specular = specular;
    const Frame frame = scene.render(camera, options);
    return pixelOf(frame, 32, 24)[1] / pixelOf(frame, 32, 24)[3];
  };
  EXPECT_EQ(brightness(0.0, 1.0), brightness(0.0, 0.0));
  EXPECT_NEAR(brightness(1.0, 0.4) - brightness(1.0, 0.0), 0.4, 0.02);
  EXPECT_NEAR(brightness(0.5, 0.4) - brightness(0.5, 0.0), 0.2, 0.01);
}

/// A block of hexahedra with scalars value(position) at its points.
template <typename Value>
IrregularGrid scalarBlock(const Box3& box, const Vector3i& cells, const Value& value) {
  const Topology block = makeBlock(box, cells);
  IrregularGrid grid;
  grid.points = block.rest_positions;
  grid.cell_types = block.cell_types;
  grid.cell_offsets = block.cell_offsets;
  grid.connectivity = block.connectivity;
  for (const Vector3f& p : grid.points)
    grid.point_scalars.push_back(float(value(p.cast<double>())));
  return grid;
}

struct GridScene : CanvasScene {
  GridScene(const IrregularGrid& grid, const TransferFunction& function)
      : CanvasScene(std::make_unique<GlCanvas>(), drawnGrid(grid), function) {}
};

TEST(GlCanvas, ScalarsAreInterpolatedBetweenPoints) {
  const Camera camera = straightCamera(Vector3::Zero());
  const auto grid = scalarBlock(sheet(-0.2, 0.2, -0.1, 0.1), Vector3i(2, 1, 1), [](const Vector3& p) { return p.x(); });
  GridScene scene(grid, makeRamp(-0.2, 0.2));
  const Frame frame = scene.render(camera, plain(1));
  for (int u = 13; u < 50; ++u) {
    const double x = (u - camera.cx) / camera.fx;
    ASSERT_NEAR(pixelOf(frame, u, 24)[0] / pixelOf(frame, u, 24)[3], (x + 0.2) / 0.4, 3e-4) << u;
  }
}

TEST(GlCanvas, ColoursOfVerticesMissWhatLiesBetweenThem) {
  // White at x = -0.2 and 0.2, black between: the look-up per fragment sees it, the one per vertex does not.
  TransferFunction function = makeRamp(-0.2, 0.2);
  const Vector3f white = Vector3f::Ones();
  function.points = {{-0.2, white, 1.0F}, {0.0, Vector3f::Zero(), 1.0F}, {0.2, white, 1.0F}};
  const Camera camera = straightCamera(Vector3::Zero());
  GridScene scene(scalarBlock(sheet(-0.2, 0.2, -0.1, 0.1), Vector3i(1, 1, 1), [](const Vector3& p) { return p.x(); }),
                  function);
  RenderOptions options = plain(1);
  const Frame by_scalar = scene.render(camera, options);
  options.lookup = Lookup::kColour;
  const Frame by_colour = scene.render(camera, options);
  for (int u = 13; u < 50; ++u) {
    const double x = (u - camera.cx) / camera.fx;
    ASSERT_NEAR(pixelOf(by_scalar, u, 24)[0] / pixelOf(by_scalar, u, 24)[3], std::abs(x) / 0.2, 1e-3) << u;
    ASSERT_NEAR(pixelOf(by_colour, u, 24)[0] / pixelOf(by_colour, u, 24)[3], 1.0, 1e-5) << u;
  }
}

TEST(GlCanvas, ColoursOfVerticesAreInterpolatedWithTheirAbsorption) {
  // Absorption grows linearly with x, so its logarithm of transparency does.
  TransferFunction function;
  for (int i = 0; i <= 40; ++i)
    function.points.push_back({0.01 * i, Vector3f(0.25F, 0.5F, 1.0F), float(1.0 - std::pow(2.0, -0.05 * i))});
  function.unit_distance_m = 1e-3;
  const Camera camera = parallelCamera(100.0);
  GridScene scene(scalarBlock(sheet(0.0, 0.3, -0.1, 0.1), Vector3i(1, 1, 1), [](const Vector3& p) { return p.x(); }),
                  function);
  for (const Lookup lookup : {Lookup::kColour, Lookup::kScalar}) {
    RenderOptions options = plain(1);
    options.lookup = lookup;
    const Frame frame = scene.render(camera, options);
    for (int u = 33; u < 60; ++u) {
      const double x = (u - camera.cx) / camera.fx;
      ASSERT_NEAR(pixelOf(frame, u, 24)[3], 1.0 - std::pow(2.0, -5.0 * x), 1e-3) << u;
      ASSERT_NEAR(pixelOf(frame, u, 24)[1], 0.5 * pixelOf(frame, u, 24)[3], 1e-5) << u;
    }
  }
}

TEST(GlCanvas, ScalarsOfCellsAreConstantInThem) {
  IrregularGrid grid = scalarBlock(sheet(-0.3, 0.3, -0.1, 0.1), Vector3i(6, 1, 1), [](const Vector3&) { return 0.0; });
  grid.point_scalars.clear();
  grid.cell_scalars = {0.1F, 0.9F, 0.3F, std::numeric_limits<float>::quiet_NaN(), 0.5F, 0.7F};
  const Camera camera = straightCamera(Vector3::Zero());
  GridScene scene(grid, makeRamp(0.0, 1.0));
  for (const Lookup lookup : {Lookup::kScalar, Lookup::kColour}) {
    RenderOptions options = plain(1);
    options.lookup = lookup;
    const Frame frame = scene.render(camera, options);
    for (int u = 2; u < 62; ++u) {
      const auto cell = std::size_t(((u - camera.cx) / camera.fx + 0.3) / 0.1);
      if (cell == 3) {
        ASSERT_EQ(pixelOf(frame, u, 24)[3], 0.0F) << "NaN is nothing";
      } else {
        ASSERT_NEAR(pixelOf(frame, u, 24)[0] / pixelOf(frame, u, 24)[3], grid.cell_scalars[cell], 3e-4) << u;
      }
    }
  }
}

TEST(GlCanvas, NanScalarsOfPointsDrawAsNothing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto grid = scalarBlock(Box3(Vector3(-0.2, -0.1, 0.95), Vector3(0.2, 0.1, 1.05)), Vector3i(8, 2, 2),
                                [nan](const Vector3& p) { return p.x() < -1e-6 ? nan : 1.0; });
  GridScene scene(grid, makeFog(0.9F, 0.01));
  for (const Lookup lookup : {Lookup::kScalar, Lookup::kColour}) {
    RenderOptions options = shaded(true);
    options.lookup = lookup;
    const Frame frame = scene.render(straightCamera(Vector3::Zero()), options);
    EXPECT_EQ(pixelOf(frame, 20, 24)[3], 0.0F);
    EXPECT_GT(pixelOf(frame, 44, 24)[3], 0.9F);
    for (const float value : frame.rgba)
      ASSERT_TRUE(std::isfinite(value));
  }
}

TEST(GlCanvas, CellsOfEveryTypeFillTheirSpace) {
  std::mt19937 random(4);
  const CellGrid cells = makeMixedCells(Vector3f(-3.0F, -3.0F, 10.0F), Vector3i(6, 6, 6), random);
  IrregularGrid grid;
  grid.points = cells.points;
  grid.cell_types = cells.types;
  grid.cell_offsets = cells.offsets;
  grid.connectivity = cells.connectivity;
  for (const Vector3f& p : grid.points)
    grid.point_scalars.push_back(p.z());
  TransferFunction function;
  function.points = {{10.0, Vector3f(1.0F, 0.0F, 0.0F), 0.1F}, {16.0, Vector3f(1.0F, 0.0F, 0.0F), 0.1F}};
  function.unit_distance_m = 1.0;
  GridScene scene(grid, function);
  Camera camera = parallelCamera(6.0);
  camera.far_m = 100.0;
  for (const int slices : {11, 60}) {
    const Frame frame = scene.render(camera, plain(slices));
    for (int v = 10; v < 38; ++v) {
      for (int u = 18; u < 46; ++u)
        ASSERT_NEAR(pixelOf(frame, u, v)[3], 1.0 - std::pow(0.9, 6.0), 1e-4) << u << " " << v;
    }
  }
}

TEST(GlCanvas, NarrowPeaksAreNotSteppedOver) {
  // The scalar is z. A triangle of 2 mm at z = 1.0633 has the integral of 1 mm of its top; four slabs are 50 mm each.
  TransferFunction function;
  const Vector3f white = Vector3f::Ones();
  function.points = {{1.0623, white, 0.0F}, {1.0633, white, 0.5F}, {1.0643, white, 0.0F}};
  function.unit_distance_m = 1e-3;
  double integral = 0.0;
  for (int i = 0; i < 2000; ++i)
    integral += -std::log2(1.0 - function.evaluate(1.0623 + (i + 0.5) * 1e-6).opacity) * 1e-6 / 1e-3;
  const Box3 box(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));
  GridScene scene(scalarBlock(box, Vector3i(3, 3, 5), [](const Vector3& p) { return p.z(); }), function);
  const Frame frame = scene.render(parallelCamera(80.0), plain(4));
  EXPECT_NEAR(pixelOf(frame, 30, 20)[3], 1.0 - std::exp2(-integral), 0.005);
}

TEST(GlCanvas, ScalarGridsAreLitByTheirGradient) {
  // A linear scalar, as steep as a full surface; the light's formula is that of light.h.
  const Box3 box(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1));
  const Vector3 gradient = 40.0 * Vector3(0.3, -0.5, 0.8);
  GridScene scene(scalarBlock(box, Vector3i(5, 5, 5), [&](const Vector3& p) { return gradient.dot(p); }), [] {
    TransferFunction function;
    const Vector3f grey = Vector3f::Constant(0.4F);
    function.points = {{20.0, grey, 0.9F}, {50.0, grey, 0.9F}};
    function.unit_distance_m = 0.01;
    return function;
  }());
  const double strength = std::min(1.0, gradient.norm() * 0.04 * kEdgesPerRange / 30.0);
  const Vector3 normal = gradient.normalized();
  const double diffuse = kAmbient + kDiffuse * std::abs(normal.dot(lightDirection().cast<double>()));
  const double gloss = std::pow(normal.dot(highlightDirection().cast<double>()), kShininess);
  RenderOptions options;
  options.shading = 0.6;
  options.specular = 0.5;
  for (const Lookup lookup : {Lookup::kScalar, Lookup::kColour}) {
    options.lookup = lookup;
    const Frame frame = scene.render(straightCamera(Vector3::Zero()), options);
    const double mean = kMeanLight + strength * (diffuse - kMeanLight);
    const double exact = 0.4 * (1.0 + 0.6 * (mean - 1.0)) + 0.6 * 0.5 * strength * gloss;
    EXPECT_NEAR(pixelOf(frame, 32, 24)[0] / pixelOf(frame, 32, 24)[3], exact, 2e-3);
  }
}

TEST(GlCanvas, CrossSectionsShowColoursAtFullOpacity) {
  // The transfer function has no opacity at all.
  TransferFunction function = makeRamp(-0.2, 0.2);
  for (auto& point : function.points)
    point.opacity = 0.0F;
  const Box3 box(Vector3(-0.2, -0.1, 1.0), Vector3(0.2, 0.1, 1.2));
  const auto value = [](const Vector3& p) { return p.x(); };
  GridScene scalars(scalarBlock(box, Vector3i(4, 2, 2), value), function);
  Scene volume(box, Vector3i(4, 2, 2),
               makeVolume(Vector3i(64, 4, 4), box.sizes(), [](const Vector3& t) { return 0.4 * t.x() - 0.2; }),
               function);
  const Camera camera = parallelCamera(100.0);
  for (CanvasScene* scene : std::initializer_list<CanvasScene*>{&scalars, &volume}) {
    const Frame frame = scene->crossSection(camera, 1.13, plain(1));
    for (int v = 0; v < frame.height; ++v) {
      for (int u = 0; u < frame.width; ++u) {
        const double x = (u - camera.cx) / camera.fx;
        const bool inside = std::abs(x) < 0.2 && std::abs(v - camera.cy) < 10.0;
        ASSERT_EQ(pixelOf(frame, u, v)[3], inside ? 1.0F : 0.0F) << u << " " << v;
        if (inside) {
          ASSERT_NEAR(pixelOf(frame, u, v)[0], (x + 0.2) / 0.4, 3e-3) << u << " " << v;
        }
      }
    }
  }
}

TEST(GlCanvas, ThinCellsBetweenThePlanesAreDrawnWhenAdaptive) {
  // Two sheets of 2 mm; planes every 50 mm meet neither.
  const Box3 first(Vector3(-0.2, -0.2, 1.010), Vector3(0.2, 0.2, 1.012));
  IrregularGrid grid = scalarBlock(first, Vector3i(1, 1, 1), [](const Vector3&) { return 1.0; });
  IrregularGrid second = grid;
  for (std::size_t i = 0; i < 8; ++i) {
    grid.points.push_back(second.points[i] + Vector3f(0, 0, 0.05F));
    grid.point_scalars.push_back(1.0F);
    grid.connectivity.push_back(second.connectivity[i] + 8);
  }
  grid.cell_types.push_back(CellType::kHexahedron);
  grid.cell_offsets.push_back(16);
  GridScene scene(grid, makeFog(0.5F, 0.05));
  RenderOptions options = plain(1);
  options.step_m = 0.05;
  const Camera camera = parallelCamera(80.0);
  EXPECT_EQ(pixelOf(scene.render(camera, options), 32, 24)[3], 0.0F);
  options.adaptive = true;
  const Frame frame = scene.render(camera, options);
  double way = 0.0;
  for (const Slice& slice : scene.mesh().slices)
    way += slice.polygon_count > 0 ? double(slice.back_m) - double(slice.front_m) : 0.0;
  EXPECT_GT(way, 0.004);
  EXPECT_LT(way, 0.1) << "the opacity of extra planes is that of their own slabs";
  EXPECT_NEAR(pixelOf(frame, 32, 24)[3], 1.0 - std::pow(0.5, way / 0.05), 1e-4);
}

std::shared_ptr<const Volume> waves(int side) {
  return makeVolume(Vector3i(side, side + 5, side - 3), Vector3::Constant(0.2), [](const Vector3& t) {
    return 0.5 + 0.5 * std::sin(20.0 * t.x()) * std::sin(17.0 * t.y() + 3.0) * std::cos(23.0 * t.z());
  });
}

TEST(GlCanvas, BricksMakeTheSamePicture) {
  const Box3 box(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1));
  const auto volume = waves(60);
  const auto labels =
      makeVolume(Vector3i(50, 30, 20), Vector3::Ones(), [](const Vector3& t) { return std::floor(1000.0 * t.x()); });
  Scene whole(box, Vector3i(9, 8, 10), volume, makeStep(0.6, 0.3F, 0.005));
  Scene bricks(box, Vector3i(9, 8, 10), volume, makeStep(0.6, 0.3F, 0.005), 32);
  RenderOptions options = everything();
  options.jitter = false;
  const Camera camera = Camera::lookAt({0.3, 0.25, 0.6}, {0, 0, 1}, {0, -1, 0}, 0.5, 160, 120);
  std::mt19937 random(3);
  std::uniform_real_distribution<float> offset(-0.004F, 0.004F);
  std::vector<Vector3f> positions = whole.rest();
  for (Vector3f& p : positions)
    p += Vector3f(offset(random), offset(random), offset(random));
  whole.setLabels(labels);
  bricks.setLabels(labels);
  const Frame a = whole.render(camera, positions, options);
  const Frame b = bricks.render(camera, positions, options);
  EXPECT_GT(*std::max_element(a.rgba.begin(), a.rgba.end()), 0.9F);
  EXPECT_NE(a.rgba, b.rgba) << "there is only one brick";
  // The weights of the driver's filter have 8 bits behind the point or more, and round elsewhere in a brick.
  int other_labels = 0;
  for (std::size_t i = 0; i < a.rgba.size(); ++i)
    ASSERT_NEAR(a.rgba[i], b.rgba[i], 2e-3) << i;
  for (std::size_t i = 0; i < a.labels.size(); ++i)
    other_labels += a.labels[i] != b.labels[i];
  EXPECT_LT(other_labels, 20) << "of " << a.labels.size();
}

TEST(GlCanvas, CellsThatFitIntoNoBrickAreRefused) {
  const Box3 box(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1));
  Scene scene(box, Vector3i(2, 2, 2), waves(20), makeStep(0.6, 0.3F, 0.005), 32);
  const Camera camera = straightCamera(Vector3::Zero());
  const Frame before = scene.render(camera, plain(20));
  EXPECT_THROW(scene.canvas().setVolume(*waves(60)), InputError);
  EXPECT_EQ(scene.render(camera, plain(20)).rgba, before.rgba) << "the former volume stays";
  EXPECT_THROW(Scene(box, Vector3i(1, 1, 1), waves(60), makeStep(0.6, 0.3F, 0.005), 32), InputError);
}

TEST(GlCanvas, VolumesSeenFromAfarAreAveraged) {
  // Every second voxel is white, and a pixel is 8 voxels wide, so each should be grey.
  const Box3 box(Vector3(-0.5, -0.5, 0.9), Vector3(0.5, 0.5, 1.1));
  const auto checkers = [](const Vector3& t) { return int(t.x() * 256) % 2 == int(t.y() * 256) % 2 ? 1.0 : 0.0; };
  const auto volume = makeVolume(Vector3i(256, 256, 16), box.sizes(), checkers);
  for (const int limit : {0, 128}) {
    Scene scene(box, Vector3i(8, 8, 1), volume, makeRamp(0.0, 1.0), limit);
    for (const double shift : {0.0, 0.3, 0.7}) {
      Camera camera = parallelCamera(32.0);
      camera.cx += shift;
      const Frame frame = scene.render(camera, plain(20));
      for (int v = 10; v < 38; ++v) {
        for (int u = 18; u < 46; ++u)
          ASSERT_NEAR(pixelOf(frame, u, v)[0] / pixelOf(frame, u, v)[3], 0.5, 0.01) << u << " " << v;
      }
    }
  }
}

TEST(GlCanvas, NearViewsOfAFineVolumeStaySharp) {
  const Box3 box = sheet(-0.2, 0.2, -0.1, 0.1);
  const auto stripes =
      makeVolume(Vector3i(20, 4, 1), box.sizes(), [](const Vector3& t) { return int(t.x() * 20) % 2; });
  Scene scene(box, Vector3i(1, 1, 1), stripes, makeRamp(0.0, 1.0));
  const Camera camera = parallelCamera(100.0);  // two pixels a voxel
  const Frame frame = scene.render(camera, plain(1));
  float low = 1.0F, high = 0.0F;
  for (int u = 14; u < 50; ++u) {
    low = std::min(low, pixelOf(frame, u, 24)[0]);
    high = std::max(high, pixelOf(frame, u, 24)[0]);
  }
  EXPECT_LT(low, 0.3F);
  EXPECT_GT(high, 0.7F);
}

/// Sets a variable of the environment as long as it lives.
class Environment {
 public:
  Environment(const char* name, const char* value) : name_(name) {
    const char* before = std::getenv(name);
    had_ = before != nullptr;
    before_ = had_ ? before : "";
    setenv(name, value, 1);
  }
  ~Environment() {
    if (had_)
      setenv(name_, before_.c_str(), 1);
    else
      unsetenv(name_);
  }

 private:
  const char* name_;
  bool had_ = false;
  std::string before_;
};

TEST(GlCanvas, UnknownMakersAreRefused) {
  const Environment environment("SOFT_VOLUME_GL", "opengl");
  EXPECT_THROW(GlCanvas(), Error);
}

/// Run by the test below in processes of their own, so that two drivers never meet in one.
TEST(GlCanvas, DISABLED_PrintImage) {
  BallScene scene;
  scene.setLabels(layers());
  const Frame frame = scene.render(straightCamera(Vector3::Zero(), 160, 120, 500.0), everything());
  std::printf("driver %s\n", scene.canvas().driver().c_str());
  for (const float value : frame.rgba)
    std::printf("value %.9g\n", double(value));
}

struct MadeImage {
  std::string driver;
  std::vector<float> rgba;
};

MadeImage imageWith(const char* maker) {
  const std::string command = std::string("SOFT_VOLUME_GL=") + maker + " /proc/" + std::to_string(getpid()) +
                              "/exe --gtest_also_run_disabled_tests --gtest_filter=GlCanvas.DISABLED_PrintImage";
  FILE* pipe = popen(command.c_str(), "r");
  MadeImage image;
  std::array<char, 1024> line{};
  while (pipe != nullptr && fgets(line.data(), int(line.size()), pipe) != nullptr) {
    if (std::strncmp(line.data(), "driver ", 7) == 0)
      image.driver = line.data() + 7;
    if (std::strncmp(line.data(), "value ", 6) == 0)
      image.rgba.push_back(std::strtof(line.data() + 6, nullptr));
  }
  if (pipe != nullptr)
    pclose(pipe);
  return image;
}

TEST(GlCanvas, BothMakersDrawTheSame) {
  const MadeImage osmesa = imageWith("osmesa");
  const MadeImage egl = imageWith("egl");
  if (osmesa.rgba.empty() || egl.rgba.empty())
    GTEST_SKIP() << "needs OSMesa (" << (osmesa.rgba.empty() ? "missing" : "there") << ") and EGL ("
                 << (egl.rgba.empty() ? "missing" : "there") << ")";
  EXPECT_EQ(osmesa.driver.rfind("OSMesa", 0), 0U) << osmesa.driver;
  EXPECT_EQ(egl.driver.rfind("EGL", 0), 0U) << egl.driver;
  ASSERT_EQ(osmesa.rgba.size(), std::size_t(160 * 120 * 4));
  ASSERT_EQ(egl.rgba.size(), osmesa.rgba.size());
  // A GPU's filter has weights of 8 bits behind the point; the same software gives the same bits.
  for (std::size_t i = 0; i < egl.rgba.size(); ++i)
    ASSERT_NEAR(egl.rgba[i], osmesa.rgba[i], 0.02) << i;
}

}  // namespace
}  // namespace soft_volume::core
