#pragma once

#include <string>
#include <vector>

#include "rendering_sweep.h"
#include "tradeoff_table.h"

namespace soft_volume::core {

/// A case and what its sweep measured, in the order of the settings.
struct RenderingResults {
  RenderingCase rendering_case;
  std::vector<RenderingResult> results;
};

/// One row for every result, case after case, with the front marked and the presets named. Rows are compared among
/// those that draw the same: grid, transfer function, size of the image, task. `preview`, `balanced` and `faithful` are
/// the cheapest within 4, 1 and 0.5 levels, or the most exact one where none is.
TradeoffTable renderingTable(const std::vector<RenderingResults>& cases);

/// How the table is drawn.
TradeoffPlot renderingPlot(const std::vector<RenderingResults>& cases, const std::string& png_path);

/// What the numbers say and which setting serves which need, in Markdown. `skipped`: scenes that could not be drawn,
/// with the reason.
std::string renderingReport(const std::vector<RenderingResults>& cases, const TradeoffTable& table,
                            const std::vector<std::string>& skipped);

}  // namespace soft_volume::core
