#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <random>
#include <string>

#include "render/kinds_of_scenes.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 19970521;

std::string nameOf(Backend backend) {
  const std::array<const char*, 3> names = {"gl", "native", "exact"};
  return names[std::size_t(backend)];
}

/// Two renderers of one scene: one draws what changed, the other everything.
struct Pair {
  Pair(Backend backend, Kind kind) : changes(backend), all(backend) {
    if (kind == Kind::kTexture) {
      const Topology lattice = makeLatticeOfKind(5);
      rest = lattice.rest_positions;
      set([&](Renderer& r) { r.setTopology(lattice); });
      set([volume = makeWavyVolume()](Renderer& r) { r.setVolume(volume); });
      set([labels = makeManyLabels()](Renderer& r) { r.setLabels(labels); });
    } else {
      const IrregularGrid grid = makeGridOfKind(kind, kSeed);
      rest = grid.points;
      set([&](Renderer& r) { r.setGrid(grid); });
    }
    set([](Renderer& r) { r.setTransferFunction(makePeaks()); });
    options.slices = 29;
    options.shading = 0.0;
    options.threads = 2;
    options.lookup = kind == Kind::kColour ? Lookup::kColour : Lookup::kScalar;
  }

  template <typename Call>
  void set(const Call& call) {
    call(changes);
    call(all);
  }
  /// The frame that only draws changes, after comparing it with the other one.
  const Frame& expectEqualFrames(const Camera& camera, const std::vector<Vector3f>& positions,
                                 const std::string& what) {
    all.forgetFrame();
    const Frame& wanted = all.render(camera, positions, options);
    const Frame& frame = changes.render(camera, positions, options);
    EXPECT_EQ(wanted.updated.pixels(), wanted.rgba.size() / 4);
    EXPECT_TRUE(sameFrames(frame, wanted)) << what << ", seed " << kSeed;
    return frame;
  }

  Renderer changes;
  Renderer all;
  std::vector<Vector3f> rest;
  RenderOptions options;
};

/// Moves the vertices within 1.2 m of a random one by up to half a metre.
void pokeSomewhere(std::vector<Vector3f>& positions, std::mt19937& random) {
  std::uniform_real_distribution<float> offset(-0.3F, 0.3F);
  const Vector3f centre = positions[random() % positions.size()];
  const Vector3f move(offset(random), offset(random), offset(random));
  for (Vector3f& p : positions)
    p += move * std::max(0.0F, 1.0F - (p - centre).norm() / 1.2F);
}

struct Case {
  Backend backend;
  Kind kind;
};

class Changes : public testing::TestWithParam<Case> {
 protected:
  bool isTexture() const { return GetParam().kind == Kind::kTexture; }
  bool isExact() const { return GetParam().backend == Backend::kExact; }
  /// More than two of native's tiles each way; exact takes its time for every pixel.
  int width() const { return isExact() ? 60 : 150; }
  int height() const { return isExact() ? 28 : 70; }
  /// A walk of random pokes.
  void walk(const std::string& name, Projection projection, const std::function<void(RenderOptions&)>& change) {
    SCOPED_TRACE(name);
    Pair pair(GetParam().backend, GetParam().kind);
    change(pair.options);
    std::mt19937 random(kSeed);
    std::vector<Vector3f> positions = pair.rest;
    std::size_t drawn = 0;
    bool shows = false;
    const int frames = isExact() ? 4 : 20;
    for (int frame = 0; frame < frames; ++frame) {
      const Frame& f =
          pair.expectEqualFrames(obliqueCamera(projection, width(), height()), positions, std::to_string(frame));
      shows = showsSomething(f);
      drawn += frame > 0 ? f.updated.pixels() : 0;
      pokeSomewhere(positions, random);
    }
    EXPECT_TRUE(shows);
    // Adaptive slicing draws all when its planes change, and they do nearly always.
    if (!pair.options.adaptive) {
      EXPECT_LT(drawn, std::size_t((frames - 1) * width() * height() * 2 / 3))
          << "small changes drew nearly everything";
    }
  }
};

TEST_P(Changes, DrawnByThemselvesGiveTheSameBits) {
  walk("plain", Projection::kPerspective, [](RenderOptions&) {});
  walk("plain, parallel", Projection::kParallel, [](RenderOptions&) {});
  walk("shaded", Projection::kPerspective, [](RenderOptions& o) { o.shading = 0.8; });
  if (isExact())
    return;  // knows neither slices nor their options
  walk("depth", Projection::kParallel, [&](RenderOptions& o) {
    o.depth = true;
    o.labels = isTexture();
  });
  walk("clipped, jitter", Projection::kPerspective, [](RenderOptions& o) {
    o.clip_planes = {{Vector3(1.0, 2.0, -1.0).normalized(), 0.6}};
    o.jitter = true;
  });
  walk("adaptive", Projection::kPerspective, [](RenderOptions& o) {
    o.slices = 4;
    o.adaptive = true;
  });
  if (GetParam().backend == Backend::kNative)
    walk("exact boundary", Projection::kPerspective, [](RenderOptions& o) { o.exact_boundary = true; });
  walk("all", Projection::kPerspective, [&](RenderOptions& o) {
    o.shading = 1.0;
    o.depth = o.jitter = o.adaptive = true;
    o.exact_boundary = GetParam().backend == Backend::kNative;
    o.labels = isTexture();
  });
}

/// Moves the vertices within `reach_m` of two random ones; the rest of the rectangle around both stays.
void pokeTwoPlaces(std::vector<Vector3f>& positions, float reach_m, std::mt19937& random) {
  const std::vector<Vector3f> before = positions;
  std::uniform_real_distribution<float> offset(-0.1F, 0.1F);
  for (int place = 0; place < 2; ++place) {
    const Vector3f centre = before[random() % before.size()];
    const Vector3f move(offset(random), offset(random), offset(random));
    for (std::size_t i = 0; i < before.size(); ++i) {
      if ((before[i] - centre).norm() < reach_m)
        positions[i] += move;
    }
  }
}

TEST_P(Changes, AtTwoPlacesGiveTheSameBits) {
  if (isExact())
    GTEST_SKIP() << "exact draws the whole rectangle";
  for (const unsigned seed : {1U, 20U, 300U, 4000U}) {
    Pair pair(GetParam().backend, GetParam().kind);
    pair.options.shading = seed % 3 == 0 ? 0.7 : 0.0;
    pair.options.depth = seed % 2 == 0;
    std::mt19937 random(seed);
    std::vector<Vector3f> positions = pair.rest;
    const Camera camera =
        obliqueCamera(seed < 100 ? Projection::kPerspective : Projection::kParallel, 2 * width(), 2 * height());
    for (int frame = 0; frame < 5; ++frame) {
      pair.expectEqualFrames(camera, positions, "pokes from seed " + std::to_string(seed));
      pokeTwoPlaces(positions, 0.1F, random);
    }
  }
}

/// Of two corners of the grid in opposite corners of the image, native draws little more than the corners.
TEST_P(Changes, FarFromEachOtherLeaveWhatLiesBetween) {
  if (GetParam().backend != Backend::kNative)
    GTEST_SKIP() << "others draw the whole rectangle";
  Pair pair(GetParam().backend, GetParam().kind);
  pair.set([](Renderer& r) {
    TransferFunction haze;
    haze.points = {{-100.0, Vector3f::Ones(), 0.02F}, {100.0, Vector3f::Ones(), 0.02F}};
    r.setTransferFunction(haze);
  });
  const Camera camera = obliqueCamera(Projection::kParallel, 2 * width(), 2 * height());
  const std::size_t whole = pair.expectEqualFrames(camera, pair.rest, "rest").fragments;
  std::vector<Vector3f> positions = pair.rest;
  positions.front() += Vector3f(0.05F, 0.05F, 0.05F);
  positions.back() -= Vector3f(0.05F, 0.05F, 0.05F);
  const Frame& frame = pair.expectEqualFrames(camera, positions, "two corners");
  EXPECT_GT(frame.fragments, 0U);
  EXPECT_GT(frame.updated.pixels(), std::size_t(camera.width * camera.height) / 10) << "the corners are not far apart";
  EXPECT_LT(frame.fragments, whole / 4);
}

TEST_P(Changes, NoneDrawNothing) {
  Pair pair(GetParam().backend, GetParam().kind);
  const Camera camera = obliqueCamera(Projection::kPerspective, width(), height());
  const std::vector<float> before = pair.changes.render(camera, pair.rest, pair.options).rgba;
  const Frame& frame = pair.changes.render(camera, pair.rest, pair.options);
  EXPECT_TRUE(frame.updated.empty());
  EXPECT_TRUE(sameBits(frame.rgba, before));
  pair.options.threads = 1;
  EXPECT_TRUE(pair.changes.render(camera, pair.rest, pair.options).updated.empty()) << "threads change no image";
  pair.changes.forgetFrame();
  EXPECT_EQ(pair.changes.render(camera, pair.rest, pair.options).updated.pixels(), std::size_t(width() * height()));
}

TEST_P(Changes, OfAnythingButPositionsDrawEverything) {
  Pair pair(GetParam().backend, GetParam().kind);
  Camera camera = obliqueCamera(Projection::kPerspective, width(), height());
  const auto expectAll = [&](const char* what) {
    const Frame& frame = pair.expectEqualFrames(camera, pair.rest, what);
    EXPECT_EQ(frame.updated.pixels(), std::size_t(width() * height())) << what;
  };
  expectAll("the first frame");
  camera.fx *= 1.1;
  expectAll("another focal length");
  camera.T_volume_camera.position_m.x() += 0.1;
  expectAll("another place");
  camera.width = width() - 8;
  pair.options.slices = 31;
  pair.expectEqualFrames(camera, pair.rest, "another size and number of slices");
  camera.width = width();
  expectAll("the size before");
  pair.options.depth = true;
  expectAll("depth");
  pair.options.clip_planes = {{Vector3::UnitX(), 0.3}};
  expectAll("a clip plane");
  pair.options.clip_planes[0].offset_m = 0.4;
  expectAll("the plane's offset");
  TransferFunction function = makePeaks();
  function.points[1].opacity = 0.2F;
  pair.set([&](Renderer& r) { r.setTransferFunction(function); });
  expectAll("another transfer function");
  if (!isTexture())
    return;
  const auto volume = makeVolume(Vector3i(9, 9, 9), Vector3::Constant(4.0), [](const Vector3& t) { return t.x(); });
  pair.set([&](Renderer& r) { r.setVolume(volume); });
  expectAll("another volume");
  pair.options.labels = true;
  expectAll("labels");
  pair.set([&](Renderer& r) { r.setLabels(volume); });
  expectAll("other labels");
}

TEST_P(Changes, OfTheNumberOfVerticesAreAnError) {
  Pair pair(GetParam().backend, GetParam().kind);
  const Camera camera = obliqueCamera(Projection::kPerspective, width(), height());
  pair.expectEqualFrames(camera, pair.rest, "before");
  std::vector<Vector3f> positions = pair.rest;
  positions.pop_back();
  EXPECT_ANY_THROW(pair.changes.render(camera, positions, pair.options));
  positions = pair.rest;
  positions[3].y() += 0.2F;
  pair.expectEqualFrames(camera, positions, "after");
}

TEST_P(Changes, ThroughTheCameraAndOutOfSight) {
  Pair pair(GetParam().backend, GetParam().kind);
  pair.options.depth = true;
  Camera camera = Camera::lookAt({0.1, 0.2, -1.6}, {0.4, 0.3, 3.0}, Vector3(0, -1, 0), 1.0, width(), height());
  camera.near_m = 0.05;
  std::mt19937 random(kSeed);
  std::vector<Vector3f> positions = pair.rest;
  for (int frame = 0; frame < 6; ++frame) {
    pair.expectEqualFrames(camera, positions, "inside " + std::to_string(frame));
    pokeSomewhere(positions, random);
  }
  for (const float z : {-3.0F, -5.0F, 0.0F, -20.0F, 0.5F}) {
    for (std::size_t i = 0; i < positions.size(); ++i)
      positions[i] = pair.rest[i] + Vector3f(0, 0, z);
    pair.expectEqualFrames(camera, positions, "moved by " + std::to_string(z));
  }
}

/// At most four times the planes at rest are drawn, from the front: a corner that is pulled towards the camera takes
/// them from what lies behind.
TEST_P(Changes, ThatPullTheGridFarDeeperThanItsPlanes) {
  Pair pair(GetParam().backend, GetParam().kind);
  pair.options.depth = true;
  pair.options.slices = 3;
  Camera camera = Camera::lookAtParallel({0, 0, -40.0}, Vector3::Zero(), Vector3(0, -1, 0), 5.0, width(), height());
  camera.far_m = 100.0;
  std::vector<Vector3f> positions = pair.rest;
  bool all_planes = true;
  for (int pull = 0; pull < 8; ++pull) {
    const Frame& frame = pair.expectEqualFrames(camera, positions, "pulled " + std::to_string(pull));
    all_planes = all_planes && frame.slices < 12;
    positions.front().z() -= 2.6F;
  }
  EXPECT_TRUE(isExact() || !all_planes);
}

TEST_P(Changes, OfAGridThatIsOutOfSightAtRest) {
  Pair pair(GetParam().backend, GetParam().kind);
  Camera camera = obliqueCamera(Projection::kPerspective, width(), height());
  camera.T_volume_camera.position_m = Vector3(0, 0, 0);
  camera.T_volume_camera.orientation = Eigen::Quaterniond::Identity();
  camera.far_m = 20.0;
  camera.near_m = 3.0;  // the grid ends at 2.2 m
  std::vector<Vector3f> positions = pair.rest;
  for (Vector3f& p : positions)
    p.z() += 6.0F;
  std::mt19937 random(kSeed);
  for (int frame = 0; frame < 8; ++frame) {
    pair.expectEqualFrames(camera, positions, std::to_string(frame));
    pokeSomewhere(positions, random);
  }
}

TEST_P(Changes, AfterLookingAtStoredSlicesAndCrossSections) {
  if (GetParam().backend == Backend::kExact)
    GTEST_SKIP() << "exact draws no slices";
  Pair pair(GetParam().backend, GetParam().kind);
  const Camera camera = obliqueCamera(Projection::kPerspective, width(), height());
  std::mt19937 random(kSeed);
  std::vector<Vector3f> positions = pair.rest;
  for (int frame = 0; frame < 4; ++frame) {
    pair.expectEqualFrames(camera, positions, std::to_string(frame));
    pokeSomewhere(positions, random);
    Camera other = camera;
    other.T_volume_camera.position_m.x() += 0.2;
    other.width = 40;
    if (frame % 2 == 0)
      pair.changes.renderStored(other);
    else
      pair.changes.renderCrossSection(other, 8.0);
  }
}

std::vector<Case> allCases() {
  std::vector<Case> cases;
  for (const Backend backend : {Backend::kGl, Backend::kNative, Backend::kExact}) {
    for (const Kind kind : {Kind::kScalar, Kind::kColour, Kind::kCells, Kind::kTexture})
      cases.push_back({backend, kind});
  }
  return cases;
}

INSTANTIATE_TEST_SUITE_P(AllBackends, Changes, testing::ValuesIn(allCases()),
                         [](const auto& info) { return nameOf(info.param.backend) + "_" + nameOf(info.param.kind); });

}  // namespace
}  // namespace soft_volume::core
