#include "soft_volume/volume/volume_reader.h"

#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <thread>

#include "soft_volume/common/error.h"
#include "volume/sample_files.h"

namespace soft_volume::core {
namespace {

using namespace testing_volume;

const char* const kMri = "/usr/share/mricron/templates/ch2.nii.gz";
const char* const kLabels = "/usr/share/mricron/templates/aal.nii.gz";

SampleGrid gridWith(const Matrix3& direction_ras) {
  SampleGrid grid;
  grid.direction_ras = direction_ras;
  return grid;
}

class Orientations : public testing::TestWithParam<Matrix3> {
 protected:
  SampleGrid grid_ = gridWith(GetParam());
  TemporaryFolder folder_;
};
INSTANTIATE_TEST_SUITE_P(All, Orientations, testing::Values(Matrix3::Identity(), turnedAxes(), mirroredAxes()));

TEST_P(Orientations, NiftiSform) {
  expectSamePlaces(readVolume(folder_.write("a b.nii", niftiFile(grid_))), grid_);
}

TEST_P(Orientations, NiftiQform) {
  NiftiOptions options;
  options.use_sform = false;
  expectSamePlaces(readVolume(folder_.write("a.nii.gz", gzipped(niftiFile(grid_, options)))), grid_);
}

TEST_P(Orientations, MetaImage) {
  expectSamePlaces(readVolume(folder_.write("a.mha", metaImageFile(grid_))), grid_);
}

TEST_P(Orientations, MetaImageWithDetachedData) {
  const std::string whole = metaImageFile(grid_);
  const std::size_t header_size = whole.size() - grid_.bytes().size();
  folder_.write("the data.raw", grid_.bytes());
  const std::string header = replaced(whole.substr(0, header_size), "LOCAL", "the data.raw");
  expectSamePlaces(readVolume(folder_.write("a.mhd", header)), grid_);
}

TEST_P(Orientations, NrrdInBothSpaces) {
  for (const char* space : {"left-posterior-superior", "right-anterior-superior"}) {
    for (const char* encoding : {"raw", "gzip"}) {
      SCOPED_TRACE(std::string(space) + " " + encoding);
      expectSamePlaces(readVolume(folder_.write("a.nrrd", nrrdFile(grid_, space, encoding))), grid_);
    }
  }
}

TEST_P(Orientations, NrrdWithDetachedData) {
  const std::string whole = nrrdFile(grid_, "left-posterior-superior", "raw");
  const std::string header = whole.substr(0, whole.size() - grid_.bytes().size());
  folder_.write("a.raw", grid_.bytes());
  const std::string detached = replaced(header, "encoding: raw", "encoding: raw\ndata file: a.raw");
  expectSamePlaces(readVolume(folder_.write("a.nhdr", detached)), grid_);
}

TEST_P(Orientations, Vti) {
  expectSamePlaces(readVolume(folder_.write("a.vti", vtiFile(grid_))), grid_);
}

TEST_P(Orientations, DicomSeries) {
  writeDicomSeries(folder_, grid_);
  folder_.write("README.txt", "not an image");
  expectSamePlaces(readVolume(folder_.path()), grid_);
}

TEST(ReadVolume, KeepsTheTypeOfTheFile) {
  const TemporaryFolder folder;
  EXPECT_EQ(readVolume(folder.write("a.nii", niftiFile({}))).type(), ScalarType::kInt16);
  NiftiOptions options;
  options.datatype = 512;
  EXPECT_EQ(readVolume(folder.write("b.nii", niftiFile({}, options))).type(), ScalarType::kUInt16);
}

TEST(ReadVolume, NiftiUnitsAreHonoured) {
  const TemporaryFolder folder;
  const double factors[] = {1e-3, 1.0, 1e-3, 1e-6};  // unknown, metre, millimetre, micrometre
  for (int unit = 0; unit < 4; ++unit) {
    NiftiOptions options;
    options.xyzt_units = unit;
    const Volume volume = readVolume(folder.write("a.nii", niftiFile({}, options)));
    EXPECT_DOUBLE_EQ(volume.geometry().spacing_m.y(), 0.75 * factors[unit]);
    EXPECT_DOUBLE_EQ(volume.geometry().origin_m.z(), 30.0 * factors[unit]);
  }
}

TEST(ReadVolume, NiftiSlopeAndInterceptBecomeIntensities) {
  const TemporaryFolder folder;
  NiftiOptions options;
  options.slope = 2.5F;
  options.intercept = -1024.0F;
  const Volume volume = readVolume(folder.write("a.nii", niftiFile({}, options)));
  EXPECT_EQ(volume.type(), ScalarType::kFloat32);
  EXPECT_EQ(volume.at(3, 2, 1), 2.5 * SampleGrid::value(3, 2, 1) - 1024.0);
}

TEST(ReadVolume, DicomRescaleBecomesHounsfieldUnits) {
  const TemporaryFolder folder;
  DicomOptions options;
  options.intercept = "-1024";
  writeDicomSeries(folder, {}, options);
  const Volume volume = readVolume(folder.path());
  EXPECT_EQ(volume.type(), ScalarType::kInt16);
  EXPECT_EQ(volume.at(3, 2, 1), SampleGrid::value(3, 2, 1) - 1024.0);
}

TEST(ReadVolume, DicomFractionalSlopeBecomesFloat) {
  const TemporaryFolder folder;
  DicomOptions options;
  options.slope = "0.5";
  writeDicomSeries(folder, {}, options);
  const Volume volume = readVolume(folder.path());
  EXPECT_EQ(volume.type(), ScalarType::kFloat32);
  EXPECT_EQ(volume.at(3, 2, 1), 0.5 * SampleGrid::value(3, 2, 1));
}

TEST(ReadVolume, OfTheMriHeadAndItsLabelsIsOnOneGrid) {
  if (!std::filesystem::exists(kMri)) {
    GTEST_SKIP() << "install mricron-data to run this test";
  }
  const Volume mri = readVolume(kMri);
  const Volume labels = readVolume(kLabels);
  EXPECT_EQ(mri.geometry().dims, Vector3i(181, 217, 181));
  EXPECT_EQ(mri.geometry().spacing_m, Vector3(0.001, 0.001, 0.001));
  EXPECT_EQ(mri.geometry().origin_m, Vector3(-0.090, -0.125, -0.071));
  EXPECT_EQ(mri.type(), ScalarType::kUInt8);
  EXPECT_EQ(mri.range(), (std::array<double, 2>{0.0, 254.0}));
  EXPECT_EQ(labels.range(), (std::array<double, 2>{0.0, 116.0}));
  EXPECT_EQ(labels.geometry().dims, mri.geometry().dims);
  EXPECT_EQ(labels.geometry().origin_m, mri.geometry().origin_m);
  EXPECT_EQ(labels.geometry().direction, mri.geometry().direction);
  EXPECT_EQ(mri.hash(), readVolume(kMri).hash());
}

TEST(ReadVolume, WorksInSeveralThreadsAtOnce) {
  const TemporaryFolder folder;
  const std::string path = folder.write("a.nrrd", nrrdFile({}, "left-posterior-superior", "gzip"));
  const std::uint64_t expected = readVolume(path).hash();
  std::vector<std::uint64_t> hashes(8);
  std::vector<std::thread> threads;
  for (std::uint64_t& hash : hashes) {
    threads.emplace_back([&hash, &path] { hash = readVolume(path).hash(); });
  }
  for (std::thread& thread : threads) {
    thread.join();
  }
  EXPECT_EQ(hashes, std::vector<std::uint64_t>(8, expected));
}

class RoundTrip : public testing::TestWithParam<int> {
 protected:
  Volume makeVolume() const {
    VolumeGeometry geometry;
    geometry.dims = {7, 3, 4};
    geometry.spacing_m = {0.957e-3, 1.1e-3, 0.0015};
    geometry.origin_m = {-0.0123, 0.2, 1.0 / 3.0};
    geometry.direction = turnedAxes();
    const auto type = static_cast<ScalarType>(GetParam());
    std::vector<std::uint8_t> data(geometry.voxelCount() * scalarSize(type));
    for (std::size_t i = 0; i < data.size(); ++i) {
      data[i] = static_cast<std::uint8_t>(i * 37 + 11);  // every bit pattern must survive, whatever it means
    }
    return Volume(geometry, type, data);
  }
};
INSTANTIATE_TEST_SUITE_P(EveryScalarType, RoundTrip, testing::Range(0, 8));

void expectSameVolume(const Volume& a, const Volume& b) {
  EXPECT_EQ(a.type(), b.type());
  EXPECT_EQ(a.data(), b.data());
  EXPECT_EQ(a.geometry().dims, b.geometry().dims);
  EXPECT_LT((a.geometry().spacing_m - b.geometry().spacing_m).norm(), 1e-17);
  EXPECT_LT((a.geometry().origin_m - b.geometry().origin_m).norm(), 1e-15);
  EXPECT_LT((a.geometry().direction - b.geometry().direction).norm(), 1e-14);
}

TEST_P(RoundTrip, MetaImageInOneFileAndInTwo) {
  const TemporaryFolder folder;
  const Volume volume = makeVolume();
  for (const char* name : {"a.mha", "b c.mhd"}) {
    writeMetaImage(volume, folder.file(name));
    expectSameVolume(readVolume(folder.file(name)), volume);
  }
  EXPECT_TRUE(std::filesystem::exists(folder.file("b c.raw")));
}

TEST(WriteMetaImage, RefusesWhatItCannotWrite) {
  const TemporaryFolder folder;
  const Volume volume(VolumeGeometry{Vector3i(1, 1, 1)}, ScalarType::kUInt8, {1});
  EXPECT_THROW(writeMetaImage(volume, folder.file("a.nii")), FileError);
  EXPECT_THROW(writeMetaImage(volume, folder.file("no such folder/a.mha")), FileError);
  std::filesystem::create_symlink("/dev/full", folder.file("full.mha"));
  EXPECT_THROW(writeMetaImage(volume, folder.file("full.mha")), FileError);
  EXPECT_THROW(writeMetaImage(Volume(), folder.file("a.mha")), FileError);
}

}  // namespace
}  // namespace soft_volume::core
