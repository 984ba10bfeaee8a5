// Files that are missing, short, wrong or hostile: each must become a FileError, never a crash, a hang or zeros.

#include <dirent.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <iostream>
#include <random>

#include "../src/volume/reader_protocol.h"
#include "soft_volume/common/error.h"
#include "soft_volume/volume/volume_reader.h"
#include "volume/file_damage.h"
#include "volume/sample_files.h"

namespace soft_volume::core {
namespace {

using namespace testing_volume;

constexpr const char* kLps = "left-posterior-superior";

ReadLimits limitsOf(double time_s) {
  ReadLimits limits;
  limits.time_s = time_s;
  return limits;
}

/// Reads and expects a FileError that begins with the path and contains `reason`; returns its text. A reader that hangs
/// until its time is over does not count as a refusal.
std::string expectRefused(const std::string& path, const std::string& reason,
                          const ReadLimits& limits = limitsOf(10.0)) {
  try {
    readVolume(path, limits);
    ADD_FAILURE() << path << " was accepted; expected: " << reason;
    return "";
  } catch (const FileError& error) {
    const std::string text = error.what();
    EXPECT_EQ(text.rfind(path + ": ", 0), 0U) << text;
    EXPECT_NE(text.find(reason), std::string::npos) << text << "\n expected: " << reason;
    EXPECT_EQ(text.find("longer than 10"), std::string::npos) << text;
    return text;
  }
}

int openFiles() {
  DIR* folder = opendir("/proc/self/fd");
  int count = 0;
  while (readdir(folder) != nullptr) {
    ++count;
  }
  closedir(folder);
  return count;
}

/// Every test ends with the files and children that it began with: no leak, no zombie.
class Damage : public testing::Test {
 protected:
  void SetUp() override { files_before_ = openFiles(); }
  void TearDown() override {
    unsetenv("SOFT_VOLUME_READER");
    EXPECT_EQ(openFiles(), files_before_);
    EXPECT_EQ(waitpid(-1, nullptr, WNOHANG), -1);
    EXPECT_EQ(errno, ECHILD) << "a child was left behind";
  }

  TemporaryFolder folder_;

 private:
  int files_before_ = 0;
};

TEST_F(Damage, MissingFile) {
  expectRefused(folder_.file("nothing.mha"), "No such file");
}

TEST_F(Damage, UnknownExtension) {
  expectRefused(folder_.write("a.txt", "x"), "type of this file is not known");
  expectRefused(folder_.write("mha", metaImageFile({})), "type of this file is not known");
}

TEST_F(Damage, FolderWithoutDicom) {
  expectRefused(folder_.path(), "no DICOM images");
  folder_.write("notes.txt", "hello");
  expectRefused(folder_.path(), "no DICOM images");
}

TEST_F(Damage, EmptyFiles) {
  for (const char* name : {"a.nii", "a.nii.gz", "a.nrrd", "a.nhdr", "a.mha", "a.mhd", "a.vti"}) {
    expectRefused(folder_.write(name, ""), "");
  }
  folder_.write("a.dcm", "");
  expectRefused(folder_.path(), "no DICOM file");
}

TEST_F(Damage, FileWithoutPermission) {
  const std::string path = folder_.write("a.mha", metaImageFile({}));
  chmod(path.c_str(), 0);
  if (access(path.c_str(), R_OK) == 0) {
    GTEST_SKIP() << "this user may read everything";
  }
  expectRefused(path, "");
}

/// One good file of each format.
struct Sample {
  std::string name;
  std::string bytes;
};

std::vector<Sample> goodFiles() {
  SampleGrid grid;
  grid.direction_ras = turnedAxes();
  return {{"a.nii", niftiFile(grid)},
          {"a.nii.gz", gzipped(niftiFile(grid))},
          {"a.mha", metaImageFile(grid)},
          {"raw.nrrd", nrrdFile(grid, kLps, "raw")},
          {"gzip.nrrd", nrrdFile(grid, kLps, "gzip")},
          {"a.vti", vtiFile(grid)},
          {"a.dcm", dicomFile(grid, 1)}};
}

/// A DICOM file is read through its folder.
std::string pathOf(const TemporaryFolder& folder, const Sample& sample) {
  folder.write(sample.name, sample.bytes);
  return sample.name == "a.dcm" ? folder.path() : folder.file(sample.name);
}

TEST_F(Damage, GoodFilesAreAccepted) {
  for (const Sample& sample : goodFiles()) {
    const TemporaryFolder folder;
    EXPECT_NO_THROW(readVolume(pathOf(folder, sample))) << sample.name;
  }
}

TEST_F(Damage, TruncatedFilesNeverBecomeZeros) {
  for (const Sample& sample : goodFiles()) {
    for (const double part : {0.02, 0.2, 0.5, 0.7, 0.8, 0.9, 0.97}) {
      const TemporaryFolder folder;
      const auto size = static_cast<std::size_t>(part * double(sample.bytes.size()));
      SCOPED_TRACE(sample.name + " cut to " + std::to_string(size) + " bytes");
      expectRefused(pathOf(folder, {sample.name, sample.bytes.substr(0, size)}), "");
    }
  }
}

TEST_F(Damage, OneMissingByteIsNoticed) {
  for (const char* name : {"a.nii", "a.mha", "raw.nrrd", "a.dcm"}) {
    for (Sample sample : goodFiles()) {
      if (sample.name == name) {
        const TemporaryFolder folder;
        sample.bytes.pop_back();
        expectRefused(pathOf(folder, sample), "");
      }
    }
  }
}

TEST_F(Damage, ShortDetachedData) {
  const std::string whole = metaImageFile({});
  const std::string header = whole.substr(0, whole.size() - SampleGrid().bytes().size());
  const std::string path = folder_.write("a.mhd", replaced(header, "LOCAL", "a.raw"));
  expectRefused(path, "a.raw cannot be read");
  folder_.write("a.raw", SampleGrid().bytes().substr(1));
  expectRefused(path, "too short");
}

TEST_F(Damage, HugeClaims) {
  const std::string many = "100000 100000 100000";
  expectRefused(folder_.write("a.mha", replaced(metaImageFile({}), "5 4 3", many)), "claims 100000 x 100000 x 100000");
  expectRefused(folder_.write("a.nrrd", replaced(nrrdFile({}, kLps, "gzip"), "5 4 3", many)), "memory limit");
  SampleGrid huge;
  std::string vti = vtiFile(huge);
  for (int i = 0; i < 2; ++i) {
    vti = replaced(vti, "2 6 2 5 2 4", "0 99999 0 99999 0 99999");
  }
  expectRefused(folder_.write("a.vti", vti), "memory limit");
  NiftiOptions options;
  options.dims = {3, 32767, 32767, 32767, 1, 1, 1, 1};
  expectRefused(folder_.write("a.nii", niftiFile({}, options)), "memory limit");
}

TEST_F(Damage, SizesThatAreNotPositive) {
  for (const char* bad : {"5 0 3", "5 -4 3", "5 4"}) {
    expectRefused(folder_.write("a.mha", replaced(metaImageFile({}), "5 4 3", bad)), "");
    expectRefused(folder_.write("a.nrrd", replaced(nrrdFile({}, kLps, "raw"), "5 4 3", bad)), "");
  }
}

TEST_F(Damage, MoreThanOneComponent) {
  SampleGrid grid;
  grid.dims = {5, 4, 6};
  const std::string twice = replaced(replaced(metaImageFile(grid), "5 4 6", "5 4 3"), "ElementType",
                                     "ElementNumberOfChannels = 2\nElementType");
  expectRefused(folder_.write("a.mha", twice), "2 components");
  expectRefused(folder_.write("a.nrrd", replaced(nrrdFile({}, kLps, "raw"), "kinds: domain", "kinds: vector")),
                "vector");
  expectRefused(folder_.write("b.nrrd", replaced(nrrdFile({}, kLps, "raw"), "dimension: 3", "dimension: 4")),
                "4 dimensions");
  NiftiOptions colour;
  colour.datatype = 128;
  colour.bits = 24;
  expectRefused(folder_.write("a.nii", niftiFile({}, colour) + std::string(60, '\0')), "3 components");
  SampleGrid twice_as_deep;
  twice_as_deep.dims = {5, 4, 6};
  std::string vti = replaced(vtiFile(twice_as_deep), "Name=", "NumberOfComponents=\"2\" Name=");
  for (int i = 0; i < 2; ++i) {
    vti = replaced(vti, "2 6 2 5 2 7", "2 6 2 5 2 4");
  }
  expectRefused(folder_.write("a.vti", vti), "2 components");
}

TEST_F(Damage, SeveralTimePoints) {
  NiftiOptions options;
  options.dims = {4, 5, 4, 3, 2, 1, 1, 1};
  expectRefused(folder_.write("a.nii", niftiFile({}, options) + SampleGrid().bytes()), "2 time points");
}

TEST_F(Damage, UnsupportedScalars) {
  SampleGrid grid;
  grid.dims = {5, 4, 12};
  const std::string file = replaced(replaced(metaImageFile(grid), "5 4 12", "5 4 3"), "MET_SHORT", "MET_LONG_LONG");
  expectRefused(folder_.write("a.mha", file), "not supported");
}

TEST_F(Damage, ShearedAxes) {
  SampleGrid grid;
  grid.direction_ras(0, 1) = 0.2;
  for (const Sample& sample : {Sample{"a.mha", metaImageFile(grid)}, Sample{"a.nii", niftiFile(grid)},
                               Sample{"a.nrrd", nrrdFile(grid, kLps, "raw")}}) {
    expectRefused(folder_.write(sample.name, sample.bytes), "not perpendicular");
  }
}

TEST_F(Damage, SpacingOfZero) {
  expectRefused(folder_.write("a.mha", replaced(metaImageFile({}), "0.5 0.75 1.25", "0.5 0 1.25")), "spacing");
}

TEST_F(Damage, UnknownSpaceOrUnit) {
  expectRefused(folder_.write("a.nrrd", replaced(nrrdFile({}, kLps, "raw"), kLps, "left-anterior-superior")), "space");
  expectRefused(folder_.write("a.mha", metaImageFile({}, "DistanceUnits = inch\n")), "unit");
}

TEST_F(Damage, DicomSeriesWithAMissingSlice) {
  SampleGrid grid;
  grid.dims = {5, 4, 4};
  writeDicomSeries(folder_, grid);
  unlink(folder_.file("image3.dcm").c_str());  // the second slice
  expectRefused(folder_.path(), "not evenly spaced");
}

TEST_F(Damage, DicomSeriesTwiceInOneFolder) {
  writeDicomSeries(folder_, {});
  folder_.write("copy.dcm", dicomFile({}, 1));
  expectRefused(folder_.path(), "not evenly spaced");
}

TEST_F(Damage, TwoDicomSeries) {
  writeDicomSeries(folder_, {});
  DicomOptions options;
  options.series = "9.9.9";
  folder_.write("other.dcm", dicomFile({}, 0, options));
  expectRefused(folder_.path(), "2 DICOM series");
}

TEST_F(Damage, CompressedDicom) {
  DicomOptions options;
  options.transfer_syntax = "1.2.840.10008.1.2.4.70";
  writeDicomSeries(folder_, {}, options);
  expectRefused(folder_.path(), "compressed");
}

TEST_F(Damage, DicomWithoutPixels) {
  DicomOptions options;
  options.has_pixels = false;
  writeDicomSeries(folder_, {}, options);
  expectRefused(folder_.path(), "too short");
}

double secondsOf(const std::function<void()>& body) {
  const auto start = std::chrono::steady_clock::now();
  body();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

TEST_F(Damage, FileThatNeverEndsIsStoppedAtTheTimeLimit) {
  const std::string path = folder_.file("pipe.nii");
  ASSERT_EQ(mkfifo(path.c_str(), 0600), 0);
  ReadLimits limits;
  limits.time_s = 0.3;
  EXPECT_LT(secondsOf([&] { expectRefused(path, "longer than 0.3", limits); }), 3.0);  // nobody writes at all
  const int writer = open(path.c_str(), O_RDWR);
  ASSERT_EQ(write(writer, "\x5C\x01\x00\x00", 4), 4);
  EXPECT_LT(secondsOf([&] { expectRefused(path, "longer than 0.3", limits); }), 3.0);  // somebody began to
  close(writer);
}

TEST_F(Damage, MemoryLimitRefusesTheClaim) {
  ReadLimits limits;
  limits.memory_bytes = 100;
  expectRefused(folder_.write("a.mha", metaImageFile({})), "limit", limits);
}

TEST_F(Damage, MemoryLimitStopsTheParser) {
  SampleGrid grid;
  grid.dims = {160, 160, 160};  // 8 MB of int16, and 16 MB more when it is rescaled to float
  NiftiOptions options;
  options.slope = 2.0F;
  const std::string path = folder_.write("a.nii", niftiFile(grid, options));
  EXPECT_EQ(readVolume(path).type(), ScalarType::kFloat32);
  ReadLimits limits;
  limits.memory_bytes = std::uint64_t(12) << 20;
  expectRefused(path, "memory", limits);
}

/// A reader of our own making, to see what the parent does with answers that a healthy child never gives.
class FakeReader : public Damage {
 protected:
  void use(const std::string& script) {
    const std::string path = folder_.write("reader.sh", "#!/bin/sh\n" + script + "\n");
    chmod(path.c_str(), 0755);
    setenv("SOFT_VOLUME_READER", path.c_str(), 1);
  }
  void answer(const VolumeReply& reply, const std::string& data, const std::string& afterwards = "") {
    const std::string bytes(reinterpret_cast<const char*>(&reply), sizeof reply);
    use("cat '" + folder_.write("answer", bytes + data) + "'\n" + afterwards);
  }
  static VolumeReply goodReply() {
    VolumeReply reply = {};
    std::memcpy(reply.magic, kVolumeMagic, sizeof reply.magic);
    reply.version = kReaderProtocolVersion;
    reply.scalar_type = 1;
    for (int axis = 0; axis < 3; ++axis) {
      reply.dims[axis] = 2;
      reply.spacing_m[axis] = 1.0;
      reply.direction[4 * axis] = 1.0;
    }
    reply.byte_count = 8;
    return reply;
  }
  std::string path_ = folder_.write("any.nii", "x");
};

TEST_F(FakeReader, GoodAnswerIsAccepted) {
  answer(goodReply(), "12345678");
  EXPECT_EQ(readVolume(path_).at(1, 1, 1), double('8'));
}

TEST_F(FakeReader, DeathBySignalIsReported) {
  use("kill -SEGV $$");
  expectRefused(path_, "the reader died (ended by signal 11");
  answer(goodReply(), "123", "kill -ABRT $$");
  expectRefused(path_, "the reader died (ended by signal 6");
}

TEST_F(FakeReader, DeathAfterTheDataIsAnErrorToo) {
  answer(goodReply(), "12345678", "kill -SEGV $$");
  expectRefused(path_, "signal 11");
}

TEST_F(FakeReader, EarlyEndCarriesTheLastWords) {
  use("echo 'cannot load libvtk' >&2; exit 127");
  const std::string text = expectRefused(path_, "exit code 127");
  EXPECT_NE(text.find("cannot load libvtk"), std::string::npos) << text;
}

TEST_F(FakeReader, ErrorTextIsMadePrintable) {
  use("printf 'SVERROR:bad\\nfile\\033[31m'; exit 1");
  expectRefused(path_, "bad file [31m");
}

TEST_F(FakeReader, UnknownAnswer) {
  VolumeReply reply = goodReply();
  reply.magic[0] = 'x';
  answer(reply, "12345678");
  expectRefused(path_, "not understood");
  reply = goodReply();
  reply.version = kReaderProtocolVersion + 1;
  answer(reply, "12345678");
  expectRefused(path_, "not understood");
}

TEST_F(FakeReader, ClaimBeyondTheLimitCostsNothing) {
  VolumeReply reply = goodReply();
  reply.byte_count = std::uint64_t(1) << 62;
  answer(reply, "12345678");
  expectRefused(path_, "more than the limit");
  reply.byte_count = std::uint64_t(7) << 30;  // within the default limit, but it never comes
  answer(reply, "12345678");
  expectRefused(path_, "the reader died (exit code 0");
}

TEST_F(FakeReader, InconsistentAnswers) {
  const std::function<void(VolumeReply&)> spoils[] = {
      [](VolumeReply& r) { r.dims[0] = 3; },          [](VolumeReply& r) { r.dims[1] = -2; },
      [](VolumeReply& r) { r.scalar_type = 77; },     [](VolumeReply& r) { r.spacing_m[2] = 0.0; },
      [](VolumeReply& r) { r.direction[0] = 2.0; },   [](VolumeReply& r) { r.origin_m[0] = std::nan(""); },
      [](VolumeReply& r) { r.scalar_type = 1 << 8; },
  };
  for (const auto& spoil : spoils) {
    VolumeReply reply = goodReply();
    spoil(reply);
    answer(reply, "12345678");
    expectRefused(path_, "");
  }
}

TEST_F(FakeReader, ChildThatClosesItsOutputButLivesIsStopped) {
  answer(goodReply(), "12345678", "exec >&- 2>&-; sleep 20");
  ReadLimits limits;
  limits.time_s = 0.5;
  EXPECT_LT(secondsOf([&] { expectRefused(path_, "longer than 0.5", limits); }), 4.0);
}

TEST_F(FakeReader, FloodOfComplaintsDoesNotBlock) {
  answer(goodReply(), "12345678", "head -c 3000000 /dev/zero | tr '\\0' x >&2");
  EXPECT_NO_THROW(readVolume(path_));
}

TEST_F(FakeReader, MissingProgramIsNamed) {
  setenv("SOFT_VOLUME_READER", "/no/such/program", 1);
  expectRefused(path_, "/no/such/program");
}

void expectConsistent(const Volume& volume) {
  const VolumeGeometry& geometry = volume.geometry();
  EXPECT_EQ(volume.data().size(), geometry.voxelCount() * scalarSize(volume.type()));
  EXPECT_NO_THROW(Volume(geometry, volume.type(), volume.data()));
  EXPECT_TRUE(std::isfinite(volume.range()[1]));
}

TEST_F(Damage, RandomDamageIsRefusedOrConsistent) {
  constexpr unsigned kSeed = 1997;
  std::mt19937 random(kSeed);
  int refused = 0, accepted = 0, died = 0, hung = 0;
  ReadLimits limits;
  limits.memory_bytes = std::uint64_t(256) << 20;
  limits.time_s = 3.0;
  for (int round = 0; round < fuzzRounds(12); ++round) {
    for (const Sample& sample : goodFiles()) {
      SCOPED_TRACE("seed " + std::to_string(kSeed) + ", round " + std::to_string(round) + ", " + sample.name);
      const TemporaryFolder folder;
      try {
        expectConsistent(readVolume(pathOf(folder, {sample.name, damaged(sample.bytes, random)}), limits));
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
