#include "simulation_report.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>

#include "report_text.h"
#include "soft_volume/simulation/setting_names.h"

namespace soft_volume::core {
namespace {

struct ErrorBudget {
  const char* preset;
  double largest_error;
};
constexpr ErrorBudget kBudgets[] = {{"fast", 0.15}, {"balanced", 0.05}, {"exact", 0.01}};
constexpr char kBaseline[] = "reed1997";

constexpr std::size_t kSpacingSetting = 0;
constexpr std::size_t kIntegratorSetting = 1;

const std::vector<std::string>& settingNames() {
  static const std::vector<std::string> names = {"spacing_mm",
                                                 "integrator",
                                                 "dt_us",
                                                 "dt_of_limit",
                                                 "dt_fraction",
                                                 "precision",
                                                 "active_set",
                                                 "threshold",
                                                 "tolerance",
                                                 "safe_move",
                                                 "spring_rule",
                                                 "settings_of_preset",
                                                 "cells",
                                                 "vertices",
                                                 "mean_active_cells",
                                                 "largest_displacement_mm",
                                                 "limited_moves",
                                                 "repeats",
                                                 "error_same_lattice_percent"};
  return names;
}

// ---------------------------------------------------------------------------------------------------------- numbers

std::string percent(double fraction) {
  return std::isfinite(fraction) ? format(fraction >= 0.1 ? "%.0f %%" : "%.2g %%", 100.0 * fraction) : "diverged";
}

std::string percent(const std::optional<double>& fraction) {
  return fraction ? percent(*fraction) : "";
}

double error(const SweepResult& result) {
  return result.known_error.value_or(result.reference_error);
}

double memoryMib(const SweepResult& result) {
  return result.bytes_per_vertex * static_cast<double>(result.vertices) / 1048576.0;
}

// ------------------------------------------------------------------------------------------------ finding of results

using Filter = std::function<bool(const SimulationSettings&)>;

bool sameSettings(const SimulationSettings& s, Integrator integrator, double dt_fraction) {
  return s.integrator == integrator && std::abs(s.dt_fraction - dt_fraction) < 1e-9;
}

/// The finest lattice on which every setting was tried.
double crossedSpacing(const SceneResults& scene) {
  double finest_m = 1.0;
  for (const SweepResult& result : scene.results) {
    if (!result.setting.preset.empty())
      finest_m = std::min(finest_m, result.setting.spacing_m);
  }
  return finest_m;
}

/// Results on a lattice that ran, presets left out because they repeat settings of the sweep.
std::vector<const SweepResult*> onLattice(const SceneResults& scene, double spacing_m, const Filter& filter) {
  std::vector<const SweepResult*> found;
  for (const SweepResult& result : scene.results) {
    if (result.setting.spacing_m == spacing_m && result.setting.preset.empty() && result.failure.empty() &&
        !result.setting.is_lattice_reference && filter(result.setting.simulation))
      found.push_back(&result);
  }
  return found;
}

const SweepResult* find(const SceneResults& scene, const std::function<bool(const SweepResult&)>& matches) {
  const auto found = std::find_if(scene.results.begin(), scene.results.end(), matches);
  return found != scene.results.end() ? &*found : nullptr;
}

const SweepResult* presetOn(const SceneResults& scene, const std::string& preset, double spacing_m) {
  return find(scene, [&](const SweepResult& result) {
    return result.setting.preset == preset && result.setting.spacing_m == spacing_m && result.failure.empty();
  });
}

/// The setting that every lattice was tried with.
bool isLine(const SimulationSettings& s, Precision precision, ActiveSet active_set) {
  const bool usual_threshold = s.activation_threshold == SimulationSettings().activation_threshold;
  return sameSettings(s, Integrator::kSymplecticEuler, 0.9) && s.precision == precision && s.active_set == active_set &&
         (usual_threshold || active_set != ActiveSet::kGrowth);
}

/// Symplectic Euler at 0.9 of the limit on every lattice, coarse to fine.
std::vector<const SweepResult*> spacingLine(const SceneResults& scene, ActiveSet active_set) {
  std::vector<const SweepResult*> line;
  for (const SweepResult& result : scene.results) {
    if (result.setting.preset.empty() && result.failure.empty() &&
        isLine(result.setting.simulation, Precision::kFloat, active_set))
      line.push_back(&result);
  }
  std::sort(line.begin(), line.end(),
            [](const SweepResult* a, const SweepResult* b) { return a->setting.spacing_m > b->setting.spacing_m; });
  return line;
}

// -------------------------------------------------------------------------------------------------------- the table

std::string thresholdText(const SimulationSettings& settings) {
  return settings.active_set == ActiveSet::kGrowth ? number(settings.activation_threshold) : "";
}

std::vector<std::string> settingTexts(const SweepResult& result) {
  const SimulationSettings& s = result.setting.simulation;
  return {number(1e3 * result.setting.spacing_m),
          nameOf(s.integrator),
          number(1e6 * result.dt_s),
          result.failure.empty() ? number(result.dt_s / result.limit_s) : "",
          isExplicit(s.integrator) ? number(s.dt_fraction) : "",
          nameOf(s.precision),
          nameOf(s.active_set),
          thresholdText(s),
          s.integrator == Integrator::kAdaptive ? number(s.error_tolerance) : "",
          nameOf(s.safe_move),
          nameOf(s.spring_rule),
          result.setting.preset,
          std::to_string(result.cells),
          std::to_string(result.vertices),
          number(result.mean_active_cells),
          number(1e3 * result.largest_displacement_m),
          std::to_string(result.limited_moves),
          std::to_string(result.repeats),
          result.same_lattice_error ? format("%.3g", 100.0 * *result.same_lattice_error) : ""};
}

TradeoffRow rowOf(const SceneResults& scene, const SweepResult& result) {
  TradeoffRow row;
  row.scene = scene.scene.name;
  row.settings = settingTexts(result);
  row.cost = result.ms_per_simulated_s;
  row.memory = std::round(10.0 * result.bytes_per_vertex) / 10.0;
  row.reference_error = result.reference_error;
  row.known_error = result.known_error;
  row.is_reference = result.setting.is_reference;
  if (result.setting.preset == kBaseline && result.setting.spacing_m == crossedSpacing(scene))
    row.preset = kBaseline;
  return row;
}

void namePresets(TradeoffTable& table, const std::string& scene) {
  for (const ErrorBudget& budget : kBudgets) {
    if (TradeoffRow* row = cheapestWithin(table, scene, budget.largest_error))
      row->preset += (row->preset.empty() ? "" : " ") + std::string(budget.preset);
  }
}

/// The result of the first scene that earned a name.
const SweepResult& namedResult(const std::vector<SceneResults>& scenes, const TradeoffTable& table,
                               const std::string& name) {
  for (std::size_t n = 0; n < scenes.front().results.size(); ++n) {
    if (table.rows[n].preset.find(name) != std::string::npos)
      return scenes.front().results[n];
  }
  return scenes.front().results.back();
}

// ------------------------------------------------------------------------------------------------------- the report

/// `integrator`, step and the rest of a setting, in the words of a scene file.
std::string settingText(const SweepResult& result) {
  const SimulationSettings& s = result.setting.simulation;
  std::string text = format("`%s`, dt %s ms (%s of the limit), `%s`, active set `%s`", nameOf(s.integrator),
                            number(1e3 * result.dt_s).c_str(), number(result.dt_s / result.limit_s).c_str(),
                            nameOf(s.precision), nameOf(s.active_set));
  if (s.active_set == ActiveSet::kGrowth)
    text += ", threshold " + number(s.activation_threshold);
  return text;
}

std::string realTimeText(const SweepResult& result) {
  const double factor = 1e3 / result.ms_per_simulated_s;
  return factor >= 1.0 ? format("%s times faster than real time on one core", number(factor).c_str())
                       : format("%s times slower than real time on one core", number(1.0 / factor).c_str());
}

std::string needOf(const char* preset) {
  const std::string name = preset;
  if (name == "fast")
    return "Feeling and showing: haptics, a first look, many instruments at once";
  if (name == "balanced")
    return "Planning and training: what is seen and felt is right";
  return "Measuring and validating: numbers go into a paper";
}

std::string presetTable(const std::vector<SceneResults>& scenes, const TradeoffTable& table) {
  std::string text =
      "| need | preset | lattice | setting | error | ms per simulated second | memory |\n"
      "|---|---|---|---|---|---|---|\n";
  const auto line = [&](const std::string& need, const std::string& name, const SweepResult& result) {
    text += format("| %s | `%s` | %s mm, %zu cells | %s | %s | %s | %s MiB |\n", need.c_str(), name.c_str(),
                   number(1e3 * result.setting.spacing_m).c_str(), result.cells, settingText(result).c_str(),
                   percent(error(result)).c_str(), number(result.ms_per_simulated_s).c_str(),
                   number(memoryMib(result)).c_str());
  };
  for (const ErrorBudget& budget : kBudgets)
    line(needOf(budget.preset), budget.preset, namedResult(scenes, table, budget.preset));
  const SweepResult* baseline = presetOn(scenes.front(), kBaseline, crossedSpacing(scenes.front()));
  if (baseline != nullptr)
    line("Comparing with the dissertation", kBaseline, *baseline);
  return text;
}

std::string presetWords(const std::vector<SceneResults>& scenes, const TradeoffTable& table) {
  std::string text;
  for (const ErrorBudget& budget : kBudgets) {
    const SweepResult& result = namedResult(scenes, table, budget.preset);
    const bool within = error(result) <= budget.largest_error;
    text += format("- `%s` is %s. ", budget.preset, realTimeText(result).c_str());
    text += within ? format("It is the cheapest setting within %s of the reference.\n",
                            percent(budget.largest_error).c_str())
                   : format("No setting came within %s of the reference; this is the most exact one.\n",
                            percent(budget.largest_error).c_str());
  }
  return text;
}

/// Settings of the shipped presets on a lattice.
std::string shippedPresets(const SceneResults& scene) {
  const double spacing_m = crossedSpacing(scene);
  std::string text = format(
      "| preset in the scene file | error at %s mm | of it not due to the spacing | ms per simulated second |\n"
      "|---|---|---|---|\n",
      number(1e3 * spacing_m).c_str());
  for (const SweepResult& result : scene.results) {
    if (result.setting.preset.empty() || result.setting.spacing_m != spacing_m)
      continue;
    text += format("| `%s` | %s | %s | %s |\n", result.setting.preset.c_str(), percent(error(result)).c_str(),
                   percent(result.same_lattice_error).c_str(),
                   result.failure.empty() ? number(result.ms_per_simulated_s).c_str() : result.failure.c_str());
  }
  return text;
}

/// How much the error falls and the cost rises when the spacing is halved, from the ends of a line.
std::string orderWords(const std::vector<const SweepResult*>& line) {
  if (line.size() < 2)
    return "";
  const SweepResult& coarse = *line.front();
  const SweepResult& fine = *line.back();
  const double halvings = std::log2(coarse.setting.spacing_m / fine.setting.spacing_m);
  const double error_factor = std::pow(error(coarse) / error(fine), 1.0 / halvings);
  const double cost_factor = std::pow(fine.ms_per_simulated_s / coarse.ms_per_simulated_s, 1.0 / halvings);
  return format("Each halving of the spacing divides the error by %s and multiplies the cost by %s.\n",
                number(error_factor).c_str(), number(cost_factor).c_str());
}

std::string spacingSection(const SceneResults& scene) {
  const std::vector<const SweepResult*> line = spacingLine(scene, ActiveSet::kAll);
  std::string text =
      "| spacing | cells | error | ms per simulated second | bytes per vertex |\n|---|---|---|---|---|\n";
  for (const SweepResult* result : line) {
    text += format("| %s mm | %zu | %s | %s | %s |\n", number(1e3 * result->setting.spacing_m).c_str(), result->cells,
                   percent(error(*result)).c_str(), number(result->ms_per_simulated_s).c_str(),
                   number(result->bytes_per_vertex).c_str());
  }
  return text + "\n(`symplectic_euler`, 0.9 of the limit, `float`, active set `all`.) " + orderWords(line);
}

std::string steppingLabel(const SimulationSettings& s) {
  if (s.integrator == Integrator::kAdaptive)
    return format("`%s`, tolerance %s", nameOf(s.integrator), number(s.error_tolerance).c_str());
  return format("`%s`", nameOf(s.integrator));
}

std::string integratorSection(const SceneResults& scene) {
  const std::vector<const SweepResult*> rows = onLattice(scene, crossedSpacing(scene), [](const SimulationSettings& s) {
    return s.active_set == ActiveSet::kAll && s.precision == Precision::kDouble;
  });
  std::string text =
      "| integrator | dt, ms | of the limit | error | of it not due to the spacing | ms per simulated second |\n"
      "|---|---|---|---|---|---|\n";
  for (const SweepResult* row : rows) {
    text +=
        format("| %s | %s | %s | %s | %s | %s |\n", steppingLabel(row->setting.simulation).c_str(),
               number(1e3 * row->dt_s).c_str(), number(row->dt_s / row->limit_s).c_str(), percent(error(*row)).c_str(),
               percent(row->same_lattice_error).c_str(), number(row->ms_per_simulated_s).c_str());
  }
  return text + format("\n(%s mm, `double`, active set `all`.)\n", number(1e3 * crossedSpacing(scene)).c_str());
}

/// What the cheapest way of stepping is that adds next to nothing to the error of the spacing.
std::string integratorWords(const SceneResults& scene) {
  const std::vector<const SweepResult*> rows = onLattice(scene, crossedSpacing(scene), [](const SimulationSettings& s) {
    return s.active_set == ActiveSet::kAll && s.precision == Precision::kDouble;
  });
  const SweepResult* best = nullptr;
  const SweepResult* most_exact = nullptr;
  for (const SweepResult* row : rows) {
    if (!row->same_lattice_error)
      continue;
    const bool negligible = *row->same_lattice_error < 0.1 * error(*row);
    if (negligible && (best == nullptr || row->ms_per_simulated_s < best->ms_per_simulated_s))
      best = row;
    if (most_exact == nullptr || *row->same_lattice_error < *most_exact->same_lattice_error)
      most_exact = row;
  }
  if (best == nullptr || most_exact == nullptr)
    return "No way of stepping keeps its own error below a tenth of the spacing's: refine the step before the "
           "lattice.\n";
  return format(
      "The cheapest way of stepping whose own error is less than a tenth of the whole is %s at dt = %s ms. The most "
      "exact "
      "one, %s at dt = %s ms, costs %s times as much and changes the answer by %s: on this lattice that is paid for "
      "nothing.\n",
      steppingLabel(best->setting.simulation).c_str(), number(1e3 * best->dt_s).c_str(),
      steppingLabel(most_exact->setting.simulation).c_str(), number(1e3 * most_exact->dt_s).c_str(),
      number(most_exact->ms_per_simulated_s / best->ms_per_simulated_s).c_str(),
      percent(best->same_lattice_error).c_str());
}

std::string activeSetSection(const SceneResults& scene) {
  const std::vector<const SweepResult*> rows = onLattice(scene, crossedSpacing(scene), [](const SimulationSettings& s) {
    return sameSettings(s, Integrator::kSymplecticEuler, 0.9) && s.precision == Precision::kFloat;
  });
  std::string text =
      "| active set | cells in the solve, mean | error | of it not due to the spacing | ms per simulated second |\n"
      "|---|---|---|---|---|\n";
  for (const SweepResult* row : rows) {
    const SimulationSettings& s = row->setting.simulation;
    const std::string threshold = s.active_set == ActiveSet::kGrowth ? ", threshold " + thresholdText(s) : "";
    text += format("| `%s`%s | %s of %zu | %s | %s | %s |\n", nameOf(s.active_set), threshold.c_str(),
                   number(row->mean_active_cells).c_str(), row->cells, percent(error(*row)).c_str(),
                   percent(row->same_lattice_error).c_str(), number(row->ms_per_simulated_s).c_str());
  }
  return text + format("\n(%s mm, `symplectic_euler`, 0.9 of the limit, `float`.)\n",
                       number(1e3 * crossedSpacing(scene)).c_str());
}

/// Compares pairs of results that differ in precision alone.
std::string precisionWords(const SceneResults& scene) {
  double largest_change = 0.0;
  std::vector<double> cost_ratios;
  std::vector<double> memory_ratios;
  for (std::size_t n = 0; n + 1 < scene.results.size(); ++n) {
    const SweepResult& single = scene.results[n];
    const SweepResult& twice = scene.results[n + 1];
    const bool pair = single.setting.preset.empty() && single.setting.simulation.precision == Precision::kFloat &&
                      single.failure.empty() && twice.failure.empty() && std::isfinite(error(single));
    if (!pair)
      continue;
    largest_change = std::max(largest_change, std::abs(error(single) - error(twice)));
    cost_ratios.push_back(twice.ms_per_simulated_s / single.ms_per_simulated_s);
    memory_ratios.push_back(twice.bytes_per_vertex / single.bytes_per_vertex);
  }
  if (cost_ratios.empty())
    return "";
  std::sort(cost_ratios.begin(), cost_ratios.end());
  std::sort(memory_ratios.begin(), memory_ratios.end());
  return format(
      "In %zu pairs of settings that differ in precision alone, `double` costs %s times as much (median) and %s times "
      "the "
      "memory; the error changes by %s of the largest displacement at most.\n",
      cost_ratios.size(), number(cost_ratios[cost_ratios.size() / 2]).c_str(),
      number(memory_ratios[memory_ratios.size() / 2]).c_str(), percent(largest_change).c_str());
}

std::string baselineWords(const std::vector<SceneResults>& scenes, TradeoffTable table) {
  const SceneResults& scene = scenes.front();
  const SweepResult* baseline = presetOn(scene, kBaseline, crossedSpacing(scene));
  if (baseline == nullptr)
    return "The dissertation's method refused the scene.\n";
  std::string text =
      format("On the %s mm lattice the dissertation's method is off by %s at %s ms per simulated second. ",
             number(1e3 * baseline->setting.spacing_m).c_str(), percent(error(*baseline)).c_str(),
             number(baseline->ms_per_simulated_s).c_str());
  const TradeoffRow* same = cheapestWithin(table, scene.scene.name, error(*baseline));
  const SweepResult& ours = scene.results[static_cast<std::size_t>(same - table.rows.data())];
  if (same->preset != kBaseline) {
    text += format("Our cheapest setting that is at least as exact (%s mm, %s: %s) costs %s, %s times less.",
                   number(1e3 * ours.setting.spacing_m).c_str(), settingText(ours).c_str(),
                   percent(error(ours)).c_str(), number(ours.ms_per_simulated_s).c_str(),
                   number(baseline->ms_per_simulated_s / ours.ms_per_simulated_s).c_str());
  } else {
    text += "Nothing of ours is as exact and cheaper.";
  }
  return text + "\n";
}

/// The next coarser lattice with the reference's or the line's settings says how good the reference is.
std::string referenceWords(const SceneResults& scene) {
  const SweepResult& reference = scene.results.back();
  const std::vector<const SweepResult*> line = spacingLine(scene, ActiveSet::kAll);
  if (line.empty())
    return "";
  const SweepResult& next = *line.back();
  const double ratio = next.setting.spacing_m / reference.setting.spacing_m;
  const double left = next.reference_error / (ratio * ratio - 1.0);
  return format(
      "The reference has %s mm, %zu cells, `runge_kutta_4` at %s of the limit, `double`, everything in the solve. A "
      "lattice "
      "of %s mm differs from it by %s; with an error that falls with the square of the spacing, as it does here or "
      "nearly so, the reference itself is off by about %s, so smaller differences from it mean little.\n",
      number(1e3 * reference.setting.spacing_m).c_str(), reference.cells,
      number(reference.dt_s / reference.limit_s).c_str(), number(1e3 * next.setting.spacing_m).c_str(),
      percent(next.reference_error).c_str(), percent(left).c_str());
}

/// What reaches a known static answer cheapest on one lattice.
std::string staticsSection(const SceneResults& scene) {
  std::string text = spacingSection(scene) + "\n" + integratorSection(scene);
  const std::vector<const SweepResult*> rows = onLattice(
      scene, crossedSpacing(scene), [](const SimulationSettings& s) { return s.active_set == ActiveSet::kAll; });
  const SweepResult* cheapest = nullptr;
  for (const SweepResult* row : rows) {
    const bool rests = row->same_lattice_error && *row->same_lattice_error < 0.01;
    if (rests && (cheapest == nullptr || row->ms_per_simulated_s < cheapest->ms_per_simulated_s))
      cheapest = row;
  }
  if (cheapest != nullptr) {
    text += format("\nCheapest within 1 %% of the resting state of the same lattice: %s, `%s`, dt = %s ms.\n",
                   steppingLabel(cheapest->setting.simulation).c_str(), nameOf(cheapest->setting.simulation.precision),
                   number(1e3 * cheapest->dt_s).c_str());
  }
  return text;
}

std::string refusedWords(const SceneResults& scene) {
  std::map<std::string, int> reasons;
  for (const SweepResult& result : scene.results) {
    if (!result.failure.empty())
      ++reasons[result.failure];
  }
  std::string text;
  for (const auto& reason : reasons)
    text += format("%d settings were refused: %s\n", reason.second, reason.first.c_str());
  return text;
}

}  // namespace

TradeoffTable simulationTable(const std::vector<SceneResults>& scenes) {
  TradeoffTable table;
  table.setting_names = settingNames();
  table.cost_name = "ms_per_simulated_s";
  table.memory_name = "bytes_per_vertex";
  for (const SceneResults& scene : scenes) {
    for (const SweepResult& result : scene.results)
      table.rows.push_back(rowOf(scene, result));
  }
  markFront(table);
  namePresets(table, scenes.front().scene.name);
  return table;
}

TradeoffPlot simulationPlot(const std::vector<SceneResults>& scenes, const std::string& png_path) {
  TradeoffPlot plot;
  plot.png_path = png_path;
  plot.title = "Simulation: what exactness costs, one core";
  plot.cost_label = "cost: ms of computing per simulated second (left of 1000: faster than real time)";
  plot.colour_setting = kSpacingSetting;
  plot.colour_unit = " mm lattice";
  plot.shape_setting = kIntegratorSetting;
  for (const SceneResults& scene : scenes) {
    const std::string compared = scene.scene.known ? scene.scene.known->source : "the converged reference";
    plot.panels.push_back({scene.scene.name, scene.scene.name + ": error against " + compared, "error"});
  }
  return plot;
}

std::string simulationReport(const std::vector<SceneResults>& scenes, const TradeoffTable& table) {
  const SceneResults& moving = scenes.front();
  std::string text = "# What a faster or a more exact simulation costs\n\n";
  text +=
      "Made by `soft_volume_tradeoff --simulation` on one core of " + processorName() + ", compiled by " + __VERSION__ +
      ". All settings are in `simulation.csv`, the picture is `simulation.png`. Costs are processor time, medians of "
      "interleaved repeats. Errors are root mean squares as a fraction of the largest displacement.\n\n";
  text += "![error against cost](simulation.png)\n\n## What to choose\n\n" + presetTable(scenes, table) + "\n" +
          presetWords(scenes, table) + "\n";
  text += "## The scene\n\n" + moving.scene.description + "\n\n" + referenceWords(moving) + "\n";
  text += "## Lattice spacing\n\n" + spacingSection(moving) + "\n";
  text += "## Integrator and step\n\n" + integratorSection(moving) + "\n" + integratorWords(moving) + "\n";
  text += "## Active set\n\n" + activeSetSection(moving) + "\n";
  text += "## Float or double\n\n" + precisionWords(moving) + "\n";
  text += "## Presets of the scene file\n\nA preset does not choose the lattice.\n\n" + shippedPresets(moving) + "\n";
  text += "## The dissertation's method\n\n" + baselineWords(scenes, table) + "\n";
  for (std::size_t n = 1; n < scenes.size(); ++n)
    text += "## Statics: " + scenes[n].scene.name + "\n\n" + scenes[n].scene.description + "\n\n" +
            staticsSection(scenes[n]) + "\n";
  for (const SceneResults& scene : scenes)
    text += refusedWords(scene);
  return text;
}

}  // namespace soft_volume::core
