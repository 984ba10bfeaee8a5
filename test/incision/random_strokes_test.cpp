#include <gtest/gtest.h>

#include <cstdio>
#include <functional>

#include "incision/cut_cases.h"
#include "soft_volume/incision/stroke.h"

namespace soft_volume::core {
namespace {

constexpr unsigned kSeed = 19970603;
constexpr double kCellVolume = kH * kH * kH;
constexpr double kTall = 3.0;
constexpr Stroke::Settings kSettings = {0.5 * kH, 0.2 * kH, 0.03 * kH};

/// The way of a blade's tip through a block of 8 x 8 x 3 cells, and from there to its heel.
struct Path {
  std::function<Vector3(double)> tip;
  Vector3 up;
  int sweeps;
  double from = -1.0;
  double to = 9.0;
};

/// Cuts along a path, every quad in a call of its own.
class Cutter {
 public:
  explicit Cutter(Path path) : path_(std::move(path)) {}

  /// One sweep more; false when it was the end.
  bool step(CutBlock& block) {
    std::vector<SweptQuad> quads;
    if (sweep_ == path_.sweeps) {
      stroke_.end(quads);
    } else {
      const Vector3 from = tipAt(sweep_);
      const Vector3 to = tipAt(sweep_ + 1);
      stroke_.add({from, from + path_.up, to + path_.up, to}, quads);
    }
    for (const SweptQuad& quad : quads) {
      const BladeCutResult result = block.cut({quad}, stroke_.lips());
      opened_area_m2_ += result.opened_area_m2;
      splits_ += result.pieces_split;
      refused_ += result.splits_refused;
    }
    return sweep_++ < path_.sweeps;
  }
  void run(CutBlock& block) {
    while (step(block)) {
    }
  }

  Stroke& stroke() { return stroke_; }
  double openedArea() const { return opened_area_m2_; }
  std::size_t splits() const { return splits_; }
  std::size_t refused() const { return refused_; }

 private:
  Vector3 tipAt(int sweep) const { return path_.tip(path_.from + (path_.to - path_.from) * sweep / path_.sweeps); }

  Path path_;
  Stroke stroke_{kSettings};
  int sweep_ = 0;
  double opened_area_m2_ = 0.0;
  std::size_t splits_ = 0;
  std::size_t refused_ = 0;
};

class RandomPaths {
 public:
  explicit RandomPaths(unsigned seed) : random_(seed) {}

  double range(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random_); }

  /// A leaning blade along a sine, fast, at a hand's speed or creeping.
  Path sine(double highest = 2.0) {
    const double height = range(0.0, highest);
    const double bend = range(0.3, 1.2);
    const double phase = range(0.0, 6.28);
    const double y = range(3.5, 4.5);
    const Vector3 up = Vector3(range(-0.3, 0.3), range(-0.3, 0.3), 5.0) * kH;
    const int sweeps = std::array<int, 3>{25, 200, 3000}[count_++ % 3];
    return {[=](double x) -> Vector3 { return Vector3(x, y + height * std::sin(bend * x + phase), -1.0) * kH; }, up,
            sweeps};
  }

 private:
  std::mt19937 random_;
  std::size_t count_ = 0;
};

/// Along y instead of x.
Path turned(const Path& path) {
  Path other = path;
  const auto turn = [](const Vector3& p) { return Vector3(p.y(), p.x(), p.z()); };
  other.tip = [=](double x) { return turn(path.tip(x)); };
  return other;
}

/// What a stroke along x leaves below it in y, in cells.
double volumeBelow(const Path& path) {
  constexpr int kSteps = 50;
  double sum = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const Vector3 up = ((i + 0.5) / kSteps * kTall + 1.0) / 5.0 * path.up;
    for (int j = 0; j < 8 * kSteps; ++j)
      sum += (path.tip((j + 0.5) / kSteps - up.x() / kH) + up).y() / kH * kTall / kSteps / kSteps;
  }
  return sum;
}

void expectParts(const CutBlock& block, std::size_t parts) {
  const std::vector<double> volumes = islandVolumes(block.mesh);
  ASSERT_EQ(volumes.size(), parts);
  ASSERT_GE(volumes[0], 0.999 * block.resolution.least_island * kCellVolume);
}

TEST(RandomStrokes, PartABlockInTwo) {
  std::printf("seed %u\n", kSeed);
  RandomPaths paths(kSeed);
  std::size_t splits = 0;
  std::size_t refused = 0;
  double worst = 0.0;
  for (int n = 0; n < caseCount(100); ++n) {
    SCOPED_TRACE(n);
    const Path path = paths.sine();
    CutBlock block({8, 8, 3});
    Cutter cutter(path);
    cutter.run(block);
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 2));
    const std::vector<double> volumes = islandVolumes(block.mesh);
    const double below = volumeBelow(path);
    const double error = std::abs(volumes[0] / kCellVolume - std::min(below, 192.0 - below));
    worst = std::max(worst, error);
    splits += cutter.splits();
    refused += cutter.refused();
    if (n % 10 == 0) {
      ASSERT_NO_FATAL_FAILURE(expectSound(block));
    }
  }
  std::printf("%zu splits, %zu refused, volumes within %.2f cells of the path's\n", splits, refused, worst);
  // The cut is some 30 squares of h: this is 0.02 h of it.
  EXPECT_LT(worst, 0.6);
}

/// A block that is bent, sheared, twisted and carried along while it is cut: displacements grow with time.
class MovingBlock {
 public:
  explicit MovingBlock(RandomPaths& random)
      : shear_(random.range(-0.5, 0.5)),
        bend_(random.range(-0.3, 0.3)),
        twist_(random.range(-0.3, 0.3)),
        drift_(random.range(-0.5, 0.5), random.range(-0.5, 0.5), random.range(-0.5, 0.5)) {}

  Vector3 place(const Vector3& rest_m, double time) const {
    const Vector3 q = rest_m / kH;
    const Vector3 d(shear_ * q.z() + twist_ * std::sin(0.5 * q.y()),
                    bend_ * (q.x() - 4) * (q.x() - 4) / 8 + twist_ * q.z(), 0.3 * shear_ * std::sin(0.7 * q.x()));
    return rest_m + time * kH * (d + drift_);
  }
  Vector3 rest(const Vector3& place_m, double time) const {
    Vector3 q = place_m;
    for (int n = 0; n < 60; ++n)
      q += place_m - place(q, time);
    return q;
  }
  /// Moves the tissue on, and the joint of the stroke with it.
  void move(CutBlock& block, Stroke& stroke, double from, double to) const {
    for (std::size_t v = 0; v < block.positions_m.size(); ++v) {
      block.positions_m[v] = place(block.mesh.restPositions()[v], to);
      block.reach_m = std::max(block.reach_m, (block.positions_m[v] - block.mesh.restPositions()[v]).norm());
    }
    if (const auto joint = stroke.joint())
      stroke.moveJoint({place(rest((*joint)[0], from), to), place(rest((*joint)[1], from), to)});
  }

 private:
  double shear_;
  double bend_;
  double twist_;
  Vector3 drift_;
};

TEST(RandomStrokes, PartABlockThatIsDeformedBetweenTheirSweeps) {
  RandomPaths paths(kSeed + 1);
  for (int n = 0; n < caseCount(60); ++n) {
    SCOPED_TRACE(n);
    Path path = paths.sine();
    path.from = -2.0;
    path.to = 12.0;
    const MovingBlock moving(paths);
    CutBlock block({8, 8, 3});
    Cutter cutter(path);
    double time = 0.0;
    const double step = 1.0 / path.sweeps;
    do {
      moving.move(block, cutter.stroke(), time, time + step);
      time += step;
    } while (cutter.step(block));
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 2));
    if (n % 10 == 0) {
      ASSERT_NO_FATAL_FAILURE(expectSound(block));
    }
  }
}

TEST(RandomStrokes, ThatCrossPartABlockInFour) {
  RandomPaths paths(kSeed + 2);
  for (int n = 0; n < caseCount(60); ++n) {
    SCOPED_TRACE(n);
    CutBlock block({8, 8, 3});
    Cutter first(paths.sine(0.6));
    Cutter second(turned(paths.sine(0.6)));
    first.run(block);
    second.run(block);
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 4));
    if (n % 10 == 0) {
      ASSERT_NO_FATAL_FAILURE(expectSound(block));
    }
  }
}

TEST(RandomStrokes, ThatSplitEachOthersLipsInMidStrokePartABlockInFour) {
  RandomPaths paths(kSeed + 3);
  for (int n = 0; n < caseCount(60); ++n) {
    SCOPED_TRACE(n);
    CutBlock block({8, 8, 3});
    Path path = paths.sine(0.6);
    Path other = turned(paths.sine(0.6));
    path.sweeps = other.sweeps = 100;
    Cutter first(path);
    Cutter second(other);
    for (bool more = true; more;) {
      more = first.step(block);
      more |= second.step(block);
    }
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 4));
  }
}

TEST(RandomStrokes, ThreeInATrianglePartABlockInSeven) {
  RandomPaths paths(kSeed + 4);
  const auto line = [&](double x0, double y0, double x1, double y1) {
    const double bend = paths.range(-0.25, 0.25);
    const Vector3 up = Vector3(paths.range(-0.2, 0.2), paths.range(-0.2, 0.2), 5.0) * kH;
    const auto tip = [=](double s) -> Vector3 {
      return Vector3(x0 + s * (x1 - x0), y0 + s * (y1 - y0) + bend * std::sin(3 * s), -1.0) * kH;
    };
    return Path{tip, up, 60, -0.15, 1.15};
  };
  for (int n = 0; n < caseCount(40); ++n) {
    SCOPED_TRACE(n);
    CutBlock block({8, 8, 3});
    Cutter(line(0, paths.range(1.5, 2.5), 8, paths.range(2.5, 3.5))).run(block);
    Cutter(line(paths.range(0.5, 1.5), 0, paths.range(5.2, 6.2), 8)).run(block);
    Cutter(line(paths.range(6.5, 7.5), 0, paths.range(2.2, 3.2), 8)).run(block);
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 7));
    if (n % 10 == 0) {
      ASSERT_NO_FATAL_FAILURE(expectSound(block));
    }
  }
}

TEST(RandomStrokes, ExactlyThroughVerticesEdgesAndFacesPartABlockInTwo) {
  for (const double share : {0.0, 0.01, 0.04, 0.5, 0.99}) {
    for (const Vector3& go : {Vector3(1, 0, 0), Vector3(1, 1, 0), Vector3(1, 0.5, 0), Vector3(1, 0.01, 0)}) {
      for (const int sweeps : {10, 20, 47, 200}) {
        CutBlock block({8, 8, 3});
        const Vector3 start(-1.0, 4.0 - std::round(4.0 * go.y()) + share - go.y(), -1.0 + share);
        Cutter(
            Path{[=](double x) -> Vector3 { return (start + (x + 1.0) * go) * kH; }, 5 * kH* Vector3::UnitZ(), sweeps})
            .run(block);
        SCOPED_TRACE(share);
        SCOPED_TRACE(sweeps);
        ASSERT_NO_FATAL_FAILURE(expectParts(block, 2));
        if (sweeps == 47) {
          ASSERT_NO_FATAL_FAILURE(expectSound(block));
        }
      }
    }
  }
}

TEST(RandomStrokes, OfABladeLongerThanTheLatticePartABlockInTwo) {
  RandomPaths paths(kSeed + 5);
  for (int n = 0; n < caseCount(60); ++n) {
    SCOPED_TRACE(n);
    Path path = paths.sine();
    const auto tip = path.tip;
    path.tip = [=](double x) -> Vector3 { return tip(x) - 40 * kH * Vector3::UnitZ(); };
    path.up.z() = 80 * kH;
    CutBlock block({8, 8, 3});
    Cutter(path).run(block);
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 2));
  }
}

TEST(RandomStrokes, ShallowOnesOpenAsMuchAsTheyPassedAndPartNothing) {
  RandomPaths paths(kSeed + 6);
  double least = 1.0;
  double most = 1.0;
  for (int n = 0; n < caseCount(60); ++n) {
    SCOPED_TRACE(n);
    Path path = paths.sine();
    const double depth = n % 2 == 0 ? 0.3 : paths.range(0.3, 2.3);
    const auto tip = path.tip;
    path.tip = [=](double x) -> Vector3 { return tip(x) + (kTall - depth + 1.0) * kH * Vector3::UnitZ(); };
    CutBlock block({8, 8, 3});
    Cutter cutter(path);
    cutter.run(block);
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 1));
    double length = 0.0;
    for (int i = 0; i < 800; ++i)
      length += (tip(0.01 * i) - tip(0.01 * (i + 1))).norm();
    const double share = cutter.openedArea() / (length * depth * kH);
    least = std::min(least, share);
    most = std::max(most, share);
    if (n % 10 == 0) {
      ASSERT_NO_FATAL_FAILURE(expectSound(block));
    }
  }
  std::printf("opened %.2f to %.2f of the area that the blade passed\n", least, most);
  EXPECT_GT(least, 0.85);
  EXPECT_LT(most, 1.2);
}

double distanceFromSegment(const Vector3& p, const Vector3& a, const Vector3& b) {
  const double t = std::clamp((b - a).dot(p - a) / (b - a).squaredNorm(), 0.0, 1.0);
  return (p - a - t * (b - a)).norm();
}

double distanceFromTriangle(const Vector3& p, const Vector3& a, const Vector3& b, const Vector3& c) {
  const Vector3 normal = (b - a).cross(c - a).normalized();
  const auto inside = [&](const Vector3& from, const Vector3& to) {
    return normal.dot((to - from).cross(p - from)) >= 0;
  };
  if (inside(a, b) && inside(b, c) && inside(c, a))
    return std::abs(normal.dot(p - a));
  return std::min({distanceFromSegment(p, a, b), distanceFromSegment(p, b, c), distanceFromSegment(p, c, a)});
}

/// The part of a quad's area that is inside a block, by points of a grid.
double areaInside(const SweptQuad& quad, const Vector3& size_m) {
  constexpr int kSteps = 20;
  int inside = 0;
  for (int i = 0; i < kSteps * kSteps; ++i) {
    const double a = (i % kSteps + 0.5) / kSteps;
    const double c = (i / kSteps + 0.5) / kSteps;
    const Vector3 p = (1 - c) * ((1 - a) * quad[0] + a * quad[1]) + c * ((1 - a) * quad[3] + a * quad[2]);
    inside += (p.array() > 0.0).all() && (p.array() < size_m.array()).all() ? 1 : 0;
  }
  return 0.5 * (quad[2] - quad[0]).cross(quad[1] - quad[3]).norm() * inside / (kSteps * kSteps);
}

/// A stroke that comes down into a block of 14 x 14 x 6 cells, goes along a curve and comes up again.
std::vector<SweptQuad> dip(RandomPaths& random) {
  const double heading = random.range(-3.14, 3.14);
  const double bend = random.range(-0.12, 0.12);
  const double depth = random.range(2.0, 3.5);
  const Vector3 middle(random.range(6, 8), random.range(6, 8), 6.0);
  const Vector3 shaft = Vector3(random.range(-0.5, 0.5), random.range(-0.5, 0.5), 1.0).normalized();
  const auto tip = [&](double s) -> Vector3 {
    const double x = 11.0 * (s - 0.5);
    const Vector3 along = Eigen::AngleAxisd(heading, Vector3::UnitZ()) * Vector3(x, bend * x * x, 0.0);
    const double down = -0.6 + (depth + 0.6) * std::min(1.0, std::min(s, 1 - s) / 0.15);
    return kH * (middle + along - down / shaft.z() * shaft);
  };
  Stroke stroke(kSettings);
  std::vector<SweptQuad> quads;
  const Vector3 up = 6 * kH * shaft;
  for (int n = 0; n < 300; ++n)
    stroke.add({tip(n / 300.0), tip(n / 300.0) + up, tip((n + 1) / 300.0) + up, tip((n + 1) / 300.0)}, quads);
  stroke.end(quads);
  return quads;
}

TEST(RandomStrokes, ThatDipIntoABlockOpenWhatTheBladePassed) {
  RandomPaths paths(kSeed + 7);
  double passed = 0.0;
  double opened = 0.0;
  double beside = 0.0;
  for (int n = 0; n < caseCount(40); ++n) {
    SCOPED_TRACE(n);
    CutBlock block({14, 14, 6});
    const std::vector<SweptQuad> quads = dip(paths);
    Lips lips;
    for (const SweptQuad& quad : quads) {
      opened += block.cut({quad}, lips).opened_area_m2;
      passed += areaInside(quad, block.size());
    }
    ASSERT_NO_FATAL_FAILURE(expectParts(block, 1));
    for (const auto& face : block.mesh.faces()) {
      if (!face.opened)
        continue;
      Vector3 middle = Vector3::Zero();
      for (const std::uint32_t v : face.loop)
        middle += block.mesh.restPositions()[v] / double(face.loop.size());
      double distance = HUGE_VAL;
      for (const SweptQuad& quad : quads) {
        distance = std::min({distance, distanceFromTriangle(middle, quad[0], quad[1], quad[2]),
                             distanceFromTriangle(middle, quad[0], quad[2], quad[3])});
      }
      if (distance > 0.2 * kH)  // a face has two lips
        beside += 0.25 * areaVector(block.mesh.restPositions(), face.loop).norm();
    }
    if (n % 10 == 0) {
      ASSERT_NO_FATAL_FAILURE(expectSound(block));
    }
  }
  std::printf("opened %.3f of the area that the blade passed, %.4f of it more than 0.2 h beside the blade\n",
              opened / passed, beside / opened);
  EXPECT_NEAR(opened / passed, 1.0, 0.03);
  EXPECT_LT(beside / opened, 0.01);
}

}  // namespace
}  // namespace soft_volume::core
