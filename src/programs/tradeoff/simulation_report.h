#pragma once

#include <string>
#include <vector>

#include "simulation_sweep.h"
#include "tradeoff_table.h"

namespace soft_volume::core {

/// A scene and what its sweep measured, in the order of the settings; the reference is the last.
struct SceneResults {
  TradeoffScene scene;
  std::vector<SweepResult> results;
};

/// One row for every result, scene after scene, with the front marked and the presets named. In the first scene `fast`,
/// `balanced` and `exact` are the cheapest settings within 15, 5 and 1 % of the reference, or the most exact one where
/// none is. Everywhere `reed1997` is the dissertation's method on its finest lattice. What could not run has infinite
/// error and cost.
TradeoffTable simulationTable(const std::vector<SceneResults>& scenes);

/// How the table is drawn.
TradeoffPlot simulationPlot(const std::vector<SceneResults>& scenes, const std::string& png_path);

/// What the numbers say and which setting serves which need, in Markdown.
std::string simulationReport(const std::vector<SceneResults>& scenes, const TradeoffTable& table);

}  // namespace soft_volume::core
