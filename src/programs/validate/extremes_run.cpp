#include "extremes_run.h"

#include <algorithm>

#include "soft_volume/common/error.h"

namespace soft_volume::core::validate {

WatchedRun::WatchedRun(const Block& block, const SimulationSettings& settings, int threads, bool dissertation)
    : block_(&block), simulation_(block.lattice, block.materials, settings, threads), dissertation_(dissertation) {}

void WatchedRun::step(int count) {
  for (int n = 0; n < count; ++n) {
    simulation_.step();
    const auto& moved = simulation_.state().displacements_m;
    finite_ = finite_ && std::all_of(moved.begin(), moved.end(), [](const Vector3& u) { return isFinite(u); });
    least_width_m_ = std::min(least_width_m_, simulation_.minWidth());
  }
}

std::unique_ptr<Block> makeExtremeBlock(const Experiment& experiment, bool dissertation) {
  // The dissertation knows no damping.
  auto block = std::make_unique<Block>(experiment.cells, Vector3::Constant(kExtremeSpacingM),
                                       tissue(0.25, dissertation ? 0.0 : experiment.damping_ratio));
  if (!experiment.free)
    block->fixWhere([](const Vector3i& n) { return n.z() == 0; });
  if (experiment.prepare)
    experiment.prepare(*block);
  return block;
}

void ExtremeItem::run(const Experiment& experiment) {
  const std::vector<double> values = runOurs(experiment);
  const std::vector<std::optional<double>> dissertation = runDissertation(experiment);
  for (std::size_t n = 0; n < values.size(); ++n) {
    const Quantity& quantity = experiment.quantities[n];
    const std::string name = title_ + ": " + quantity.name;
    if (quantity.positive)
      report_.positive(name, values[n], dissertation[n]);
    else
      report_.atMost(name, values[n], quantity.bound, dissertation[n]);
  }
}

std::vector<double> ExtremeItem::runOurs(const Experiment& experiment) {
  const std::unique_ptr<Block> block = makeExtremeBlock(experiment, false);
  std::vector<double> values;
  std::uint64_t hash = 0;
  for (const int threads : {1, 2}) {
    WatchedRun run(*block, experiment.ours, threads, false);
    values = experiment.measure(run);
    different_bits_ += threads > 1 && run.simulation().stateHash() != hash ? 1 : 0;
    hash = run.simulation().stateHash();
    not_finite_ += run.finite() ? 0 : 1;
    least_width_h_ = std::min(least_width_h_, run.leastWidthInH());
  }
  return values;
}

std::vector<std::optional<double>> ExtremeItem::runDissertation(const Experiment& experiment) {
  const std::unique_ptr<Block> block = makeExtremeBlock(experiment, true);
  try {
    WatchedRun run(*block, experiment.dissertation, 1, true);
    const std::vector<double> values = experiment.measure(run);
    dissertation_not_finite_ += run.finite() ? 0 : 1;
    dissertation_width_h_ = std::min(dissertation_width_h_, run.leastWidthInH());
    return {values.begin(), values.end()};
  } catch (const Error&) {  // its step is refused
    return std::vector<std::optional<double>>(experiment.quantities.size());
  }
}

void ExtremeItem::reportAlways() const {
  const auto finiteOrNothing = [](double width) {
    return width < std::numeric_limits<double>::infinity() ? std::optional<double>(width) : std::nullopt;
  };
  report_.positive(title_ + ", always: least width of a corner tetrahedron, h", least_width_h_,
                   finiteOrNothing(dissertation_width_h_));
  report_.atMost(title_ + ", always: runs with a value that is not finite", not_finite_, 0.0,
                 double(dissertation_not_finite_));
  report_.atMost(title_ + ", always: runs with other bits (again, 2 threads)", different_bits_, 0.0);
}

}  // namespace soft_volume::core::validate
