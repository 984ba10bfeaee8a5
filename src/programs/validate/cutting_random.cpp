// Random strokes through a block that moves, and slices of what they leave.

#include <algorithm>
#include <cmath>
#include <memory>

#include "cut_block.h"
#include "cutting.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/render/grid_slicer.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core::validate {
namespace {

constexpr unsigned kSeed = 19970602;
constexpr int kCells = 8;
int cutsOfBlock(const Options& options) {
  return options.quick ? 10 : 20;
}
constexpr int kStepsOfCut = 10;
constexpr char kPlates[] = "plates";

struct LoadCase {
  const char* name;
  Matrix3 map;  ///< of places at rest
};

LoadCase loadCase(CutLoad load) {
  Matrix3 map = Matrix3::Identity();
  if (load == CutLoad::kNone)
    return {"at rest", map};
  if (load == CutLoad::kSheared) {
    map(0, 2) = 0.3;
    return {"sheared by 30 %", map};
  }
  map.diagonal() = Vector3(1.14, 1.14, 0.7);  // wider, as nu = 0.45 wants it
  return {"compressed by 30 %", map};
}

/// The worst of all blocks.
struct Worst {
  int cuts = 0;
  std::size_t most_pieces = 0;
  double mass = 0.0;
  double volume = 0.0;
  double least_width_h = HUGE_VAL;
  double displacement_h = 0.0;
  double jump = 0.0;     ///< energy that a cut adds at once, of what the tissue stored
  double motion = 0.0;   ///< energy after the steps that follow, beyond what it was before the cut
  double kinetic = 0.0;  ///< largest share of the stored energy that moved
  int not_finite = 0;
  double at_end = 0.0;  ///< energy still in motion a second after the last cut, of what was stored before the first
  int not_settled = 0;
  int other_bits = 0;
};

void raise(double& worst, double value) {
  worst = std::isnan(value) ? value : std::max(worst, value);
}

void lower(double& worst, double value) {
  worst = std::isnan(value) ? -HUGE_VAL : std::min(worst, value);
}

/// A loaded block between two plates, and the strokes through it.
class CutRun {
 public:
  CutRun(const LoadCase& load, bool lips_press, unsigned seed, int threads)
      : load_(load),
        lips_press_(lips_press),
        tissue_(Vector3i::Constant(kCells), kCutSpacingM, tissue(0.45, 0.2)),
        strokes_(seed, kCells, kCutSpacingM),
        simulation_(tissue_.block.lattice, tissue_.block.materials, settings(), threads) {
    std::vector<Vector3> displacements;
    for (const Vector3& p : tissue_.block.lattice.rest_positions)
      displacements.push_back(load.map * p - p);
    setMotion(simulation_, displacements, std::vector<Vector3>(displacements.size(), Vector3::Zero()));
    const std::vector<std::uint32_t> plates =
        tissue_.block.verticesWhere([](const Vector3i& n) { return n.z() == 0 || n.z() == kCells; });
    std::vector<Vector3> targets;
    for (const std::uint32_t v : plates)
      targets.push_back(load.map * tissue_.block.lattice.rest_positions[v]);
    simulation_.leadVertices(kPlates, plates, targets, kForever);
  }

  /// `watch`: also measures, which takes longer than the steps.
  void cutAndMove(bool watch, Worst& worst) {
    std::vector<SweptQuad> quads = strokes_.next();
    for (SweptQuad& quad : quads) {
      for (Vector3& p : quad)
        p = load_.map * p;
    }
    const double before_j = watch ? energy() : 0.0;
    const double stored_j = watch ? simulation_.mechanics().elastic_j : 0.0;
    tissue_.cut(quads, simulation_, lips_press_);
    if (stored_first_j_ == 0.0)
      stored_first_j_ = stored_j;
    if (watch && before_j > 0.0)
      raise(worst.jump, std::abs(energy() - before_j) / before_j);
    for (int n = 0; n < kStepsOfCut; ++n) {
      simulation_.step();
      if (watch)
        lower(worst.least_width_h, simulation_.minWidth() / tissue_.h());
    }
    if (!watch)
      return;
    if (before_j > 0.0) {
      raise(worst.motion, energy() / before_j - 1.0);
      raise(worst.kinetic, simulation_.mechanics().kinetic_j / stored_j);
    }
    checkMass(worst);
    ++worst.cuts;
  }

  void finish(Worst& worst) {
    raise(worst.volume, std::abs(totalVolume(tissue_.mesh) / tissue_.size().prod() - 1.0));
    const bool moves = stored_first_j_ > 0.0;
    for (double t_s = 0.0; moves && t_s < 1.0; t_s += simulation_.settings().dt_s)
      simulation_.step();
    if (moves)
      checkRest(worst);
    lower(worst.least_width_h, simulation_.minWidth() / tissue_.h());
    const std::vector<Vector3> places = tissue_.places(simulation_.positions());
    const bool finite = std::all_of(places.begin(), places.end(), [](const Vector3& p) { return isFinite(p); });
    worst.not_finite += finite ? 0 : 1;
    worst.most_pieces = std::max(worst.most_pieces, tissue_.mesh.pieces().size());
    raise(worst.displacement_h, simulation_.maxDisplacement() / tissue_.h());
  }

  std::uint64_t hash() const {
    std::uint64_t hash = hashVector(tissue_.mesh.restPositions(), simulation_.stateHash());
    for (const CutMesh::Face& face : tissue_.mesh.faces())
      hash = hashVector(face.loop, hash);
    return hashVector(tissue_.embedding.cellsOfPieces(), hash);
  }

 private:
  static SimulationSettings settings() {
    SimulationSettings settings;
    settings.active_set = ActiveSet::kAll;
    return settings;
  }

  double energy() const {
    const Mechanics mechanics = simulation_.mechanics();
    return mechanics.kinetic_j + mechanics.elastic_j;
  }

  void checkRest(Worst& worst) const {
    constexpr double kAtRest = 1e-4;
    const double share = simulation_.mechanics().kinetic_j / stored_first_j_;
    raise(worst.at_end, share);
    worst.not_settled += share < kAtRest ? 0 : 1;
  }

  void checkMass(Worst& worst) const {
    double mass_kg = 0.0;
    for (std::uint32_t v = 0; v < tissue_.block.lattice.vertexCount(); ++v)
      mass_kg += simulation_.mass(v);
    const double whole_kg = tissue_.block.materials.front().density_kg_m3 * tissue_.size().prod();
    raise(worst.mass, std::abs(mass_kg / whole_kg - 1.0));
  }

  LoadCase load_;
  bool lips_press_;
  CutBlock tissue_;
  RandomStrokes strokes_;
  Simulation simulation_;
  double stored_first_j_ = 0.0;
};

struct CutSeries {
  LoadCase load;
  bool lips_press;
  int blocks;
  unsigned seed;
};

void cutBlock(const CutSeries& what, int number, const Options& options, Worst& worst) {
  const unsigned seed = what.seed + unsigned(number);
  CutRun run(what.load, what.lips_press, seed, options.threads);
  for (int cut = 0; cut < cutsOfBlock(options); ++cut)
    run.cutAndMove(true, worst);
  const std::uint64_t hash = run.hash();
  run.finish(worst);
  if (number % 5 != 0)
    return;
  CutRun again(what.load, what.lips_press, seed, 3 - options.threads % 2);
  for (int cut = 0; cut < cutsOfBlock(options); ++cut)
    again.cutAndMove(false, worst);
  worst.other_bits += again.hash() == hash ? 0 : 1;
}

/// Whether a point of a slice lies inside a polygon, and how near to its border.
struct Hit {
  bool inside = false;
  bool at_border = false;
};
Hit hit(const SliceMesh& mesh, const SlicePolygon& polygon, const Eigen::Vector2d& at) {
  constexpr double kNear = 0.01;  // pixels
  Hit found;
  for (std::uint32_t i = 0; i < polygon.size; ++i) {
    const SliceVertex& a = mesh.vertices[mesh.corners[polygon.first + i]];
    const SliceVertex& b = mesh.vertices[mesh.corners[polygon.first + (i + 1) % polygon.size]];
    const Eigen::Vector2d p(a.u, a.v);
    const Eigen::Vector2d along(double(b.u) - a.u, double(b.v) - a.v);
    if ((a.v > at.y()) != (b.v > at.y()) && at.x() < along.x() * (at.y() - p.y()) / along.y() + p.x())
      found.inside = !found.inside;
    const double t = along.squaredNorm() > 0.0 ? std::clamp((at - p).dot(along) / along.squaredNorm(), 0.0, 1.0) : 0.0;
    found.at_border |= (at - p - t * along).norm() < kNear;
  }
  return found;
}

/// Points of slices, and at how many of them there is another number of polygons than there should be.
struct Tiling {
  std::size_t points = 0;
  std::size_t wrong = 0;
};

/// Slices of a cut block at rest, in units of a cell.
class CutSlices {
 public:
  CutSlices(const CutMesh& mesh, const Vector3& direction) : camera_(lookAlong(direction)) {
    for (const Vector3& p : mesh.restPositions())
      points_.push_back((p / kCutSpacingM).cast<float>());
    std::vector<std::uint32_t> offsets = {0};
    std::vector<std::uint32_t> stream;
    for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p) {
      const auto loops = mesh.loopsOf(p);
      stream.push_back(std::uint32_t(loops.size()));
      for (const auto& loop : loops) {
        stream.push_back(std::uint32_t(loop.size()));
        stream.insert(stream.end(), loop.begin(), loop.end());
      }
      offsets.push_back(std::uint32_t(stream.size()));
    }
    GridSlicer slicer;
    slicer.setCells(std::vector<CellType>(mesh.pieces().size(), CellType::kPolyhedron), offsets, stream,
                    points_.size());
    slicer.transform(camera_, points_, 1);
    const auto range = slicer.depthRange(camera_);
    constexpr int kPlanes = 15;
    slicer.bucket(camera_, planesThrough(range, range[0], (range[1] - range[0]) / kPlanes, kPlanes), {},
                  {-kFar, -kFar, kFar, kFar}, false);
    slicer.slice(0, slicer.planeCount(), 1, mesh_);
  }

  void tryPoints(int points_a_slice, std::mt19937& random, Tiling& tiling) const {
    std::uniform_real_distribution<double> pixel(0.0, kPixels);
    for (const Slice& slice : mesh_.slices) {
      for (int i = 0; i < points_a_slice; ++i) {
        const double u = pixel(random);
        tryPoint(slice, {u, pixel(random)}, tiling);
      }
    }
  }

 private:
  static constexpr int kPixels = 1000;
  static constexpr int kFar = 1000000;

  static Camera lookAlong(const Vector3& direction) {
    const Vector3 target = Vector3::Constant(kCells / 2.0);
    Camera camera =
        Camera::lookAtParallel(target + 40.0 * direction, target, Vector3(0.1, 0.2, 1.0), 16.0, kPixels, kPixels);
    camera.far_m = 100.0;
    return camera;
  }

  void tryPoint(const Slice& slice, const Eigen::Vector2d& at, Tiling& tiling) const {
    const Vector3 p = camera_.T_volume_camera *
                      Vector3((at.x() - camera_.cx) / camera_.fx, (at.y() - camera_.cy) / camera_.fy, slice.z_m);
    const double outside = (p - Vector3::Constant(kCells / 2.0)).cwiseAbs().maxCoeff() - kCells / 2.0;
    if (std::abs(outside) < 1e-3)
      return;
    int covering = 0;
    for (std::uint32_t k = 0; k < slice.polygon_count; ++k) {
      const Hit found = hit(mesh_, mesh_.polygons[slice.first_polygon + k], at);
      if (found.at_border)
        return;
      covering += found.inside ? 1 : 0;
    }
    ++tiling.points;
    tiling.wrong += covering == (outside < 0.0 ? 1 : 0) ? 0 : 1;
  }

  Camera camera_;
  std::vector<Vector3f> points_;
  SliceMesh mesh_;
};

}  // namespace

void slicesOfCuts(const Options& options, Report& report) {
  std::mt19937 random(kSeed);
  std::normal_distribution<double> normal;
  Tiling tiling;
  for (int n = 0; n < (options.quick ? 1 : 20); ++n) {
    CutBlock tissue(Vector3i::Constant(kCells));
    RandomStrokes strokes(kSeed + 100 + unsigned(n), kCells, kCutSpacingM);
    for (int cut = 0; cut < cutsOfBlock(options); ++cut)
      tissue.cut(strokes.next());
    const double x = normal(random);
    const double y = normal(random);
    CutSlices(tissue.mesh, Vector3(x, y, normal(random)).normalized()).tryPoints(100, random, tiling);
  }
  report.row("slices of cut blocks: points tried", double(tiling.points), 0.0, 0.0);
  report.atMost("slices of cut blocks: points not in exactly one polygon", double(tiling.wrong), 0.0);
}

void randomCuts(CutLoad load, bool lips_press, const Options& options, Report& report) {
  const int blocks = lips_press ? 10 : load == CutLoad::kNone ? 50 : 25;
  const CutSeries what = {loadCase(load), lips_press, options.quick ? 1 : blocks, kSeed + 1000 * unsigned(load)};
  Worst worst;
  for (int n = 0; n < what.blocks; ++n)
    cutBlock(what, n, options, worst);
  const std::string name = std::string("8^3 cells ") + what.load.name + (lips_press ? ", lips press: " : ": ");
  report.row(name + "random cuts", worst.cuts, cutsOfBlock(options) * what.blocks, 0.0);
  report.row(name + "most pieces of a block", double(worst.most_pieces), 0.0, 0.0);
  report.atMost(name + "blocks with a value that is not finite", worst.not_finite, 0.0);
  report.atMost(name + "mass off by", worst.mass, 1e-12);
  report.atMost(name + "volume at rest off by", worst.volume, 1e-9);
  report.positive(name + "least width of a corner tetrahedron, h", worst.least_width_h);
  report.atMost(name + "blocks with other bits (again, other threads)", worst.other_bits, 0.0);
  if (load == CutLoad::kNone) {
    report.atMost(name + "farthest that anything moved, h", worst.displacement_h, 1e-6);
    return;
  }
  // Lips that have slid far from where they were cut are pressed by what is no neighbour any more.
  const auto energy = [&](const char* what_of_it, double value) {
    if (lips_press)
      report.goalAtMost(name + what_of_it, value, 0.01);
    else
      report.atMost(name + what_of_it, value, 0.01);
  };
  energy("energy that a cut adds, of all", worst.jump);
  energy("energy 10 steps later, beyond that before the cut", worst.motion);
  report.row(name + "largest share of the energy in motion", worst.kinetic, 0.0, worst.kinetic);
  report.row(name + "share in motion 1 s after the last cut", worst.at_end, 0.0, worst.at_end);
  report.goalAtMost(name + "blocks that have not settled by then", worst.not_settled, 0.0);
}

}  // namespace soft_volume::core::validate
