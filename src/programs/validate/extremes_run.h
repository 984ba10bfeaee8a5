#pragma once

#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "blocks.h"
#include "report.h"

namespace soft_volume::core::validate {

/// A simulation of an extreme case that is watched at every step.
class WatchedRun {
 public:
  WatchedRun(const Block& block, const SimulationSettings& settings, int threads, bool dissertation);

  void step(int count = 1);

  const Block& block() const { return *block_; }
  Simulation& simulation() { return simulation_; }
  const Simulation& simulation() const { return simulation_; }
  /// This run shows the dissertation's rule, not ours.
  bool dissertation() const { return dissertation_; }
  /// Shortest edge of a cell, metres.
  double h() const { return block_->edge(); }
  double largestDisplacementInH() const { return largestNorm(simulation_.state().displacements_m) / h(); }
  /// Least width of all corner tetrahedra in all states so far, of a cell edge; below 0: inverted.
  double leastWidthInH() const { return least_width_m_ / h(); }
  bool finite() const { return finite_; }

 private:
  const Block* block_;
  Simulation simulation_;
  bool dissertation_;
  bool finite_ = true;
  double least_width_m_ = std::numeric_limits<double>::infinity();
};

/// A number that a run gives, and what it has to be.
struct Quantity {
  std::string name;
  double bound = 0.0;     ///< it passes at or below this
  bool positive = false;  ///< it passes above 0 instead
};

struct Experiment {
  std::vector<Quantity> quantities;
  Vector3i cells = Vector3i::Constant(6);
  bool free = false;  ///< otherwise the lowest layer of vertices is fixed
  double damping_ratio = 1.0;
  SimulationSettings ours;
  SimulationSettings dissertation = dissertationSettings();
  std::function<std::vector<double>(WatchedRun&)> measure;  ///< one value for each quantity
  std::function<void(Block&)> prepare;                      ///< optional: changes materials before a simulation is made
};

constexpr double kExtremeSpacingM = 0.005;

std::unique_ptr<Block> makeExtremeBlock(const Experiment& experiment, bool dissertation);

/// One of the numbered rows of the table of extremes. Every experiment runs with ours for several numbers of threads,
/// and once by the dissertation's rule; at the end come the rows of what holds always.
class ExtremeItem {
 public:
  ExtremeItem(int number, std::string title, const Options& options, Report& report)
      : title_(std::to_string(number) + " " + title), options_(options), report_(report) {}

  void run(const Experiment& experiment);
  void reportAlways() const;

 private:
  std::vector<double> runOurs(const Experiment& experiment);
  std::vector<std::optional<double>> runDissertation(const Experiment& experiment);

  std::string title_;
  const Options& options_;
  Report& report_;
  double least_width_h_ = std::numeric_limits<double>::infinity();
  double dissertation_width_h_ = std::numeric_limits<double>::infinity();
  int not_finite_ = 0;
  int dissertation_not_finite_ = 0;
  int different_bits_ = 0;
};

}  // namespace soft_volume::core::validate
