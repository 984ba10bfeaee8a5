#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

#include "soft_volume/volume/volume_reader.h"
#include "volume/sample_files.h"

namespace soft_volume::core {
namespace {

using testing_volume::TemporaryFolder;

const std::string kScript = std::string("'") + SOFT_VOLUME_SOURCE_DIR + "/scripts/sample_data'";

struct Result {
  int status;
  std::string output;
};

Result run(const std::string& command) {
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  std::string output;
  std::array<char, 4096> block;
  for (std::size_t got = 0; (got = fread(block.data(), 1, block.size(), pipe)) > 0;) {
    output.append(block.data(), got);
  }
  return {pclose(pipe), output};
}

Result makeSamples(const TemporaryFolder& folder) {
  return run(kScript + " --cache '" + folder.path() + "'");
}

class SampleData : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists("/usr/share/doc/invesalius-examples/examples/Cranium.inv3") ||
        !std::filesystem::exists("/usr/share/mricron/templates/ch2.nii.gz")) {
      GTEST_SKIP() << "install invesalius-examples and mricron-data to run this test";
    }
  }
  TemporaryFolder folder_;
};

double meanOf(const Volume& volume, const Vector3i& begin, const Vector3i& end) {
  double sum = 0.0;
  for (int k = begin.z(); k < end.z(); ++k) {
    for (int j = begin.y(); j < end.y(); ++j) {
      for (int i = begin.x(); i < end.x(); ++i) {
        sum += volume.at(i, j, k);
      }
    }
  }
  return sum / double((end - begin).prod());
}

TEST_F(SampleData, TurnsTheCtIntoHounsfieldUnitsInPatientAxes) {
  const Result result = makeSamples(folder_);
  ASSERT_EQ(result.status, 0) << result.output;
  const Volume ct = readVolume(folder_.file("ct_head.mha"));
  const VolumeGeometry& geometry = ct.geometry();
  EXPECT_EQ(geometry.dims, Vector3i(256, 256, 108));
  EXPECT_EQ(ct.type(), ScalarType::kInt16);
  EXPECT_EQ(ct.range(), (std::array<double, 2>{-1024.0, 2986.0}));
  EXPECT_LT((geometry.spacing_m - Vector3(0.9570312e-3, 0.9570312e-3, 1.5e-3)).norm(), 1e-12);
  EXPECT_EQ(geometry.direction, Matrix3(Matrix3::Identity()));
  // The grid's centre is the origin.
  const Vector3 last = geometry.spacing_m.cwiseProduct((geometry.dims - Vector3i::Ones()).cast<double>());
  EXPECT_LT((geometry.origin_m + 0.5 * last).norm(), 1e-12);
  EXPECT_EQ(ct.hash(), readVolume(folder_.file("ct_head.mha")).hash());
}

/// Largest j with tissue, seen from the front.
int frontOf(const Volume& ct, int i, int k) {
  int j = ct.geometry().dims.y() - 1;
  while (j > 0 && ct.at(i, j, k) < -300.0) {
    --j;
  }
  return j;
}

/// The nose sticks out towards high j in the middle of the lower slices; the skull closes towards high k.
TEST_F(SampleData, PointsTheCtTheRightWay) {
  ASSERT_EQ(makeSamples(folder_).status, 0);
  const Volume ct = readVolume(folder_.file("ct_head.mha"));
  EXPECT_GT(frontOf(ct, 128, 20), frontOf(ct, 70, 20) + 15);
  EXPECT_GT(frontOf(ct, 128, 20), frontOf(ct, 186, 20) + 15);
  EXPECT_LT(meanOf(ct, {60, 40, 106}, {196, 210, 108}), meanOf(ct, {60, 40, 50}, {196, 210, 52}) - 300.0);
}

TEST_F(SampleData, RunsTwiceAndLeavesFilesAlone) {
  ASSERT_EQ(makeSamples(folder_).status, 0);
  const auto time = std::filesystem::last_write_time(folder_.file("ct_head.mha"));
  const Result again = makeSamples(folder_);
  EXPECT_EQ(again.status, 0) << again.output;
  EXPECT_EQ(std::filesystem::last_write_time(folder_.file("ct_head.mha")), time);
  EXPECT_NE(again.output.find(folder_.file("ct_head.mha")), std::string::npos);
}

TEST_F(SampleData, TwoRunsAtOnceDoNotClash) {
  std::array<Result, 2> results;
  std::thread other([&] { results[1] = makeSamples(folder_); });
  results[0] = makeSamples(folder_);
  other.join();
  EXPECT_EQ(results[0].status, 0) << results[0].output;
  EXPECT_EQ(results[1].status, 0) << results[1].output;
  const auto entries = std::filesystem::directory_iterator(folder_.path());
  EXPECT_EQ(std::distance(begin(entries), end(entries)), 3) << "a temporary file was left behind";
  EXPECT_NO_THROW(readVolume(folder_.file("ct_head.mha")));
}

TEST_F(SampleData, CopiesTheMriAndItsLabels) {
  ASSERT_EQ(makeSamples(folder_).status, 0);
  EXPECT_EQ(readVolume(folder_.file("ch2.nii.gz")).hash(),
            readVolume("/usr/share/mricron/templates/ch2.nii.gz").hash());
  EXPECT_EQ(readVolume(folder_.file("aal.nii.gz")).geometry().dims, Vector3i(181, 217, 181));
}

TEST(SampleDataScript, TeachesAndReportsErrors) {
  const Result help = run(kScript + " --help");
  EXPECT_EQ(help.status, 0);
  EXPECT_NE(help.output.find("invesalius-examples"), std::string::npos);
  const Result unwritable = run(kScript + " --cache /dev/null/folder");
  EXPECT_NE(unwritable.status, 0);
  EXPECT_EQ(unwritable.output.find("Traceback"), std::string::npos) << unwritable.output;
}

}  // namespace
}  // namespace soft_volume::core
