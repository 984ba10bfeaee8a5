#pragma once

#include <optional>
#include <string>
#include <vector>

namespace soft_volume::core {

/// One setting that was measured.
struct TradeoffRow {
  std::string scene;                  ///< rows of different scenes are not compared
  std::vector<std::string> settings;  ///< what was chosen, as TradeoffTable::setting_names
  double cost = 0.0;                  ///< as TradeoffTable::cost_name
  double memory = 0.0;                ///< as TradeoffTable::memory_name
  double reference_error = 0.0;       ///< against the scene's reference; infinite when there is no answer
  std::optional<double> known_error;  ///< against the scene's known answer
  std::string preset;                 ///< name that the row has or earned, else empty
  bool is_reference = false;          ///< what the others are compared with: no candidate for the front or a preset
  bool on_front = false;              ///< no cheaper row of the scene is as exact, to 1 % of the error

  /// What counts: the known answer where there is one.
  double error() const { return known_error.value_or(reference_error); }
};

/// How errors are written: a row's error times `scale`. Fractions are written in per cent.
struct ErrorUnit {
  double scale = 100.0;
  std::string name = "percent";       ///< ends the names of the CSV's columns
  std::string axis_format = "%g %%";  ///< gnuplot's, of the numbers beside the plot
};

/// What a sweep measured, for simulation and rendering alike.
struct TradeoffTable {
  std::vector<std::string> setting_names;
  std::string cost_name;
  std::string memory_name;
  std::vector<TradeoffRow> rows;
  ErrorUnit error_unit{};
};

/// Sets `on_front` in every row: the Pareto front of cost and error() within each scene.
void markFront(TradeoffTable& table);

/// Row of the scene with the least cost among those with error() <= `largest_error`; the most exact row when there is
/// none; null when the scene has no rows.
TradeoffRow* cheapestWithin(TradeoffTable& table, const std::string& scene, double largest_error);

/// Writes all rows. Throws FileError when the file cannot be written.
void writeCsv(const TradeoffTable& table, const std::string& path);

/// One panel of the plot: a scene, with colour and point shape by two of the settings.
struct TradeoffPanel {
  std::string scene;
  std::string title;
  std::string error_label;
};

/// How the plot is made; indices are those of TradeoffTable::setting_names.
struct TradeoffPlot {
  std::string png_path;
  std::string title;
  std::string cost_label;
  std::vector<TradeoffPanel> panels;  ///< up to three side by side, more in two columns
  std::size_t colour_setting = 0;
  std::string colour_unit;  ///< follows the value in the legend
  std::size_t shape_setting = 0;
};

/// A gnuplot script, data included, that draws error against cost in logarithmic scales, marks each scene's front and
/// names the rows that have a preset.
std::string plotScript(const TradeoffTable& table, const TradeoffPlot& plot);

}  // namespace soft_volume::core
