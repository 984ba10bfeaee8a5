#include "exact_tracer.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <random>

#include "blunt_fin.h"
#include "light.h"
#include "render/canvas_scene.h"
#include "render/ray_oracle.h"
#include "render/render_scenes.h"
#include "render/warped_grids.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 19970521;
/// Of the reference that the other back ends are measured with, in 8-bit levels.
constexpr double kRmse = 0.2;
constexpr double kLargest = 2.0;
/// The oracle itself places the depth no better where there is little absorption.
constexpr double kLargestDepth_m = 0.02;

/// What the issue calls TF-A, TF-B and TF-C, for scalars in [0, 1] and grids a few units wide.
TransferFunction makeHaze() {
  TransferFunction function;
  function.points = {{0.0, {0.1F, 0.1F, 0.6F}, 0.05F},
                     {0.3, {0.1F, 0.8F, 0.9F}, 0.1F},
                     {0.6, {0.9F, 0.8F, 0.1F}, 0.2F},
                     {1.0, {1.0F, 0.2F, 0.1F}, 0.5F}};
  function.unit_distance_m = 1.0;
  return function;
}

TransferFunction makePeaks() {
  TransferFunction function;
  const Vector3f blue(0.2F, 0.4F, 1.0F);
  const Vector3f yellow(1.0F, 0.9F, 0.2F);
  function.points = {{0.32, blue, 0.0F},   {0.35, blue, 0.95F},   {0.38, blue, 0.0F},
                     {0.62, yellow, 0.0F}, {0.65, yellow, 0.98F}, {0.68, yellow, 0.0F}};
  function.unit_distance_m = 1.0;
  return function;
}

TransferFunction makeOpaque() {
  TransferFunction function;
  function.points = {
      {0.3, {0.2F, 0.6F, 1.0F}, 0.0F}, {0.5, {0.3F, 0.9F, 0.4F}, 0.99F}, {1.0, {1.0F, 0.2F, 0.1F}, 1.0F}};
  function.unit_distance_m = 1.0;
  return function;
}

Camera perspectiveCamera(int width, int height) {
  Camera camera = Camera::lookAt({2.5, -3.0, -8.0}, Vector3::Zero(), Vector3(0.1, -1.0, 0.0), 0.55, width, height);
  camera.near_m = 0.1;
  camera.far_m = 100.0;
  return camera;
}

Camera parallelCamera(int width, int height) {
  Camera camera =
      Camera::lookAtParallel({2.5, -3.0, -8.0}, Vector3::Zero(), Vector3(0.1, -1.0, 0.0), 5.0, width, height);
  camera.near_m = 0.1;
  camera.far_m = 100.0;
  return camera;
}

std::vector<Vector3f> inCameraFrame(const Camera& camera, const std::vector<Vector3f>& points) {
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  std::vector<Vector3f> result;
  for (const Vector3f& point : points)
    result.push_back((T_camera_volume * point.cast<double>()).cast<float>());
  return result;
}

RenderOptions unlit() {
  RenderOptions options;
  options.shading = 0.0;
  options.depth = true;
  options.threads = 2;
  return options;
}

Frame emptyFrame(const Camera& camera, const RenderOptions& options) {
  Frame frame;
  frame.width = camera.width;
  frame.height = camera.height;
  const std::size_t pixels = std::size_t(camera.width) * std::size_t(camera.height);
  frame.rgba.assign(4 * pixels, -1.0F);
  frame.depth_m.assign(options.depth ? pixels : 0, -1.0F);
  frame.labels.assign(options.labels ? pixels : 0, 999);
  return frame;
}

/// A tracer with what it refers to.
struct Scene {
  Scene(DrawnGrid drawn, const TransferFunction& function) : grid(std::move(drawn)) {
    tracer.setGrid(grid);
    tracer.setTransferFunction(function);
  }
  Frame draw(const Camera& camera, const RenderOptions& options) {
    Frame frame = emptyFrame(camera, options);
    drawInto(frame, camera, options, wholeImage(camera));
    return frame;
  }
  void drawInto(Frame& frame, const Camera& camera, const RenderOptions& options, const PixelRect& rect) {
    std::vector<std::uint8_t> skipped = skip;
    skipped.resize(grid.cellCount(), 0);
    tracer.draw(camera, options, inCameraFrame(camera, positions.empty() ? grid.rest_positions : positions), skipped,
                rect, frame);
  }

  DrawnGrid grid;
  std::vector<Vector3f> positions;  ///< volume frame; empty for the grid at rest
  std::vector<std::uint8_t> skip;
  ExactTracer tracer;
};

/// Errors of an image in 8-bit levels, over pixels that are not black.
struct Errors {
  double sum_of_squares = 0.0;
  std::size_t count = 0;
  double largest = 0.0;
  double largest_depth = 0.0;

  double rmse() const { return count > 0 ? std::sqrt(sum_of_squares / double(4 * count)) : 0.0; }
  void add(const float* rgba, const OraclePixel& wanted) {
    double squares = 0.0;
    for (int channel = 0; channel < 4; ++channel) {
      const double error = 255.0 * (double(rgba[channel]) - wanted.rgba[channel]);
      squares += error * error;
      largest = std::max(largest, std::abs(error));
    }
    if (wanted.rgba[3] > 0.0 || rgba[3] > 0.0F)
      ++count;
    sum_of_squares += squares;
  }
};

Errors errorsOf(Scene& scene, const TransferFunction& function, const Camera& camera, const Volume* volume = nullptr) {
  const RenderOptions options = unlit();
  const Frame frame = scene.draw(camera, options);
  IrregularGrid grid;
  grid.points = inCameraFrame(camera, scene.positions.empty() ? scene.grid.rest_positions : scene.positions);
  grid.cell_types = scene.grid.cell_types;
  grid.cell_offsets = scene.grid.cell_offsets;
  grid.connectivity = scene.grid.connectivity;
  grid.point_scalars = scene.grid.point_scalars;
  grid.cell_scalars = scene.grid.cell_scalars;
  RayOracle oracle(grid, function, scene.grid.texture, volume);
  Errors errors;
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      const OraclePixel wanted = oracle.trace(camera, u, v, camera.near_m, camera.far_m, options.depth_threshold);
      errors.add(pixelOf(frame, u, v), wanted);
      const float depth = frame.depth_m[std::size_t(v) * std::size_t(camera.width) + std::size_t(u)];
      const bool near_threshold = std::abs(wanted.rgba[3] - options.depth_threshold) < 0.01;
      EXPECT_TRUE(near_threshold || std::isnan(depth) == std::isnan(wanted.depth_m));
      if (!near_threshold && !std::isnan(depth))
        errors.largest_depth = std::max(errors.largest_depth, std::abs(double(depth) - wanted.depth_m));
    }
  }
  return errors;
}

void report(const std::string& name, const Errors& errors) {
  std::printf("%-32s RMSE %.4f, largest %.3f levels, depth %.2g m over %zu pixels\n", name.c_str(), errors.rmse(),
              errors.largest, errors.largest_depth, errors.count);
}

class ExactAgainstOracle : public testing::TestWithParam<CubeParts> {};

TEST_P(ExactAgainstOracle, EveryTransferFunctionAndProjection) {
  const std::vector<NamedFunction> functions = {{"haze", makeHaze()}, {"peaks", makePeaks()}, {"opaque", makeOpaque()}};
  const IrregularGrid grid = makeWarpedGrid(GetParam(), 4, 0.2F, kSeed);
  for (const NamedFunction& named : functions) {
    Scene scene(drawnGrid(grid), named.function);
    for (const Camera& camera : {perspectiveCamera(8, 6), parallelCamera(8, 6)}) {
      const Errors errors = errorsOf(scene, named.function, camera);
      report(nameOf(GetParam()) + " " + named.name, errors);
      EXPECT_GT(errors.count, 20U);
      EXPECT_LT(errors.rmse(), kRmse);
      EXPECT_LT(errors.largest, kLargest);
      EXPECT_LT(errors.largest_depth, kLargestDepth_m);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(AllCells, ExactAgainstOracle,
                         testing::Values(CubeParts::kTetrahedra, CubeParts::kVoxels, CubeParts::kHexahedra,
                                         CubeParts::kWedges, CubeParts::kPyramids, CubeParts::kPolyhedra,
                                         CubeParts::kPentagons, CubeParts::kMixed),
                         [](const auto& info) { return nameOf(info.param); });

TEST(ExactTracer, DeformedTexturedLatticeIsAsTheOracleSays) {
  const auto value = [](const Vector3& t) {
    return 0.5 + 0.3 * std::sin(9.0 * t.x()) * std::cos(7.0 * t.y()) + 0.2 * std::sin(11.0 * t.z() + 4.0 * t.x());
  };
  const auto volume = makeVolume(Vector3i(17, 13, 11), Vector3(4.0, 4.0, 4.0), value);
  const Topology topology = makeBlock(Box3(Vector3::Constant(-2.0), Vector3::Constant(2.0)), Vector3i(3, 3, 3));
  for (const NamedFunction& named : {NamedFunction{"haze", makeHaze()}, NamedFunction{"peaks", makePeaks()}}) {
    Scene scene(drawnGrid(topology), named.function);
    scene.tracer.setVolume(*volume);
    std::mt19937 random(kSeed);
    scene.positions = jittered(topology.rest_positions, 0.25F, random);
    for (const Camera& camera : {perspectiveCamera(8, 6), parallelCamera(8, 6)}) {
      const Errors errors = errorsOf(scene, named.function, camera, volume.get());
      report("texture " + named.name, errors);
      EXPECT_GT(errors.count, 20U);
      EXPECT_LT(errors.rmse(), kRmse);
      EXPECT_LT(errors.largest, kLargest);
      EXPECT_LT(errors.largest_depth, kLargestDepth_m);
    }
  }
}

TEST(ExactTracer, BluntFinIsAsTheOracleSays) {
  const std::string folder = bluntFinFolder(SOFT_VOLUME_SOURCE_DIR);
  if (folder.empty())
    GTEST_SKIP() << "set SOFT_VOLUME_DATA to the folder of the sample data to run this test";
  const IrregularGrid grid = readBluntFin(folder);
  for (const NamedFunction& named : bluntFinFunctions()) {
    Scene scene(drawnGrid(grid), named.function);
    for (const double angle : {0.0, M_PI / 4}) {
      const Errors errors = errorsOf(scene, named.function, bluntFinCamera(angle, 10, 8));
      report("blunt fin " + named.name, errors);
      EXPECT_GT(errors.count, 15U);
      EXPECT_LT(errors.rmse(), kRmse);
      EXPECT_LT(errors.largest, kLargest);
      EXPECT_LT(errors.largest_depth, kLargestDepth_m);
    }
  }
}

/// Two by two by two cubes of one scalar from (-1, -1, -1) to (1, 1, 1).
DrawnGrid makeSlab(float scalar) {
  IrregularGrid grid = makeWarpedGrid(CubeParts::kHexahedra, 2, 0.0F, kSeed);
  grid.point_scalars.assign(grid.vertexCount(), scalar);
  return drawnGrid(grid);
}

/// White, of one opacity per metre.
TransferFunction makeFog(float opacity) {
  TransferFunction function;
  function.points = {{0.0, Vector3f::Ones(), opacity}, {1.0, Vector3f::Ones(), opacity}};
  function.unit_distance_m = 1.0;
  return function;
}

Camera lookAlongZ(Projection projection, double distance) {
  Camera camera = straightCamera({0.0, 0.0, -distance}, 24, 18, 30.0);
  camera.projection = projection;
  if (projection == Projection::kParallel)
    camera.fx = camera.fy = 10.0;
  return camera;
}

/// Length of a pixel's ray inside the box from (-1, -1, begin) to (1, 1, end), both seen from the camera of
/// lookAlongZ(.., 4).
double wayThrough(const Camera& camera, int u, int v, double begin, double end) {
  const bool parallel = camera.projection == Projection::kParallel;
  const Eigen::Vector2d slope((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
  if (parallel)
    return slope.cwiseAbs().maxCoeff() < 1.0 ? end - begin : 0.0;
  const double side = 1.0 / std::max(1e-9, slope.cwiseAbs().maxCoeff());
  return std::max(0.0, std::min(end, side) - begin) * std::sqrt(1.0 + slope.squaredNorm());
}

TEST(ExactTracer, SlabOfOneAbsorptionIsExact) {
  const TransferFunction fog = makeFog(0.4F);
  Scene scene(makeSlab(0.5F), fog);
  for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
    const Camera camera = lookAlongZ(projection, 4.0);
    const Frame frame = scene.draw(camera, unlit());
    int seen = 0;
    for (int v = 0; v < camera.height; ++v) {
      for (int u = 0; u < camera.width; ++u) {
        const double way = wayThrough(camera, u, v, 3.0, 5.0);
        const double wanted = 1.0 - std::pow(1.0 - 0.4F, way);
        for (int channel = 0; channel < 4; ++channel)
          EXPECT_NEAR(pixelOf(frame, u, v)[channel], wanted, 1e-5) << u << ' ' << v;
        seen += way > 0.0 ? 1 : 0;
      }
    }
    EXPECT_GT(seen, 40);
  }
}

TEST(ExactTracer, DepthIsWhereTheThresholdIsReached) {
  const TransferFunction fog = makeFog(0.9F);
  Scene scene(makeSlab(0.5F), fog);
  const Camera camera = lookAlongZ(Projection::kPerspective, 4.0);
  RenderOptions options = unlit();
  options.depth_threshold = 0.7;
  const Frame frame = scene.draw(camera, options);
  const double way = std::log(1.0 - 0.7) / std::log(1.0 - double(0.9F));
  for (const auto& [u, v] : {std::pair(11, 8), {9, 7}, {14, 11}}) {
    const Eigen::Vector2d slope = camera.raySlope(u, v);
    const double wanted = 3.0 + way / std::sqrt(1.0 + slope.squaredNorm());
    EXPECT_NEAR(frame.depth_m[std::size_t(v * camera.width + u)], wanted, 1e-6);
  }
  EXPECT_TRUE(std::isnan(frame.depth_m[0]));
}

TEST(ExactTracer, ClippingPlanesCutExactly) {
  const TransferFunction fog = makeFog(0.4F);
  Scene scene(makeSlab(0.5F), fog);
  const Camera camera = lookAlongZ(Projection::kParallel, 4.0);
  RenderOptions options = unlit();
  // From z = -0.75 to z = 0.5 + x, volume frame.
  options.clip_planes = {{-Vector3::UnitZ(), 0.75}, {Vector3(-1.0, 0.0, 1.0).normalized(), 0.5 / std::sqrt(2.0)}};
  const Frame frame = scene.draw(camera, options);
  for (int u = 0; u < camera.width; ++u) {
    const double x = (u - camera.cx) / camera.fx;
    const double way = std::abs(x) < 1.0 ? std::clamp(0.5 + x, -0.75, 1.0) + 0.75 : 0.0;
    EXPECT_NEAR(pixelOf(frame, u, 9)[3], 1.0 - std::pow(1.0 - 0.4F, way), 1e-5) << u;
  }
}

TEST(ExactTracer, ClippedRandomGridIsAsTheOracleSays) {
  const IrregularGrid grid = makeWarpedGrid(CubeParts::kMixed, 4, 0.2F, kSeed);
  const TransferFunction haze = makeHaze();
  Scene scene(drawnGrid(grid), haze);
  Camera camera = perspectiveCamera(8, 6);
  camera.near_m = 8.5;
  camera.far_m = 9.6;
  const Errors errors = errorsOf(scene, haze, camera);
  report("near and far planes", errors);
  EXPECT_GT(errors.count, 20U);
  EXPECT_LT(errors.rmse(), kRmse);
  EXPECT_LT(errors.largest, kLargest);
}

TEST(ExactTracer, CameraInsideTheGridSeesWhatIsInFrontOfIt) {
  for (const CubeParts parts : {CubeParts::kHexahedra, CubeParts::kPyramids, CubeParts::kPentagons}) {
    const IrregularGrid grid = makeWarpedGrid(parts, 4, 0.2F, kSeed);
    const TransferFunction haze = makeHaze();
    Scene scene(drawnGrid(grid), haze);
    Camera camera = Camera::lookAt({0.1, 0.2, -0.3}, {1.0, 2.0, 3.0}, Vector3::UnitX(), 1.5, 8, 6);
    camera.near_m = 0.001;
    const Errors errors = errorsOf(scene, haze, camera);
    report("camera inside " + nameOf(parts), errors);
    EXPECT_EQ(errors.count, 48U);
    EXPECT_LT(errors.rmse(), kRmse);
    EXPECT_LT(errors.largest, kLargest);
  }
}

bool equal(const Frame& a, const Frame& b) {
  return std::memcmp(a.rgba.data(), b.rgba.data(), a.rgba.size() * sizeof(float)) == 0 &&
         std::memcmp(a.depth_m.data(), b.depth_m.data(), a.depth_m.size() * sizeof(float)) == 0;
}

TEST(ExactTracer, ThreadsAndRectanglesChangeNoBit) {
  const IrregularGrid grid = makeWarpedGrid(CubeParts::kMixed, 6, 0.25F, kSeed);
  Scene scene(drawnGrid(grid), makePeaks());
  const Camera camera = perspectiveCamera(60, 45);
  RenderOptions options = unlit();
  options.shading = 0.7;
  options.threads = 1;
  const Frame one = scene.draw(camera, options);
  for (const int threads : {2, 3, 7}) {
    options.threads = threads;
    const Frame more = scene.draw(camera, options);
    EXPECT_TRUE(equal(one, more)) << threads;
    EXPECT_EQ(one.fragments, more.fragments);
  }
  Frame pieces = emptyFrame(camera, options);
  for (const PixelRect& rect : {PixelRect{0, 0, 23, 45}, PixelRect{23, 0, 60, 11}, PixelRect{23, 11, 60, 45}})
    scene.drawInto(pieces, camera, options, rect);
  EXPECT_TRUE(equal(one, pieces));
}

TEST(ExactTracer, RectangleLeavesTheOtherPixelsAlone) {
  Scene scene(makeSlab(0.5F), makeFog(0.4F));
  const Camera camera = lookAlongZ(Projection::kParallel, 4.0);
  Frame frame = emptyFrame(camera, unlit());
  scene.drawInto(frame, camera, unlit(), {3, 4, 20, 12});
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      const bool drawn = u >= 3 && u < 20 && v >= 4 && v < 12;
      EXPECT_EQ(pixelOf(frame, u, v)[3] >= 0.0F, drawn);
    }
  }
}

TEST(ExactTracer, SkippedCellsAndCellsWithoutANumberShowNothing) {
  IrregularGrid grid = makeWarpedGrid(CubeParts::kHexahedra, 2, 0.0F, kSeed);
  grid.point_scalars.assign(grid.vertexCount(), 0.5F);
  const Camera camera = lookAlongZ(Projection::kParallel, 4.0);
  const auto opacityAt = [](const Frame& frame, int u, int v) { return pixelOf(frame, u, v)[3]; };
  const double half = 1.0 - std::pow(1.0 - 0.4F, 1.0);
  const double whole = 1.0 - std::pow(1.0 - 0.4F, 2.0);
  {
    Scene scene(drawnGrid(grid), makeFog(0.4F));
    scene.skip.assign(8, 0);
    scene.skip[0] = 1;  // the upper left cube of the nearer layer
    const Frame frame = scene.draw(camera, unlit());
    EXPECT_NEAR(opacityAt(frame, 7, 5), half, 1e-5);
    EXPECT_NEAR(opacityAt(frame, 16, 12), whole, 1e-5);
  }
  grid.point_scalars[0] = std::numeric_limits<float>::quiet_NaN();
  Scene scene(drawnGrid(grid), makeFog(0.4F));
  const Frame frame = scene.draw(camera, unlit());
  EXPECT_NEAR(opacityAt(frame, 7, 5), half, 1e-5);
  EXPECT_NEAR(opacityAt(frame, 16, 12), whole, 1e-5);
  EXPECT_NEAR(opacityAt(frame, 16, 5), whole, 1e-5);
}

TEST(ExactTracer, CellScalarsAreConstantInTheirCells) {
  for (const CubeParts parts : {CubeParts::kHexahedra, CubeParts::kPentagons}) {
    IrregularGrid grid = makeWarpedGrid(parts, 4, 0.2F, kSeed);
    grid.point_scalars.clear();
    for (std::size_t cell = 0; cell < grid.cellCount(); ++cell)
      grid.cell_scalars.push_back(float(cell % 7) / 6.0F);
    const TransferFunction haze = makeHaze();
    Scene scene(drawnGrid(grid), haze);
    const Errors errors = errorsOf(scene, haze, parallelCamera(8, 6));
    report("cell scalars " + nameOf(parts), errors);
    EXPECT_LT(errors.rmse(), kRmse);
    EXPECT_LT(errors.largest, kLargest);
  }
}

TEST(ExactTracer, ColourLookupInterpolatesColourAndAbsorption) {
  // Red without absorption at the front, blue with absorption 2 per metre at the back.
  IrregularGrid grid = makeWarpedGrid(CubeParts::kHexahedra, 1, 0.0F, kSeed);
  grid.point_scalars = {0.0F, 0.0F, 0.0F, 0.0F, 1.0F, 1.0F, 1.0F, 1.0F};
  TransferFunction function;
  function.points = {{0.0, {1.0F, 0.0F, 0.0F}, 0.0F},
                     {0.9, {0.0F, 1.0F, 0.0F}, 0.0F},
                     {1.0, {0.0F, 0.0F, 1.0F}, float(1.0 - std::exp(-2.0))}};
  function.unit_distance_m = 1.0;
  Scene scene(drawnGrid(grid), function);
  RenderOptions options = unlit();
  options.lookup = Lookup::kColour;
  const Camera camera = lookAlongZ(Projection::kParallel, 4.0);
  const Frame frame = scene.draw(camera, options);
  const float* pixel = pixelOf(frame, 12, 9);
  Eigen::Vector4d wanted = Eigen::Vector4d::Zero();
  constexpr int kSteps = 100000;
  for (int i = 0; i < kSteps; ++i) {
    const double part = (i + 0.5) / kSteps;
    const double seen = 2.0 * part * std::exp(-part * part) / kSteps;
    wanted += seen * Eigen::Vector4d(1.0 - part, 0.0, part, 1.0);
  }
  for (int channel = 0; channel < 4; ++channel)
    EXPECT_NEAR(pixel[channel], wanted[channel], 1e-5) << channel;
}

/// Frames of anything have numbers between 0 and 1.
void expectSane(const Frame& frame) {
  for (const float value : frame.rgba)
    ASSERT_TRUE(value >= 0.0F && value <= 1.00001F) << value;
}

TEST(ExactTracer, DegenerateFoldedAndTornCellsStaySane) {
  std::mt19937 random(kSeed);
  for (const CubeParts parts : {CubeParts::kTetrahedra, CubeParts::kHexahedra, CubeParts::kWedges, CubeParts::kPyramids,
                                CubeParts::kPolyhedra, CubeParts::kPentagons}) {
    IrregularGrid grid = makeWarpedGrid(parts, 3, 0.9F, kSeed);  // many cells fold over themselves and each other
    grid.points[5] = grid.points[6];
    grid.points[9] = grid.points[10] = grid.points[11];
    for (std::size_t i = 20; i < 26; ++i)
      grid.points[i].z() = 0.0F;
    Scene scene(drawnGrid(grid), makeHaze());
    RenderOptions options = unlit();
    options.shading = 0.7;
    for (const Camera& camera :
         {perspectiveCamera(28, 21), parallelCamera(28, 21), lookAlongZ(Projection::kParallel, 4.0)})
      expectSane(scene.draw(camera, options));
    scene.positions.assign(grid.vertexCount(), Vector3f(0.1F, 0.1F, 0.1F));
    expectSane(scene.draw(perspectiveCamera(28, 21), options));
  }
}

TEST(ExactTracer, InsideOutGridLooksTheSame) {
  // Mirrored cells run the other way round: VTK's files have both.
  IrregularGrid grid = makeWarpedGrid(CubeParts::kHexahedra, 3, 0.2F, kSeed);
  Scene scene(drawnGrid(grid), makeHaze());
  const Camera camera = perspectiveCamera(32, 24);
  const Frame right = scene.draw(camera, unlit());
  for (std::size_t cell = 0; cell < grid.cellCount(); ++cell)
    std::swap_ranges(&grid.connectivity[8 * cell], &grid.connectivity[8 * cell + 4], &grid.connectivity[8 * cell + 4]);
  Scene inside_out(drawnGrid(grid), makeHaze());
  const Frame turned = inside_out.draw(camera, unlit());
  for (std::size_t i = 0; i < right.rgba.size(); ++i)
    EXPECT_NEAR(right.rgba[i], turned.rgba[i], 2e-5);
}

TEST(ExactTracer, RaysThroughEdgesAndVerticesMissNothing) {
  // Every second pixel's ray runs along edges of this grid, and through the corners of many of its cells.
  for (const CubeParts parts : {CubeParts::kHexahedra, CubeParts::kTetrahedra, CubeParts::kPyramids}) {
    IrregularGrid grid = makeWarpedGrid(parts, 8, 0.0F, kSeed);
    grid.point_scalars.assign(grid.vertexCount(), 0.5F);
    Scene scene(drawnGrid(grid), makeFog(0.1F));
    Camera camera = straightCamera({0.0, 0.0, -20.0}, 15, 15);
    camera.far_m = 100.0;
    camera.projection = Projection::kParallel;
    camera.fx = camera.fy = 2.0;
    const Frame frame = scene.draw(camera, unlit());
    for (int v = 0; v < 15; ++v) {
      for (int u = 0; u < 15; ++u)
        EXPECT_NEAR(pixelOf(frame, u, v)[3], 1.0 - std::pow(1.0 - 0.1F, 8.0), 1e-5) << u << ' ' << v;
    }
  }
}

TEST(ExactTracer, NonConvexPolyhedronIsFilledOnce) {
  // An L of three unit cubes in the plane of the image, as one polyhedron; the mean of its vertices lies in it but does
  // not see all of its faces.
  CellGrid cells;
  const std::array<std::array<float, 2>, 6> outline = {{{0, 0}, {2, 0}, {2, 1}, {1, 1}, {1, 2}, {0, 2}}};
  Faces faces(2);
  for (const float z : {-0.5F, 0.5F}) {
    for (const auto& [x, y] : outline)
      cells.addPoint({x - 1.0F, y - 1.0F, z});
  }
  for (std::uint32_t i = 0; i < 6; ++i) {
    faces[0].push_back(5 - i);
    faces[1].push_back(6 + i);
    faces.push_back({i, (i + 1) % 6, (i + 1) % 6 + 6, i + 6});
  }
  addPolyhedron(cells, faces);
  IrregularGrid grid;
  grid.points = cells.points;
  grid.cell_types = cells.types;
  grid.cell_offsets = cells.offsets;
  grid.connectivity = cells.connectivity;
  grid.point_scalars.assign(12, 0.5F);
  Scene scene(drawnGrid(grid), makeFog(0.4F));
  const Camera camera = lookAlongZ(Projection::kParallel, 4.0);
  const Frame frame = scene.draw(camera, unlit());
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      const double x = (u - camera.cx) / camera.fx;
      const double y = (v - camera.cy) / camera.fy;
      const bool inside = std::abs(x) < 1.0 && std::abs(y) < 1.0 && (x < 0.0 || y < 0.0);
      EXPECT_NEAR(pixelOf(frame, u, v)[3], inside ? 0.4 : 0.0, 1e-5) << u << ' ' << v;
    }
  }
}

TEST(ExactTracer, LabelsLieAtTheDepth) {
  const auto volume = makeVolume(Vector3i(4, 4, 4), Vector3::Constant(2.0), [](const Vector3&) { return 0.5; });
  // Layers along z: 0 in front, then 1, 2, 3.
  const auto labels =
      makeVolume(Vector3i(1, 1, 4), Vector3::Constant(2.0), [](const Vector3& t) { return std::floor(4.0 * t.z()); });
  const Topology topology = makeBlock(Box3(Vector3::Constant(-1.0), Vector3::Constant(1.0)), Vector3i(2, 2, 2));
  Scene scene(drawnGrid(topology), makeFog(0.9F));
  scene.tracer.setVolume(*volume);
  scene.tracer.setLabels(labels.get());
  const Camera camera = lookAlongZ(Projection::kParallel, 4.0);
  RenderOptions options = unlit();
  options.labels = true;
  for (const auto& [way, label] : {std::pair(0.25, 0), {0.75, 1}, {1.25, 2}, {1.75, 3}}) {
    options.depth_threshold = 1.0 - std::pow(1.0 - 0.9F, way);
    const Frame frame = scene.draw(camera, options);
    const std::size_t centre = 9 * 24 + 12;
    EXPECT_NEAR(frame.depth_m[centre], 3.0 + way, 1e-5);
    EXPECT_EQ(frame.labels[centre], label);
    EXPECT_EQ(frame.labels[0], 0);
  }
}

TEST(ExactTracer, LightFollowsTheGradient) {
  // A plane ramp: its gradient is the same everywhere, so is the light.
  IrregularGrid grid = makeWarpedGrid(CubeParts::kHexahedra, 2, 0.0F, kSeed);
  const Vector3f direction = Vector3f(0.3F, -0.5F, -1.0F).normalized();
  for (std::size_t i = 0; i < grid.points.size(); ++i)
    grid.point_scalars[i] = 0.5F + 0.2F * direction.dot(grid.points[i]);
  TransferFunction fog = makeFog(0.4F);
  for (auto& point : fog.points)
    point.colour = Vector3f::Constant(0.5F);
  Scene scene(drawnGrid(grid), fog);
  RenderOptions options = unlit();
  options.shading = 0.6;
  options.specular = 0.3;
  const Camera camera = lookAlongZ(Projection::kParallel, 4.0);
  const Frame frame = scene.draw(camera, options);
  const double step = shadingStep(scene.grid, nullptr);
  const double strength = std::min(1.0, 0.2 * step * kEdgesPerRange);
  const double diffuse = kAmbient + kDiffuse * std::abs(direction.dot(lightDirection()));
  const double gloss = std::pow(std::abs(direction.dot(highlightDirection())), kShininess);
  const double brightness = 0.4 + 0.6 * (kMeanLight + strength * (diffuse - kMeanLight));
  const double wanted = 0.5 * brightness + 0.6 * 0.3 * strength * gloss;
  const float* pixel = pixelOf(frame, 12, 9);
  EXPECT_NEAR(pixel[0] / pixel[3], wanted, 1e-4);
  EXPECT_NE(wanted, 0.5);
}

}  // namespace
}  // namespace soft_volume::core
