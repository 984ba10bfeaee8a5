#include "native_canvas.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <random>

#include "render/canvas_scene.h"
#include "render/kinds_of_scenes.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 19970521;
constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kEpsilon = std::numeric_limits<float>::epsilon();

std::vector<const NativeKernel*> allKernels() {
  std::vector<const NativeKernel*> kernels = {&portableNativeKernel()};
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") != 0)
    kernels.push_back(&avx2NativeKernel());
#endif
  return kernels;
}

// --- Filling polygons

/// The samples of one tile whose first pixel is (x, y).
class SampleTile {
 public:
  SampleTile(int x, int y) : x_(x), y_(y) {
    samples_.assign(std::size_t(kMaxAttributes) * kPlaneSamples, kNaN);
    for (std::size_t n = 0; n < kMaxAttributes; ++n)
      target_.sample[n] = samples_.data() + n * kPlaneSamples;
    target_.first_x = x - kPixelLanes;
    target_.first_y = y - kApron;
    target_.begin_x = x;
    target_.end_x = x + kTileWidth;
    target_.begin_y = y;
    target_.end_y = y + kTileHeight;
  }

  void fill(const NativeKernel& kernel, const std::vector<FillCorner>& corners, int attributes,
            const float* trilinear = nullptr) {
    crossings_.resize(corners.size() * kSampleRows);
    kernel.fill(target_, corners.data(), int(corners.size()), attributes, trilinear, crossings_.data());
  }
  /// Of a pixel of the image; NaN where nothing was drawn.
  float at(int x, int y, int attribute = 0) const {
    const std::size_t place = std::size_t(y - target_.first_y) * kSampleStride + std::size_t(x - target_.first_x);
    return samples_[std::size_t(attribute) * kPlaneSamples + place];
  }
  template <typename Visit>
  void forEachPixel(const Visit& visit) const {
    for (int y = y_; y < y_ + kTileHeight; ++y) {
      for (int x = x_; x < x_ + kTileWidth; ++x)
        visit(x, y);
    }
  }
  const std::vector<float>& samples() const { return samples_; }

 private:
  int x_, y_;
  FillTarget target_{};
  std::vector<float> samples_;
  std::vector<Crossing> crossings_;
};

FillCorner corner(float x, float y, float value = 1.0F) {
  return {x, y, {value, 2.0F * value, -value, x, y}};
}

using Outline = std::vector<FillCorner>;

/// A rectangle in parts that fill it without gaps: cells of a bent mesh, single, in pairs (six corners, not convex) or
/// as two triangles. Some of the vertices lie on pixel centres.
std::vector<Outline> makeSubdivision(float x0, float y0, float x1, float y1, int side, std::mt19937& random) {
  std::uniform_real_distribution<float> offset(-0.2F, 0.2F);             // less than a quarter turns no triangle over
  const bool rounds = std::min(x1 - x0, y1 - y0) > 10.0F * float(side);  // so that half a pixel more does not either
  const auto count = std::size_t(side) + 1;
  std::vector<FillCorner> vertices;
  for (int j = 0; j <= side; ++j) {
    for (int i = 0; i <= side; ++i) {
      const bool inner_x = i > 0 && i < side;
      const bool inner_y = j > 0 && j < side;
      float x = i == side ? x1 : x0 + (x1 - x0) / float(side) * (float(i) + (inner_x ? offset(random) : 0.0F));
      float y = j == side ? y1 : y0 + (y1 - y0) / float(side) * (float(j) + (inner_y ? offset(random) : 0.0F));
      if (rounds && inner_x && inner_y && random() % 3 == 0)
        x = std::round(x), y = std::round(y);
      vertices.push_back(corner(x, y));
    }
  }
  const auto at = [&](int i, int j) { return vertices[std::size_t(i) + std::size_t(j) * count]; };
  std::vector<Outline> parts;
  for (int j = 0; j < side; ++j) {
    for (int i = 0; i < side; ++i) {
      if (i + 1 < side && random() % 3 == 0) {
        parts.push_back({at(i, j), at(i + 1, j), at(i + 2, j), at(i + 2, j + 1), at(i + 1, j + 1), at(i, j + 1)});
        ++i;
      } else if (random() % 2 == 0) {
        parts.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)});
      } else {
        parts.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
        parts.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
      }
    }
  }
  return parts;
}

TEST(NativeFill, PartsOfARectangleCoverEveryPixelOnce) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> low(-20.0F, 20.0F);
  std::uniform_real_distribution<float> high(30.0F, 80.0F);
  for (int round = 0; round < 60; ++round) {
    // Every third outline lies on pixel centres: its left and upper sides belong to it, the others do not.
    const auto place = [&](float x) { return round % 3 == 0 ? std::round(x) : x; };
    const float x0 = place(low(random)), y0 = place(low(random)), x1 = place(high(random)), y1 = place(high(random));
    const std::vector<Outline> parts = makeSubdivision(x0, y0, x1, y1, 2 + int(random() % 12), random);
    for (const NativeKernel* kernel : allKernels()) {
      SampleTile whole(0, 0);
      std::vector<int> covered(kTilePixels, 0);
      for (const Outline& part : parts) {
        SampleTile tile(0, 0);
        tile.fill(*kernel, part, 1);
        tile.forEachPixel(
            [&](int x, int y) { covered[std::size_t(y * kTileWidth + x)] += !std::isnan(tile.at(x, y)); });
      }
      whole.forEachPixel([&](int x, int y) {
        const bool inside = float(x) >= x0 && float(x) < x1 && float(y) >= y0 && float(y) < y1;
        ASSERT_EQ(covered[std::size_t(y * kTileWidth + x)], int(inside))
            << "seed " << kSeed << " round " << round << " pixel " << x << ' ' << y;
      });
    }
  }
}

/// Whether a point is inside by the even-odd rule; nothing within `margin` of an edge.
std::optional<bool> isInside(const Outline& outline, double x, double y, double margin) {
  bool inside = false;
  for (std::size_t i = 0, before = outline.size() - 1; i < outline.size(); before = i++) {
    const Eigen::Vector2d a(outline[before].x, outline[before].y);
    const Eigen::Vector2d b(outline[i].x, outline[i].y);
    const Eigen::Vector2d p(x, y);
    const double t =
        (b - a).squaredNorm() > 0.0 ? std::clamp((p - a).dot(b - a) / (b - a).squaredNorm(), 0.0, 1.0) : 0.0;
    if ((a + t * (b - a) - p).norm() < margin)
      return std::nullopt;
    if ((a.y() <= y) != (b.y() <= y))
      inside = inside != (x < a.x() + (y - a.y()) / (b.y() - a.y()) * (b.x() - a.x()));
  }
  return inside;
}

TEST(NativeFill, OutlinesOfAnyShapeAreFilledEvenOdd) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> x(-30.0F, 100.0F);
  std::uniform_real_distribution<float> y(-20.0F, 60.0F);
  int inner = 0;
  for (int round = 0; round < 100; ++round) {
    Outline outline;
    for (std::size_t i = 0; i < 3 + std::size_t(round) % 12; ++i)
      outline.push_back(corner(x(random), y(random)));  // crosses itself
    for (const NativeKernel* kernel : allKernels()) {
      SampleTile tile(0, 0);
      tile.fill(*kernel, outline, 1);
      tile.forEachPixel([&](int px, int py) {
        // Crossings are rounded to float: 100 pixels times some 1e-7, enlarged where an edge is nearly level.
        const std::optional<bool> wanted = isInside(outline, px, py, 1e-3);
        if (!wanted)
          return;
        inner += int(*wanted);
        ASSERT_EQ(!std::isnan(tile.at(px, py)), *wanted)
            << "seed " << kSeed << " round " << round << ' ' << px << ' ' << py;
      });
    }
  }
  EXPECT_GT(inner, 10000);
}

TEST(NativeFill, TwoLoopsInOneOutlineLeaveAHole) {
  // A square with a square hole; the way from one to the other is walked twice and so belongs to neither side.
  const Outline outline = {corner(4.5F, 4.5F),   corner(40.5F, 4.5F),  corner(40.5F, 28.5F), corner(4.5F, 28.5F),
                           corner(4.5F, 4.5F),   corner(12.5F, 10.5F), corner(12.5F, 20.5F), corner(30.5F, 20.5F),
                           corner(30.5F, 10.5F), corner(12.5F, 10.5F)};
  for (const NativeKernel* kernel : allKernels()) {
    SampleTile tile(0, 0);
    tile.fill(*kernel, outline, 1);
    tile.forEachPixel([&](int x, int y) {
      const bool outer = x > 4 && x < 41 && y > 4 && y < 29;
      const bool hole = x > 12 && x < 31 && y > 10 && y < 21;
      EXPECT_EQ(!std::isnan(tile.at(x, y)), outer && !hole) << x << ' ' << y;
    });
  }
}

TEST(NativeFill, AffineValuesStayAffine) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> unit(-1.0F, 1.0F);
  for (int round = 0; round < 40; ++round) {
    const float c0 = unit(random), cx = 0.1F * unit(random), cy = 0.1F * unit(random);
    const auto value = [&](double x, double y) { return double(c0) + double(cx) * x + double(cy) * y; };
    for (Outline part : makeSubdivision(-9.7F, -5.2F, 71.3F, 40.9F, 6, random)) {
      for (FillCorner& c : part)
        c.value[0] = float(value(c.x, c.y));
      for (const NativeKernel* kernel : allKernels()) {
        SampleTile tile(0, 0);
        tile.fill(*kernel, part, 5);
        tile.forEachPixel([&](int x, int y) {
          if (std::isnan(tile.at(x, y)))
            return;
          // Values and places are rounded some ten times on the way: |value| < 15, |x|, |y| < 81.
          EXPECT_NEAR(tile.at(x, y), value(x, y), 10 * kEpsilon * 15) << "seed " << kSeed << ' ' << x << ' ' << y;
          EXPECT_NEAR(tile.at(x, y, 3), x, 10 * kEpsilon * 81);
          EXPECT_NEAR(tile.at(x, y, 4), y, 10 * kEpsilon * 81);
        });
      }
    }
  }
}

TEST(NativeFill, TrilinearPolynomialIsThatOfThePlaces) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> unit(0.0F, 1.0F);
  std::array<float, 8> c{};
  for (float& x : c)
    x = unit(random);
  Outline outline;
  for (const auto& [x, y] : {std::pair(2.3F, 1.7F), {55.1F, 4.2F}, {60.9F, 29.4F}, {20.2F, 30.8F}}) {
    FillCorner at{x, y, {x / 64.0F, y / 32.0F, (x + 2.0F * y) / 128.0F, 0.0F, 0.0F}};
    outline.push_back(at);
  }
  for (const NativeKernel* kernel : allKernels()) {
    SampleTile tile(0, 0);
    tile.fill(*kernel, outline, 3, c.data());
    int filled = 0;
    tile.forEachPixel([&](int x, int y) {
      if (std::isnan(tile.at(x, y)))
        return;
      const double u = x / 64.0, v = y / 32.0, w = (x + 2.0 * y) / 128.0;
      const double wanted =
          c[0] + c[1] * u + c[2] * v + c[3] * w + c[4] * u * v + c[5] * u * w + c[6] * v * w + c[7] * u * v * w;
      EXPECT_NEAR(tile.at(x, y), wanted, 20 * kEpsilon * 8);  // eight terms below 1, each rounded a few times
      ++filled;
    });
    EXPECT_GT(filled, 900);
  }
}

TEST(NativeFill, KernelsAndTilesGiveTheSameBits) {
  std::mt19937 random(kSeed);
  std::uniform_real_distribution<float> x(-60.0F, 200.0F);
  std::uniform_real_distribution<float> y(-40.0F, 90.0F);
  std::array<float, 8> c{};
  for (float& n : c)
    n = x(random);
  for (int round = 0; round < 50; ++round) {
    Outline outline;
    for (std::size_t i = 0; i < 3 + std::size_t(round) % 6; ++i)
      outline.push_back(corner(x(random), y(random), x(random)));
    for (int attributes = 1; attributes <= 6; ++attributes) {
      const float* trilinear = attributes == 6 ? c.data() : nullptr;
      const int count = attributes == 6 ? 3 : attributes;
      SampleTile tile(64, 32);
      tile.fill(portableNativeKernel(), outline, count, trilinear);
      for (const NativeKernel* kernel : allKernels()) {
        SampleTile same(64, 32);
        same.fill(*kernel, outline, count, trilinear);
        EXPECT_TRUE(sameBits(same.samples(), tile.samples())) << "seed " << kSeed << " round " << round;
      }
      SampleTile shifted(64 - 13, 32 - 9);
      shifted.fill(portableNativeKernel(), outline, count, trilinear);
      tile.forEachPixel([&](int px, int py) {
        if (px >= 64 - 13 + kTileWidth || py >= 32 - 9 + kTileHeight)
          return;
        const float a = tile.at(px, py);
        const float b = shifted.at(px, py);
        ASSERT_EQ(std::memcmp(&a, &b, sizeof(a)), 0) << "where a tile begins changed a sample";
      });
    }
  }
}

// --- Drawing slices

struct NamedOptions {
  const char* name;
  RenderOptions options;
};

/// One option after the other, then all together.
std::vector<NamedOptions> optionsFor(Kind kind) {
  RenderOptions plain;
  plain.slices = 37;
  plain.shading = 0.0;
  plain.threads = 1;
  plain.lookup = kind == Kind::kColour ? Lookup::kColour : Lookup::kScalar;
  std::vector<NamedOptions> all(8, {"plain", plain});
  all[1].name = "shaded";
  all[1].options.shading = 0.7;
  all[2].name = "depth";
  all[2].options.depth = true;
  all[2].options.labels = kind == Kind::kTexture;
  all[3].name = "clipped";
  all[3].options.clip_planes = {{Vector3(1.0, 2.0, -1.0).normalized(), 0.6}, {-Vector3::UnitX(), 1.1}};
  all[4].name = "jitter";
  all[4].options.jitter = true;
  all[5].name = "exact boundary";
  all[5].options.exact_boundary = true;
  all[6].name = "adaptive";
  all[6].options.slices = 3;
  all[6].options.adaptive = true;
  RenderOptions& together = all[7].options;
  all[7].name = "all";
  together = all[3].options;
  together.shading = 1.0;
  together.depth = together.jitter = together.exact_boundary = together.adaptive = true;
  together.labels = kind == Kind::kTexture;
  return all;
}

/// Voxels of a tenth of the grid's metre.
std::shared_ptr<const Volume> makeFineVolume() {
  return makeVolume(Vector3i(41, 33, 27), Vector3::Constant(4.0), [](const Vector3& t) {
    return 0.5 + 0.3 * std::sin(9.0 * t.x()) * std::cos(27.0 * t.y()) + 0.2 * std::sin(31.0 * t.z() + 4.0 * t.x());
  });
}

/// Pixels are wider than voxels in all of the grid under parallel projection, else in its rear part.
Camera cameraFromAfar(Projection projection) {
  Camera camera = obliqueCamera(projection, 150, 70);
  const double zoom = projection == Projection::kParallel ? 0.5 : 0.65;
  camera.fx *= zoom;
  camera.fy *= zoom;
  return camera;
}

struct NativeScene : CanvasScene {
  NativeScene(const NativeKernel& kernel, Kind kind)
      : CanvasScene(std::make_unique<NativeCanvas>(kernel), gridOf(kind), makePeaks()) {
    std::mt19937 random(kSeed);
    positions = jittered(rest(), kind == Kind::kTexture ? 0.2F : 0.0F, random);
    if (kind != Kind::kTexture)
      return;
    setVolume(makeFineVolume());
    setLabels(makeManyLabels());
  }
  static DrawnGrid gridOf(Kind kind) {
    return kind == Kind::kTexture ? drawnGrid(makeLatticeOfKind(4)) : drawnGrid(makeGridOfKind(kind, kSeed));
  }
  Frame draw(const Camera& camera, const RenderOptions& options) { return render(camera, positions, options); }

  std::vector<Vector3f> positions;
};

class NativeKinds : public testing::TestWithParam<Kind> {
 protected:
  /// Calls visit(camera, options) for both projections and all options, for volumes from afar too.
  template <typename Visit>
  void forEachView(const Visit& visit) {
    for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
      for (const NamedOptions& named : optionsFor(GetParam())) {
        SCOPED_TRACE(std::string(named.name) + (projection == Projection::kParallel ? ", parallel" : ", perspective"));
        visit(obliqueCamera(projection, 150, 70), named.options);
        if (GetParam() != Kind::kTexture)
          continue;
        SCOPED_TRACE("from afar");
        visit(cameraFromAfar(projection), named.options);
      }
    }
  }
};

TEST_P(NativeKinds, KernelsGiveTheSameBits) {
  if (allKernels().size() < 2)
    GTEST_SKIP() << "the processor has no AVX2";
  NativeScene portable(*allKernels()[0], GetParam());
  NativeScene fast(*allKernels()[1], GetParam());
  forEachView([&](const Camera& camera, const RenderOptions& options) {
    const Frame wanted = portable.draw(camera, options);
    const Frame frame = fast.draw(camera, options);
    EXPECT_TRUE(showsSomething(wanted));
    EXPECT_TRUE(sameFrames(frame, wanted));
    EXPECT_EQ(frame.fragments, wanted.fragments);
  });
}

TEST_P(NativeKinds, ThreadsChangeNoBit) {
  NativeScene scene(bestNativeKernel(), GetParam());
  forEachView([&](const Camera& camera, RenderOptions options) {
    const Frame wanted = scene.draw(camera, options);
    for (const int threads : {1, 2, 3, 8}) {
      options.threads = threads;
      const Frame frame = scene.draw(camera, options);
      EXPECT_TRUE(sameFrames(frame, wanted)) << threads << " threads";
      EXPECT_EQ(frame.fragments, wanted.fragments);
      EXPECT_EQ(frame.polygons, wanted.polygons);
    }
  });
}

TEST_P(NativeKinds, RunsOfPlanesAndRectanglesChangeNoBit) {
  NativeScene scene(bestNativeKernel(), GetParam());
  std::mt19937 random(kSeed);
  forEachView([&](const Camera& camera, const RenderOptions& options) {
    const Frame wanted = scene.draw(camera, options);
    for (const int run : {1, 5, 16, 20}) {
      Frame frame = CanvasScene::blankFrame(camera, options);
      scene.renderInto(frame, camera, scene.positions, options, wholeImage(camera), run);
      EXPECT_TRUE(sameFrames(frame, wanted)) << "runs of " << run;
      EXPECT_EQ(frame.polygons, wanted.polygons);
    }
    // The image in four rectangles around a random pixel.
    const int x = 1 + int(random() % unsigned(camera.width - 1));
    const int y = 1 + int(random() % unsigned(camera.height - 1));
    Frame frame = CanvasScene::blankFrame(camera, options);
    for (const PixelRect& rect : {PixelRect{0, 0, x, y}, PixelRect{x, 0, camera.width, y},
                                  PixelRect{0, y, x, camera.height}, PixelRect{x, y, camera.width, camera.height}})
      scene.renderInto(frame, camera, scene.positions, options, rect);
    EXPECT_TRUE(sameFrames(frame, wanted)) << "rectangles around " << x << ' ' << y << ", seed " << kSeed;
  });
}

TEST_P(NativeKinds, OneRectangleLeavesTheOthersAlone) {
  NativeScene scene(bestNativeKernel(), GetParam());
  forEachView([&](const Camera& camera, const RenderOptions& options) {
    Frame frame = CanvasScene::blankFrame(camera, options);
    std::fill(frame.rgba.begin(), frame.rgba.end(), -7.0F);
    scene.renderInto(frame, camera, scene.positions, options, {61, 30, 103, 37});
    for (int v = 0; v < camera.height; ++v) {
      for (int u = 0; u < camera.width; ++u) {
        const bool drawn = u >= 61 && u < 103 && v >= 30 && v < 37;
        ASSERT_EQ(pixelOf(frame, u, v)[3] != -7.0F, drawn) << u << ' ' << v;
      }
    }
  });
}

TEST_P(NativeKinds, FramesDoNotDependOnEarlierOnes) {
  NativeScene scene(bestNativeKernel(), GetParam());
  forEachView([&](const Camera& camera, const RenderOptions& options) {
    NativeScene fresh(bestNativeKernel(), GetParam());
    EXPECT_TRUE(sameFrames(scene.draw(camera, options), fresh.draw(camera, options)));
  });
}

/// With depth every plane goes the long way; without, those where nothing special happens go a short one.
TEST_P(NativeKinds, DepthChangesNoColour) {
  NativeScene scene(bestNativeKernel(), GetParam());
  forEachView([&](const Camera& camera, RenderOptions options) {
    for (const int slices : {options.slices, 3 * options.slices}) {
      options.slices = slices;
      options.depth = options.labels = false;
      const Frame plain = scene.draw(camera, options);
      options.depth = true;
      EXPECT_TRUE(sameBits(scene.draw(camera, options).rgba, plain.rgba)) << slices << " slices";
    }
  });
}

TEST_P(NativeKinds, EveryPixelIsFinite) {
  NativeScene scene(bestNativeKernel(), GetParam());
  forEachView([&](const Camera& camera, const RenderOptions& options) {
    for (const float value : scene.draw(camera, options).rgba)
      ASSERT_TRUE(value >= 0.0F && value <= 1.0F) << value;
  });
}

INSTANTIATE_TEST_SUITE_P(AllKinds, NativeKinds,
                         testing::Values(Kind::kScalar, Kind::kColour, Kind::kCells, Kind::kTexture),
                         [](const auto& info) { return nameOf(info.param); });

// --- Minification

/// Voxels are 1 and 0 in turn along every axis.
std::shared_ptr<const Volume> makeCheckers(const Vector3i& dims, const Vector3& size_m) {
  return makeVolume(dims, size_m, [&](const Vector3& t) {
    const Vector3i voxel = t.cwiseProduct(dims.cast<double>()).cast<int>();
    return double(voxel.sum() % 2);
  });
}

template <typename Scalar>
std::vector<std::uint8_t> wavesAs(const Vector3i& dims) {
  std::vector<Scalar> scalars;
  for (int i = 0; i < dims.prod(); ++i)
    scalars.push_back(Scalar(std::round(50.0 + 45.0 * std::sin(0.37 * i) * std::cos(0.011 * i))));
  std::vector<std::uint8_t> data(scalars.size() * sizeof(Scalar));
  std::memcpy(data.data(), scalars.data(), data.size());
  return data;
}

/// Whole numbers from 5 to 95.
std::shared_ptr<const Volume> makeWaves(const Vector3i& dims, ScalarType type) {
  VolumeGeometry geometry;
  geometry.dims = dims;
  geometry.spacing_m = Vector3::Constant(1.0 / 64.0);
  std::vector<std::uint8_t> data = type == ScalarType::kFloat32  ? wavesAs<float>(dims)
                                   : type == ScalarType::kInt16  ? wavesAs<std::int16_t>(dims)
                                   : type == ScalarType::kUInt16 ? wavesAs<std::uint16_t>(dims)
                                                                 : wavesAs<std::uint8_t>(dims);
  return std::make_shared<const Volume>(geometry, type, std::move(data));
}

/// Opaque, grey from black at 0 to white at `white`.
TransferFunction makeGreys(double white) {
  TransferFunction function;
  function.points = {{0.0, Vector3f::Zero(), 1.0F}, {white, Vector3f::Ones(), 1.0F}};
  function.unit_distance_m = 1e-4;
  return function;
}

/// A sheet of 256 x 256 x 16 voxels, 1 m wide, opaque in the grey of its scalar.
struct Checkers : CanvasScene {
  Checkers()
      : CanvasScene(std::make_unique<NativeCanvas>(), makeBlock(kBox, Vector3i(8, 8, 1)),
                    makeCheckers(Vector3i(256, 256, 16), kBox.sizes()), makeGreys(1.0)) {}
  Frame draw(const Camera& camera) {
    RenderOptions options;
    options.slices = 20;
    options.shading = 0.0;
    return render(camera, options);
  }

  inline static const Box3 kBox{Vector3(-0.5, -0.5, 0.9), Vector3(0.5, 0.5, 1.1)};
};

/// Of `pixels_per_m` at 1 m, the middle of the image moved by a part of a pixel.
Camera cameraOverCheckers(Projection projection, double pixels_per_m, double shift) {
  Camera camera = straightCamera(Vector3::Zero(), 64, 48, pixels_per_m);
  camera.projection = projection;
  camera.cx += shift;
  return camera;
}

TEST(NativeMipmap, VolumesSeenFromAfarAreAveraged) {
  Checkers scene;
  for (const Projection projection : {Projection::kPerspective, Projection::kParallel}) {
    for (const double pixels_per_m : {32.0, 50.0}) {  // 8 and 5.1 voxels a pixel
      for (const double shift : {0.0, 0.3, 0.7}) {
        const Frame frame = scene.draw(cameraOverCheckers(projection, pixels_per_m, shift));
        for (int v = 10; v < 38; ++v) {
          for (int u = 19; u < 45; ++u)
            ASSERT_NEAR(pixelOf(frame, u, v)[0] / pixelOf(frame, u, v)[3], 0.5, 0.01) << u << ' ' << v;
        }
      }
    }
  }
}

/// Darkest and lightest pixel of the image's middle.
std::array<float, 2> contrastOf(const Frame& frame) {
  std::array<float, 2> range = {1.0F, 0.0F};
  for (int v = 12; v < 36; ++v) {
    for (int u = 12; u < 52; ++u) {
      range[0] = std::min(range[0], pixelOf(frame, u, v)[0]);
      range[1] = std::max(range[1], pixelOf(frame, u, v)[0]);
    }
  }
  return range;
}

TEST(NativeMipmap, NearViewsStaySharpAlsoAfterOnesFromAfar) {
  Checkers scene;
  const Camera near = cameraOverCheckers(Projection::kParallel, 1024.0, 0.0);  // four pixels a voxel
  const Frame before = scene.draw(near);
  EXPECT_LT(contrastOf(before)[0], 0.3F);
  EXPECT_GT(contrastOf(before)[1], 0.7F);
  scene.draw(cameraOverCheckers(Projection::kParallel, 32.0, 0.0));
  EXPECT_TRUE(sameFrames(scene.draw(near), before));
}

TEST(NativeMipmap, ANewVolumeHasItsOwnMipmap) {
  Checkers scene;
  const Camera camera = cameraOverCheckers(Projection::kParallel, 32.0, 0.0);
  scene.draw(camera);
  scene.setVolume(makeVolume(Vector3i(256, 256, 1), Checkers::kBox.sizes(),
                             [](const Vector3& t) { return t.x() > 0.5 ? 0.8 : 0.2; }));
  const Frame frame = scene.draw(camera);
  EXPECT_NEAR(pixelOf(frame, 22, 24)[0], 0.2, 0.01);
  EXPECT_NEAR(pixelOf(frame, 42, 24)[0], 0.8, 0.01);
}

TEST(NativeMipmap, IntegersAreAveragedAsFloatsAre) {
  const Vector3i dims(64, 48, 32);
  const Camera camera = cameraOverCheckers(Projection::kPerspective, 20.0, 0.3);
  std::vector<Frame> frames;
  for (const ScalarType type : {ScalarType::kFloat32, ScalarType::kInt16, ScalarType::kUInt16, ScalarType::kUInt8}) {
    CanvasScene scene(std::make_unique<NativeCanvas>(), makeBlock(Checkers::kBox, Vector3i(4, 4, 1)),
                      makeWaves(dims, type), makeGreys(100.0));
    RenderOptions options;
    options.slices = 20;
    options.shading = 0.0;
    frames.push_back(scene.render(camera, options));
    ASSERT_TRUE(showsSomething(frames.back()));
    for (std::size_t i = 0; i < frames[0].rgba.size(); ++i)
      ASSERT_NEAR(frames.back().rgba[i], frames[0].rgba[i], 0.01F) << "each level rounds by half of a hundredth";
  }
}

}  // namespace
}  // namespace soft_volume::core
