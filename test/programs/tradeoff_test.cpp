#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <limits>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "programs/tradeoff/rendering_scene.h"
#include "programs/tradeoff/rendering_sweep.h"
#include "programs/tradeoff/simulation_scene.h"
#include "programs/tradeoff/tradeoff_table.h"
#include "replay/test_folder.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

TradeoffRow makeRow(const std::string& scene, double cost, double error) {
  TradeoffRow row;
  row.scene = scene;
  row.settings = {"x"};
  row.cost = cost;
  row.reference_error = error;
  return row;
}

TradeoffTable makeTable(const std::vector<TradeoffRow>& rows) {
  return {{"letter"}, "ms", "bytes", rows};
}

TEST(TradeoffTable, FrontHoldsWhatNothingBeatsInBoth) {
  TradeoffTable table = makeTable({makeRow("a", 1.0, 0.5), makeRow("a", 2.0, 0.6), makeRow("a", 2.0, 0.2),
                                   makeRow("a", 3.0, 0.2), makeRow("a", kInfinity, kInfinity), makeRow("b", 9.0, 0.9)});
  markFront(table);
  const std::vector<bool> expected = {true, false, true, false, false, true};
  for (std::size_t n = 0; n < expected.size(); ++n)
    EXPECT_EQ(table.rows[n].on_front, expected[n]) << n;
}

TEST(TradeoffTable, ReferenceIsNoCandidate) {
  TradeoffTable table = makeTable({makeRow("a", 2.0, 0.1), makeRow("a", 1.0, 0.0)});
  table.rows[1].is_reference = true;
  markFront(table);
  EXPECT_TRUE(table.rows[0].on_front);
  EXPECT_FALSE(table.rows[1].on_front);
  EXPECT_EQ(cheapestWithin(table, "a", 1.0), &table.rows[0]);
}

TEST(TradeoffTable, KnownAnswerCountsBeforeReference) {
  TradeoffTable table = makeTable({makeRow("a", 1.0, 0.3), makeRow("a", 2.0, 0.1)});
  table.rows[1].known_error = 0.4;
  markFront(table);
  EXPECT_TRUE(table.rows[0].on_front);
  EXPECT_FALSE(table.rows[1].on_front);
}

TEST(TradeoffTable, CheapestWithinABudgetOrElseTheMostExact) {
  TradeoffTable table =
      makeTable({makeRow("a", 1.0, 0.5), makeRow("a", 3.0, 0.04), makeRow("a", 2.0, 0.05), makeRow("b", 0.1, 0.0)});
  EXPECT_EQ(cheapestWithin(table, "a", 0.05), &table.rows[2]);
  EXPECT_EQ(cheapestWithin(table, "a", 0.01), &table.rows[1]);
  EXPECT_EQ(cheapestWithin(table, "none", 1.0), nullptr);
}

/// A displacement field that trilinear cells represent exactly.
Vector3 linearField(const Vector3& p) {
  return {0.1 * p.x() - 0.2 * p.y() + 0.3 * p.z() + 0.01, 0.05 * p.y(), -0.4 * p.x() + 0.2 * p.z()};
}

class TradeoffScenes : public testing::TestWithParam<double> {};

TEST_P(TradeoffScenes, LoadsDoTheSameWorkOnEveryLattice) {
  for (const TradeoffScene& scene : {indentationScene(true), indentationScene(false), cantileverScene()}) {
    const Lattice lattice = sceneLattice(scene, GetParam());
    const double time_s = 0.45 * scene.duration_s;
    const std::vector<PointForce> points = scene.forces(time_s);
    double expected = 0.0;
    for (const PointForce& point : points)
      expected += point.force_n.dot(linearField(point.rest_point_m));
    double work = 0.0;
    for (const VertexLoad& load : vertexLoads(lattice, points))
      work += load.force_n.dot(linearField(lattice.rest_positions[load.vertex]));
    ASSERT_GT(std::abs(expected), 1e-5) << scene.name;
    EXPECT_NEAR(work, expected, 1e-12) << scene.name;
  }
}

TEST_P(TradeoffScenes, ProbesReadALinearFieldExactly) {
  for (const TradeoffScene& scene : {indentationScene(true), cantileverScene()}) {
    const Lattice lattice = sceneLattice(scene, GetParam());
    std::vector<Vector3> field;
    for (const Vector3& p : lattice.rest_positions)
      field.push_back(linearField(p));
    ASSERT_FALSE(scene.probes_m.empty());
    const std::vector<Vector3> values = displacementsAt(lattice, field, scene.probes_m);
    for (std::size_t n = 0; n < values.size(); ++n)
      ASSERT_LT((values[n] - linearField(scene.probes_m[n])).norm(), 1e-12) << scene.name;
  }
}

TEST_P(TradeoffScenes, FixesOneFace) {
  for (const TradeoffScene& scene : {indentationScene(true), cantileverScene()}) {
    const Lattice lattice = sceneLattice(scene, GetParam());
    const int axis = scene.name == "cantilever" ? 0 : 2;
    for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
      ASSERT_EQ(lattice.fixed[v] == 1, lattice.rest_positions[v][axis] < 1e-9) << scene.name;
  }
}

INSTANTIATE_TEST_SUITE_P(Spacings, TradeoffScenes, testing::Values(0.02, 0.01, 0.005, 0.0025));

TEST(TradeoffScenes, IndentationPressesWithOneNewtonAndLetsGo) {
  const TradeoffScene scene = indentationScene(true);
  Vector3 sum = Vector3::Zero();
  for (const PointForce& point : scene.forces(0.2))
    sum += point.force_n;
  EXPECT_NEAR(sum.z(), -1.0, 1e-12);
  EXPECT_NEAR(sum.x(), 0.3, 1e-12);
  EXPECT_TRUE(scene.forces(0.39).empty() || scene.forces(0.39).front().force_n.isZero());
}

/// What a CSV and a plot say of a table of two rows with errors of 0.5 and 2.
std::string csvOf(const ErrorUnit& unit) {
  TradeoffTable table = makeTable({makeRow("a", 1.0, 0.5), makeRow("a", 2.0, 2.0)});
  table.error_unit = unit;
  const TestFolder folder;
  writeCsv(table, folder / "table.csv");
  std::ifstream file(folder / "table.csv");
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

TEST(TradeoffTable, WritesErrorsInTheirUnit) {
  const std::string fractions = csvOf({});
  EXPECT_NE(fractions.find("error_reference_percent,error_known_percent"), std::string::npos);
  EXPECT_NE(fractions.find("a,x,50,,1,"), std::string::npos) << fractions;
  const std::string levels = csvOf({1.0, "levels", "%g"});
  EXPECT_NE(levels.find("error_reference_levels,error_known_levels"), std::string::npos);
  EXPECT_NE(levels.find("a,x,0.5,,1,"), std::string::npos) << levels;
}

TEST(TradeoffTable, PlotsErrorsInTheirUnit) {
  TradeoffTable table = makeTable({makeRow("a", 1.0, 0.5), makeRow("a", 2.0, 2.0)});
  TradeoffPlot plot;
  plot.panels = {{"a", "a", "error"}};
  EXPECT_NE(plotScript(table, plot).find("\n1 50 "), std::string::npos);
  EXPECT_NE(plotScript(table, plot).find("%g %%"), std::string::npos);
  table.error_unit = {1.0, "levels", "%g"};
  EXPECT_NE(plotScript(table, plot).find("\n1 0.5 "), std::string::npos);
  EXPECT_EQ(plotScript(table, plot).find("%g %%"), std::string::npos);
}

// --------------------------------------------------------------------------------------------- what the renderer draws

TEST(RenderingScenes, CurvilinearGridIsValidAndNowhereInsideOut) {
  const RenderingScene scene = curvilinearScene(8000);
  EXPECT_EQ(scene.grid.cellCount(), 8000u);
  EXPECT_NO_THROW(scene.grid.validate());
  for (std::size_t c = 0; c < scene.grid.cellCount(); ++c) {
    std::array<Vector3, 8> corners;
    for (std::size_t n = 0; n < 8; ++n)
      corners[n] = scene.grid.points[scene.grid.connectivity[8 * c + n]].cast<double>();
    ASSERT_GT((corners[1] - corners[0]).cross(corners[3] - corners[0]).dot(corners[4] - corners[0]), 0.0) << c;
    ASSERT_GT((corners[5] - corners[6]).cross(corners[7] - corners[6]).dot(corners[2] - corners[6]), 0.0) << c;
  }
  const auto range = std::minmax_element(scene.grid.point_scalars.begin(), scene.grid.point_scalars.end());
  EXPECT_LT(*range.first, 0.2F);
  EXPECT_GT(*range.second, 0.8F);
}

TEST(RenderingScenes, ViewsShowTheWholeGridAndLittleElse) {
  const RenderingScene scene = curvilinearScene(1000);
  for (const RenderingView& view : scene.views) {
    const Camera camera = view.camera(640, 480);
    EXPECT_NO_THROW(camera.validate());
    Eigen::AlignedBox2d shown;
    for (const Vector3f& p : scene.positions) {
      const Vector3 p_camera = camera.T_volume_camera.inverse() * p.cast<double>();
      EXPECT_GT(p_camera.z(), camera.near_m) << view.name;
      EXPECT_LT(p_camera.z(), camera.far_m) << view.name;
      shown.extend(camera.project(p_camera));
    }
    EXPECT_GT(shown.min().x(), 0.0) << view.name;
    EXPECT_GT(shown.min().y(), 0.0) << view.name;
    EXPECT_LT(shown.max().x(), 639.0) << view.name;
    EXPECT_LT(shown.max().y(), 479.0) << view.name;
    EXPECT_GT(std::max(shown.sizes().x() / 640.0, shown.sizes().y() / 480.0), 0.6) << view.name;
  }
}

TEST(RenderingScenes, ATouchMovesWhatShowsInATenthOfTheImage) {
  const RenderingScene scene = curvilinearScene(27000);
  const Camera camera = scene.views[1].camera(640, 480);
  const std::vector<Vector3f> after = touched(scene, camera, 0.1);
  ASSERT_EQ(after.size(), scene.positions.size());
  Eigen::AlignedBox2d moved;
  const Pose T_camera_volume = camera.T_volume_camera.inverse();
  for (std::size_t c = 0; c < scene.grid.cellCount(); ++c) {
    const std::uint32_t* corners = &scene.grid.connectivity[8 * c];
    if (std::all_of(corners, corners + 8, [&](std::uint32_t v) { return after[v] == scene.positions[v]; }))
      continue;
    for (int n = 0; n < 8; ++n)
      moved.extend(camera.project(T_camera_volume * scene.positions[corners[n]].cast<double>()));
  }
  EXPECT_NEAR(moved.volume() / (640.0 * 480.0), 0.1, 0.02);
}

Frame frameOf(const std::vector<float>& rgba) {
  Frame frame;
  frame.width = int(rgba.size() / 4);
  frame.height = 1;
  frame.rgba = rgba;
  return frame;
}

TEST(RenderingError, CountsColoursOfPixelsThatAreNotBlack) {
  const Frame reference = frameOf({0.5F, 0.5F, 0.5F, 1.0F, 0.0F, 0.0F, 0.0F, 0.0F});
  EXPECT_EQ(rmseLevels(reference, reference), 0.0);
  const Frame brighter = frameOf({0.6F, 0.5F, 0.5F, 0.3F, 0.0F, 0.0F, 0.0F, 0.5F});
  EXPECT_NEAR(rmseLevels(brighter, reference), 25.5 / std::sqrt(3.0), 1e-4);  // neither opacity nor black pixels count
  const Frame beside = frameOf({0.5F, 0.5F, 0.5F, 1.0F, 0.1F, 0.0F, 0.0F, 0.5F});
  EXPECT_NEAR(rmseLevels(beside, reference), 25.5 / std::sqrt(6.0), 1e-4);
  EXPECT_THROW(rmseLevels(frameOf({1.0F, 1.0F, 1.0F, 1.0F}), reference), InputError);
}

// ------------------------------------------------------------------------------------------------------ the program

struct Outcome {
  int code;
  std::string output;
};

Outcome runProgram(const std::string& arguments) {
  const std::string command = "'" SOFT_VOLUME_BIN_DIR "/soft_volume_tradeoff' " + arguments + " 2>&1";
  FILE* pipe = popen(command.c_str(), "r");
  std::string output;
  char buffer[4096];
  while (const std::size_t n = std::fread(buffer, 1, sizeof buffer, pipe))
    output.append(buffer, n);
  const int status = pclose(pipe);
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, output};
}

std::string readFile(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::stringstream text;
  text << file.rdbuf();
  return text.str();
}

std::vector<std::string> splitAt(const std::string& line, char separator) {
  std::vector<std::string> parts;
  std::stringstream stream(line + separator);
  for (std::string part; std::getline(stream, part, separator);)
    parts.push_back(part);
  return parts;
}

using CsvRow = std::map<std::string, std::string>;

std::vector<CsvRow> readCsv(const std::string& path) {
  std::stringstream text(readFile(path));
  std::string line;
  std::getline(text, line);
  const std::vector<std::string> names = splitAt(line, ',');
  std::vector<CsvRow> rows;
  while (std::getline(text, line)) {
    const std::vector<std::string> values = splitAt(line, ',');
    EXPECT_EQ(values.size(), names.size()) << line;
    rows.emplace_back();
    for (std::size_t n = 0; n < std::min(names.size(), values.size()); ++n)
      rows.back()[names[n]] = values[n];
  }
  return rows;
}

const CsvRow* findRow(const std::vector<CsvRow>& rows, const CsvRow& wanted) {
  for (const CsvRow& row : rows) {
    bool fits = true;
    for (const auto& entry : wanted)
      fits = fits && row.at(entry.first) == entry.second;
    if (fits)
      return &row;
  }
  return nullptr;
}

double numberIn(const CsvRow* row, const std::string& name) {
  EXPECT_NE(row, nullptr) << name;
  return row != nullptr ? std::stod(row->at(name)) : kInfinity;
}

TEST(TradeoffProgram, TeachesAndRefuses) {
  const Outcome help = runProgram("--help");
  EXPECT_EQ(help.code, 0);
  EXPECT_NE(help.output.find("simulation.md"), std::string::npos);
  const Outcome nothing = runProgram("--out /nowhere");
  EXPECT_EQ(nothing.code, 2);
  EXPECT_NE(nothing.output.find("--simulation"), std::string::npos);
  EXPECT_NE(nothing.output.find("--rendering"), std::string::npos);
  EXPECT_EQ(runProgram("--simulation").code, 2);
  const Outcome unwritable = runProgram("--simulation --quick --out /proc/tradeoff");
  EXPECT_EQ(unwritable.code, 2);
  EXPECT_NE(unwritable.output.find("/proc/tradeoff"), std::string::npos);
}

/// Errors do not depend on the machine, so they are checked; costs are not.
TEST(TradeoffProgram, QuickSweepTellsAClearStory) {
  const TestFolder folder;
  const std::string out = folder / "sweep";
  const Outcome outcome = runProgram("--simulation --quick --repeats 1 --no-progress --out '" + out + "'");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  const std::vector<CsvRow> rows = readCsv(out + "/simulation.csv");

  const CsvRow line = {{"integrator", "symplectic_euler"}, {"precision", "float"}, {"active_set", "all"},
                       {"settings_of_preset", ""},         {"threshold", ""},      {"dt_fraction", "0.9"}};
  const auto lineError = [&](const std::string& scene, const std::string& spacing_mm, const std::string& error) {
    CsvRow wanted = line;
    wanted["scene"] = scene;
    wanted["spacing_mm"] = spacing_mm;
    return numberIn(findRow(rows, wanted), error);
  };
  EXPECT_LT(lineError("indentation", "10", "error_reference_percent"),
            0.7 * lineError("indentation", "20", "error_reference_percent"));
  EXPECT_LT(lineError("cantilever", "10", "error_known_percent"),
            0.7 * lineError("cantilever", "20", "error_known_percent"));

  std::set<std::string> presets;
  for (const CsvRow& row : rows) {
    for (const std::string& preset : splitAt(row.at("preset"), ' '))
      presets.insert(preset);
    EXPECT_GT(std::stod(row.at("ms_per_simulated_s")), 0.0);
    if (row.at("active_set") == "all" && !row.at("error_same_lattice_percent").empty()) {
      EXPECT_LT(std::stod(row.at("error_same_lattice_percent")), 5.0) << row.at("integrator");
    }
  }
  for (const std::string preset : {"fast", "balanced", "exact", "reed1997"})
    EXPECT_EQ(presets.count(preset), 1u) << preset;
  const std::string report = readFile(out + "/simulation.md");
  EXPECT_NE(report.find("## What to choose"), std::string::npos);
  EXPECT_EQ(report.find("nan"), std::string::npos);
  EXPECT_EQ(readFile(out + "/simulation.png").substr(1, 3), "PNG");
}

TEST(TradeoffProgram, QuickSweepOfTheRendererTellsAClearStory) {
  const TestFolder folder;
  const std::string out = folder / "sweep";
  const Outcome outcome = runProgram("--rendering --quick --repeats 1 --no-progress --out '" + out + "'");
  ASSERT_EQ(outcome.code, 0) << outcome.output;
  const std::vector<CsvRow> rows = readCsv(out + "/rendering.csv");
  const auto error = [&](const std::string& function, const std::string& method, const std::string& slices) {
    const CsvRow wanted = {{"scene", "curvilinear " + function + " 160x120"}, {"method", method}, {"slices", slices}};
    return numberIn(findRow(rows, wanted), "error_reference_levels");
  };
  for (const std::string function : {"haze", "peaks"}) {
    for (const std::string method : {"gl", "native", "native boundary", "native adaptive"})
      EXPECT_LT(error(function, method, "40"), 0.7 * error(function, method, "10")) << function << " " << method;
    EXPECT_LT(error(function, "native boundary", "40"), 1.02 * error(function, "native", "40")) << function;
    EXPECT_EQ(error(function, "exact", ""), 0.0) << function;
  }
  // An update draws the same picture as a full redraw, but less of it.
  for (const std::string backend : {"gl", "native"}) {
    CsvRow wanted = {{"scene", "curvilinear haze 160x120 touch"}, {"backend", backend}, {"update", "full"}};
    const CsvRow* full = findRow(rows, wanted);
    wanted["update"] = "incremental";
    const CsvRow* incremental = findRow(rows, wanted);
    EXPECT_EQ(numberIn(incremental, "error_reference_levels"), numberIn(full, "error_reference_levels")) << backend;
    EXPECT_EQ(numberIn(full, "updated_percent"), 100.0) << backend;
    EXPECT_GT(numberIn(incremental, "updated_percent"), 5.0) << backend;
    EXPECT_LT(numberIn(incremental, "updated_percent"), 40.0) << backend;  // gl's normals reach one cell farther
  }
  const std::string report = readFile(out + "/rendering.md");
  for (const std::string section : {"## What to choose", "## Look-up", "## Incremental or full"})
    EXPECT_NE(report.find(section), std::string::npos);
  EXPECT_EQ(report.find("nan"), std::string::npos);
  EXPECT_EQ(report.find("## Refused"), std::string::npos);
  EXPECT_EQ(readFile(out + "/rendering.png").substr(1, 3), "PNG");
}

}  // namespace
}  // namespace soft_volume::core
