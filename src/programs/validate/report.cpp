#include "report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>

#include "plot.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core::validate {
namespace {

constexpr int kNameWidth = 66;

void printHeader(const std::string& suite) {
  std::printf("\n%-*s %12s %12s %10s %10s\n", kNameWidth, suite.c_str(), "value", "reference", "error", "bound");
}

void printRow(const Row& row) {
  std::printf("  %-*s %12.6g %12.6g %10.3g ", kNameWidth - 2, row.name.c_str(), row.value, row.reference, row.error);
  if (row.bound == kNoBound)
    std::printf("%10s     ", "-");
  else
    std::printf("%10.3g %s", row.bound, row.pass ? "pass" : row.goal ? "NOT REACHED" : "FAIL");
  if (row.has_dissertation && row.dissertation.has_value())
    std::printf("   1997: %.4g", *row.dissertation);
  else if (row.has_dissertation)
    std::printf("   1997: -");
  std::printf("\n");
  std::fflush(stdout);
}

nlohmann::json number(double value) {
  return std::isfinite(value) ? nlohmann::json(value) : nlohmann::json(nullptr);
}

nlohmann::json toJson(const Row& row) {
  nlohmann::json json{{"suite", row.suite},
                      {"case", row.name},
                      {"value", number(row.value)},
                      {"reference", number(row.reference)},
                      {"error", number(row.error)},
                      {"bound", number(row.bound)},
                      {"pass", row.pass}};
  if (row.goal)
    json["goal"] = true;
  if (row.has_dissertation)
    json["dissertation"] = row.dissertation.has_value() ? number(*row.dissertation) : nlohmann::json(nullptr);
  return json;
}

}  // namespace

void Report::add(Row row) {
  if (rows_.empty() || rows_.back().suite != suite_)
    printHeader(suite_);
  row.suite = suite_;
  printRow(row);
  rows_.push_back(std::move(row));
}

void Report::row(const std::string& name, double value, double reference, double error, double bound) {
  Row row;
  row.name = name;
  row.value = value;
  row.reference = reference;
  row.error = error;
  row.bound = bound;
  // A row without a bound still has to be a number.
  row.pass = std::isfinite(error) && error <= bound;
  add(std::move(row));
}

void Report::equal(const std::string& name, double value, double reference, double bound) {
  const double error = reference == 0.0 ? std::abs(value) : std::abs(value / reference - 1.0);
  row(name, value, reference, error, bound);
}

void Report::atMost(const std::string& name, double value, double bound) {
  row(name, value, 0.0, value, bound);
}

void Report::atMost(const std::string& name, double value, double bound, std::optional<double> dissertation) {
  Row row;
  row.name = name;
  row.value = value;
  row.error = value;
  row.bound = bound;
  row.pass = std::isfinite(value) && value <= bound;
  row.has_dissertation = true;
  row.dissertation = dissertation;
  add(std::move(row));
}

void Report::goalAtMost(const std::string& name, double value, double bound) {
  Row row;
  row.name = name;
  row.value = value;
  row.error = value;
  row.bound = bound;
  row.pass = std::isfinite(value) && value <= bound;
  row.goal = true;
  add(std::move(row));
}

void Report::positive(const std::string& name, double value) {
  row(name, value, 0.0, std::isfinite(value) && value > 0.0 ? 0.0 : HUGE_VAL, 0.0);
}

void Report::positive(const std::string& name, double value, std::optional<double> dissertation) {
  Row row;
  row.name = name;
  row.value = value;
  row.error = std::max(0.0, -value);
  row.bound = 0.0;
  row.pass = std::isfinite(value) && value > 0.0;
  row.has_dissertation = true;
  row.dissertation = dissertation;
  add(std::move(row));
}

void Report::skip(const std::string& what) {
  std::printf("\n%s: skipped: %s\n", suite_.c_str(), what.c_str());
  skipped_.push_back(suite_ + ": " + what);
}

std::size_t Report::failures() const {
  return static_cast<std::size_t>(
      std::count_if(rows_.begin(), rows_.end(), [](const Row& row) { return !row.pass && !row.goal; }));
}

void Report::printSummary() const {
  const auto bounded = std::count_if(rows_.begin(), rows_.end(), [](const Row& row) { return row.bound != kNoBound; });
  std::printf("\n%zu numbers, %td of them with a bound, %zu failed, %zu skipped\n", rows_.size(), bounded, failures(),
              skipped_.size());
  for (const Row& row : rows_) {
    if (!row.pass)
      std::printf("%s %s: %s\n", row.goal ? "NOT REACHED" : "FAILED", row.suite.c_str(), row.name.c_str());
  }
}

void Report::writeJson(const std::string& path) const {
  nlohmann::json json{{"rows", nlohmann::json::array()}, {"skipped", skipped_}};
  for (const Row& row : rows_)
    json["rows"].push_back(toJson(row));
  std::ofstream file(path);
  file << json.dump(1) << "\n";
  file.close();
  if (!file)
    throw FileError(path + ": the JSON cannot be written");
}

void Options::plot(const std::string& name, const std::string& commands) const {
  if (plots.empty())
    return;
  const std::string file = (plots / (name + ".png")).string();
  plotWithGnuplot("set terminal pngcairo size 900,620 font 'DejaVu Sans,11'\nset output \"" + file +
                  "\"\nset grid lc rgb '#dddddd'\nset key opaque\n" + commands);
}

}  // namespace soft_volume::core::validate
