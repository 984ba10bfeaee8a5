#include "soft_volume/replay/bag_export.h"

#include <geometry_msgs/WrenchStamped.h>
#include <gtest/gtest.h>
#include <soft_volume/ToolState.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <sstream>

#include "recorded_run.h"
#include "soft_volume/grid/grid_reader.h"
#include "test_folder.h"

namespace soft_volume {
namespace {

/// A run with a tool whose tip goes along x by 1 mm a tick of 10 ms, and the force at the device.
class Export : public testing::Test {
 protected:
  void SetUp() override {
    BagRecorderSettings settings;
    settings.file = folder_ / "run.bag";
    settings.reserve_bytes = 1 << 20;
    BagRecorder recorder(settings);
    recordRun(recorder, {});
    for (int n = 0; n < 10; ++n) {
      const ros::Time stamp = ros::Time(1000.0) + ros::Duration(0.01 * n);
      const ros::Time receipt = ros::Time(1110.0) + ros::Duration(0.01 * n);
      recorder.write("/tool/state", receipt, toolState(n, stamp));
      geometry_msgs::WrenchStamped force;
      force.header.stamp = stamp;
      force.header.frame_id = "base, of the \"device\"";
      force.wrench.force.y = 0.25 * n;
      recorder.write("/servo_cf", receipt, force);
    }
  }

  static ToolState toolState(int n, const ros::Time& stamp) {
    ToolState state;
    state.header.stamp = stamp;
    state.session = 1;
    state.tool_id = "probe";
    state.pose.position.x = 0.001 * n;
    state.pose.orientation.w = 1.0;
    state.proxy = state.pose;
    state.proxy.position.z = 0.5;
    state.device_force.x = 2.0;
    return state;
  }

  const TestFolder folder_;
};

std::vector<std::string> readLines(const std::string& path) {
  std::ifstream file(path);
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);)
    lines.push_back(line);
  return lines;
}

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> fields;
  std::istringstream stream(line);
  for (std::string field; std::getline(stream, field, ',');)
    fields.push_back(field);
  return fields;
}

TEST_F(Export, CsvHoldsForcesWithUnits) {
  const RecordedBag bag(folder_ / "run.bag");
  EXPECT_EQ(exportCsv(bag.longest(), folder_ / "").files, 7U);
  const std::vector<std::string> lines = readLines(folder_ / "tissue_force.csv");
  // A force every 10 of 400 steps, and a NaN force once.
  ASSERT_EQ(lines.size(), 1U + 40U + 1U);
  EXPECT_EQ(lines[0].substr(0, 36), "time_s,tool,step,force_x_N,force_y_N");
  const std::vector<std::string> second = split(lines[2]);
  EXPECT_EQ(second.size(), split(lines[0]).size());
  EXPECT_EQ(second[1], "probe");
  EXPECT_EQ(second[2], "10");
  EXPECT_DOUBLE_EQ(std::stod(second[5]), -0.051);
  EXPECT_DOUBLE_EQ(std::stod(second[6]), 0.051);
  const double dt_s = bag.longest().scene().simulation.dt_s;
  EXPECT_NEAR(std::stod(second[0]), 10.0 * dt_s, 2e-9);
}

TEST_F(Export, CsvHoldsToolsDeviceAndInputs) {
  const RecordedBag bag(folder_ / "run.bag");
  exportCsv(bag.longest(), folder_ / "");
  const std::vector<std::string> tools = readLines(folder_ / "tool.csv");
  ASSERT_EQ(tools.size(), 11U);
  EXPECT_EQ(tools[8].substr(0, 21), "0.07,probe,0.007,0,0,");
  EXPECT_EQ(split(tools[8]).size() + 1, split(tools[0]).size()) << "the last field, no fault, is empty";
  const std::vector<std::string> device = readLines(folder_ / "device_force.csv");
  ASSERT_EQ(device.size(), 11U);
  EXPECT_EQ(device[4], "0.03,/servo_cf,\"base, of the \"\"device\"\"\",0,0.75,0,0.75");
  const std::vector<std::string> inputs = readLines(folder_ / "inputs.csv");
  EXPECT_EQ(inputs.size(), 1U + 41U + 1U);  // forces and a cut
  EXPECT_NE(inputs[17].find(",refused,"), std::string::npos) << inputs[17];
  EXPECT_EQ(readLines(folder_ / "simulation.csv").size(), 1U + bag.longest().stats().size());
  EXPECT_EQ(readLines(folder_ / "device_pose.csv").size(), 1U) << "none was recorded";
  EXPECT_EQ(readLines(folder_ / "rendering.csv").size(), 1U + 4U);
}

core::GridFile readBack(const std::string& path) {
  core::GridReadOptions options;
  options.array = "displacement";
  options.component = 2;
  return core::readGrid(path, options);
}

TEST_F(Export, VtuHoldsEveryState) {
  const RecordedBag bag(folder_ / "run.bag");
  const RecordedRun& run = bag.longest();
  const ExportResult result = exportVtu(run, folder_ / "vtu", [](double, double) {});
  EXPECT_EQ(result.states, 21U);
  EXPECT_EQ(result.files, 44U);
  EXPECT_TRUE(result.notes.empty());
  EXPECT_EQ(readLines(folder_ / "vtu/tissue.pvd").size(), 6U + 21U);
  for (const std::size_t n : {std::size_t(1), std::size_t(20)}) {
    char name[64];
    std::snprintf(name, sizeof name, "vtu/tissue/tissue_%08d.vtu", int(run.states()[n].step));
    const core::GridFile file = readBack(folder_ / name);
    EXPECT_TRUE(file.notes.empty()) << file.notes.front();
    EXPECT_EQ(file.grid.points, run.positions(n));
    const auto topology = run.topology(run.states()[n].revision);
    for (std::size_t v = 0; v < topology->vertexCount(); ++v)
      EXPECT_EQ(file.grid.point_scalars[v], run.positions(n)[v].z() - topology->rest_positions[v].z());
  }
}

/// VTK finds every polyhedron closed and turned outward, as before the export.
TEST_F(Export, VtuHoldsThePiecesOfCutCells) {
  const RecordedBag bag(folder_ / "run.bag");
  const RecordedRun& run = bag.longest();
  exportVtu(run, folder_ / "vtu", [](double, double) {});
  const core::GridFile file = readBack(folder_ / "vtu/tissue/tissue_00000400.vtu");
  const auto topology = run.topology(run.states().back().revision);
  std::vector<core::CellType> types;
  for (const core::CellType type : topology->cell_types) {
    if (type != core::CellType::kEmpty)
      types.push_back(type);
  }
  EXPECT_EQ(file.grid.cell_types, types);
  EXPECT_NE(std::count(types.begin(), types.end(), core::CellType::kPolyhedron), 0);
}

TEST_F(Export, VtuSaysWhereTheToolIs) {
  const RecordedBag bag(folder_ / "run.bag");
  exportVtu(bag.longest(), folder_ / "vtu", [](double, double) {});
  std::ifstream file(folder_ / "vtu/tools/tools_00000400.vtu", std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  EXPECT_NE(text.find("<Piece NumberOfPoints=\"2\" NumberOfCells=\"2\">"), std::string::npos);
  for (const char* name : {"tool", "at_rest_place", "force_on_tissue", "device_force"})
    EXPECT_NE(text.find(std::string("Name=\"") + name + "\""), std::string::npos) << name;
}

TEST_F(Export, TheProgramWritesBoth) {
  const ProgramResult result =
      replay(folder_ / "run.bag", "--export-csv '" + folder_ / "a/csv" + "' --export-vtu '" + folder_ / "a/vtu" + "'");
  EXPECT_EQ(result.code, 0) << result.output;
  EXPECT_EQ(readLines(folder_ / "a/csv/tissue_force.csv").size(), 42U);
  EXPECT_EQ(readLines(folder_ / "a/vtu/tools.pvd").size(), 27U);
  EXPECT_EQ(replay(folder_ / "run.bag", "--export-csv /proc/no").code, 2);
}

}  // namespace
}  // namespace soft_volume
