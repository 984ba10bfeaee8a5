#pragma once

#include <string>
#include <vector>

namespace soft_volume::replay_program {

/// A curve: values over time.
struct Curve {
  std::string name;
  bool second = false;  ///< of the second run: another colour, drawn above the first
  int dash = 0;         ///< number of the curve among those of its run
  std::vector<double> times_s;
  std::vector<double> values;

  void add(double time_s, double value) {
    times_s.push_back(time_s);
    values.push_back(value);
  }
};

struct Plot {
  std::string title;
  std::string unit;
  std::vector<Curve> curves;
  bool from_zero = true;  ///< the axis begins at 0
};

/// The largest value of every of so many equal parts of the time: a force of 1 kHz needs no point for each sample.
Curve thinned(const Curve& curve, std::size_t parts);

/// SVG texts, one for each plot that has a curve with two points or more. Throws core::Error without gnuplot.
std::vector<std::string> drawPlots(const std::vector<Plot>& plots, const std::string& temporary_folder);

}  // namespace soft_volume::replay_program
