#include "report_plots.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <iterator>

#include "plot.h"
#include "report_page.h"

namespace soft_volume::replay_program {
namespace {

constexpr const char* kFirstColours[] = {"#1f5fa8", "#5b9bd5", "#0b3a6f", "#8db9e0"};
constexpr const char* kSecondColours[] = {"#d2600f", "#f0a15e", "#8f3c00", "#f5c49b"};

/// In double quotes for gnuplot, which would take some letters for commands.
std::string quoted(const std::string& text) {
  std::string word = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\' || c == '`')
      word += '\'';
    else
      word += static_cast<unsigned char>(c) < 0x20 ? ' ' : c;
  }
  return word + "\"";
}

/// A pause that is so much longer than usual parts a curve: between two contacts there is no force to draw.
double longestStep(const Curve& curve) {
  std::vector<double> steps_s;
  for (std::size_t n = 1; n < curve.times_s.size(); ++n)
    steps_s.push_back(curve.times_s[n] - curve.times_s[n - 1]);
  if (steps_s.empty())
    return HUGE_VAL;
  std::nth_element(steps_s.begin(), steps_s.begin() + std::ptrdiff_t(steps_s.size() / 2), steps_s.end());
  return 10.0 * steps_s[steps_s.size() / 2] + 1e-9;
}

std::string dataBlock(const std::string& name, const Curve& curve) {
  std::string text = "$" + name + " << EOD\n";
  const double longest_s = longestStep(curve);
  for (std::size_t n = 0; n < curve.values.size(); ++n) {
    if (n > 0 && curve.times_s[n] - curve.times_s[n - 1] > longest_s)
      text += "\n";
    if (std::isfinite(curve.values[n]))
      text += number(curve.times_s[n], 9) + " " + number(curve.values[n], 6) + "\n";
  }
  return text + "EOD\n";
}

std::string styleOf(const Curve& curve) {
  const char* colour = (curve.second ? kSecondColours : kFirstColours)[curve.dash % 4];
  return std::string("with lines linewidth 1.6 linecolor rgb '") + colour + "'" +
         (curve.second ? " dashtype (12,4)" : "");
}

std::string scriptOf(const Plot& plot, const std::string& path) {
  std::string script = "reset\nset output " + quoted(path) + "\nset title " + quoted(plot.title) + " noenhanced\n";
  script += "set xlabel 'simulated time [s]'\nset ylabel " + quoted("[" + plot.unit + "]") + " noenhanced\n";
  script += "set grid linecolor rgb '#dfe4ea'\nset border 3 linecolor rgb '#8a94a3'\nset tics nomirror\n";
  script += "set key outside top left horizontal noenhanced samplen 2\n";
  if (plot.from_zero)
    script += "set yrange [0:*]\n";
  std::string curves;
  for (std::size_t n = 0; n < plot.curves.size(); ++n) {
    const std::string name = "data" + std::to_string(n);
    script += dataBlock(name, plot.curves[n]);
    curves += (n > 0 ? ", " : "") + ("$" + name) + " using 1:2 " + styleOf(plot.curves[n]) + " title " +
              quoted(plot.curves[n].name);
  }
  return script + "plot " + curves + "\n";
}

bool hasPoints(const Plot& plot) {
  return std::any_of(plot.curves.begin(), plot.curves.end(), [](const Curve& c) { return c.values.size() > 1; });
}

}  // namespace

Curve thinned(const Curve& curve, std::size_t parts) {
  if (curve.values.size() <= parts)
    return curve;
  Curve thin{curve.name, curve.second, curve.dash, {}, {}};
  const double begin_s = curve.times_s.front();
  const double length_s = std::max(curve.times_s.back() - begin_s, 1e-12);
  std::size_t last_part = parts;
  for (std::size_t n = 0; n < curve.values.size(); ++n) {
    const double place = (curve.times_s[n] - begin_s) / length_s * double(parts);
    const auto part = std::min(parts - 1, static_cast<std::size_t>(std::max(place, 0.0)));
    if (part != last_part)
      thin.add(curve.times_s[n], curve.values[n]);
    else
      thin.values.back() = std::max(thin.values.back(), curve.values[n]);
    last_part = part;
  }
  return thin;
}

std::vector<std::string> drawPlots(const std::vector<Plot>& plots, const std::string& temporary_folder) {
  std::string script = "set terminal svg size 640,300 dynamic background '#ffffff' font 'DejaVu Sans,12'\n";
  std::vector<std::string> paths;
  for (Plot plot : plots) {
    if (!hasPoints(plot))
      continue;
    const auto empty = std::remove_if(plot.curves.begin(), plot.curves.end(), [](const Curve& c) {
      return std::none_of(c.values.begin(), c.values.end(), [](double v) { return std::isfinite(v); });
    });
    plot.curves.erase(empty, plot.curves.end());
    paths.push_back(temporary_folder + "/plot" + std::to_string(paths.size()) + ".svg");
    script += scriptOf(plot, paths.back());
  }
  if (paths.empty())
    return {};
  core::plotWithGnuplot(script + "set output\n");
  std::vector<std::string> drawings;
  for (const std::string& path : paths) {
    const std::vector<std::uint8_t> bytes = readBytesOf(path);
    drawings.emplace_back(bytes.begin(), bytes.end());
  }
  return drawings;
}

}  // namespace soft_volume::replay_program
