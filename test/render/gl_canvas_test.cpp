#include "gl_canvas.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <limits>
#include <string>
#include <thread>

#include "render/canvas_scene.h"
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

}  // namespace
}  // namespace soft_volume::core
