// A square patch pressed into a half-space, of which the lattice is a box around the patch whose other faces move as
// Boussinesq's solution says: the size of the box then hardly matters.

#include <array>
#include <cmath>
#include <memory>
#include <sstream>

#include "blocks.h"
#include "references.h"
#include "report.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kHalfWidthM = 0.02;
constexpr double kPressurePa = 1e-4 * kYoungPa;  ///< small against E: displacements stay proportional
constexpr int kMaxSteps = 50000;

struct HalfSpace {
  int cells_per_half_width;  ///< a/h
  int box_half_widths;       ///< the box reaches this many half-widths sideways and down
  double poisson_ratio;

  double spacing() const { return kHalfWidthM / cells_per_half_width; }
  int reach() const { return cells_per_half_width * box_half_widths; }
};

/// z points up; the surface is the top of the box, the patch's centre the origin.
std::unique_ptr<Block> makeBox(const HalfSpace& space) {
  const int n = space.reach();
  const double reach_m = n * space.spacing();
  auto block = std::make_unique<Block>(Vector3i(2 * n, 2 * n, n), Vector3::Constant(space.spacing()),
                                       tissue(space.poisson_ratio, 1.0), Vector3(-reach_m, -reach_m, -reach_m));
  block->fixWhere(
      [n](const Vector3i& v) { return v.x() == 0 || v.x() == 2 * n || v.y() == 0 || v.y() == 2 * n || v.z() == 0; });
  return block;
}

Vector3 exactDisplacement(const Vector3& rest_m, const HalfSpace& space) {
  const Vector3 into(rest_m.x(), rest_m.y(), -rest_m.z());
  const Vector3 u = squarePatchDisplacement(into, kHalfWidthM, kPressurePa, kYoungPa, space.poisson_ratio);
  return {u.x(), u.y(), -u.z()};
}

SimulationSettings pressedSettings(const HalfSpace& space) {
  SimulationSettings settings = staticSettings();
  const double a = kHalfWidthM;
  const double half_cell = 0.5 * space.spacing();
  settings.pressures.push_back({Box3(Vector3(-a, -a, -0.1 * half_cell), Vector3(a, a, 0.1 * half_cell)), kPressurePa});
  return settings;
}

/// Depth of the surface along x from the centre, in units of the exact centre displacement, as lines of gnuplot.
std::string profile(const Block& block, const Simulation& simulation, const HalfSpace& space) {
  const double centre = squarePatchCentre(kHalfWidthM, kPressurePa, kYoungPa, space.poisson_ratio);
  const int n = space.reach();
  std::ostringstream lines;
  for (int i = n; i < 2 * n; ++i) {
    const std::uint32_t v = block.vertex(i, n, n);
    lines << (i - n) * space.spacing() / kHalfWidthM << " " << simulation.state().displacements_m[v].z() / centre
          << "\n";
  }
  return lines.str() + "\n\n";
}

std::string press(const HalfSpace& space, double bound, const Options& options, Report& report) {
  const std::unique_ptr<Block> block = makeBox(space);
  Simulation simulation(block->lattice, block->materials, pressedSettings(space), options.threads);
  std::vector<Vector3> start(block->lattice.vertexCount(), Vector3::Zero());
  for (std::uint32_t v = 0; v < start.size(); ++v) {
    if (block->lattice.fixed[v])
      start[v] = exactDisplacement(block->lattice.rest_positions[v], space);
  }
  setMotion(simulation, start, std::vector<Vector3>(start.size(), Vector3::Zero()));
  const double exact = squarePatchCentre(kHalfWidthM, kPressurePa, kYoungPa, space.poisson_ratio);
  const bool rests = settle(simulation, 1e-4 * exact, kMaxSteps);
  const int n = space.reach();
  const double depth = -simulation.state().displacements_m[block->vertex(n, n, n)].z();
  std::ostringstream name;
  name << "nu " << space.poisson_ratio << ", a/h " << space.cells_per_half_width << ", box " << space.box_half_widths
       << " a: centre displacement, um" << (rests ? "" : " (did not come to rest)");
  report.equal(name.str(), depth * 1e6, exact * 1e6, bound);
  return profile(*block, simulation, space);
}

std::string exactProfile() {
  const double centre = squarePatchCentre(kHalfWidthM, 1.0, 1.0, 0.0);
  std::ostringstream lines;
  for (double x = 0.0; x < 5.0; x += 0.02)
    lines << x << " " << -squarePatchSurface(x * kHalfWidthM, kHalfWidthM, 1.0, 1.0, 0.0) / centre << "\n";
  return lines.str();
}

void pressAll(const std::vector<int>& resolutions, int box, const Options& options, Report& report) {
  std::string profiles;
  std::string plots;
  for (std::size_t n = 0; n < resolutions.size(); ++n) {
    const HalfSpace space{resolutions[n], box, 0.25};
    profiles += press(space, resolutions[n] == 2 ? 0.03 : kNoBound, options, report);
    plots += ", $profiles index " + std::to_string(n) + " w p pt " + std::to_string(5 + n) +
             " t 'a/h = " + std::to_string(resolutions[n]) + "'";
  }
  options.plot("half_space_profile", "$exact << EOD\n" + exactProfile() + "EOD\n$profiles << EOD\n" + profiles +
                                         "EOD\nset title 'Square patch on a half-space: shape of the surface'\n"
                                         "set xlabel 'x / a'\nset ylabel 'displacement / exact centre displacement'\n"
                                         "set key bottom right\n"
                                         "plot $exact w l lw 2 lc 'black' t 'exact (Love)'" +
                                         plots + "\n");
}

/// The exact displacement of the box's faces must not decide the answer: another box gives the same.
void otherBox(int box, const Options& options, Report& report) {
  press({2, box, 0.25}, 0.03, options, report);
}

void nearlyIncompressible(int box, const Options& options, Report& report) {
  for (const double nu : {0.4, 0.49})
    press({2, box, nu}, kNoBound, options, report);
}

}  // namespace

std::vector<Case> halfSpaceCases(const Options& options) {
  if (options.quick)
    return {{"square patch", 1.0, [=](Report& report) { pressAll({1, 2}, 4, options, report); }}};
  return {{"square patch", 40.0,
           [=](Report& report) {
             pressAll({1, 2, 3, 4}, 5, options, report);
           }},
          {"a larger box", 10.0, [=](Report& report) { otherBox(8, options, report); }},
          {"nearly incompressible", 10.0, [=](Report& report) { nearlyIncompressible(5, options, report); }}};
}

}  // namespace soft_volume::core::validate
