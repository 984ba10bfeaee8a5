// What the two ways to make pieces stiff are worth, from their equations of motion at rest.

#include <Eigen/Dense>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>

#include "cut_bodies.h"
#include "cutting.h"

namespace soft_volume::core::validate {
namespace {

constexpr std::array<PieceStiffness, 3> kWays{PieceStiffness::kEmbedded, PieceStiffness::kComplete,
                                              PieceStiffness::kCompleteEqual};

std::string text(const char* format, double a, double b = 0.0) {
  std::array<char, 100> buffer{};
  std::snprintf(buffer.data(), buffer.size(), format, a, b);
  return buffer.data();
}

// --- a block two cells tall, cut at a share of the upper cell

constexpr int kWide = 3;
constexpr int kTall = 2;

std::unique_ptr<CutBlock> tallBlock(double share, double poisson_ratio) {
  auto block = std::make_unique<CutBlock>(Vector3i(kWide, kWide, kTall), kCutSpacingM, tissue(poisson_ratio));
  const double h = block->h();
  if (share > 0.0)
    block->cut({squareQuad(h * Vector3(0.5 * kWide, 0.5 * kWide, 1.0 + share), Vector3::UnitZ(), 10.0 * h)});
  return block;
}

std::vector<std::uint32_t> verticesAt(const CutBlock& tissue, double z_m) {
  std::vector<std::uint32_t> found;
  for (std::uint32_t v = 0; v < tissue.mesh.vertexCount(); ++v) {
    if (std::abs(tissue.mesh.restPositions()[v].z() - z_m) < 1e-9 * tissue.h())
      found.push_back(v);
  }
  return found;
}

/// The largest force when the part on top is lifted off by half a cell, of E h^2.
double carriedInTension(const CutBody& body) {
  const double h = body.tissue().h();
  const std::uint32_t top = body.part(body.weightsOf(verticesAt(body.tissue(), kTall * h).front()).begin()->first);
  std::vector<Vector3> displacements;
  for (std::uint32_t node = 0; node < body.nodeCount(); ++node)
    displacements.push_back(body.part(node) == top ? Vector3(0.0, 0.0, 0.5 * h) : Vector3::Zero());
  std::vector<Vector3> forces(body.nodeCount(), Vector3::Zero());
  body.addForces(displacements, forces);
  return largestNorm(forces) / (kYoungPa * h * h);
}

/// A spring along an axis between combinations of nodes.
void addSpring(const std::map<std::uint32_t, double>& weights, int axis, double spring_n_m, Eigen::MatrixXd& matrix) {
  for (const auto& a : weights) {
    for (const auto& b : weights)
      matrix(3 * a.first + axis, 3 * b.first + axis) += spring_n_m * a.second * b.second;
  }
}

/// Vertices of the two lips at the same place.
std::vector<std::array<std::uint32_t, 2>> lipPairs(const CutMesh& mesh, double near_m) {
  std::set<std::uint32_t> lips;
  for (const CutMesh::Face& face : mesh.faces()) {
    if (face.opened)
      lips.insert(face.loop.begin(), face.loop.end());
  }
  std::vector<std::array<std::uint32_t, 2>> pairs;
  for (const std::uint32_t a : lips) {
    for (const std::uint32_t b : lips) {
      if (a < b && (mesh.restPositions()[a] - mesh.restPositions()[b]).norm() < near_m)
        pairs.push_back({a, b});
    }
  }
  return pairs;
}

/// Force per metre with which a plate on top is pushed back by tissue on a plate. Lips that touch do not go through
/// each other. Plates and lips hold the tissue sideways, or let it slide.
double pressedStiffness(const CutBody& body, bool sticks) {
  const CutBlock& tissue = body.tissue();
  const double scale = kYoungPa * tissue.h();
  Eigen::MatrixXd matrix = body.stiffness();
  matrix.diagonal().array() += 1e-7 * scale;  // keeps what slides freely from floating away
  for (const auto& pair : lipPairs(tissue.mesh, 1e-9 * tissue.h())) {
    std::map<std::uint32_t, double> gap = body.weightsOf(pair[0]);
    for (const auto& weight : body.weightsOf(pair[1]))
      gap[weight.first] -= weight.second;
    for (int axis = sticks ? 0 : 2; axis < 3; ++axis)
      addSpring(gap, axis, 1e4 * scale, matrix);
  }
  const double plate_n_m = 1e6 * scale;
  const std::vector<std::uint32_t> top = verticesAt(tissue, kTall * tissue.h());
  for (const auto& plate : {top, verticesAt(tissue, 0.0)}) {
    for (const std::uint32_t v : plate) {
      for (int axis = sticks ? 0 : 2; axis < 3; ++axis)
        addSpring(body.weightsOf(v), axis, plate_n_m, matrix);
    }
  }
  Eigen::VectorXd load = Eigen::VectorXd::Zero(matrix.rows());
  for (const std::uint32_t v : top) {
    for (const auto& weight : body.weightsOf(v))
      load[3 * weight.first + 2] -= plate_n_m * weight.second;
  }
  const Eigen::VectorXd moved = matrix.ldlt().solve(load);
  double force = 0.0;
  for (const std::uint32_t v : top) {
    double z = 0.0;
    for (const auto& weight : body.weightsOf(v))
      z += weight.second * moved[3 * weight.first + 2];
    force += plate_n_m * (1.0 + z);
  }
  return force;
}

/// How much a plate that presses evenly on top shortens the block in a simulation, whose lips press on each other.
double shortened(double share, double poisson_ratio, int threads) {
  const auto cut = tallBlock(share, poisson_ratio);
  Block& block = cut->block;
  block.materials.front().damping_ratio = 1.0;
  const auto on_floor = [](const Vector3i& n) { return n.z() == 0; };
  block.fixWhere(on_floor);
  Simulation simulation(block.lattice, block.materials, exactSettings(), threads);
  simulation.setLips(cut->lips());
  std::vector<VertexLoad> loads;
  const std::vector<std::uint32_t> top = block.layer(2, kTall);
  for (const std::uint32_t v : top)
    loads.push_back({v, {0.0, 0.0, -0.02 * kYoungPa * block.faceArea(v, 2)}});
  simulation.setLoads(loads);
  settle(simulation, 1e-9 * cut->h(), 20000);
  double sum_m = 0.0;
  for (const std::uint32_t v : top)
    sum_m -= simulation.state().displacements_m[v].z();
  return sum_m / double(top.size());
}

void lipsOfSimulation(double poisson_ratio, int threads, Report& report) {
  const double whole_m = shortened(0.0, poisson_ratio, threads);
  for (const double share : {0.1, 0.3, 0.5}) {
    report.equal(text("simulated, nu %.2f, cut at %.0f %%: compression", poisson_ratio, 100 * share),
                 whole_m / shortened(share, poisson_ratio, threads), 1.0, 0.05);
  }
}

void lipsOf(PieceStiffness way, double poisson_ratio, Report& report) {
  const bool ours = way == PieceStiffness::kEmbedded;
  const auto whole = tallBlock(0.0, poisson_ratio);
  const CutBody whole_body(*whole, way);
  const double slides = pressedStiffness(whole_body, false);
  const double sticks = pressedStiffness(whole_body, true);
  for (const double share : {0.1, 0.3, 0.5}) {
    const auto cut = tallBlock(share, poisson_ratio);
    const CutBody body(*cut, way);
    const std::string name = std::string(nameOf(way)) + text(", nu %.2f, cut at %.0f %%: ", poisson_ratio, 100 * share);
    report.atMost(name + "tension, E h^2", carriedInTension(body), 1e-10);
    report.equal(name + "compression, lips slide", pressedStiffness(body, false) / slides, 1.0, ours ? 0.05 : kNoBound);
    report.equal(name + "compression, glued", pressedStiffness(body, true) / sticks, 1.0);
  }
}

// --- a free bar

struct Axial {
  double frequency_rad_s;
  double likeness;  ///< of the mode with the one looked for, 1 at best
};

/// The mode most like u_x = cos(pi (x - begin) / length) in one part of the tissue.
Axial axialMode(const CutBody& body, double begin_m, double length_m, std::uint32_t part) {
  Eigen::MatrixXd matrix = body.stiffness();
  Eigen::VectorXd root(matrix.rows());
  Eigen::VectorXd wanted = Eigen::VectorXd::Zero(matrix.rows());
  for (std::uint32_t node = 0; node < body.nodeCount(); ++node) {
    root.segment<3>(3 * node).setConstant(std::sqrt(body.masses()[node]));
    if (body.part(node) == part)
      wanted[3 * node] = root[3 * node] * std::cos(M_PI * (body.place(node).x() - begin_m) / length_m);
  }
  wanted.normalize();
  const Eigen::VectorXd inverse = root.cwiseInverse();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> modes(inverse.asDiagonal() * matrix * inverse.asDiagonal());
  Eigen::Index best = 0;
  (modes.eigenvectors().transpose() * wanted).cwiseAbs().maxCoeff(&best);
  return {std::sqrt(std::max(0.0, modes.eigenvalues()[best])), std::abs(modes.eigenvectors().col(best).dot(wanted))};
}

/// The part at a place of the mesh's surface.
std::uint32_t partAt(const CutBody& body, double x_m) {
  const auto& places = body.tissue().mesh.restPositions();
  std::uint32_t nearest = 0;
  for (std::uint32_t v = 0; v < places.size(); ++v) {
    if (std::abs(places[v].x() - x_m) < std::abs(places[nearest].x() - x_m))
      nearest = v;
  }
  return body.part(body.weightsOf(nearest).begin()->first);
}

struct BarCut {
  int cells;
  double off;  ///< from the middle, cells
};

void barOf(PieceStiffness way, const BarCut& bar, Report& report) {
  CutBlock tissue({bar.cells, 1, 1});
  const double length_m = tissue.size().x();
  const Axial whole = axialMode(CutBody(tissue, way), 0.0, length_m, 0);
  const double at_m = 0.5 * length_m + bar.off * tissue.h();
  tissue.cut({squareQuad({at_m, 0.5 * tissue.h(), 0.5 * tissue.h()}, Vector3::UnitX(), 10.0 * tissue.h())});
  const CutBody body(tissue, way);
  const Axial left = axialMode(body, 0.0, at_m, partAt(body, 0.0));
  const Axial right = axialMode(body, at_m, length_m - at_m, partAt(body, length_m));
  const bool ours = way == PieceStiffness::kEmbedded;
  const std::string name =
      std::string(nameOf(way)) + text(", bar of %.0f cells, cut at %.2f: ", bar.cells, 0.5 * bar.cells + bar.off);
  const auto compare = [&](const char* which, const Axial& half, double part_m) {
    report.equal(name + which, half.frequency_rad_s / whole.frequency_rad_s, length_m / part_m, ours ? 0.05 : kNoBound);
  };
  compare("left of whole", left, at_m);
  compare("right of whole", right, length_m - at_m);
  if (ours)
    report.row(name + "likeness of the modes", std::min({whole.likeness, left.likeness, right.likeness}), 1.0,
               1.0 - std::min({whole.likeness, left.likeness, right.likeness}), 0.1);
}

// --- where a partial cut ends

/// The opened faces and the vertices of each in its own order, by what lies across.
struct FrontOfCut {
  double geometric = 0.0;  ///< farthest place along y that was opened, cells
  double dynamic = 0.0;    ///< the same of lips that different cells carry, which can part
};

Vector3 middleOf(const CutMesh& mesh, const CutMesh::Face& face) {
  Vector3 sum = Vector3::Zero();
  for (const std::uint32_t v : face.loop)
    sum += mesh.restPositions()[v];
  return sum / double(face.loop.size());
}

FrontOfCut frontOf(const CutBlock& tissue) {
  const CutMesh& mesh = tissue.mesh;
  std::vector<std::uint32_t> opened;
  for (std::uint32_t f = 0; f < mesh.faces().size(); ++f) {
    if (mesh.faces()[f].opened)
      opened.push_back(f);
  }
  const auto cellOf = [&](std::uint32_t f) {
    return tissue.embedding.cellOf(std::uint32_t(mesh.faces()[f].pieces[0]));
  };
  FrontOfCut front;
  for (const std::uint32_t f : opened) {
    double farthest = 0.0;
    for (const std::uint32_t v : mesh.faces()[f].loop)
      farthest = std::max(farthest, mesh.restPositions()[v].y() / tissue.h());
    front.geometric = std::max(front.geometric, farthest);
    for (const std::uint32_t twin : opened) {
      const bool same_place =
          (middleOf(mesh, mesh.faces()[f]) - middleOf(mesh, mesh.faces()[twin])).norm() < 1e-9 * tissue.h();
      if (same_place && cellOf(f) != cellOf(twin))
        front.dynamic = std::max(front.dynamic, farthest);
    }
  }
  return front;
}

}  // namespace

void lipsUnderLoad(const Options& options, Report& report) {
  for (const double poisson_ratio : {0.25, 0.45}) {
    lipsOf(PieceStiffness::kEmbedded, poisson_ratio, report);
    lipsOfSimulation(poisson_ratio, options.threads, report);
  }
  if (options.quick)
    return;
  lipsOf(PieceStiffness::kComplete, 0.25, report);
  lipsOf(PieceStiffness::kCompleteEqual, 0.25, report);
}

void barCutInTwo(const Options& options, Report& report) {
  const std::vector<BarCut> bars = {{8, 0.0}, {9, 0.0}, {9, 0.4}, {12, 0.0}, {12, 0.25}, {12, 0.4}};
  for (const PieceStiffness way : kWays) {
    for (const BarCut& bar : bars) {
      if (!options.quick || (way == PieceStiffness::kEmbedded && bar.cells < 10))
        barOf(way, bar, report);
    }
  }
}

/// A blade that leans goes along y into a block and stops; it reaches through the top.
void endOfACut(const Options& options, Report& report) {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> part(0.0, 1.0);
  double geometric = 0.0;
  double dynamic = 0.0;
  double dynamic_sum = 0.0;
  const int cuts = options.quick ? 20 : 400;
  for (int n = 0; n < cuts; ++n) {
    CutBlock tissue({4, 6, 4});
    const double end = 1.5 + 3.0 * part(random);
    const double tilt = part(random) - 0.5;
    const double x = 1.2 + 1.6 * part(random);
    const Vector3 low = tissue.h() * Vector3(x - tilt, -1.0, 0.7 + part(random));
    const Vector3 high = tissue.h() * Vector3(x + tilt, -1.0, 6.0);
    const Vector3 go = tissue.h() * (end + 1.0) * Vector3::UnitY();
    tissue.cut({{low, high, high + go, low + go}});
    const FrontOfCut front = frontOf(tissue);
    geometric = std::max(geometric, std::abs(front.geometric - end));
    dynamic = std::max(dynamic, std::abs(front.dynamic - end));
    dynamic_sum += std::abs(front.dynamic - end);
  }
  report.atMost("end of a partial cut: lips off the blade's end, h", geometric, 0.5);
  report.row("end of a partial cut: where they can part, mean off, h", dynamic_sum / cuts, 0.0, dynamic_sum / cuts);
  report.goalAtMost("end of a partial cut: where they can part, h", dynamic, 0.5);
}

void stepOfCutTissue(const Options& options, Report& report) {
  const Vector3i cells = options.quick ? Vector3i(8, 8, 5) : Vector3i(13, 12, 9);
  for (const PieceStiffness way : kWays) {
    for (const double poisson_ratio : {0.25, 0.45}) {
      const bool ours = way == PieceStiffness::kEmbedded;
      if (!ours && (options.quick || poisson_ratio > 0.25))
        continue;
      CutBlock cut(cells, kCutSpacingM, tissue(poisson_ratio));
      const CutBody whole(cut, way);
      const double uncut_rad_s = whole.largestFrequency();
      cutCrosswise(cut);
      const CutBody body(cut, way);
      const double ratio = uncut_rad_s / body.largestFrequency();
      const std::string name = std::string(nameOf(way)) +
                               text(", nu %.2f, %.0f cells cut: ", poisson_ratio, double(cutPlaces(cut.block.lattice)));
      report.row(name + "stable step of the uncut", ratio, 1.0, 1.0 - ratio, ours ? 0.2 : kNoBound);
      report.row(name + "springs of the uncut", double(body.springCount()) / double(whole.springCount()), 1.0,
                 double(body.springCount()) / double(whole.springCount()) - 1.0);
    }
  }
  for (const double poisson_ratio : {0.25, 0.45, 0.49}) {
    CutBlock chips(Vector3i::Constant(options.quick ? 5 : 8), kCutSpacingM, tissue(poisson_ratio));
    const double uncut_rad_s = CutBody(chips, PieceStiffness::kEmbedded).largestFrequency();
    RandomStrokes strokes(20040801, chips.block.lattice.dims.x(), chips.h());
    const std::size_t wanted = options.quick ? 60 : 200;
    while (cutPlaces(chips.block.lattice) < wanted)
      chips.cut(strokes.next());
    const double ratio = uncut_rad_s / CutBody(chips, PieceStiffness::kEmbedded).largestFrequency();
    report.goalAtMost(text("embedded, nu %.2f, %.0f cells in chips: stable step lost", poisson_ratio,
                           double(cutPlaces(chips.block.lattice))),
                      1.0 - ratio, 0.2);
  }
}

}  // namespace soft_volume::core::validate
