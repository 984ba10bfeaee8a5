#pragma once

#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

namespace soft_volume::core::validate {

constexpr double kNoBound = std::numeric_limits<double>::infinity();

/// One number of the table. It passes when `error` is at most `bound`.
struct Row {
  std::string suite;
  std::string name;
  double value = 0.0;
  double reference = 0.0;
  double error = 0.0;
  double bound = kNoBound;
  bool pass = false;
  bool has_dissertation = false;       ///< the row compares with the dissertation's rule
  std::optional<double> dissertation;  ///< its value; none where it refuses or does not apply. It has no bound.
  bool goal = false;                   ///< the bound is something to strive for: beyond it is no failure
};

/// Takes the numbers of all suites, prints them as they come, and writes them as JSON.
class Report {
 public:
  void beginSuite(const std::string& suite) { suite_ = suite; }

  /// Relative error |value / reference - 1|, or |value| where the reference is 0.
  void equal(const std::string& name, double value, double reference, double bound = kNoBound);
  /// For an error that was computed elsewhere.
  void row(const std::string& name, double value, double reference, double error, double bound = kNoBound);
  /// A number that should be 0 and has to stay at or below the bound.
  void atMost(const std::string& name, double value, double bound);
  /// The same, where it is known that the bound is not reached in all cases: stated, but no failure.
  void goalAtMost(const std::string& name, double value, double bound);
  /// A number that has to be above 0.
  void positive(const std::string& name, double value);
  /// The same with what the dissertation's rule reached.
  void atMost(const std::string& name, double value, double bound, std::optional<double> dissertation);
  void positive(const std::string& name, double value, std::optional<double> dissertation);
  /// A case that could not run; says what to do.
  void skip(const std::string& what);

  const std::vector<Row>& rows() const { return rows_; }
  std::size_t failures() const;
  void printSummary() const;
  /// Throws FileError when the file cannot be written. Numbers that JSON lacks (infinite, not a number) become null.
  void writeJson(const std::string& path) const;

 private:
  void add(Row row);

  std::string suite_;
  std::vector<Row> rows_;
  std::vector<std::string> skipped_;
};

/// What the user asked for.
struct Options {
  bool quick = false;
  bool full = false;  ///< every combination, where a suite has more than it runs by default
  int threads = 1;
  std::filesystem::path plots;  ///< empty: none

  /// Runs gnuplot with `commands` into plots/NAME.png; does nothing when no plots are wanted.
  void plot(const std::string& name, const std::string& commands) const;
};

/// A part of a suite that takes about `seconds`; progress and the time left are counted in these.
struct Case {
  std::string name;
  double seconds = 1.0;
  std::function<void(Report&)> run;
};

struct Suite {
  std::string name;
  std::string about;
  std::vector<Case> (*cases)(const Options&);
};

std::vector<Case> patchCases(const Options& options);
std::vector<Case> cantileverCases(const Options& options);
std::vector<Case> halfSpaceCases(const Options& options);
std::vector<Case> indentationCases(const Options& options);
std::vector<Case> truthCubeCases(const Options& options);
std::vector<Case> freeVibrationCases(const Options& options);
std::vector<Case> extremesCases(const Options& options);
std::vector<Case> cuttingCases(const Options& options);
std::vector<Case> hapticsCases(const Options& options);

}  // namespace soft_volume::core::validate
