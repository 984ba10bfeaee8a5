// What cutting and cut tissue cost, on this machine. Everything on one core.

#include <algorithm>
#include <chrono>
#include <memory>

#include "cut_bodies.h"
#include "cutting.h"

namespace soft_volume::core::validate {
namespace {

template <typename Work>
double timeOf(const Work& work) {
  const auto start = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

/// An upright blade that goes through a row of 10 cells under the top.
SweptQuad shortStroke(const CutBlock& tissue, int n) {
  const double h = tissue.h();
  const int cells = tissue.block.lattice.dims.x();
  const Vector3 a = h * Vector3(0.4 + 1.1 * n, 0.3, cells - 1.6);
  const Vector3 up = 5.0 * h * Vector3::UnitZ();
  const Vector3 go = h * Vector3(0.1, 4.4, 0.0);
  return {a, a + up, a + up + go, a + go};
}

void costOfAStroke(int cells, Report& report) {
  std::vector<double> cut_ms;
  std::vector<double> adopt_ms;
  std::vector<double> lips_ms;
  std::size_t cut_cells = 0;
  for (int round = 0; round < 3; ++round) {
    CutBlock tissue(Vector3i::Constant(cells));
    SimulationSettings settings;
    settings.active_set = ActiveSet::kAll;
    Simulation simulation(tissue.block.lattice, tissue.block.materials, settings, 1);
    std::vector<Vector3> positions = tissue.mesh.restPositions();
    for (int n = 0; n < 6; ++n) {
      const std::size_t before = tissue.mesh.pieces().size();
      cut_ms.push_back(1e3 * timeOf([&] { tissue.cut({shortStroke(tissue, n)}, 0.0, positions); }));
      adopt_ms.push_back(1e3 * timeOf([&] { simulation.adoptTopology(); }));
      lips_ms.push_back(1e3 * timeOf([&] { simulation.setLips(tissue.lips()); }));
      cut_cells = std::max(cut_cells, tissue.mesh.pieces().size() - before);
    }
  }
  const std::string name = std::to_string(cells) + "^3 cells, a stroke through 10: ";
  report.atMost(name + "mesh and lattice, ms", median(cut_ms), 1.0);
  report.row(name + "the simulation adopts it, ms", median(adopt_ms), 0.0, median(adopt_ms));
  report.row(name + "contacts of all lips, ms", median(lips_ms), 0.0, median(lips_ms));
}

/// A block on a floor under a pull at its top.
class MovingBlock {
 public:
  MovingBlock(const Vector3i& cells, void (*cut)(CutBlock&), bool lips_press)
      : tissue_(cells, kCutSpacingM, tissue(0.45, 0.3)) {
    tissue_.block.fixWhere([](const Vector3i& n) { return n.z() == 0; });
    if (cut != nullptr)
      cut(tissue_);
    SimulationSettings settings;
    settings.active_set = ActiveSet::kAll;
    simulation_ = std::make_unique<Simulation>(tissue_.block.lattice, tissue_.block.materials, settings, 1);
    if (lips_press)
      simulation_->setLips(tissue_.lips());
    std::vector<VertexLoad> loads;
    for (const std::uint32_t v : tissue_.block.layer(2, cells.z()))
      loads.push_back({v, {simulation_->mass(v) * 5.0, 0.0, 0.0}});
    simulation_->setLoads(loads);
  }

  std::size_t cutCells() const { return cutPlaces(tissue_.block.lattice); }
  double secondsOfASecond() {
    constexpr int kSteps = 60;
    const double wall_s = timeOf([&] {
      for (int n = 0; n < kSteps; ++n)
        simulation_->step();
    });
    return wall_s / (kSteps * simulation_->settings().dt_s);
  }

 private:
  CutBlock tissue_;
  std::unique_ptr<Simulation> simulation_;
};

/// An incision through the whole block near its middle.
void cutAcross(CutBlock& tissue) {
  tissue.cut({squareQuad(0.5 * tissue.size() + tissue.h() * Vector3(0.1, 0.2, 0.3), {0.01, 0.02, 1.0}, 1.0)});
}

void costOfASecond(const Vector3i& cells, void (*cut)(CutBlock&), Report& report) {
  MovingBlock whole_block(cells, nullptr, false);
  MovingBlock free_lips(cells, cut, false);
  MovingBlock pressed_lips(cells, cut, true);
  std::vector<double> free_more;
  std::vector<double> pressed_more;
  for (int n = 0; n < 15; ++n) {  // side by side, so that what else runs slows all down
    const double whole_s = whole_block.secondsOfASecond();
    free_more.push_back(free_lips.secondsOfASecond() / whole_s - 1.0);
    pressed_more.push_back(pressed_lips.secondsOfASecond() / whole_s - 1.0);
  }
  const std::string name = "a simulated second, " + std::to_string(free_lips.cutCells()) + " of " +
                           std::to_string(cells.prod()) + " cells cut: more than the uncut";
  report.goalAtMost(name, median(free_more), 0.3);
  report.goalAtMost(name + ", lips press", median(pressed_more), 0.3);
}

double forcePass(const CutBody& body) {
  const std::vector<Vector3> displacements(body.nodeCount(), Vector3::Zero());
  std::vector<Vector3> forces(body.nodeCount(), Vector3::Zero());
  return timeOf([&] { body.addForces(displacements, forces); });
}

/// Both ways in their clear form: one spring after the other, in double precision.
void costOfCompleteConnection(Report& report) {
  CutBlock tissue({13, 12, 9});
  cutCrosswise(tissue);
  const CutBody embedded(tissue, PieceStiffness::kEmbedded);
  const CutBody complete(tissue, PieceStiffness::kCompleteEqual);
  std::vector<double> ratios;
  for (int n = 0; n < 31; ++n) {
    const double embedded_s = forcePass(embedded);
    ratios.push_back(forcePass(complete) / embedded_s);
  }
  report.row("forces of completely connected pieces: time of embedded ones'", median(ratios), 1.0,
             median(ratios) - 1.0);
}

}  // namespace

void costOfCuts(const Options& /*options*/, Report& report) {
  for (const int cells : {8, 16, 32})
    costOfAStroke(cells, report);
  // The lattice of the dissertation's section 5.2, and one of which a fifth is cut.
  costOfASecond({10, 20, 16}, cutAcross, report);
  costOfASecond({13, 12, 9}, cutCrosswise, report);
  costOfCompleteConnection(report);
}

}  // namespace soft_volume::core::validate
