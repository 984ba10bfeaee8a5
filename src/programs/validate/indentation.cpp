// A tool of 3x3 vertices: how much too stiff is an answer that leaves part of the lattice out?

#include <array>
#include <cmath>
#include <memory>
#include <sstream>

#include "blocks.h"
#include "report.h"

namespace soft_volume::core::validate {
namespace {

constexpr double kSpacingM = 0.005;
constexpr int kMaxSteps = 20000;
constexpr double kDepth = 0.5;  ///< of a cell edge, that the tool reaches about

struct Tissue {
  Vector3i cells;
  double poisson_ratio;
};

std::unique_ptr<Block> makeTissue(const Tissue& tissue_of) {
  auto block =
      std::make_unique<Block>(tissue_of.cells, Vector3::Constant(kSpacingM), tissue(tissue_of.poisson_ratio, 1.0));
  block->fixWhere([](const Vector3i& n) { return n.z() == 0; });
  return block;
}

std::vector<std::uint32_t> toolVertices(const Block& block) {
  const Vector3i middle = block.lattice.dims / 2;
  return block.verticesWhere([&](const Vector3i& n) {
    return n.z() == block.lattice.dims.z() && std::abs(n.x() - middle.x()) <= 1 && std::abs(n.y() - middle.y()) <= 1;
  });
}

/// The force under which a half-space would sink by about kDepth cells: F/u is near 2.2 E a / (1 - nu^2), a = 1.5 h.
double toolForce(const Tissue& tissue_of) {
  const double nu = tissue_of.poisson_ratio;
  return kDepth * kSpacingM * 2.2 * kYoungPa * 1.5 * kSpacingM / (1.0 - nu * nu);
}

void pressTool(const Block& block, Simulation& simulation, double force_n) {
  std::vector<VertexLoad> loads;
  for (const std::uint32_t v : toolVertices(block))
    loads.push_back({v, Vector3(0, 0, -force_n / 9.0)});
  simulation.setLoads(loads);
}

double depthOf(const Block& block, const Simulation& simulation) {
  double depth = 0.0;
  for (const std::uint32_t v : toolVertices(block))
    depth -= simulation.state().displacements_m[v].z() / 9.0;
  return depth;
}

SimulationSettings neighbourhoodSettings() {
  SimulationSettings settings = staticSettings();
  settings.active_set = ActiveSet::kNeighbourhood;
  settings.activation_radius_m = 1e-3 * kSpacingM;
  settings.lifetime_s = 1000.0;  // longer than any run here
  return settings;
}

/// Puts exactly the given box of cells, centred under the tool, into the solve.
void wakeBox(const Block& block, Simulation& simulation, const Vector3i& cells) {
  const Vector3i middle = block.lattice.dims / 2;
  const Vector3 first(middle.x() - cells.x() / 2, middle.y() - cells.y() / 2, block.lattice.dims.z() - cells.z());
  const Vector3 inside = Vector3::Constant(0.25);
  simulation.wake(
      Box3(Vector3(kSpacingM * (first + inside)), Vector3(kSpacingM * (first + cells.cast<double>() - inside))));
}

std::string nameOf(const Tissue& tissue_of) {
  std::ostringstream name;
  name << "nu " << tissue_of.poisson_ratio << ", " << tissue_of.cells.x() << "x" << tissue_of.cells.y() << "x"
       << tissue_of.cells.z();
  return name.str();
}

std::string nameOf(const Vector3i& cells) {
  std::ostringstream name;
  name << cells.x() << "x" << cells.y() << "x" << cells.z();
  return name.str();
}

double depthOfNeighbourhood(const Block& block, const Tissue& tissue_of, const Vector3i& cells,
                            const Options& options) {
  Simulation simulation(block.lattice, block.materials, neighbourhoodSettings(), options.threads);
  pressTool(block, simulation, toolForce(tissue_of));
  wakeBox(block, simulation, cells);
  settle(simulation, 1e-5 * kSpacingM, kMaxSteps);
  return depthOf(block, simulation);
}

/// The default settings, stepped until the tissue has gone to sleep or the active set grows no more.
void growth(const Block& block, const Tissue& tissue_of, double full_depth_m, const Options& options, Report& report) {
  const SimulationSettings settings;
  Simulation simulation(block.lattice, block.materials, settings, options.threads);
  pressTool(block, simulation, toolForce(tissue_of));
  std::size_t most_cells = 0;
  double frontier_error_m = 0.0;
  int steps = 0;
  do {
    frontier_error_m = simulation.stats().frontier_error_m;
    simulation.step();
    most_cells = std::max(most_cells, simulation.activeCells());
  } while (++steps < kMaxSteps && simulation.activeCells() > 0);
  const std::string name = nameOf(tissue_of);
  const double depth_m = depthOf(block, simulation);
  report.equal(name + ", grown: depth, mm", depth_m * 1e3, full_depth_m * 1e3, 0.05);
  report.row(name + ", grown: its own estimate of the error, mm", frontier_error_m * 1e3,
             std::abs(depth_m - full_depth_m) * 1e3,
             std::abs(frontier_error_m - std::abs(depth_m - full_depth_m)) / full_depth_m);
  report.row(name + ", grown: most cells in the solve, share", double(most_cells) / double(block.lattice.cellCount()),
             1.0, 0.0);
}

void plotShape(const Block& block, const Simulation& full, const Tissue& tissue_of, const Options& options) {
  std::ostringstream name;
  name << "indentation_nu" << static_cast<int>(100 * tissue_of.poisson_ratio + 0.5);
  std::vector<Vector3> drawn = full.positions();
  options.plot(name.str(), "$shape << EOD\n" + layerLines(block, drawn, 1, block.lattice.dims.y() / 2, kSpacingM) +
                               "EOD\nunset key\nset title '3x3 tool, " + nameOf(tissue_of) +
                               " cells: section through the tool'\nset size ratio -1\nset xlabel 'x / h'\n"
                               "set ylabel 'z / h'\nplot $shape w l lc rgb '#2060a0' t 'whole lattice'\n");
}

void indent(const Tissue& tissue_of, const std::vector<Vector3i>& neighbourhoods, const Options& options,
            Report& report) {
  const std::unique_ptr<Block> block = makeTissue(tissue_of);
  Simulation full(block->lattice, block->materials, staticSettings(), options.threads);
  pressTool(*block, full, toolForce(tissue_of));
  if (!settle(full, 1e-5 * kSpacingM, kMaxSteps))
    throw std::runtime_error("the whole lattice did not come to rest");
  const double full_depth_m = depthOf(*block, full);
  for (const Vector3i& cells : neighbourhoods) {
    const double depth_m = depthOfNeighbourhood(*block, tissue_of, cells, options);
    // Stiffness is force over depth.
    report.equal(nameOf(tissue_of) + ", 1997's fixed " + nameOf(cells) + ": stiffness of the whole's",
                 full_depth_m / depth_m, 1.0);
  }
  growth(*block, tissue_of, full_depth_m, options, report);
  plotShape(*block, full, tissue_of, options);
}

}  // namespace

std::vector<Case> indentationCases(const Options& options) {
  const std::vector<Vector3i> neighbourhoods{{6, 6, 4}, {12, 12, 8}, {16, 16, 12}};
  if (options.quick) {
    const Tissue small{{16, 16, 10}, 0.25};
    return {{"3x3 tool", 5.0, [=](Report& report) { indent(small, {{6, 6, 4}}, options, report); }}};
  }
  std::vector<Case> cases;
  for (const double nu : {0.25, 0.45}) {
    const Tissue large{{32, 32, 24}, nu};
    cases.push_back({"3x3 tool", 60.0, [=](Report& report) { indent(large, neighbourhoods, options, report); }});
  }
  return cases;
}

}  // namespace soft_volume::core::validate
