#include "report_curves.h"

#include <geometry_msgs/WrenchStamped.h>
#include <soft_volume/ToolForce.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "report_frames.h"
#include "soft_volume/messages/conversions.h"

namespace soft_volume::replay_program {
namespace {

/// As many as a plot has pixels, about.
constexpr std::size_t kParts = 500;

std::string named(const ReportedRun& run, const std::string& what) {
  return run.name.empty() || what.empty() ? run.name + what : run.name + ": " + what;
}

Curve newCurve(const ReportedRun& run, const std::string& what, int dash) {
  return {named(run, what), run.second, dash, {}, {}};
}

void addDisplacement(const ReportedRun& reported, Plot& plot) {
  const RecordedRun& run = *reported.run;
  Curve curve = newCurve(reported, "", 0);
  for (std::size_t n = 0; n < run.states().size(); ++n) {
    if (const std::optional<double> largest_m = largestDisplacement(run, n))
      curve.add(reported.begin_s + run.states()[n].time_s, 1e3 * *largest_m);
  }
  plot.curves.push_back(std::move(curve));
}

/// A curve for each name, in the order of the names.
class NamedCurves {
 public:
  explicit NamedCurves(const ReportedRun& run)
      : run_(&run), end_s_(run.run->states().empty() ? HUGE_VAL : run.run->states().back().time_s) {}
  /// Messages may hold any number, and a stamp of zero or of another clock.
  void add(const std::string& name, double time_s, double value) {
    const bool within = time_s > -kMargin_s && time_s < end_s_ + kMargin_s;
    if (!within || !std::isfinite(value))
      return;
    const auto curve = curves_.emplace(name, newCurve(*run_, name, int(curves_.size()))).first;
    curve->second.add(run_->begin_s + time_s, value);
  }
  void giveTo(Plot& plot) const {
    for (const auto& [name, curve] : curves_)
      plot.curves.push_back(thinned(curve, kParts));
  }

 private:
  static constexpr double kMargin_s = 1.0;
  const ReportedRun* run_;
  double end_s_;
  std::map<std::string, Curve> curves_;
};

void addTissueForce(const ReportedRun& reported, Plot& plot) {
  NamedCurves curves(reported);
  for (const auto& recorded : reported.run->messages<ToolForce>()) {
    const double time_s = reported.run->timeOf(recorded.message.header.stamp);
    curves.add(recorded.message.tool_id, time_s, fromVector(recorded.message.force).norm());
  }
  curves.giveTo(plot);
}

void addDeviceForce(const ReportedRun& reported, Plot& plot) {
  NamedCurves curves(reported);
  for (const auto& recorded : reported.run->messages<geometry_msgs::WrenchStamped>()) {
    const double time_s = reported.run->timeOf(recorded.message.header.stamp);
    curves.add(recorded.topic, time_s, fromVector(recorded.message.wrench.force).norm());
  }
  curves.giveTo(plot);
}

/// Of a number that the simulation tells about once a second.
void addStats(const ReportedRun& reported, double (*value)(const SimulationStats&), Plot& plot) {
  Curve curve = newCurve(reported, "", 0);
  for (const SimulationStats& stats : reported.run->stats()) {
    if (const double y = value(stats); std::isfinite(y))
      curve.add(reported.begin_s + stats.simulation_time, y);
  }
  plot.curves.push_back(std::move(curve));
}

std::vector<ComparedQuantity> quantitiesOf(const Findings& findings) {
  if (findings.comparison)
    return findings.comparison->quantities;
  return findings.check ? findings.check->measured : std::vector<ComparedQuantity>();
}

/// The differences of one key, RMS and largest of every time.
void addDifferences(const std::vector<ComparedQuantity>& quantities, const std::string& key, double factor,
                    Plot& plot) {
  int dash = 0;
  for (const ComparedQuantity& quantity : quantities) {
    if (quantity.key != key || quantity.run > 0)
      continue;
    const bool spread = key == "positions";
    const std::string who = quantity.subject.empty() ? "" : quantity.subject + (spread ? ", " : "");
    Curve largest{who + (spread ? "largest" : ""), true, dash, {}, {}};
    Curve rms{who + "RMS", false, dash, {}, {}};
    for (const ComparedSample& sample : quantity.samples) {
      largest.add(sample.time_s, factor * sample.largest);
      rms.add(sample.time_s, factor * sample.rms);
    }
    plot.curves.push_back(thinned(largest, kParts));
    if (spread)
      plot.curves.push_back(thinned(rms, kParts));
    ++dash;
  }
}

}  // namespace

std::vector<Plot> reportPlots(const std::vector<ReportedRun>& runs, const Findings& findings) {
  std::vector<Plot> plots = {{"Largest displacement of the tissue", "mm", {}, true},
                             {"Force of the tools on the tissue", "N", {}, true},
                             {"Force sent to the device", "N", {}, true},
                             {"Elastic energy of the tissue", "mJ", {}, false},
                             {"Kinetic energy of the tissue", "mJ", {}, true},
                             {"Wall time of a step, median since the last statistics", "ms", {}, true},
                             {"Cells in the solve", "cells", {}, true},
                             {"Difference of positions", "mm", {}, true},
                             {"Difference of forces on the tissue", "N", {}, true},
                             {"Difference of forces at the device", "N", {}, true},
                             {"Difference of frames: RMSE", "levels of 255", {}, true},
                             {"Difference of frames: SSIM, 1 when the same", "SSIM", {}, false}};
  for (const ReportedRun& run : runs) {
    addDisplacement(run, plots[0]);
    addTissueForce(run, plots[1]);
    addDeviceForce(run, plots[2]);
    addStats(
        run, [](const SimulationStats& m) { return 1e3 * m.elastic_energy; }, plots[3]);
    addStats(
        run, [](const SimulationStats& m) { return 1e3 * m.kinetic_energy; }, plots[4]);
    // None where no step was done since the last statistics.
    addStats(
        run, [](const SimulationStats& m) { return m.step_ms_median > 0.0 ? m.step_ms_median : NAN; }, plots[5]);
    addStats(
        run, [](const SimulationStats& m) { return double(m.active_cells); }, plots[6]);
  }
  const std::vector<ComparedQuantity> quantities = quantitiesOf(findings);
  addDifferences(quantities, "positions", 1e3, plots[7]);
  addDifferences(quantities, "force", 1.0, plots[8]);
  addDifferences(quantities, "device_force", 1.0, plots[9]);
  addDifferences(quantities, "image_rmse", 1.0, plots[10]);
  addDifferences(quantities, "ssim", 1.0, plots[11]);
  return plots;
}

}  // namespace soft_volume::replay_program
