#include "tradeoff_table.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <set>
#include <sstream>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
/// What is less than 1 % more exact than something cheaper is no step of the front.
constexpr double kWorthwhile = 0.99;
constexpr const char* kColours[] = {"#4477aa", "#66ccee", "#228833", "#ccbb44", "#ee6677", "#aa3377",
                                    "#bbbbbb", "#222255", "#dd8833", "#999933", "#663300", "#44bb99"};
constexpr int kShapes[] = {7, 5, 9, 13, 11, 15, 4, 6};  ///< gnuplot's filled shapes first

bool drawable(const TradeoffRow& row) {
  return std::isfinite(row.error()) && row.error() > 0.0 && std::isfinite(row.cost) && row.cost > 0.0;
}

bool hasPanel(const TradeoffPlot& plot, const std::string& scene) {
  return std::any_of(plot.panels.begin(), plot.panels.end(),
                     [&](const TradeoffPanel& panel) { return panel.scene == scene; });
}

/// The values that a setting takes in what is drawn, numbers in increasing order.
std::vector<std::string> distinctValues(const TradeoffTable& table, const TradeoffPlot& plot, std::size_t setting) {
  const auto before = [](const std::string& a, const std::string& b) {
    char* end = nullptr;
    const double x = std::strtod(a.c_str(), &end);
    const bool number = end != a.c_str();
    const double y = std::strtod(b.c_str(), nullptr);
    return number && x != y ? x < y : a < b;
  };
  std::set<std::string, decltype(before)> values(before);
  for (const TradeoffRow& row : table.rows) {
    if (drawable(row) && hasPanel(plot, row.scene))
      values.insert(row.settings[setting]);
  }
  return {values.begin(), values.end()};
}

std::size_t indexOf(const std::vector<std::string>& values, const std::string& value) {
  return static_cast<std::size_t>(std::find(values.begin(), values.end(), value) - values.begin());
}

const char* colour(std::size_t index) {
  return kColours[index % std::size(kColours)];
}

int shape(std::size_t index) {
  return kShapes[index % std::size(kShapes)];
}

std::string inUnit(double error, const ErrorUnit& unit) {
  std::ostringstream text;
  text << unit.scale * error;
  return text.str();
}

/// The script's strings stand in double quotes.
std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\')
      result += '\\';
    result += c;
  }
  return result + "\"";
}

/// 1, 2 and 5 times the powers of ten between two numbers, as gnuplot's labels of an axis.
std::string ticks(double low, double high) {
  std::ostringstream text;
  const char* separator = "";
  for (double decade = std::pow(10.0, std::floor(std::log10(low))); decade <= high; decade *= 10.0) {
    for (const double factor : {1.0, 2.0, 5.0}) {
      if (factor * decade < low || factor * decade > high)
        continue;
      text << separator << factor * decade;
      separator = ", ";
    }
  }
  return text.str();
}

/// Rows of a scene that can be drawn, by increasing cost.
std::vector<const TradeoffRow*> drawableRows(const TradeoffTable& table, const std::string& scene) {
  std::vector<const TradeoffRow*> rows;
  for (const TradeoffRow& row : table.rows) {
    if (row.scene == scene && drawable(row))
      rows.push_back(&row);
  }
  std::sort(rows.begin(), rows.end(), [](const TradeoffRow* a, const TradeoffRow* b) { return a->cost < b->cost; });
  return rows;
}

/// Writes one panel: its data, the labels of the named rows, the points and a legend of colours and shapes.
class PanelWriter {
 public:
  PanelWriter(std::ostream& script, const TradeoffTable& table, const TradeoffPlot& plot, std::size_t index)
      : script_(script),
        plot_(plot),
        scale_(table.error_unit.scale),
        panel_(plot.panels[index]),
        suffix_(std::to_string(index)),
        rows_(drawableRows(table, panel_.scene)),
        colours_(distinctValues(table, plot, plot.colour_setting)),
        shapes_(distinctValues(table, plot, plot.shape_setting)) {}

  void write() {
    writeData("$all", false);
    writeData("$front", true);
    writeLabels();
    writeRanges();
    script_ << "set title " << quoted(panel_.title) << "\nset ylabel " << quoted(panel_.error_label) << "\nplot \\\n"
            << "  $front" << suffix_ << " using 1:2 with lines lw 2 lc rgb \"black\" title \"Pareto front\", \\\n"
            << "  $all" << suffix_ << " using 1:2:3:4 with points pt variable lc rgb variable ps 1.2 notitle, \\\n"
            << "  $front" << suffix_ << " using 1:2 with points pt 6 ps 2.2 lw 1.5 lc rgb \"black\" notitle";
    writeLegend();
    script_ << "\n";
  }

 private:
  void writeData(const std::string& name, bool front_only) {
    script_ << name << suffix_ << " << EOD\n";
    for (const TradeoffRow* row : rows_) {
      if (front_only && !row->on_front)
        continue;
      script_ << row->cost << " " << scale_ * row->error() << " "
              << shape(indexOf(shapes_, row->settings[plot_.shape_setting])) << " 0x"
              << colour(indexOf(colours_, row->settings[plot_.colour_setting])) + 1 << "\n";
    }
    script_ << "EOD\n";
  }

  /// Above and below in turns, so that neighbours on the front do not cover each other's names.
  void writeLabels() {
    script_ << "unset label\n";
    bool above = true;
    for (const TradeoffRow* row : rows_) {
      if (row->preset.empty())
        continue;
      script_ << "set label " << quoted(row->preset) << " at " << row->cost << "," << scale_ * row->error()
              << " left front font \",15\" offset 0.8," << (above ? "1.1" : "-1.1")
              << " point pt 2 ps 2.2 lw 3 lc rgb \"black\"\n";
      above = !above;
    }
  }

  /// Automatic ranges go to whole decades, which leaves the points little room.
  void writeRanges() {
    double least_cost = kInfinity;
    double most_cost = 0.0;
    double least_error = kInfinity;
    double most_error = 0.0;
    for (const TradeoffRow* row : rows_) {
      least_cost = std::min(least_cost, row->cost);
      most_cost = std::max(most_cost, row->cost);
      least_error = std::min(least_error, scale_ * row->error());
      most_error = std::max(most_error, scale_ * row->error());
    }
    if (rows_.empty())
      return;
    writeRange("x", least_cost / 1.5, most_cost * 2.5);
    writeRange("y", least_error / 1.5, most_error * 1.5);
  }

  void writeRange(const char* axis, double low, double high) {
    script_ << "set " << axis << "range [" << low << ":" << high << "]\nset " << axis << "tics (" << ticks(low, high)
            << ")\n";
  }

  void writeLegend() {
    for (std::size_t n = 0; n < colours_.size(); ++n) {
      script_ << ", \\\n  NaN with points pt 5 ps 1.6 lc rgb \"" << colour(n) << "\" title "
              << quoted(colours_[n] + plot_.colour_unit);
    }
    for (std::size_t n = 0; n < shapes_.size(); ++n) {
      script_ << ", \\\n  NaN with points pt " << shape(n) << " ps 1.4 lc rgb \"#555555\" title " << quoted(shapes_[n]);
    }
  }

  std::ostream& script_;
  const TradeoffPlot& plot_;
  double scale_;
  const TradeoffPanel& panel_;
  std::string suffix_;
  std::vector<const TradeoffRow*> rows_;
  std::vector<std::string> colours_;
  std::vector<std::string> shapes_;
};

}  // namespace

void markFront(TradeoffTable& table) {
  std::vector<TradeoffRow*> by_cost;
  for (TradeoffRow& row : table.rows) {
    row.on_front = false;
    if (!row.is_reference)
      by_cost.push_back(&row);
  }
  std::sort(by_cost.begin(), by_cost.end(), [](const TradeoffRow* a, const TradeoffRow* b) {
    return a->cost != b->cost ? a->cost < b->cost : a->error() < b->error();
  });
  std::map<std::string, double> least_error;
  for (TradeoffRow* row : by_cost) {
    double& least = least_error.try_emplace(row->scene, kInfinity).first->second;
    row->on_front = row->error() < kWorthwhile * least;
    if (row->on_front)
      least = row->error();
  }
}

TradeoffRow* cheapestWithin(TradeoffTable& table, const std::string& scene, double largest_error) {
  TradeoffRow* cheapest = nullptr;
  TradeoffRow* most_exact = nullptr;
  for (TradeoffRow& row : table.rows) {
    if (row.scene != scene || row.is_reference)
      continue;
    if (row.error() <= largest_error && (cheapest == nullptr || row.cost < cheapest->cost))
      cheapest = &row;
    if (most_exact == nullptr || row.error() < most_exact->error())
      most_exact = &row;
  }
  return cheapest != nullptr ? cheapest : most_exact;
}

void writeCsv(const TradeoffTable& table, const std::string& path) {
  std::ofstream file(path);
  file << "scene";
  for (const std::string& name : table.setting_names)
    file << "," << name;
  file << ",error_reference_" << table.error_unit.name << ",error_known_" << table.error_unit.name << ","
       << table.cost_name << "," << table.memory_name << ",on_front,preset\n";
  for (const TradeoffRow& row : table.rows) {
    file << row.scene;
    for (const std::string& value : row.settings)
      file << "," << value;
    file << "," << inUnit(row.reference_error, table.error_unit) << ","
         << (row.known_error ? inUnit(*row.known_error, table.error_unit) : "") << "," << row.cost << "," << row.memory
         << "," << (row.on_front ? 1 : 0) << "," << row.preset << "\n";
  }
  file.close();
  if (!file)
    throw FileError(path + ": the table cannot be written");
}

std::string plotScript(const TradeoffTable& table, const TradeoffPlot& plot) {
  const std::size_t columns = plot.panels.size() <= 3 ? plot.panels.size() : 2;
  const std::size_t rows = (plot.panels.size() + columns - 1) / columns;
  std::ostringstream script;
  script << "set terminal pngcairo noenhanced size " << 1000 * columns << "," << 900 * rows
         << " font \"DejaVu Sans,13\"\nset output " << quoted(plot.png_path) << "\n"
         << "set multiplot layout " << rows << "," << columns << " title " << quoted(plot.title) << " font \",17\"\n"
         << "set logscale xy\nset grid xtics ytics mxtics "
            "mytics lc rgb \"#cccccc\", lc rgb \"#eeeeee\"\n"
         << "set xlabel " << quoted(plot.cost_label) << "\nset key outside bottom center horizontal\n"
         << "set format x \"%g\"\nset format y " << quoted(table.error_unit.axis_format) << "\n";
  for (std::size_t index = 0; index < plot.panels.size(); ++index)
    PanelWriter(script, table, plot, index).write();
  script << "unset multiplot\n";
  return script.str();
}

}  // namespace soft_volume::core
