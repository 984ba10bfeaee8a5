#include <gtest/gtest.h>
#include <sys/wait.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>
#include <string>

#include "replay/test_folder.h"

namespace soft_volume::core {
namespace {

struct Result {
  int code = -1;
  std::string output;  ///< stdout and stderr
};

Result run(const std::string& command) {
  Result result;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  std::array<char, 4096> text{};
  while (std::fgets(text.data(), text.size(), pipe) != nullptr)
    result.output += text.data();
  const int status = pclose(pipe);
  result.code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return result;
}

std::string program() {
  return "\"" SOFT_VOLUME_BIN_DIR "/soft_volume_validate\" --no-progress ";
}

nlohmann::json readJson(const std::filesystem::path& path) {
  return nlohmann::json::parse(std::ifstream(path));
}

TEST(ValidateProgram, HelpTeaches) {
  const Result help = run(program() + "--help");
  EXPECT_EQ(help.code, 0);
  for (const char* word : {"Examples", "How to read", "SOFT_VOLUME_DATA", "Exit code"})
    EXPECT_NE(help.output.find(word), std::string::npos) << word;
}

TEST(ValidateProgram, ListsEverySuite) {
  const Result list = run(program() + "--list");
  EXPECT_EQ(list.code, 0);
  for (const char* suite : {"patch", "cantilever", "half_space", "indentation", "truth_cube", "free_vibration",
                            "extremes", "cutting", "haptics"})
    EXPECT_NE(list.output.find(std::string(suite) + ":"), std::string::npos) << suite;
}

TEST(ValidateProgram, RefusesUnknownSuiteAndCase) {
  const Result suite = run(program() + "--suite bridge");
  EXPECT_EQ(suite.code, 2);
  EXPECT_NE(suite.output.find("no suite 'bridge'; use one of all, patch"), std::string::npos) << suite.output;
  const Result part = run(program() + "--suite patch --case bridge");
  EXPECT_EQ(part.code, 2);
  EXPECT_NE(part.output.find("--list"), std::string::npos) << part.output;
}

TEST(ValidateProgram, RefusesBadArguments) {
  EXPECT_EQ(run(program() + "--threads 0").code, 2);
  EXPECT_EQ(run(program() + "--unknown").code, 2);
}

TEST(ValidateProgram, SaysBeforeTheWorkThatJsonCannotBeWritten) {
  const Result result = run(program() + "--suite all --json /no/such/folder/v.json");
  EXPECT_EQ(result.code, 2);
  EXPECT_NE(result.output.find("/no/such/folder/v.json: the JSON cannot be written"), std::string::npos);
}

TEST(ValidateProgram, SaysWhatToInstallForPlots) {
  const TestFolder folder;
  const Result result = run("PATH=/nowhere " + program() + "--suite patch --quick --plots \"" + folder / "p" + "\"");
  EXPECT_EQ(result.code, 2);
  EXPECT_NE(result.output.find("gnuplot-nox"), std::string::npos) << result.output;
}

TEST(ValidateProgram, SkipsTheTruthCubeWithoutItsData) {
  const TestFolder folder;
  const std::filesystem::path json = folder / "v.json";
  const Result result =
      run("SOFT_VOLUME_DATA=/nowhere " + program() + "--suite truth_cube --json \"" + json.string() + "\"");
  EXPECT_EQ(result.code, 0);
  EXPECT_NE(result.output.find("SOFT_VOLUME_DATA"), std::string::npos) << result.output;
  const nlohmann::json report = readJson(json);
  EXPECT_TRUE(report["rows"].empty());
  EXPECT_EQ(report["skipped"].size(), 1U);
}

TEST(ValidateProgram, RefusesDamagedBeads) {
  const TestFolder folder;
  std::filesystem::create_directories(folder / "truth_cube");
  std::ofstream(folder / "truth_cube/uniaxial_positions.csv") << "1,1,1,0,0,0,0,0,0,0,0,0,0,0,0\n";
  const Result result = run("SOFT_VOLUME_DATA=\"" + folder / "" + "\" " + program() + "--suite truth_cube");
  EXPECT_EQ(result.code, 1);
  EXPECT_NE(result.output.find("1 beads instead of 343"), std::string::npos) << result.output;
}

TEST(ValidateProgram, WritesRowsAndPlots) {
  const TestFolder folder;
  const std::filesystem::path json = folder / "v.json";
  const std::filesystem::path plots = folder / "plots";
  const Result result =
      run(program() + "--suite half_space --quick --json \"" + json.string() + "\" --plots \"" + plots.string() + "\"");
  EXPECT_EQ(result.code, 0) << result.output;
  const nlohmann::json report = readJson(json);
  for (const nlohmann::json& row : report["rows"]) {
    for (const char* key : {"suite", "case", "value", "reference", "error", "bound", "pass"})
      EXPECT_TRUE(row.contains(key)) << key;
  }
  EXPECT_TRUE(std::filesystem::exists(plots / "half_space_profile.png"));
}

/// Every suite in its short form: every number with a bound holds.
TEST(ValidateProgram, QuickFormOfAllSuitesPasses) {
  const TestFolder folder;
  const std::filesystem::path json = folder / "v.json";
  // Without a spinning wait: other tests run beside this one.
  const Result result =
      run("OMP_WAIT_POLICY=passive " + program() + "--suite all --quick --json \"" + json.string() + "\"");
  EXPECT_EQ(result.code, 0) << result.output;
  const nlohmann::json report = readJson(json);
  std::set<std::string> suites;
  for (const nlohmann::json& row : report["rows"]) {
    EXPECT_TRUE(row["pass"] || row.contains("goal")) << row;
    suites.insert(row["suite"]);
  }
  EXPECT_EQ(suites.size() + report["skipped"].size(), 9U);
}

}  // namespace
}  // namespace soft_volume::core
