#include "rendering_report.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <thread>

#include "report_text.h"
#include "soft_volume/render/option_names.h"

namespace soft_volume::core {
namespace {

struct ErrorBudget {
  const char* preset;
  double largest_error;  ///< levels
  const char* need;
};
constexpr ErrorBudget kBudgets[] = {{"preview", 4.0, "Turning and searching: a picture at once"},
                                    {"balanced", 1.0, "Looking: no eye tells it from the exact one"},
                                    {"faithful", 0.5, "Measuring and publishing without waiting for `exact`"}};

constexpr std::size_t kMethodSetting = 0;
constexpr std::size_t kSlicesSetting = 1;

const std::vector<std::string>& settingNames() {
  static const std::vector<std::string> names = {"method",   "slices",   "backend",         "lookup", "adaptive",
                                                 "boundary", "task",     "update",          "width",  "height",
                                                 "planes",   "polygons", "updated_percent", "frames"};
  return names;
}

// ------------------------------------------------------------------------------------------------ finding of results

const RenderOptions& optionsOf(const RenderingResult& result) {
  return result.setting.options;
}

bool isRegular(const RenderingResult& result) {
  const RenderOptions& o = optionsOf(result);
  return !o.adaptive && !o.exact_boundary && o.lookup == Lookup::kScalar;
}

/// A whole frame of the size that all options are tried at, the first in the list.
bool isUsual(const RenderingResults& c, const RenderingResult& result) {
  return result.setting.task == FrameTask::kView && result.setting.width == c.results.front().setting.width;
}

using Filter = std::function<bool(const RenderingResult&)>;

std::vector<const RenderingResult*> drawn(const RenderingResults& c, const Filter& filter) {
  std::vector<const RenderingResult*> found;
  for (const RenderingResult& result : c.results) {
    if (result.failure.empty() && filter(result))
      found.push_back(&result);
  }
  return found;
}

/// The result that differs from another in one respect, which `change` makes; null when it was not drawn.
const RenderingResult* changed(const RenderingResults& c, const RenderingResult& from,
                               const std::function<void(RenderingSetting&)>& change) {
  RenderingSetting wanted = from.setting;
  change(wanted);
  const auto found = drawn(c, [&](const RenderingResult& result) {
    const RenderingSetting& s = result.setting;
    return s.backend == wanted.backend && s.options.lookup == wanted.options.lookup &&
           s.options.slices == wanted.options.slices && s.options.adaptive == wanted.options.adaptive &&
           s.options.exact_boundary == wanted.options.exact_boundary && s.width == wanted.width &&
           s.task == wanted.task && s.full_redraw == wanted.full_redraw;
  });
  return found.empty() ? nullptr : found.front();
}

// -------------------------------------------------------------------------------------------------------- the table

/// Back end and what is not usual about it.
std::string methodText(const RenderingResult& result) {
  std::string text = nameOf(result.setting.backend);
  if (optionsOf(result).lookup == Lookup::kColour)
    text += " colour";
  if (optionsOf(result).adaptive)
    text += " adaptive";
  if (optionsOf(result).exact_boundary)
    text += " boundary";
  if (!result.setting.full_redraw)
    text += " incremental";
  return text;
}

bool isExact(const RenderingResult& result) {
  return result.setting.backend == Backend::kExact;
}

std::vector<std::string> settingTexts(const RenderingResult& result) {
  const RenderingSetting& s = result.setting;
  const bool touch = s.task == FrameTask::kTouch;
  return {methodText(result),
          isExact(result) ? "" : std::to_string(s.options.slices),
          nameOf(s.backend),
          nameOf(s.options.lookup),
          s.options.adaptive ? "adaptive" : "regular",
          s.options.exact_boundary || isExact(result) ? "exact" : "slice",
          touch ? "touch" : "view",
          s.full_redraw ? "full" : "incremental",
          std::to_string(s.width),
          std::to_string(s.height),
          std::to_string(result.planes),
          std::to_string(result.polygons),
          number(100.0 * result.updated_part),
          std::to_string(result.frames)};
}

/// Only what draws the same is compared.
std::string comparedName(const RenderingResults& c, const RenderingResult& result) {
  const RenderingSetting& s = result.setting;
  return format("%s %s %dx%d%s", c.rendering_case.scene->name.c_str(), c.rendering_case.function.name.c_str(), s.width,
                s.height, s.task == FrameTask::kTouch ? " touch" : "");
}

TradeoffRow rowOf(const RenderingResults& c, const RenderingResult& result) {
  TradeoffRow row;
  row.scene = comparedName(c, result);
  row.settings = settingTexts(result);
  row.cost = result.ms;
  row.memory = std::round(result.bytes / 1048576.0 * 10.0) / 10.0;
  row.reference_error = result.error_levels;
  row.is_reference = isExact(result);
  return row;
}

void namePresets(TradeoffTable& table, const std::string& scene) {
  for (const ErrorBudget& budget : kBudgets) {
    if (TradeoffRow* row = cheapestWithin(table, scene, budget.largest_error))
      row->preset += (row->preset.empty() ? "" : " ") + std::string(budget.preset);
  }
}

// ------------------------------------------------------------------------------------------------------- the report

std::string levels(double error) {
  return std::isfinite(error) ? number(error) : "-";
}

std::string settingText(const RenderingResult& result) {
  return format("`%s`, %d slices", methodText(result).c_str(), optionsOf(result).slices);
}

std::string titleOf(const RenderingResults& c) {
  return format("%s, %s", c.rendering_case.scene->name.c_str(), c.rendering_case.function.name.c_str());
}

/// The rows of a table start where the results of earlier cases end.
std::string chooseSection(const std::vector<RenderingResults>& cases, const TradeoffTable& table) {
  std::string text =
      "| grid, transfer function | need | name | setting | error, levels | ms a frame | frames/s | memory, MiB |\n"
      "|---|---|---|---|---|---|---|---|\n";
  std::size_t first_row = 0;
  for (const RenderingResults& c : cases) {
    for (const ErrorBudget& budget : kBudgets) {
      for (std::size_t n = 0; n < c.results.size(); ++n) {
        const TradeoffRow& row = table.rows[first_row + n];
        if (!isUsual(c, c.results[n]) || row.preset.find(budget.preset) == std::string::npos)
          continue;
        text += format("| %s | %s | `%s`%s | %s | %s | %s | %s | %s |\n", titleOf(c).c_str(), budget.need,
                       budget.preset, row.error() > budget.largest_error ? " (not reached)" : "",
                       settingText(c.results[n]).c_str(), levels(row.error()).c_str(), number(row.cost).c_str(),
                       number(1e3 / row.cost).c_str(), number(row.memory).c_str());
      }
    }
    first_row += c.results.size();
  }
  return text;
}

std::string budgetWords() {
  std::string text = "Each name is the cheapest setting whose error is within its bound:";
  for (const ErrorBudget& budget : kBudgets)
    text += format(" `%s` %s,", budget.preset, number(budget.largest_error).c_str());
  text.back() = '.';
  return text + " Levels are those of 8-bit images, 0 to 255.\n";
}

std::string scenesSection(const std::vector<RenderingResults>& cases, const std::vector<std::string>& skipped) {
  std::string text;
  for (std::size_t n = 0; n < cases.size(); ++n) {
    const RenderingScene& scene = *cases[n].rendering_case.scene;
    if (n == 0 || cases[n - 1].rendering_case.scene != &scene)
      text += "- `" + scene.name + "`: " + scene.description + "\n";
  }
  for (const std::string& reason : skipped)
    text += "- **Left out:** " + reason + "\n";
  const RenderingCase& first = cases.front().rendering_case;
  const RenderingSetting& setting = cases.front().results.front().setting;
  return text +
         format(
             "\nView `%s`, %d x %d pixels unless a table says otherwise, no light, all %u cores. The reference is "
             "`exact` at the same size.\n",
             first.view.name.c_str(), setting.width, setting.height, std::thread::hardware_concurrency());
}

/// Both back ends beside each other for every count of slices.
std::string slicesSection(const std::vector<RenderingResults>& cases) {
  std::string text =
      "| grid, transfer function | slices | `gl`: error | ms | `native`: error | ms | `gl` / `native` |\n"
      "|---|---|---|---|---|---|---|\n";
  for (const RenderingResults& c : cases) {
    for (const RenderingResult* gl : drawn(c, [&](const RenderingResult& r) {
           return isUsual(c, r) && isRegular(r) && r.setting.backend == Backend::kGl;
         })) {
      const RenderingResult* native = changed(c, *gl, [](RenderingSetting& s) { s.backend = Backend::kNative; });
      if (native == nullptr)
        continue;
      text += format("| %s | %d | %s | %s | %s | %s | %s |\n", titleOf(c).c_str(), optionsOf(*gl).slices,
                     levels(gl->error_levels).c_str(), number(gl->ms).c_str(), levels(native->error_levels).c_str(),
                     number(native->ms).c_str(), number(gl->ms / native->ms).c_str());
    }
    for (const RenderingResult* exact : drawn(c, [&](const RenderingResult& r) { return isUsual(c, r) && isExact(r); }))
      text += format("| %s | `exact` | | | 0 | %s | |\n", titleOf(c).c_str(), number(exact->ms).c_str());
  }
  return text;
}

/// A table of results with and without an option.
std::string optionSection(const std::vector<RenderingResults>& cases, const std::string& without,
                          const std::string& with, const Filter& has,
                          const std::function<void(RenderingSetting&)>& take) {
  std::string rows;
  for (const RenderingResults& c : cases) {
    for (const RenderingResult* result :
         drawn(c, [&](const RenderingResult& r) { return isUsual(c, r) && !isExact(r) && has(r); })) {
      const RenderingResult* other = changed(c, *result, take);
      if (other == nullptr)
        continue;
      rows += format("| %s | `%s` | %d | %s | %s | %s | %s |\n", titleOf(c).c_str(), nameOf(result->setting.backend),
                     optionsOf(*result).slices, levels(other->error_levels).c_str(), number(other->ms).c_str(),
                     levels(result->error_levels).c_str(), number(result->ms).c_str());
    }
  }
  if (rows.empty())
    return "No scene has a choice here.\n";
  return format(
             "| grid, transfer function | back end | slices | %s: error | ms | %s: error | ms |\n"
             "|---|---|---|---|---|---|---|\n",
             without.c_str(), with.c_str()) +
         rows;
}

std::string lookupSection(const std::vector<RenderingResults>& cases) {
  return optionSection(
      cases, "scalar", "colour", [](const RenderingResult& r) { return optionsOf(r).lookup == Lookup::kColour; },
      [](RenderingSetting& s) { s.options.lookup = Lookup::kScalar; });
}

std::string adaptiveSection(const std::vector<RenderingResults>& cases) {
  return optionSection(
      cases, "regular", "adaptive", [](const RenderingResult& r) { return optionsOf(r).adaptive; },
      [](RenderingSetting& s) { s.options.adaptive = false; });
}

std::string boundarySection(const std::vector<RenderingResults>& cases) {
  return optionSection(
      cases, "slices", "exact boundary", [](const RenderingResult& r) { return optionsOf(r).exact_boundary; },
      [](RenderingSetting& s) { s.options.exact_boundary = false; });
}

/// The most slices, up to 100, that more than one size was drawn with.
int slicesOfSizes(const RenderingResults& c) {
  int most = 0;
  for (const RenderingResult& a : c.results) {
    for (const RenderingResult& b : c.results) {
      const int slices = optionsOf(a).slices;
      if (!isExact(a) && !isExact(b) && a.setting.width != b.setting.width && slices == optionsOf(b).slices &&
          slices <= 100)
        most = std::max(most, slices);
    }
  }
  return most;
}

std::string sizeSection(const std::vector<RenderingResults>& cases) {
  std::string text =
      "| grid, transfer function | image | back end | slices | error | ms | ns a pixel "
      "|\n|---|---|---|---|---|---|---|\n";
  for (const RenderingResults& c : cases) {
    const int slices = slicesOfSizes(c);
    for (const RenderingResult* r : drawn(c, [&](const RenderingResult& r) {
           return r.setting.task == FrameTask::kView && isRegular(r) && !isExact(r) && optionsOf(r).slices == slices;
         })) {
      const double pixels = double(r->setting.width) * r->setting.height;
      text += format("| %s | %d x %d | `%s` | %d | %s | %s | %s |\n", titleOf(c).c_str(), r->setting.width,
                     r->setting.height, nameOf(r->setting.backend), slices, levels(r->error_levels).c_str(),
                     number(r->ms).c_str(), number(1e6 * r->ms / pixels).c_str());
    }
  }
  return text;
}

std::string updateSection(const std::vector<RenderingResults>& cases) {
  std::string text =
      "| grid, transfer function | back end | slices | of the image | full, ms | incremental, ms | full / incremental "
      "|\n"
      "|---|---|---|---|---|---|---|\n";
  for (const RenderingResults& c : cases) {
    for (const RenderingResult* part : drawn(c, [](const RenderingResult& r) { return !r.setting.full_redraw; })) {
      const RenderingResult* full = changed(c, *part, [](RenderingSetting& s) { s.full_redraw = true; });
      if (full == nullptr)
        continue;
      text += format("| %s | `%s` | %d | %s %% | %s | %s | %s |\n", titleOf(c).c_str(), nameOf(part->setting.backend),
                     optionsOf(*part).slices, number(100.0 * part->updated_part).c_str(), number(full->ms).c_str(),
                     number(part->ms).c_str(), number(full->ms / part->ms).c_str());
    }
  }
  return text;
}

std::string refusedWords(const std::vector<RenderingResults>& cases) {
  std::string text;
  for (const RenderingResults& c : cases) {
    for (const RenderingResult& result : c.results) {
      if (!result.failure.empty())
        text += format("- %s, %s was refused: %s\n", titleOf(c).c_str(), settingText(result).c_str(),
                       result.failure.c_str());
    }
  }
  return text;
}

}  // namespace

TradeoffTable renderingTable(const std::vector<RenderingResults>& cases) {
  TradeoffTable table;
  table.setting_names = settingNames();
  table.cost_name = "ms_per_frame";
  table.memory_name = "memory_mib";
  table.error_unit = {1.0, "levels", "%g"};
  std::vector<std::string> compared;
  for (const RenderingResults& c : cases) {
    for (const RenderingResult& result : c.results) {
      table.rows.push_back(rowOf(c, result));
      if (std::find(compared.begin(), compared.end(), table.rows.back().scene) == compared.end())
        compared.push_back(table.rows.back().scene);
    }
  }
  markFront(table);
  for (const std::string& name : compared)
    namePresets(table, name);
  return table;
}

TradeoffPlot renderingPlot(const std::vector<RenderingResults>& cases, const std::string& png_path) {
  TradeoffPlot plot;
  plot.png_path = png_path;
  plot.title = "Rendering: what exactness costs";
  plot.cost_label = "cost: ms a frame";
  plot.colour_setting = kSlicesSetting;
  plot.colour_unit = " slices";
  plot.shape_setting = kMethodSetting;
  for (const RenderingResults& c : cases)
    plot.panels.push_back({comparedName(c, c.results.front()), titleOf(c), "RMSE against exact, 8-bit levels"});
  return plot;
}

std::string renderingReport(const std::vector<RenderingResults>& cases, const TradeoffTable& table,
                            const std::vector<std::string>& skipped) {
  std::string text = "# What a faster or a more exact picture costs\n\n";
  text += "Made by `soft_volume_tradeoff --rendering` on " + processorName() + ", compiled by " + __VERSION__ +
          ". All settings are in `rendering.csv`, the picture is `rendering.png`. Costs are wall time of a frame, "
          "medians of interleaved repeats. Errors are root mean squares over the pixels that are not black, in 8-bit "
          "levels, of images that are not rounded.\n\n";
  text += "![error against cost](rendering.png)\n\n## What to choose\n\n" + chooseSection(cases, table) + "\n" +
          budgetWords() + "\n";
  text += "## The scenes\n\n" + scenesSection(cases, skipped) + "\n";
  text += "## Slices and back ends\n\n" + slicesSection(cases) + "\n";
  text += "## Look-up\n\n" + lookupSection(cases) + "\n";
  text += "## Adaptive or regular\n\n" + adaptiveSection(cases) + "\n";
  text += "## Exact boundary\n\n" + boundarySection(cases) + "\n";
  text += "## Size of the image\n\n" + sizeSection(cases) + "\n";
  text += "## Incremental or full\n\n" + updateSection(cases) + "\n";
  const std::string refused = refusedWords(cases);
  return refused.empty() ? text : text + "## Refused\n\n" + refused;
}

}  // namespace soft_volume::core
