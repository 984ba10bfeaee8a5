#include "soft_volume/render/renderer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <thread>

#include "render/canvas_scene.h"
#include "render/kinds_of_scenes.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 19970521;

std::string nameOf(Backend backend) {
  const std::array<const char*, 3> names = {"gl", "native", "exact"};
  return names[std::size_t(backend)];
}

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
  options.threads = 2;
  return options;
}

RenderOptions shaded(bool depth) {
  RenderOptions options;
  options.depth = depth;
  options.threads = 2;
  return options;
}

/// A renderer with a volume over a block of cells.
struct Scene {
  Topology topology;
  Renderer renderer;

  Scene(Backend backend, const Box3& box, const Vector3i& cells, std::shared_ptr<const Volume> volume,
        const TransferFunction& function)
      : topology(makeBlock(box, cells)), renderer(backend) {
    renderer.setVolume(std::move(volume));
    renderer.setTransferFunction(function);
    renderer.setTopology(topology);
  }
  const Frame& render(const Camera& camera, const RenderOptions& options) { return renderer.render(camera, options); }
};

/// Opaque sheet around z = 1 m, drawn with one slice at exactly z = 1 m.
Box3 sheet(double x0, double x1, double y0, double y1) {
  return {Vector3(x0, y0, 0.9995), Vector3(x1, y1, 1.0005)};
}

/// How far the ray of a pixel runs inside a box and, with it, on the kept side of clip planes, metres.
double wayInside(const Camera& camera, int u, int v, const Box3& box, const std::vector<ClipPlane>& clips = {}) {
  const Eigen::Vector2d slope = camera.raySlope(u, v);
  const Vector3 direction = camera.T_volume_camera.orientation * Vector3(slope.x(), slope.y(), 1.0);
  const bool parallel = camera.projection == Projection::kParallel;
  const Vector3 origin =
      camera.T_volume_camera *
      (parallel ? Vector3((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 0.0) : Vector3::Zero());
  double enter = camera.near_m;
  double leave = camera.far_m;
  const auto cut = [&](const Vector3& normal, double offset) {  // normal . p <= offset
    const double rate = normal.dot(direction);
    const double rest = offset - normal.dot(origin);
    if (rate > 0.0)
      leave = std::min(leave, rest / rate);
    else if (rate < 0.0)
      enter = std::max(enter, rest / rate);
    else if (rest < 0.0)
      leave = enter;
  };
  for (int axis = 0; axis < 3; ++axis) {
    cut(Vector3::Unit(axis), box.max()[axis]);
    cut(-Vector3::Unit(axis), -box.min()[axis]);
  }
  for (const ClipPlane& clip : clips)
    cut(clip.normal, clip.offset_m);
  return std::max(0.0, leave - enter) * direction.norm();
}

/// Calls visit(u, v, opacity) for every pixel.
template <typename Visit>
void forEachPixel(const Frame& frame, const Visit& visit) {
  for (int v = 0; v < frame.height; ++v) {
    for (int u = 0; u < frame.width; ++u)
      visit(u, v, pixelOf(frame, u, v)[3]);
  }
}

float depthAt(const Frame& frame, int u, int v) {
  return frame.depth_m[std::size_t(v) * std::size_t(frame.width) + std::size_t(u)];
}

class AnyBackend : public testing::TestWithParam<Backend> {};
class SliceBackend : public testing::TestWithParam<Backend> {};

const Box3 kSlab(Vector3(-0.5, -0.5, 1.0), Vector3(0.5, 0.5, 1.2));

TEST_P(AnyBackend, FogHasTheAnalyticOpacityForAnyNumberOfSlices) {
  Scene scene(GetParam(), kSlab, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
    Camera camera = straightCamera(Vector3::Zero());
    camera.projection = projection;
    for (const int slices : {1, 7, 50, 200}) {
      const Frame& frame = scene.render(camera, plain(slices));
      forEachPixel(frame, [&](int u, int v, float opacity) {
        // Every ray crosses front and back face, so the slabs fill its way exactly; 2e-5 is the driver's exp2.
        const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, kSlab) / 0.05);
        ASSERT_NEAR(opacity, exact, 1e-4) << slices << " slices, pixel " << u << " " << v;
        ASSERT_NEAR(pixelOf(frame, u, v)[0], exact, 1e-4);
      });
    }
  }
}

const Box3 kCube(Vector3::Constant(-0.1), Vector3::Constant(0.1));

Camera cornerCamera() {
  return Camera::lookAt({0.5, 0.8, 0.6}, {0, 0, 0}, {0, 0, 1}, 0.4, 64, 48);
}

TEST_P(SliceBackend, ObliqueFogErrsByLessThanTwoSlabs) {
  Scene scene(GetParam(), kCube, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  const Camera camera = cornerCamera();
  double former_mean = 1.0;
  for (const int slices : {50, 100, 200}) {
    const Frame& frame = scene.render(camera, plain(slices));
    double sum = 0.0;
    forEachPixel(frame, [&](int u, int v, float opacity) {
      const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, kCube) / 0.05);
      const double error = std::abs(opacity - exact);
      // Both ends of the way are off by up to half a slab; the box's depth is at most its diagonal.
      const double slab = 0.2 * std::sqrt(3.0) / slices * 1.1;
      ASSERT_LT(error, 1.0 - std::pow(0.7, slab / 0.05)) << "pixel " << u << " " << v;
      sum += error;
    });
    const double mean = sum / (frame.width * frame.height);
    EXPECT_LT(mean, 0.7 * former_mean);
    former_mean = mean;
  }
  EXPECT_LT(former_mean, 1e-3);
}

/// The face that the rays enter through is slanted against the planes, so half a slab of another length begins each
/// ray.
TEST(NativeBackend, LightDoesNotDependOnHowFarTheFirstPlaneIs) {
  const auto ramp = makeVolume(Vector3i(17, 17, 17), Vector3::Constant(4.0), [](const Vector3& t) { return t.z(); });
  TransferFunction skin = makeFog(0.999F, 0.01);  // begins where the gradient's samples lie in the volume
  skin.points = {{0.1, Vector3f::Ones(), 0.0F}, {0.11, Vector3f::Ones(), 0.999F}, {1.0, Vector3f::Ones(), 0.999F}};
  Scene scene(Backend::kNative, Box3(Vector3::Constant(-2.0), Vector3::Constant(2.0)), Vector3i::Constant(1), ramp,
              skin);
  const Camera camera = obliqueCamera(Projection::kParallel, 60, 45);
  RenderOptions options = plain(6);
  options.shading = 1.0;
  const Frame& frame = scene.render(camera, options);
  float darkest = 1.0F;
  float brightest = 0.0F;
  for (int v = 15; v < 30; ++v) {
    for (int u = 20; u < 40; ++u) {
      const float red = frame.rgba[std::size_t(v * camera.width + u) * 4];
      darkest = std::min(darkest, red);
      brightest = std::max(brightest, red);
    }
  }
  EXPECT_GT(darkest, 0.3F);
  EXPECT_LT(brightest - darkest,
            0.03F);  // where the fade of the surface is lit; 0.28 when the first half slab has no way
}

TEST(NativeBackend, ExactBoundaryMakesObliqueFogExactForAnyNumberOfSlices) {
  Scene scene(Backend::kNative, kCube, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
    const Camera camera = projection == Projection::kPerspective
                              ? cornerCamera()
                              : Camera::lookAtParallel({0.5, 0.8, 0.6}, {0, 0, 0}, {0, 0, 1}, 0.4, 64, 48);
    for (const int slices : {1, 10, 100, 300}) {
      RenderOptions options = plain(slices);
      options.exact_boundary = true;
      int coincident = 0;
      forEachPixel(scene.render(camera, options), [&](int u, int v, float opacity) {
        const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, kCube) / 0.05);
        // Depths near 1 m are float, and hidden or lit by at most 0.7 per 5 cm: 1e-6 m are some 1e-5. Where a plane
        // and a face meet within this rounding, the plane may count up to a slab before or behind the face.
        coincident += std::abs(opacity - exact) > 3e-5;
        const double slab = 0.2 * std::sqrt(3.0) / slices;
        ASSERT_NEAR(opacity, exact, 3e-5 + 1.0 - std::pow(0.7, slab / 0.05)) << slices << ' ' << u << ' ' << v;
      });
      EXPECT_LE(coincident, 2) << slices << " slices";
    }
  }
}

TEST(NativeBackend, ExactBoundaryEndsAtNearAndFar) {
  Scene scene(Backend::kNative, kCube, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  Camera camera = Camera::lookAtParallel({0.5, 0.8, 0.6}, {0, 0, 0}, {0, 0, 1}, 0.4, 64, 48);
  const double middle = camera.T_volume_camera.position_m.norm();
  camera.near_m = middle - 0.05;
  camera.far_m = middle + 0.06;  // a slab more would be 0.04
  RenderOptions options = plain(20);
  options.exact_boundary = true;
  forEachPixel(scene.render(camera, options), [&](int u, int v, float opacity) {
    const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, kCube) / 0.05);
    ASSERT_NEAR(opacity, exact, 1e-3) << u << ' ' << v;
  });
}

TEST_P(AnyBackend, PixelCentresAreWholeNumbers) {
  const Camera camera = straightCamera(Vector3::Zero());
  for (const double shift : {-0.25, 0.25}) {
    const double left = 20.5 + shift, right = 40.5 + shift, top = 10.5 + shift, bottom = 30.5 + shift;
    const Box3 box = sheet((left - camera.cx) / camera.fx, (right - camera.cx) / camera.fx,
                           (top - camera.cy) / camera.fy, (bottom - camera.cy) / camera.fy);
    Scene scene(GetParam(), box, Vector3i(1, 1, 1), constantVolume(), makeFog(0.9F, 1e-4));
    forEachPixel(scene.render(camera, plain(1)), [&](int u, int v, float opacity) {
      EXPECT_EQ(opacity > 0.5F, u > left && u < right && v > top && v < bottom) << shift << ' ' << u << ' ' << v;
    });
  }
}

TEST_P(AnyBackend, PrincipalPointAndBothFocalLengthsCount) {
  Camera camera = straightCamera(Vector3::Zero());
  camera.fx = 80.0;
  camera.fy = 120.0;
  camera.cx = 25.0;
  camera.cy = 30.0;
  for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
    camera.projection = projection;
    Scene scene(GetParam(), sheet(0.05, 0.15, -0.1, 0.05), Vector3i(1, 1, 1), constantVolume(), makeFog(0.9F, 1e-4));
    forEachPixel(scene.render(camera, plain(1)), [&](int u, int v, float opacity) {
      const double x = (u - 25.0) / 80.0, y = (v - 30.0) / 120.0;
      // The sheet is 1 mm thick: in exact its sides are seen, up to 0.01 pixels beyond z = 1 m.
      if (std::min(std::abs(x - 0.05), std::abs(x - 0.15)) < 2e-4 ||
          std::min(std::abs(y + 0.1), std::abs(y - 0.05)) < 2e-4)
        return;
      EXPECT_EQ(opacity > 0.5F, x > 0.05 && x < 0.15 && y > -0.1 && y < 0.05) << u << " " << v;
    });
  }
}

TEST_P(AnyBackend, DepthOfAnOpaqueFaceIsWithinHalfASlab) {
  const Box3 box(Vector3(-0.2, -0.1, 1.0), Vector3(0.2, 0.1, 1.2));
  Scene scene(GetParam(), box, Vector3i(2, 2, 2), constantVolume(), makeFog(0.999F, 1e-4));
  const Camera camera = straightCamera(Vector3::Zero());
  for (const int slices : {50, 100}) {
    const Frame& frame = scene.render(camera, plain(slices, true));
    forEachPixel(frame, [&](int u, int v, float opacity) {
      if (opacity == 0.0F) {
        EXPECT_TRUE(std::isnan(depthAt(frame, u, v)));
      } else if (std::abs(u - 31.5) < 19.0 && std::abs(v - 23.5) < 9.0) {
        EXPECT_NEAR(depthAt(frame, u, v), 1.0, 0.5 * 0.2 / slices) << "along z, not along the ray";
      }
    });
  }
}

TEST_P(AnyBackend, DepthInFogIsWhereTheThresholdIsPassed) {
  Scene scene(GetParam(), kSlab, Vector3i(2, 2, 2), constantVolume(), makeFog(0.3F, 0.05));
  const Camera camera = straightCamera(Vector3::Zero());
  RenderOptions options = plain(50, true);
  for (const double threshold : {0.2, 0.5}) {
    options.depth_threshold = threshold;
    const Frame& frame = scene.render(camera, options);
    for (const int u : {2, 20, 31, 60}) {
      const double slope = camera.raySlope(u, 24).norm();
      const double way = 0.05 * std::log(1.0 - threshold) / std::log(0.7);
      EXPECT_NEAR(depthAt(frame, u, 24), 1.0 + way / std::hypot(1.0, slope), 0.01 * 0.2 / 50);
    }
  }
  options.depth_threshold = 0.95;  // more than the fog ever reaches
  EXPECT_TRUE(std::isnan(depthAt(scene.render(camera, options), 32, 24)));
}

TEST_P(AnyBackend, LabelsAreThoseOfTheDepth) {
  const Box3 box(Vector3(-0.2, -0.2, 1.0), Vector3(0.2, 0.2, 1.4));
  Scene scene(GetParam(), box, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  scene.renderer.setLabels(makeManyLabels());  // 5 by 6 by 7
  Camera camera = Camera::lookAt({0.3, -0.4, 0.0}, {0, 0, 1.2}, {0, -1, 0}, 0.5, 64, 48);
  RenderOptions options = plain(60, true);
  options.labels = true;
  const Frame& frame = scene.render(camera, options);
  int compared = 0;
  forEachPixel(frame, [&](int u, int v, float) {
    const double z = depthAt(frame, u, v);
    const std::uint16_t label = frame.labels[std::size_t(v * 64 + u)];
    if (std::isnan(z)) {
      EXPECT_EQ(label, 0);
      return;
    }
    const Eigen::Vector2d slope = camera.raySlope(u, v);
    const Vector3 p = camera.T_volume_camera * Vector3(slope.x() * z, slope.y() * z, z);
    const Vector3 place = (p - box.min()).cwiseQuotient(box.sizes()).cwiseProduct(Vector3(5, 6, 7));
    const Vector3 voxel = place.array().floor().matrix().cwiseMax(Vector3::Zero()).cwiseMin(Vector3(4, 5, 6));
    if ((place - voxel - Vector3::Constant(0.5)).cwiseAbs().maxCoeff() > 0.499)
      return;  // on the border of two labels
    const Vector3 t = (voxel + Vector3::Constant(0.5)).cwiseQuotient(Vector3(5, 6, 7));
    EXPECT_EQ(label, int(std::floor(20.0 * t.sum()) + 1.0)) << u << ' ' << v;
    ++compared;
  });
  EXPECT_GT(compared, 500);
  const std::vector<std::uint16_t> with_depth = frame.labels;
  options.depth = false;
  EXPECT_EQ(scene.render(camera, options).labels, with_depth);
}

TEST_P(AnyBackend, ClipPlanesCutTheFogExactly) {
  Scene scene(GetParam(), kSlab, Vector3i(3, 3, 3), constantVolume(), makeFog(0.3F, 0.05));
  const Vector3 oblique = Vector3(0.4, -0.3, 1.0).normalized();
  const std::vector<std::vector<ClipPlane>> cases = {
      {{Vector3::UnitZ(), 1.1}},
      {{-Vector3::UnitZ(), -1.07}},
      {{oblique, 1.1 * oblique.z()}},
      {{-oblique, -1.05 * oblique.z()}, {Vector3::UnitX(), 0.1}, {-Vector3::UnitY(), 0.05}}};
  for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
    Camera camera = straightCamera(Vector3::Zero());
    camera.projection = projection;
    for (std::size_t n = 0; n < cases.size(); ++n) {
      RenderOptions options = plain(33);
      options.clip_planes = cases[n];
      forEachPixel(scene.render(camera, options), [&](int u, int v, float opacity) {
        const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, kSlab, cases[n]) / 0.05);
        ASSERT_NEAR(opacity, exact, 1e-4) << "case " << n << " pixel " << u << ' ' << v;
      });
    }
  }
}

/// A ball of value 1 with a soft border in a lattice.
struct BallScene : Scene {
  explicit BallScene(Backend backend)
      : Scene(backend, Box3(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1)), Vector3i(8, 8, 8),
              makeVolume(Vector3i(40, 40, 40), Vector3::Constant(0.2),
                         [](const Vector3& t) {
                           return 1.0 / (1.0 + std::exp(60.0 * ((t - Vector3::Constant(0.5)).norm() - 0.3)));
                         }),
              makeStep(0.5, 0.5F, 0.005)) {}
};

const Camera kBallCamera = straightCamera(Vector3::Zero(), 100, 80, 300.0);

TEST_P(AnyBackend, ClipPlanesBesideTheGridChangeNothingAndOthersTakeAll) {
  BallScene scene(GetParam());
  RenderOptions options = shaded(true);
  const Frame whole = scene.render(kBallCamera, options);
  options.clip_planes = {{Vector3::UnitX(), 0.2}, {-Vector3::UnitZ(), -0.8}};
  EXPECT_TRUE(sameFrames(scene.render(kBallCamera, options), whole));
  options.clip_planes = {{Vector3::UnitX(), -0.2}};
  const Frame& none = scene.render(kBallCamera, options);
  EXPECT_EQ(none.rgba, std::vector<float>(whole.rgba.size(), 0.0F));
  EXPECT_TRUE(std::all_of(none.depth_m.begin(), none.depth_m.end(), [](float z) { return std::isnan(z); }));
}

TEST_P(AnyBackend, FramesDependOnTheInputAlone) {
  BallScene scene(GetParam());
  const Frame first = scene.render(kBallCamera, shaded(true));
  scene.render(straightCamera(Vector3(0.02, 0, 0.1), 90, 70, 200.0), plain(33));
  EXPECT_TRUE(sameFrames(scene.render(kBallCamera, shaded(true)), first));
  scene.renderer.forgetFrame();
  EXPECT_TRUE(sameFrames(scene.render(kBallCamera, shaded(true)), first));
  BallScene other(GetParam());
  RenderOptions options = shaded(true);
  options.threads = 3;
  EXPECT_TRUE(sameFrames(other.render(kBallCamera, options), first));
  Frame there;
  scene.renderer.forgetFrame();
  std::thread([&] { there = scene.render(kBallCamera, shaded(true)); }).join();
  EXPECT_TRUE(sameFrames(there, first)) << "from another thread";
  EXPECT_TRUE(showsSomething(first));
}

TEST_P(AnyBackend, ColoursDoNotDependOnDepth) {
  BallScene scene(GetParam());
  const std::vector<float> colours = scene.render(kBallCamera, shaded(true)).rgba;
  EXPECT_EQ(scene.render(kBallCamera, shaded(false)).rgba, colours);
  EXPECT_TRUE(scene.render(kBallCamera, shaded(false)).depth_m.empty());
}

TEST_P(AnyBackend, TextureSticksToTheDeformedCells) {
  const Box3 box = sheet(-0.2, 0.2, -0.1, 0.1);
  const auto volume = makeVolume(Vector3i(200, 4, 4), Vector3::Ones(), [](const Vector3& t) { return t.x(); });
  Scene scene(GetParam(), box, Vector3i(2, 1, 1), volume, makeRamp(0.0, 1.0));
  std::vector<Vector3f> positions = scene.topology.rest_positions;
  for (Vector3f& p : positions) {
    if (std::abs(p.x()) < 1e-6F)
      p.x() = 0.1F;  // the left cell is stretched, the right one squeezed
  }
  const Camera camera = straightCamera(Vector3::Zero());
  const Frame& frame = scene.renderer.render(camera, positions, plain(1));
  for (int u = 13; u < 50; ++u) {
    const double x = (u - camera.cx) / camera.fx;
    const double texture = x < 0.1 ? 0.5 * (x + 0.2) / 0.3 : 0.5 + 0.5 * (x - 0.1) / 0.1;
    const float* pixel = pixelOf(frame, u, 24);
    // exact sees the sheet half a millimetre nearer: 5e-4 of x, at most 0.2 m, times 5 per metre.
    EXPECT_NEAR(pixel[0] / pixel[3], texture, GetParam() == Backend::kExact ? 2e-3 : 1e-3) << "pixel " << u;
  }
}

TEST_P(SliceBackend, SkippingTransparentCellsLosesNothing) {
  const auto blob = makeVolume(Vector3i(40, 40, 40), Vector3::Ones(), [](const Vector3& t) {
    return 1.0 / (1.0 + std::exp(60.0 * ((t - Vector3(0.3, 0.4, 0.5)).norm() - 0.1)));
  });
  const Box3 box(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1));
  Scene one(GetParam(), box, Vector3i(1, 1, 1), blob, makeStep(0.5, 0.5F, 0.005));
  Scene many(GetParam(), box, Vector3i(12, 12, 12), blob, makeStep(0.5, 0.5F, 0.005));
  const Frame& whole = one.render(kBallCamera, plain(125));
  const Frame& cells = many.render(kBallCamera, plain(125));
  EXPECT_GT(*std::max_element(whole.rgba.begin(), whole.rgba.end()), 0.9F);
  EXPECT_LT(cells.polygons, std::size_t(125 * 144 / 4)) << "most cells are transparent";
  EXPECT_LT(cells.cells, 12U * 12 * 12 / 4);
  for (std::size_t i = 0; i < whole.rgba.size(); ++i)
    ASSERT_NEAR(cells.rgba[i], whole.rgba[i], 2e-3) << i;
}

TEST_P(SliceBackend, SlabsReachIntoTheNextCell) {
  // The step lies just behind a layer of cells; a slice through that transparent layer has half of its slab beyond it.
  const auto step = makeVolume(Vector3i(40, 40, 40), Vector3::Ones(), [](const Vector3& t) { return t.z() > 0.53; });
  const Box3 box(Vector3(-0.1, -0.1, 0.9), Vector3(0.1, 0.1, 1.1));
  Scene one(GetParam(), box, Vector3i(1, 1, 1), step, makeStep(0.5, 0.5F, 0.005));
  Scene many(GetParam(), box, Vector3i(12, 12, 12), step, makeStep(0.5, 0.5F, 0.005));
  const Frame& whole = one.render(straightCamera(Vector3::Zero()), plain(15));
  const Frame& cells = many.render(straightCamera(Vector3::Zero()), plain(15));
  for (std::size_t i = 0; i < whole.rgba.size(); ++i)
    ASSERT_NEAR(cells.rgba[i], whole.rgba[i], 1e-4) << i;
}

// --- Where camera and grid meet

TEST_P(AnyBackend, CameraInsideTheGridSeesNoHoles) {
  const Box3 box(Vector3::Constant(-1), Vector3::Constant(1));
  Scene scene(GetParam(), box, Vector3i(5, 5, 5), constantVolume(), makeFog(0.3F, 0.5));
  Camera camera = Camera::lookAt({0.1, 0.2, -0.1}, {1, 0.4, 0.3}, {0, 0, 1}, 1.2, 64, 48);
  for (const double near_m : {0.001, 0.3}) {
    camera.near_m = near_m;
    for (const bool boundary : {false, GetParam() == Backend::kNative}) {
      RenderOptions options = plain(200);
      options.exact_boundary = boundary;
      forEachPixel(scene.render(camera, options), [&](int u, int v, float opacity) {
        const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, box) / 0.5);
        // Half a slab of some 3.5 m / 200 at either end.
        ASSERT_NEAR(opacity, exact, 0.02) << "near " << near_m << " pixel " << u << ' ' << v;
      });
    }
  }
}

TEST_P(AnyBackend, GridBehindTheCameraShowsNothing) {
  BallScene scene(GetParam());
  const Camera away = Camera::lookAt({0, 0, 0}, {0, 0, -1}, {0, 1, 0}, 0.5, 64, 48);
  const Frame& frame = scene.render(away, shaded(true));
  EXPECT_EQ(frame.rgba, std::vector<float>(64 * 48 * 4, 0.0F));
  for (const float depth : frame.depth_m)
    EXPECT_TRUE(std::isnan(depth));
}

TEST_P(AnyBackend, GridPartlyBehindTheCameraShowsOnlyItsFront) {
  const Box3 box(Vector3(-0.1, -0.1, -2.0), Vector3(0.1, 0.1, 2.0));
  Camera camera = Camera::lookAt({0.5, 0.0, -0.2}, {0.0, 0.0, 1.0}, {0, -1, 0}, 1.2, 64, 48);
  for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
    if (projection == Projection::kParallel)
      camera = Camera::lookAtParallel({0.5, 0.0, -0.2}, {0.0, 0.0, 1.0}, {0, -1, 0}, 1.5, 64, 48);
    Scene scene(GetParam(), box, Vector3i(2, 2, 3), constantVolume(), makeFog(0.3F, 0.1));
    for (const bool boundary : {false, GetParam() == Backend::kNative}) {
      RenderOptions options = plain(400);
      options.exact_boundary = boundary;
      int seen = 0;
      forEachPixel(scene.render(camera, options), [&](int u, int v, float opacity) {
        const double exact = 1.0 - std::pow(0.7, wayInside(camera, u, v, box) / 0.1);
        ASSERT_NEAR(opacity, exact, 0.05) << "pixel " << u << ' ' << v;  // one slab of 4 m / 400
        seen += exact > 0.1;
      });
      EXPECT_GT(seen, 100);
    }
  }
}

TEST_P(AnyBackend, FoldedAndCollapsedGridsGiveFiniteFrames) {
  BallScene scene(GetParam());
  // In front of and inside the grid; small, as every pixel sees most of the cells.
  const Camera camera = straightCamera(Vector3(0, 0, 0.85), 8, 6, 12.0);
  std::mt19937 random(kSeed);
  for (const float size_m : {0.0F, 1e-20F, 0.1F}) {
    for (const bool boundary : {false, true}) {
      std::uniform_real_distribution<float> coordinate(-size_m, size_m);
      std::vector<Vector3f> positions = scene.topology.rest_positions;
      for (Vector3f& p : positions)
        p = Vector3f(0, 0, 1) + Vector3f(coordinate(random), coordinate(random), 0.9F * coordinate(random));
      RenderOptions options = shaded(true);
      options.exact_boundary = boundary && GetParam() == Backend::kNative;
      options.adaptive = boundary;
      const Frame& frame = scene.renderer.render(camera, positions, options);
      for (const float value : frame.rgba)
        ASSERT_TRUE(std::isfinite(value)) << "size " << size_m << ", seed " << kSeed;
      for (const float depth : frame.depth_m)
        ASSERT_FALSE(std::isinf(depth)) << "size " << size_m << ", seed " << kSeed;
    }
  }
}

// --- What is not there

/// Blocks of hexahedra with one scalar, side by side or in line.
IrregularGrid makeBlocks(const std::vector<Box3>& boxes, const Vector3i& cells) {
  IrregularGrid grid;
  grid.cell_offsets = {0};
  for (const Box3& box : boxes) {
    const Topology block = makeBlock(box, cells);
    const auto first = std::uint32_t(grid.points.size());
    grid.points.insert(grid.points.end(), block.rest_positions.begin(), block.rest_positions.end());
    for (const std::uint32_t vertex : block.connectivity)
      grid.connectivity.push_back(first + vertex);
    grid.cell_types.insert(grid.cell_types.end(), block.cell_types.begin(), block.cell_types.end());
    for (std::size_t i = 0; i < block.cellCount(); ++i)
      grid.cell_offsets.push_back(grid.cell_offsets.back() + 8);
  }
  grid.point_scalars.assign(grid.points.size(), 1.0F);
  return grid;
}

TEST_P(AnyBackend, GapsBetweenBlocksAbsorbNothing) {
  const std::vector<Box3> boxes = {{Vector3(-0.3, -0.3, 1.0), Vector3(0.3, 0.3, 1.1)},
                                   {Vector3(-0.3, -0.3, 1.3), Vector3(0.3, 0.3, 1.35)},
                                   {Vector3(-0.3, -0.3, 1.36), Vector3(0.3, 0.3, 1.4)}};
  Renderer renderer(GetParam());
  renderer.setGrid(makeBlocks(boxes, Vector3i(2, 2, 2)));
  renderer.setTransferFunction(makeFog(0.3F, 0.1));
  for (const Camera& camera : {straightCamera(Vector3::Zero()), straightCamera(Vector3(0.1, 0.05, 0.1))}) {
    // In exact_boundary a few planes are enough, and the thin gap may lie between two of them.
    for (const int slices : {400, GetParam() == Backend::kNative ? 9 : 400}) {
      RenderOptions options = plain(slices);
      options.exact_boundary = GetParam() == Backend::kNative;
      forEachPixel(renderer.render(camera, options), [&](int u, int v, float opacity) {
        double way = 0.0;
        for (const Box3& box : boxes)
          way += wayInside(camera, u, v, box);
        // gl: half a slab of 1 mm at each of up to six ends.
        const double tolerance = GetParam() == Backend::kGl ? 0.01 : 1e-4;
        ASSERT_NEAR(opacity, 1.0 - std::pow(0.7, way / 0.1), tolerance) << u << ' ' << v << ' ' << slices;
      });
    }
  }
}

TEST_P(AnyBackend, AHoleInAGridAbsorbsNothing) {
  const Box3 box(Vector3::Constant(-0.15), Vector3::Constant(0.15));
  const Box3 hole(Vector3::Constant(-0.05), Vector3::Constant(0.05));
  IrregularGrid grid = makeBlocks({box}, Vector3i(3, 3, 3));
  grid.cell_types.pop_back();
  grid.cell_offsets.pop_back();
  grid.connectivity.erase(grid.connectivity.begin() + 13 * 8, grid.connectivity.begin() + 14 * 8);  // the middle one
  Renderer renderer(GetParam());
  renderer.setGrid(grid);
  renderer.setTransferFunction(makeFog(0.3F, 0.1));
  const Camera camera = cornerCamera();
  RenderOptions options = plain(300);
  options.exact_boundary = GetParam() == Backend::kNative;
  forEachPixel(renderer.render(camera, options), [&](int u, int v, float opacity) {
    const double way = wayInside(camera, u, v, box) - wayInside(camera, u, v, hole);
    const double tolerance = GetParam() == Backend::kGl ? 0.02 : 1e-4;  // gl: four half slabs of 0.5 m / 300
    ASSERT_NEAR(opacity, 1.0 - std::pow(0.7, way / 0.1), tolerance) << u << ' ' << v;
  });
}

TEST_P(AnyBackend, NanScalarsOfAVolumeDrawNothing) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const auto volume =
      makeVolume(Vector3i(20, 4, 4), Vector3::Ones(), [nan](const Vector3& t) { return t.x() < 0.5 ? nan : 1.0; });
  Scene scene(GetParam(), Box3(Vector3(-0.2, -0.1, 0.95), Vector3(0.2, 0.1, 1.05)), Vector3i(4, 2, 2), volume,
              makeFog(0.9F, 0.01));
  const Frame& frame = scene.render(straightCamera(Vector3::Zero()), shaded(true));
  EXPECT_EQ(pixelOf(frame, 20, 24)[3], 0.0F);
  EXPECT_GT(pixelOf(frame, 44, 24)[3], 0.9F);
  for (const float value : frame.rgba)
    ASSERT_TRUE(std::isfinite(value));
}

TEST_P(AnyBackend, NanScalarsOfAGridDrawNothing) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const Box3 box(Vector3(-0.2, -0.1, 0.95), Vector3(0.2, 0.1, 1.05));
  const Camera camera = straightCamera(Vector3::Zero());
  for (const Lookup lookup : {Lookup::kScalar, Lookup::kColour}) {
    for (const bool of_cells : {false, true}) {
      IrregularGrid grid = makeBlocks({box}, Vector3i(2, 1, 1));
      if (of_cells) {
        grid.point_scalars.clear();
        grid.cell_scalars = {nan, 1.0F};
      } else {
        grid.point_scalars[0] = nan;  // a corner of the left cell alone
      }
      Renderer renderer(GetParam());
      renderer.setGrid(grid);
      renderer.setTransferFunction(makeFog(0.9F, 0.01));
      RenderOptions options = shaded(true);
      options.lookup = lookup;
      const Frame& frame = renderer.render(camera, options);
      forEachPixel(frame, [&](int u, int v, float opacity) {
        ASSERT_TRUE(std::isfinite(opacity));
        if (u < 31) {
          ASSERT_EQ(opacity, 0.0F) << u << ' ' << v;
        }
      });
      EXPECT_GT(pixelOf(frame, 44, 24)[3], 0.9F);
    }
  }
}

// --- Volumes of all kinds

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

TEST_P(AnyBackend, EveryScalarTypeIsLookedUpExactly) {
  const Camera camera = straightCamera(Vector3::Zero());
  // One voxel thick and not.
  for (const int thickness : {1, 4}) {
    // Values on a coarse grid, so that interpolation between voxels does most of the work.
    const auto floats = makeVolume(Vector3i(11, thickness, thickness), Vector3::Ones(), [](const Vector3& t) {
      return std::round((t.x() * 11.0 - 0.5) * 12.0);  // 0 to 120
    });
    const auto expectRamp = [&](std::shared_ptr<const Volume> volume, double low, double high) {
      const std::string name = scalarName(volume->type());
      Scene scene(GetParam(), sheet(-0.2, 0.2, -0.1, 0.1), Vector3i(1, 1, 1), std::move(volume), makeRamp(low, high));
      const Frame& frame = scene.render(camera, plain(1));
      for (int u = 14; u < 50; ++u) {
        const double texture = ((u - camera.cx) / camera.fx + 0.2) / 0.4;
        const double exact = std::clamp((texture * 11.0 - 0.5) / 10.0, 0.0, 1.0);
        // The table has 4096 entries; their nearest is at most 1 / 8190 away. exact sees the sheet 0.5 mm nearer.
        EXPECT_NEAR(pixelOf(frame, u, 24)[0] / pixelOf(frame, u, 24)[3], exact,
                    GetParam() == Backend::kExact ? 1e-3 : 3e-4)
            << name << " pixel " << u;
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
}

// --- Cross-sections and stored slices

TEST_P(SliceBackend, CrossSectionHasTheColoursOfTheTransferFunction) {
  const Box3 box(Vector3(-0.2, -0.1, 0.9), Vector3(0.2, 0.1, 1.1));
  const auto volume = makeVolume(Vector3i(20, 4, 4), Vector3::Ones(), [](const Vector3& t) { return t.x(); });
  TransferFunction faint = makeRamp(0.0, 1.0);
  faint.points[0].opacity = faint.points[1].opacity = 0.01F;
  Scene scene(GetParam(), box, Vector3i(2, 2, 2), volume, faint);
  const Camera camera = straightCamera(Vector3::Zero());
  for (const double z : {0.95, 1.05}) {
    const Frame& frame = scene.renderer.renderCrossSection(camera, z);
    forEachPixel(frame, [&](int u, int v, float opacity) {
      const double x = (u - camera.cx) / camera.fx * z;
      const double y = (v - camera.cy) / camera.fy * z;
      if (std::min(std::abs(std::abs(x) - 0.2), std::abs(std::abs(y) - 0.1)) < 1e-5)
        return;
      const bool inside = std::abs(x) < 0.2 && std::abs(y) < 0.1;
      ASSERT_EQ(opacity, inside ? 1.0F : 0.0F) << u << ' ' << v;
      // The table's entries are 1 / 4095 apart; voxels of 0.05, clamped by half of one at the sides.
      const double wanted = std::clamp((x + 0.2) / 0.4, 0.025, 0.975);
      ASSERT_NEAR(pixelOf(frame, u, v)[0], inside ? wanted : 0.0, 3e-4);
    });
  }
}

TEST_P(SliceBackend, CrossSectionFollowsThePositions) {
  const Box3 box(Vector3(-0.2, -0.1, 0.9), Vector3(0.2, 0.1, 1.1));
  const auto volume = makeVolume(Vector3i(20, 4, 4), Vector3::Ones(), [](const Vector3& t) { return t.x(); });
  Scene scene(GetParam(), box, Vector3i(2, 2, 2), volume, makeRamp(0.0, 1.0));
  std::vector<Vector3f> stretched = scene.topology.rest_positions;
  for (Vector3f& p : stretched)
    p.x() *= 1.25F;
  const Camera camera = straightCamera(Vector3::Zero());
  const Frame& frame = scene.renderer.renderCrossSection(camera, stretched, 1.0);
  forEachPixel(frame, [&](int u, int v, float opacity) {
    const double x = (u - camera.cx) / camera.fx;
    const double y = (v - camera.cy) / camera.fy;
    if (std::min(std::abs(std::abs(x) - 0.25), std::abs(std::abs(y) - 0.1)) < 1e-5)
      return;
    const bool inside = std::abs(x) < 0.25 && std::abs(y) < 0.1;
    ASSERT_EQ(opacity, inside ? 1.0F : 0.0F) << u << ' ' << v;
    ASSERT_NEAR(pixelOf(frame, u, v)[0], inside ? std::clamp((x / 1.25 + 0.2) / 0.4, 0.025, 0.975) : 0.0, 3e-4);
  });
  stretched.pop_back();
  EXPECT_THROW(scene.renderer.renderCrossSection(camera, stretched, 1.0), InputError);
}

double meanDifference(const Frame& a, const Frame& b) {
  double sum = 0.0;
  for (std::size_t i = 0; i < a.rgba.size(); ++i)
    sum += std::abs(double(a.rgba[i]) - double(b.rgba[i]));
  return sum / double(a.rgba.size());
}

Camera around(double degrees) {
  const double angle = degrees * M_PI / 180.0;
  Camera camera = Camera::lookAt({std::sin(angle), 0.0, 1.0 - std::cos(angle)}, {0, 0, 1}, {0, -1, 0}, 0.35, 100, 80);
  return camera;
}

TEST_P(SliceBackend, StoredSlicesFromTheSameCameraAreTheFrame) {
  BallScene scene(GetParam());
  for (const bool light : {false, true}) {
    RenderOptions options = shaded(false);
    options.shading = light ? 0.7 : 0.0;
    const Frame frame = scene.render(around(0.0), options);
    // Vertices are projected anew, which rounds them otherwise: pixels at the border of a polygon may change sides.
    EXPECT_LT(meanDifference(scene.renderer.renderStored(around(0.0)), frame), 1e-3);
  }
}

TEST_P(SliceBackend, StoredSlicesFromTheSideAreCloseToAFrame) {
  BallScene scene(GetParam());
  const RenderOptions options = plain(125);
  const Frame wanted = scene.render(around(20.0), options);
  scene.render(around(0.0), options);
  const Frame turned = scene.renderer.renderStored(around(20.0));
  EXPECT_TRUE(showsSomething(wanted));
  EXPECT_LT(meanDifference(turned, wanted), 0.02);
  EXPECT_EQ(turned.updated.pixels(), turned.rgba.size() / 4);
  const Frame behind = scene.renderer.renderStored(around(180.0));
  EXPECT_LT(meanDifference(behind, scene.render(around(180.0), options)), 0.02) << "back to front";
  scene.render(around(0.0), options);
  EXPECT_EQ(scene.renderer.renderStored(around(90.0)).rgba, std::vector<float>(wanted.rgba.size(), 0.0F));
}

TEST_P(AnyBackend, SaysWhenThereAreNoStoredSlices) {
  BallScene scene(GetParam());
  EXPECT_THROW(scene.renderer.renderStored(kBallCamera), InputError);
  if (GetParam() == Backend::kExact) {
    scene.render(kBallCamera, plain(10));
    EXPECT_THROW(scene.renderer.renderStored(kBallCamera), InputError);
    EXPECT_THROW(scene.renderer.renderCrossSection(kBallCamera, 1.0), InputError);
    return;
  }
  scene.render(kBallCamera, plain(10));
  EXPECT_NO_THROW(scene.renderer.renderStored(kBallCamera));
  scene.renderer.forgetFrame();
  EXPECT_THROW(scene.renderer.renderStored(kBallCamera), InputError);
  for (const double z : {0.001, 11.0, std::numeric_limits<double>::quiet_NaN()})
    EXPECT_THROW(scene.renderer.renderCrossSection(kBallCamera, z), InputError) << z;
}

// --- Errors

TEST_P(AnyBackend, SaysWhatIsMissing) {
  Renderer renderer(GetParam());
  const Camera camera = straightCamera(Vector3::Zero());
  const Topology topology = makeBlock(sheet(0, 1, 0, 1), Vector3i(1, 1, 1));
  EXPECT_THROW(renderer.render(camera), InputError);
  renderer.setVolume(constantVolume());
  EXPECT_THROW(renderer.render(camera), InputError);
  renderer.setTransferFunction(makeFog(0.5F, 0.1));
  EXPECT_THROW(renderer.render(camera), InputError);
  renderer.setTopology(topology);
  EXPECT_NO_THROW(renderer.render(camera));
  RenderOptions options;
  options.labels = true;
  EXPECT_THROW(renderer.render(camera, options), InputError);
  renderer.setLabels(constantVolume());
  EXPECT_NO_THROW(renderer.render(camera, options));
}

TEST_P(AnyBackend, RefusedInputLeavesTheFormerState) {
  BallScene scene(GetParam());
  const Frame before = scene.render(kBallCamera, shaded(true));
  Renderer& renderer = scene.renderer;
  EXPECT_THROW(renderer.setVolume(nullptr), InputError);
  EXPECT_THROW(renderer.setVolume(std::make_shared<const Volume>()), InputError);
  EXPECT_THROW(renderer.setLabels(std::make_shared<const Volume>()), InputError);
  EXPECT_THROW(renderer.setTransferFunction(TransferFunction{}), SceneError);
  Topology broken = scene.topology;
  broken.connectivity[5] = 1000000;
  EXPECT_THROW(renderer.setTopology(broken), InputError);
  EXPECT_THROW(renderer.setGrid(IrregularGrid{}), InputError);
  IrregularGrid no_scalars = makeBlocks({kCube}, Vector3i(1, 1, 1));
  no_scalars.point_scalars.clear();
  EXPECT_THROW(renderer.setGrid(no_scalars), InputError);
  Camera bad_camera = kBallCamera;
  bad_camera.fx = -1.0;
  EXPECT_THROW(renderer.render(bad_camera, shaded(true)), SceneError);
  std::vector<Vector3f> positions = scene.topology.rest_positions;
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), 5.0F, 1e30F}) {
    positions[7].x() = bad;
    EXPECT_THROW(renderer.render(kBallCamera, positions, shaded(true)), InputError) << bad;
  }
  positions.pop_back();
  EXPECT_THROW(renderer.render(kBallCamera, positions, shaded(true)), InputError);
  EXPECT_TRUE(sameFrames(renderer.render(kBallCamera, shaded(true)), before));
  renderer.forgetFrame();
  EXPECT_TRUE(sameFrames(renderer.render(kBallCamera, shaded(true)), before));
}

INSTANTIATE_TEST_SUITE_P(All, AnyBackend, testing::Values(Backend::kGl, Backend::kNative, Backend::kExact),
                         [](const auto& info) { return nameOf(info.param); });
INSTANTIATE_TEST_SUITE_P(All, SliceBackend, testing::Values(Backend::kGl, Backend::kNative),
                         [](const auto& info) { return nameOf(info.param); });

TEST(RenderOptions, EveryFieldIsValidated) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::vector<std::function<void(RenderOptions&)>> spoilers = {
      [](RenderOptions& o) { o.slices = 0; },
      [](RenderOptions& o) { o.slices = 4097; },
      [](RenderOptions& o) { o.step_m = -1.0; },
      [nan](RenderOptions& o) { o.step_m = nan; },
      [](RenderOptions& o) { o.shading = -0.1; },
      [](RenderOptions& o) { o.shading = 1.1; },
      [nan](RenderOptions& o) { o.shading = nan; },
      [](RenderOptions& o) { o.specular = -0.1; },
      [](RenderOptions& o) { o.specular = 1.1; },
      [nan](RenderOptions& o) { o.specular = nan; },
      [](RenderOptions& o) { o.depth_threshold = 0.0; },
      [](RenderOptions& o) { o.depth_threshold = 1.0; },
      [nan](RenderOptions& o) { o.depth_threshold = nan; },
      [](RenderOptions& o) { o.threads = -1; },
      [](RenderOptions& o) { o.threads = 1025; },
      [](RenderOptions& o) { o.clip_planes.resize(RenderOptions::kMaxClipPlanes + 1); },
      [](RenderOptions& o) {
        o.clip_planes = {{Vector3(1, 1, 0), 0.0}};
      },
      [](RenderOptions& o) {
        o.clip_planes = {{Vector3::Zero(), 0.0}};
      },
      [nan](RenderOptions& o) {
        o.clip_planes = {{Vector3(nan, 0, 1), 0.0}};
      },
      [nan](RenderOptions& o) {
        o.clip_planes = {{Vector3::UnitX(), nan}};
      },
  };
  EXPECT_NO_THROW(RenderOptions{}.validate());
  for (std::size_t i = 0; i < spoilers.size(); ++i) {
    RenderOptions options;
    spoilers[i](options);
    EXPECT_THROW(options.validate(), SceneError) << "spoiler " << i;
  }
}

TEST(Frame, ToRgb8BlendsOverTheBackground) {
  Frame frame;
  frame.width = 2;
  frame.height = 1;
  frame.rgba = {0.5F, 0.25F, 0.0F, 0.5F, 2.0F, 0.0F, 0.0F, 0.0F};
  const Image image = frame.toRgb8({0.0F, 0.5F, 1.0F});
  EXPECT_EQ(image.rgb, (std::vector<std::uint8_t>{128, 128, 128, 255, 128, 255}));
}

std::unique_ptr<Renderer> renderer_with_the_life_of_the_process;

/// Runs in a process of its own, in which the renderer dies after the drivers' handlers for exit() have run.
TEST(RendererDeathTest, DyingBehindTheDriversDoesNoHarm) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  const auto drawAndExit = [](Backend backend) {
    renderer_with_the_life_of_the_process = std::make_unique<Renderer>(backend);
    renderer_with_the_life_of_the_process->setTransferFunction(makePeaks());
    renderer_with_the_life_of_the_process->setGrid(makeWarpedGrid(CubeParts::kHexahedra, 3, 0.1F, 1));
    const Frame& frame =
        renderer_with_the_life_of_the_process->render(obliqueCamera(Projection::kParallel, 32, 24), plain(10));
    std::exit(showsSomething(frame) ? 0 : 1);
  };
  for (const Backend backend : {Backend::kNative, Backend::kGl, Backend::kExact})
    EXPECT_EXIT(drawAndExit(backend), testing::ExitedWithCode(0), "");
}

TEST(VolumeTopology, CellsOfAnySizeShowTheSameVolume) {
  const auto volume = makeWavyVolume();
  Renderer one(Backend::kNative);
  Renderer many(Backend::kNative);
  const Topology whole = volumeTopology(volume->geometry());
  const Topology cells = volumeTopology(volume->geometry(), 4);
  EXPECT_EQ(whole.cellCount(), 1U);
  EXPECT_EQ(cells.cellCount(), 5U * 4 * 3) << "17 by 13 by 11 voxels";
  EXPECT_TRUE(boundsOf(whole.rest_positions).isApprox(boundsOf(cells.rest_positions), 1e-6));
  EXPECT_TRUE(boundsOf(whole.rest_positions).isApprox(volume->geometry().bounds(), 1e-6));
  for (Renderer* renderer : {&one, &many}) {
    renderer->setVolume(volume);
    renderer->setTransferFunction(makePeaks());
    renderer->setTopology(renderer == &one ? whole : cells);
  }
  Camera camera = obliqueCamera(Projection::kPerspective, 64, 48);
  camera.T_volume_camera.position_m += volume->geometry().bounds().center();
  const Frame& a = one.render(camera, plain(50));
  const Frame& b = many.render(camera, plain(50));
  EXPECT_TRUE(showsSomething(a));
  for (std::size_t i = 0; i < a.rgba.size(); ++i)
    ASSERT_NEAR(a.rgba[i], b.rgba[i], 2e-3) << i;  // texture coordinates are rounded otherwise
}

}  // namespace
}  // namespace soft_volume::core
