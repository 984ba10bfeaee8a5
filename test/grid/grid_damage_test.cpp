// Grid files that are missing, short, wrong or hostile: each must become a FileError, never a crash or a hang.

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <iostream>
#include <limits>
#include <random>
#include <utility>

#include "../src/volume/reader_protocol.h"
#include "grid/grid_files.h"
#include "soft_volume/common/error.h"
#include "soft_volume/grid/grid_reader.h"
#include "volume/file_damage.h"
#include "volume/sample_files.h"

namespace soft_volume::core {
namespace {

using namespace testing_grid;
using testing_volume::damaged;
using testing_volume::fuzzRounds;
using testing_volume::replaced;
using testing_volume::TemporaryFolder;

ReadLimits shortLimits() {
  ReadLimits limits;
  limits.time_s = 10.0;
  return limits;
}

/// Reads and expects a FileError that begins with the path and contains `reason`. A reader that hangs until its time is
/// over does not count as a refusal.
void expectRefused(const std::string& path, const std::string& reason, const GridReadOptions& options = {},
                   const ReadLimits& limits = shortLimits()) {
  try {
    readGrid(path, options, limits);
    ADD_FAILURE() << path << " was accepted; expected: " << reason;
  } catch (const FileError& error) {
    const std::string text = error.what();
    EXPECT_EQ(text.rfind(path + ": ", 0), 0U) << text;
    EXPECT_NE(text.find(reason), std::string::npos) << text << "\n expected: " << reason;
    EXPECT_EQ(text.find("longer than"), std::string::npos) << text;
  }
}

class GridDamage : public testing::Test {
 protected:
  void TearDown() override {
    unsetenv("SOFT_VOLUME_READER");
    EXPECT_EQ(waitpid(-1, nullptr, WNOHANG), -1) << "a child was left behind";
  }

  /// As text and as binary, legacy and XML.
  void expectRefusedEverywhere(const FileContents& contents, const std::string& reason) {
    expectRefused(folder_.write("text.vtk", legacyFile(contents)), reason);
    expectRefused(folder_.write("binary.vtk", binaryLegacyFile(contents)), reason);
    expectRefused(folder_.write("text.vtu", vtuFile(contents)), reason);
    expectRefused(folder_.write("appended.vtu", appendedVtuFile(contents)), reason);
  }

  TemporaryFolder folder_;
};

FileContents good() {
  return FileContents(mixedGrid());
}

TEST_F(GridDamage, MissingOrUnknownFiles) {
  expectRefused(folder_.file("nothing.vtu"), "No such file");
  expectRefused(folder_.write("a.obj", "x"), "type of this file is not known");
  expectRefused(folder_.write("a.xyz", "3\nwater\nO 0 0 0\nH 0 0 1\nH 0 1 0\n"), "only binary PLOT3D");
  for (const char* name : {"a.vtk", "a.vtu", "a.vts", "a.vtr", "a.vti", "a.xyz"})
    expectRefused(folder_.write(name, ""), "");
}

TEST_F(GridDamage, OtherKindsOfVtkFile) {
  expectRefused(folder_.write("a.vtk",
                              "# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS 3 float\n0 0 0 1 0 0 0 1 "
                              "0\nPOLYGONS 1 4\n3 0 1 2\nPOINT_DATA 3\nSCALARS s float\nLOOKUP_TABLE default\n1 2 3\n"),
                "no cells with a volume; 1 points, lines or surfaces were left out");
}

/// One good file of each kind; the solution belongs to PLOT3D.
struct Sample {
  std::string name;
  std::string bytes;
  std::string solution;
};

std::vector<Sample> goodFiles() {
  Block blanked;
  blanked.blanks.assign(blanked.count(), 1);
  blanked.blanks[0] = 0;
  Plot3dOptions fortran;
  fortran.record_marks = true;
  return {{"text.vtk", legacyFile(good()), ""},
          {"binary.vtk", binaryLegacyFile(good()), ""},
          {"structured.vtk", legacyStructuredFile({}), ""},
          {"rectilinear.vtk", legacyRectilinearFile({}), ""},
          {"image.vtk", legacyImageFile({}), ""},
          {"text.vtu", vtuFile(good()), ""},
          {"appended.vtu", appendedVtuFile(good()), ""},
          {"a.vts", vtsFile({}), ""},
          {"a.vtr", vtrFile({}), ""},
          {"a.vti", vtiGridFile({}), ""},
          {"blanked.xyz", plot3dGrid({blanked}), plot3dSolution({blanked})},
          {"fortran.xyz", plot3dGrid({blanked, blanked}, fortran), plot3dSolution({blanked, blanked}, fortran)}};
}

GridReadOptions optionsOf(const Sample& sample, const TemporaryFolder& folder) {
  GridReadOptions options;
  if (!sample.solution.empty())
    options.solution = folder.write("a.q", sample.solution);
  return options;
}

TEST_F(GridDamage, TruncatedFiles) {
  for (Sample sample : goodFiles()) {
    EXPECT_NO_THROW(readGrid(folder_.write(sample.name, sample.bytes), optionsOf(sample, folder_))) << sample.name;
    for (const double part : {0.02, 0.2, 0.5, 0.7, 0.8, 0.9, 0.97}) {
      const auto size = std::size_t(part * double(sample.bytes.size()));
      SCOPED_TRACE(sample.name + " cut to " + std::to_string(size) + " of " + std::to_string(sample.bytes.size()));
      expectRefused(folder_.write(sample.name, sample.bytes.substr(0, size)), "", optionsOf(sample, folder_));
    }
    if (sample.solution.empty())
      continue;
    const std::string path = folder_.write(sample.name, sample.bytes);
    for (const double part : {0.1, 0.5, 0.9, 0.99}) {
      SCOPED_TRACE("solution cut to " + std::to_string(part));
      Sample cut = sample;
      cut.solution.resize(std::size_t(part * double(sample.solution.size())));
      expectRefused(path, "", optionsOf(cut, folder_));
    }
  }
}

TEST_F(GridDamage, HugeClaims) {
  ReadLimits limits = shortLimits();
  limits.memory_bytes = std::uint64_t(512) << 20;
  const auto refused = [&](const std::string& path) { expectRefused(path, "", {}, limits); };
  const std::string text = legacyFile(good());
  for (const char* count : {"2000000000", "200000000000", "-5"}) {
    refused(folder_.write("a.vtk", replaced(text, "POINTS 26", std::string("POINTS ") + count)));
    refused(folder_.write("b.vtk", replaced(text, "CELLS 6", std::string("CELLS ") + count)));
    refused(folder_.write("c.vtk", replaced(text, "CELL_TYPES 6", std::string("CELL_TYPES ") + count)));
    refused(folder_.write("d.vtk", replaced(text, "POINT_DATA 26", std::string("POINT_DATA ") + count)));
    const std::string xml = vtuFile(good());
    refused(folder_.write("a.vtu", replaced(xml, "NumberOfPoints=\"26", std::string("NumberOfPoints=\"") + count)));
    refused(folder_.write("b.vtu", replaced(xml, "NumberOfCells=\"6", std::string("NumberOfCells=\"") + count)));
  }
  for (const char* dims : {"30000 40000 50000", "1000000 1000000 1000000", "-3 4 5"}) {
    for (const std::string& file : {legacyStructuredFile({}), legacyRectilinearFile({}), legacyImageFile({})})
      refused(folder_.write("a.vtk", replaced(file, "DIMENSIONS 3 4 5", std::string("DIMENSIONS ") + dims)));
  }
  const std::string extent = "\"2 4 2 5 2 6 \"", huge = "\"0 99999 0 99999 0 99999\"";
  for (const auto& [name, file] : {std::pair<std::string, std::string>{"a.vts", vtsFile({})},
                                   {"a.vtr", vtrFile({})},
                                   {"a.vti", vtiGridFile({})}}) {
    refused(folder_.write(name, replaced(replaced(file, extent, huge), extent, huge)));
  }
  std::string claim = plot3dGrid({Block{}});
  claim[1] = '\x10';  // a million points along the first axis
  expectRefused(folder_.write("a.xyz", claim), "no binary PLOT3D grid",
                optionsOf({"", "", plot3dSolution({Block{}})}, folder_));
}

TEST_F(GridDamage, AbsurdNumbersOfComponents) {
  for (const char* count : {"2147483648", "9223372036854775807", "99999", "0", "-1", "x"}) {
    const std::string claim = "NumberOfComponents=\"" + std::string(count);
    for (const std::string& file : {vtuFile(good()), appendedVtuFile(good())})
      expectRefused(folder_.write("a.vtu", replaced(file, "NumberOfComponents=\"3", claim)), "components");
    expectRefused(folder_.write("a.vti", replaced(vtiGridFile({}), "NumberOfComponents=\"1", claim)), "components");
  }
}

TEST_F(GridDamage, IndicesOutOfRange) {
  for (const long bad : {26L, 27000000L, -1L}) {
    FileContents contents = good();
    contents.cells[1][3] = bad;
    expectRefusedEverywhere(contents, "cell 1 names point " + std::to_string(bad) + " of a grid with 26 points");
    contents = good();
    contents.cells[5][3] = bad;
    expectRefused(folder_.write("faces.vtu", vtuFile(contents)), "cell 5 names point " + std::to_string(bad));
  }
}

TEST_F(GridDamage, FaceStreamsThatLeadAstray) {
  for (const long faces : {8L, 100000L, 6L, 0L, -1L}) {
    FileContents contents = good();
    contents.cells[5][0] = faces;
    expectRefused(folder_.write("a.vtu", vtuFile(contents)), "");
  }
}

TEST_F(GridDamage, WrongNumberOfVertices) {
  FileContents contents = good();
  contents.cells[4].pop_back();
  expectRefusedEverywhere(contents, "cell 4 has 3 vertices where tetrahedra have 4");
  contents = good();
  contents.cells[1].push_back(0);
  expectRefusedEverywhere(contents, "cell 1 has 9 vertices where hexahedra have 8");
}

TEST_F(GridDamage, UnknownCellTypes) {
  for (const int type : {18, 99, 255}) {
    FileContents contents = good();
    contents.types[2] = type;
    expectRefusedEverywhere(contents, "cell 2 is of the type " + std::to_string(type));
  }
}

TEST_F(GridDamage, CoordinatesThatAreNotFinite) {
  FileContents contents = good();
  contents.points[3].x() = std::nan("");
  contents.points[9].y() = std::numeric_limits<double>::infinity();
  const std::string reason = "2 of the 26 vertices that cells use are not finite";
  expectRefused(folder_.write("a.vtk", binaryLegacyFile(contents)), reason);
  expectRefused(folder_.write("a.vtu", appendedVtuFile(contents)), reason);
  expectRefused(folder_.write("b.vtk", legacyFile(contents)), "Words such as nan");
  expectRefused(folder_.write("b.vtu", vtuFile(contents)), reason);
}

TEST_F(GridDamage, NoScalars) {
  FileContents contents = good();
  contents.point_arrays.clear();
  expectRefusedEverywhere(contents, "holds no scalars");
  expectRefused(folder_.write("a.xyz", plot3dGrid({Block{}})), "name the solution (Q) file");
}

TEST_F(GridDamage, ArraysThatAreNotThere) {
  FileContents contents = good();
  contents.cell_arrays.push_back({"age", 1, {1, 2, 3, 4, 5, 6}});
  contents.point_arrays.push_back({"flow", 3, std::vector<double>(78, 2.0)});
  const std::string path = folder_.write("a.vtu", vtuFile(contents));
  expectRefused(path, "has no array 'heat'; it has scalar (points), flow (points, 3 components), age (cells)",
                {"heat", GridReadOptions::kMagnitude, ""});
  expectRefused(path, "component 3 of the array flow does not exist; it has 3", {"flow", 3, ""});
  expectRefused(path, "component -2", {"flow", -2, ""});
}

TEST_F(GridDamage, ArraysOfAnotherLength) {
  FileContents contents = good();
  contents.point_arrays[0].values.resize(20);
  expectRefused(folder_.write("a.vtu", vtuFile(contents)), "");
  expectRefused(folder_.write("b.vtu", appendedVtuFile(contents)), "");
  expectRefused(folder_.write("a.vtk", replaced(legacyFile(contents), "POINT_DATA 26", "POINT_DATA 20")), "");
}

TEST_F(GridDamage, SolutionsThatDoNotFit) {
  const std::string path = folder_.write("a.xyz", plot3dGrid({Block{}}));
  GridReadOptions options;
  options.solution = folder_.file("nothing.q");
  expectRefused(path, "nothing.q", options);
  Block other;
  other.dims = {3, 5, 4};
  options.solution = folder_.write("other.q", plot3dSolution({other}));
  expectRefused(path, "", options);
  expectRefused(folder_.write("a.vtu", vtuFile(good())), "only PLOT3D", options);
}

TEST_F(GridDamage, LimitsHold) {
  Block large;
  large.dims = {60, 60, 60};
  const std::string path = folder_.write("a.vts", vtsFile(large));
  ReadLimits limits;
  limits.memory_bytes = std::uint64_t(8) << 20;
  expectRefused(path, "memory", {}, limits);
  limits.memory_bytes = std::uint64_t(1) << 30;
  EXPECT_EQ(readGrid(path, {}, limits).grid.cellCount(), 59U * 59U * 59U);
  limits.time_s = 0.05;
  EXPECT_THROW(readGrid(path, {}, limits), FileError);
}

/// A reader of our own making, to see what the parent does with answers that a healthy child never gives.
class FakeGridReader : public GridDamage {
 protected:
  static std::string answerOf(const IrregularGrid& grid, const std::function<void(GridReply&)>& spoil = {}) {
    GridReply reply = {};
    std::memcpy(reply.magic, kGridMagic, sizeof reply.magic);
    reply.version = kReaderProtocolVersion;
    reply.points = grid.vertexCount();
    reply.cells = grid.cellCount();
    reply.connectivity = grid.connectivity.size();
    reply.arrays = 1;
    if (spoil)
      spoil(reply);
    ArrayReply array = {};
    array.components = 1;
    array.name_bytes = 6;
    std::string bytes(reinterpret_cast<const char*>(&reply), sizeof reply);
    const auto append = [&bytes](const auto& values) {
      bytes.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof values[0]);
    };
    append(grid.points);
    append(grid.cell_types);
    append(grid.cell_offsets);
    append(grid.connectivity);
    append(grid.point_scalars);
    append(std::vector<ArrayReply>{array});
    return bytes + "sca\tar";
  }

  std::string use(const std::string& answer) {
    const std::string script = folder_.write("reader.sh", "#!/bin/sh\ncat '" + folder_.write("answer", answer) + "'\n");
    chmod(script.c_str(), 0755);
    setenv("SOFT_VOLUME_READER", script.c_str(), 1);
    return folder_.write("any.vtu", "x");
  }
};

TEST_F(FakeGridReader, GoodAnswerIsAccepted) {
  const GridFile file = readGrid(use(answerOf(mixedGrid())));
  EXPECT_EQ(file.grid.connectivity, mixedGrid().connectivity);
  EXPECT_EQ(file.arrays[0].name, "sca ar");  // printable, whatever it was
}

TEST_F(FakeGridReader, ClaimsBeyondTheLimitCostNothing) {
  const std::uint64_t huge = std::uint64_t(1) << 62;
  expectRefused(use(answerOf(mixedGrid(), [&](GridReply& r) { r.points = huge; })), "more than the limit");
  expectRefused(use(answerOf(mixedGrid(), [&](GridReply& r) { r.cells = huge; })), "more than the limit");
  expectRefused(use(answerOf(mixedGrid(), [&](GridReply& r) { r.connectivity = huge; })), "more than the limit");
  // Within the limit, but it never comes.
  expectRefused(use(answerOf(mixedGrid(), [](GridReply& r) { r.connectivity = 500000000; })), "the reader died");
  expectRefused(use(answerOf(mixedGrid(), [](GridReply& r) { r.arrays = 4000000000U; })), "the reader died");
  expectRefused(use(answerOf(mixedGrid(), [](GridReply& r) { r.notes = 4000000000U; })), "the reader died");
}

TEST_F(FakeGridReader, InconsistentAnswersAreRefused) {
  IrregularGrid grid = mixedGrid();
  grid.connectivity[3] = 26;
  expectRefused(use(answerOf(grid)), "cell 0 names vertex 26");
  grid = mixedGrid();
  grid.cell_offsets[2] = 3;
  expectRefused(use(answerOf(grid)), "cell_offsets");
  grid = mixedGrid();
  grid.cell_types[0] = CellType(77);
  expectRefused(use(answerOf(grid)), "type 77");
  grid = mixedGrid();
  grid.points[7].z() = std::nanf("");
  expectRefused(use(answerOf(grid)), "1 of 26 points are not finite");
  expectRefused(use(answerOf(mixedGrid(), [](GridReply& r) { r.taken = 1; })), "names no array");
  expectRefused(use(answerOf(mixedGrid(), [](GridReply& r) { ++r.version; })), "not understood");
  expectRefused(use("SVVOLUME" + std::string(300, '\0')), "not understood");
}

/// What comes back was validated by readGrid(); here it must also be of the promised kind.
void expectUsable(const GridFile& file) {
  EXPECT_GT(file.grid.cellCount(), 0U);
  EXPECT_NO_THROW(file.grid.validate());
  EXPECT_LT(file.taken, file.arrays.size());
  for (const float s : file.grid.point_scalars)
    EXPECT_FALSE(std::isinf(s));
}

TEST_F(GridDamage, RandomDamageIsRefusedOrConsistent) {
  constexpr unsigned kSeed = 1997;
  std::mt19937 random(kSeed);
  int refused = 0, accepted = 0, died = 0, hung = 0;
  ReadLimits limits;
  limits.memory_bytes = std::uint64_t(256) << 20;
  limits.time_s = 3.0;
  for (int round = 0; round < fuzzRounds(6); ++round) {
    for (Sample sample : goodFiles()) {
      SCOPED_TRACE("seed " + std::to_string(kSeed) + ", round " + std::to_string(round) + ", " + sample.name);
      std::string& victim = sample.solution.empty() || random() % 2 == 0 ? sample.bytes : sample.solution;
      victim = damaged(victim, random);
      const GridReadOptions options = optionsOf(sample, folder_);
      try {
        expectUsable(readGrid(folder_.write(sample.name, sample.bytes), options, limits));
        ++accepted;
      } catch (const FileError& error) {
        ++refused;
        died += std::string(error.what()).find("the reader died") != std::string::npos ? 1 : 0;
        hung += std::string(error.what()).find("longer than") != std::string::npos ? 1 : 0;
      }
    }
  }
  std::cout << "seed " << kSeed << ": " << refused << " refused (" << died << " by the child's death, " << hung
            << " by its time limit), " << accepted << " accepted\n";
  EXPECT_GT(refused, 0);
}

}  // namespace
}  // namespace soft_volume::core
