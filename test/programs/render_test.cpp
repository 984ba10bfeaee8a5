#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "replay/test_folder.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/volume/volume.h"
#include "soft_volume/volume/volume_reader.h"

namespace soft_volume::core {
namespace {

struct Result {
  int code = -1;
  std::string output;  ///< stdout and stderr
};

/// A hexahedron, a wedge, a pyramid and a tetrahedron; scalars grow with z.
constexpr char kMixedGrid[] =
    "# vtk DataFile Version 3.0\nmixed\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 14 float\n"
    "0 0 0  1 0 0  1 1 0  0 1 0  0 0 1  1 0 1  1 1 1  0 1 1\n"
    "2 0 0  2 1 0  0.5 0.5 2\n3 0 0  3 1 0  3 0 1\n"
    "CELLS 4 27\n8 0 1 2 3 4 5 6 7\n6 1 8 5 2 9 6\n5 4 5 6 7 10\n4 8 11 12 13\n"
    "CELL_TYPES 4\n12\n13\n14\n10\n"
    "POINT_DATA 14\nSCALARS height float 1\nLOOKUP_TABLE default\n0 0 0 0 1 1 1 1 0 0 2 0 0 1\n"
    "VECTORS wind float\n1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 1 0 0 0 3 4\n";

class RenderProgram : public testing::Test {
 protected:
  /// Runs in the test's folder; messages have names without folder.
  Result run(const std::string& arguments) const {
    const std::string program = "'" SOFT_VOLUME_BIN_DIR "/soft_volume_render' --no-progress ";
    const std::string command = "cd '" + folder_ / "" + "' && OMP_WAIT_POLICY=passive " + program + arguments + " 2>&1";
    Result result;
    FILE* pipe = popen(command.c_str(), "r");
    std::array<char, 4096> text{};
    while (std::fgets(text.data(), text.size(), pipe) != nullptr)
      result.output += text.data();
    const int status = pclose(pipe);
    result.code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    return result;
  }
  void expectDone(const std::string& arguments) const {
    const Result result = run(arguments);
    EXPECT_EQ(result.code, 0) << arguments << "\n" << result.output;
  }
  void expectRefused(const std::string& arguments, const std::string& part) const {
    const Result result = run(arguments);
    EXPECT_EQ(result.code, 1) << arguments << "\n" << result.output;
    EXPECT_NE(result.output.find(part), std::string::npos) << arguments << "\n" << result.output;
  }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return name;
  }
  Image picture(const std::string& name) const { return readPng(folder_ / name); }
  std::vector<float> floats(const std::string& name) const {
    std::ifstream file(folder_ / name, std::ios::binary);
    const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    std::vector<float> values(bytes.size() / sizeof(float));
    std::memcpy(values.data(), bytes.data(), values.size() * sizeof(float));
    return values;
  }
  nlohmann::json json(const std::string& name) const { return nlohmann::json::parse(std::ifstream(folder_ / name)); }
  bool exists(const std::string& name) const { return std::filesystem::exists(folder_ / name); }

  const TestFolder folder_;
};

/// A block of tissue in air, bright towards the patient's right, front and top. Axes are RAS.
Volume makeVolume() {
  VolumeGeometry geometry;
  geometry.dims = {24, 20, 16};
  geometry.spacing_m = {0.002, 0.002, 0.003};
  std::vector<std::uint8_t> data;
  for (int k = 0; k < 16; ++k) {
    for (int j = 0; j < 20; ++j) {
      for (int i = 0; i < 24; ++i) {
        const bool inside = i > 2 && i < 21 && j > 2 && j < 17 && k > 1 && k < 14;
        data.push_back(std::uint8_t(!inside ? 0 : 100 + (i >= 12 ? 50 : 0) + (k >= 8 ? 80 : 0)));
      }
    }
  }
  return {geometry, ScalarType::kUInt8, std::move(data)};
}

class RenderVolume : public RenderProgram {
 protected:
  void SetUp() override { writeMetaImage(makeVolume(), folder_ / "block.mha"); }
};

class RenderGrid : public RenderProgram {
 protected:
  void SetUp() override { write("mixed.vtk", kMixedGrid); }
};

double meanLevel(const Image& image, int begin_x, int end_x, int begin_y, int end_y) {
  double sum = 0.0;
  for (int y = begin_y; y < end_y; ++y) {
    for (int x = begin_x; x < end_x; ++x) {
      for (int c = 0; c < 3; ++c)
        sum += image.rgb[std::size_t(3 * (y * image.width + x) + c)];
    }
  }
  return sum / (3.0 * (end_x - begin_x) * (end_y - begin_y));
}

// ----------------------------------------------------------------------------------------------------------------
// words

TEST_F(RenderProgram, HelpTeaches) {
  const Result help = run("--help");
  EXPECT_EQ(help.code, 0);
  EXPECT_LT(help.output.find("own unit of length"), 300U) << help.output.substr(0, 400);
  for (const char* word : {"Examples", "--turntable", "--unit-distance", "premultiplied", "total_ms", "Exit code"})
    EXPECT_NE(help.output.find(word), std::string::npos) << word;
}

TEST_F(RenderProgram, ListsThePresets) {
  const Result list = run("--list-tf");
  EXPECT_EQ(list.code, 0);
  for (const char* name : {"ct_bone", "mri_t1_head", "viridis"})
    EXPECT_NE(list.output.find(name), std::string::npos) << name;
}

TEST_F(RenderGrid, ListsTheArrays) {
  const Result list = run("mixed.vtk --list-arrays");
  EXPECT_EQ(list.code, 0);
  for (const char* part : {"4 cells", "1 hexahedra", "1 pyramids", "* height", "wind", "3 components", "from 1 to 5"})
    EXPECT_NE(list.output.find(part), std::string::npos) << part << "\n" << list.output;
}

TEST_F(RenderVolume, ListsTheVolume) {
  const Result list = run("block.mha --list-arrays");
  EXPECT_EQ(list.code, 0);
  EXPECT_NE(list.output.find("24 x 20 x 16 voxels, 2 x 2 x 3 mm, uint8, from 0 to 230"), std::string::npos)
      << list.output;
}

// ---------------------------------------------------------------------------------------------------------------
// images

constexpr char kSolid[] =
    "relative: true\nunit_distance_m: 0.001\npoints: [[0, 0, 0, 0, 0], [0.2, 0.3, 0.3, 0.3, 0.9], "
    "[1, 1, 1, 1, 0.9]]\n";

/// Right and top are bright in the volume; seen from the front the patient's right is on the left.
TEST_F(RenderVolume, PatientIsUprightAndLooksAtTheViewer) {
  write("fog.yaml",
        "relative: true\nunit_distance_m: 0.001\n"
        "points: [[0, 0, 0, 0, 0], [0.4, 0.2, 0.2, 0.2, 0.05], [1, 1, 1, 1, 0.05]]\n");
  expectDone("block.mha --tf fog.yaml --size 60x60 --shade 0 --projection parallel");
  const Image image = picture("block.png");
  ASSERT_EQ(image.width, 60);
  ASSERT_EQ(image.height, 60);
  const double top = meanLevel(image, 10, 50, 12, 28);
  const double bottom = meanLevel(image, 10, 50, 32, 48);
  EXPECT_GT(top, bottom + 20.0);
  const double left = meanLevel(image, 8, 28, 12, 48);
  const double right = meanLevel(image, 32, 52, 12, 48);
  EXPECT_GT(left, right + 20.0);
}

TEST_F(RenderVolume, TheWholeBoxIsInThePictureFromEverySide) {
  write("fog.yaml", "points: [[-1, 1, 1, 1, 0.1], [300, 1, 1, 1, 0.1]]\n");
  for (const char* view :
       {"", "--azimuth 40 --elevation 30", "--elevation 90", "--projection parallel --azimuth -70"}) {
    for (const char* size : {"--size 80x40", "--size 40x80"}) {
      expectDone(std::string("block.mha --tf fog.yaml --shade 0 --raw box.raw ") + view + " " + size);
      const Image image = picture("block.png");
      const int w = image.width;
      const int h = image.height;
      EXPECT_EQ(meanLevel(image, 0, w, 0, 1) + meanLevel(image, 0, w, h - 1, h), 0.0) << view << size;
      EXPECT_EQ(meanLevel(image, 0, 1, 0, h) + meanLevel(image, w - 1, w, 0, h), 0.0) << view << size;
      const double columns = meanLevel(image, 3, 5, 0, h) + meanLevel(image, w - 5, w - 3, 0, h);
      const double rows = meanLevel(image, 0, w, 3, 5) + meanLevel(image, 0, w, h - 5, h - 3);
      EXPECT_GT(columns + rows, 0.0) << "small in the picture: " << view << size;
    }
  }
}

TEST_F(RenderGrid, EveryBackendDrawsTheSame) {
  for (const char* backend : {"native", "gl", "exact"}) {
    expectDone("mixed.vtk --size 64x48 --azimuth 30 --elevation 20 --slices 300 --raw " + std::string(backend) +
               ".raw --json a.json --backend " + backend);
    EXPECT_EQ(json("a.json")["backend"], backend);
  }
  const std::vector<float> exact = floats("exact.raw");
  ASSERT_EQ(exact.size(), 64U * 48U * 4U);
  EXPECT_GT(*std::max_element(exact.begin(), exact.end()), 0.2F);
  for (const char* backend : {"native", "gl"}) {
    const std::vector<float> image = floats(std::string(backend) + ".raw");
    ASSERT_EQ(image.size(), exact.size());
    double squares = 0.0;
    for (std::size_t n = 0; n < image.size(); ++n)
      squares += std::pow(255.0 * (image[n] - exact[n]), 2);
    EXPECT_LT(std::sqrt(squares / double(image.size())), 2.0) << backend;
  }
}

TEST_F(RenderGrid, RawIsPremultipliedAndDoesNotDependOnThreads) {
  expectDone("mixed.vtk --size 50x40 --mode colour --raw one.raw --threads 1");
  expectDone("mixed.vtk --size 50x40 --mode colour --raw two.raw --threads 2");
  const std::vector<float> image = floats("one.raw");
  ASSERT_EQ(image.size(), 50U * 40U * 4U);
  EXPECT_EQ(image, floats("two.raw"));
  for (std::size_t n = 0; n < image.size(); n += 4) {
    EXPECT_LE(image[n + 3], 1.0F);
    for (std::size_t c = 0; c < 3; ++c)
      ASSERT_TRUE(image[n + c] >= 0.0F && image[n + c] <= image[n + 3] + 1e-5F) << n;
  }
}

TEST_F(RenderGrid, JsonHasTimesCountsAndFacts) {
  expectDone("mixed.vtk --size 32x24 --repeat 3 --json a.json --array wind --component 0 --out other.png");
  EXPECT_TRUE(exists("other.png"));
  const nlohmann::json report = json("a.json");
  for (const char* key : {"transform_ms", "bucket_ms", "slice_ms", "render_ms", "total_ms"}) {
    ASSERT_TRUE(report.contains(key)) << key;
    EXPECT_GE(report[key], 0.0) << key;
  }
  for (const char* key : {"cells", "polygons", "fragments", "slices"})
    EXPECT_GT(report[key], 0) << key;
  EXPECT_GT(report["peak_rss_bytes"], 1000000);
  EXPECT_EQ(report["width"], 32);
  EXPECT_EQ(report["input"]["array"], "wind");
  EXPECT_EQ(report["input"]["cells"], 4);
  EXPECT_EQ(report["input"]["range"][1], 1.0);
  EXPECT_EQ(report["transfer_function"]["name"], "viridis");
}

TEST_F(RenderVolume, ModesOfAVolume) {
  for (const char* mode : {"texture", "scalar", "colour"}) {
    expectDone("block.mha --size 40x30 --json a.json --mode " + std::string(mode));
    EXPECT_EQ(json("a.json")["lookup"], mode);
    EXPECT_GT(meanLevel(picture("block.png"), 10, 30, 8, 22), 20.0) << mode;
  }
}

TEST_F(RenderVolume, DepthAndLabelsAgreeWithThePicture) {
  write("solid.yaml", kSolid);
  Volume labels = makeVolume();
  writeMetaImage(labels, folder_ / "labels.mha");
  const std::string common = "block.mha --tf solid.yaml --size 48x36 --projection parallel ";
  expectDone(common + "--depth z.raw --raw a.raw --json a.json --labels labels.mha --label-image l.png");
  expectDone(common + "--depth z.png");
  const std::vector<float> depth = floats("z.raw");
  const std::vector<float> rgba = floats("a.raw");
  ASSERT_EQ(depth.size(), 48U * 36U);
  for (std::size_t n = 0; n < depth.size(); ++n)
    EXPECT_EQ(std::isfinite(depth[n]), rgba[4 * n + 3] >= 0.5F) << n;
  EXPECT_TRUE(exists("l.png"));
  EXPECT_TRUE(exists("z.png"));
  EXPECT_LE(json("a.json")["depth_range"][0], json("a.json")["depth_range"][1]);
}

/// Jitter moves samples by less than a slice, so what is opaque stays opaque.
TEST_F(RenderVolume, JitterLeavesNoHoles) {
  write("solid.yaml", kSolid);
  for (const char* backend : {"native", "gl"}) {
    const auto opacities = [&](const std::string& jitter) {
      expectDone("block.mha --tf solid.yaml --size 64x48 --slices 24 --raw a.raw --backend " + std::string(backend) +
                 jitter);
      return floats("a.raw");
    };
    const std::vector<float> even = opacities("");
    const std::vector<float> jittered = opacities(" --jitter");
    ASSERT_EQ(jittered.size(), even.size());
    EXPECT_NE(jittered, even) << backend;
    std::size_t opaque = 0;
    for (std::size_t n = 3; n < even.size(); n += 4) {
      if (even[n] < 0.999F)
        continue;
      ++opaque;
      EXPECT_GT(jittered[n], 0.99F) << backend << ", pixel " << n / 4;
    }
    EXPECT_GT(opaque, 500U) << backend;
  }
}

TEST_F(RenderGrid, TurntableWritesFrames) {
  expectDone("mixed.vtk --size 32x24 --turntable 3 --out turn.png");
  EXPECT_TRUE(exists("turn_000.png") && exists("turn_001.png") && exists("turn_002.png"));
  EXPECT_FALSE(exists("turn_003.png") || exists("turn.png"));
  EXPECT_GT(compareImages(picture("turn_000.png"), picture("turn_001.png")).pixels, 20U);
}

TEST_F(RenderGrid, CrossSectionsAreOpaque) {
  for (const char* plane : {"0.3", "0,0,1,0.5", "1,1,0,0.7"}) {
    expectDone("mixed.vtk --size 40x40 --raw a.raw --cross-section " + std::string(plane));
    const std::vector<float> image = floats("a.raw");
    const auto opaque = [&](std::size_t pixel) { return image[4 * pixel + 3] == 1.0F; };
    std::size_t count = 0;
    for (std::size_t n = 0; n < 1600; ++n)
      count += opaque(n) ? 1 : 0;
    EXPECT_GT(count, 30U) << plane;
    EXPECT_LT(count, 1600U) << plane;
  }
}

TEST_F(RenderGrid, ClipsAndZooms) {
  const auto visible = [this](const std::string& arguments) {
    expectDone("mixed.vtk --size 40x40 --raw a.raw " + arguments);
    const std::vector<float> image = floats("a.raw");
    std::size_t count = 0;
    for (std::size_t n = 3; n < image.size(); n += 4)
      count += image[n] > 0.0F ? 1 : 0;
    return count;
  };
  const std::size_t all = visible("");
  EXPECT_LT(visible("--clip 1,0,0,1.2"), all);
  EXPECT_LT(visible("--clip 1,0,0,1.2 --clip 0,-2,0,-0.5"), visible("--clip 1,0,0,1.2"));
  EXPECT_GT(visible("--zoom 1.5"), all);
  EXPECT_LT(visible("--zoom 0.5"), all);
}

TEST_F(RenderGrid, CameraFromAFile) {
  write("camera.yaml",
        "width: 36\nheight: 28\neye_m: [1.5, 0.5, 9]\ntarget_m: [1.5, 0.5, 0]\nup: [0, 1, 0]\nvertical_fov_rad: 0.4\n");
  expectDone("mixed.vtk --camera camera.yaml");
  EXPECT_EQ(picture("mixed.png").width, 36);
  EXPECT_GT(meanLevel(picture("mixed.png"), 0, 36, 0, 28), 1.0);
  const auto refused = [this](const std::string& eye, const std::string& part) {
    write("bad.yaml", "eye_m: " + eye + "\ntarget_m: [1.5, 0.5, 0]\nup: [0, 1, 0]\n");
    expectRefused("mixed.vtk --camera bad.yaml", part);
  };
  refused("[1.5, 0.5, 0.5]", "within the grid");
  refused("[.inf, 0, 0]", "eye_m");
  refused("[1e11, 0, 0]", "million times");
  refused("[1.5, 0.5, 0]", "same point");
  refused("[1.5, 9, 0]", "along the view direction");
  write("zero.yaml", "fx: 10\nfy: 10\ncx: 0\ncy: 0\nposition_m: [0, 0, 9]\norientation_xyzw: [0, 0, 0, 0]\n");
  expectRefused("mixed.vtk --camera zero.yaml", "quaternion");
  expectRefused("mixed.vtk --camera missing.yaml", "missing.yaml");
  expectRefused("mixed.vtk --camera camera.yaml --azimuth 3", "excludes");
}

TEST_F(RenderGrid, SaysThatThePictureIsEmpty) {
  write("none.yaml", "points: [[100, 1, 1, 1, 0], [300, 1, 1, 1, 1]]\n");
  const Result result = run("mixed.vtk --tf none.yaml --size 20x20");
  EXPECT_EQ(result.code, 0);
  EXPECT_NE(result.output.find("the picture is empty"), std::string::npos) << result.output;
}

// ---------------------------------------------------------------------------------------------------------------
// errors

TEST_F(RenderGrid, RefusesBadArguments) {
  expectRefused("", "no input");
  expectRefused("missing.vtk", "missing.vtk");
  expectRefused("mixed.vtk --size 0x0", "out of range");
  expectRefused("mixed.vtk --size 1000000x1000000", "out of range");
  expectRefused("mixed.vtk --size 640", "WIDTHxHEIGHT");
  expectRefused("mixed.vtk --slices 0", "--slices");
  expectRefused("mixed.vtk --step 0", "--step");
  expectRefused("mixed.vtk --slices 10 --step 0.1", "excludes");
  expectRefused("mixed.vtk --backend vulkan", "native");
  expectRefused("mixed.vtk --mode texture", "for volumes");
  expectRefused("mixed.vtk --array salt", "height");
  expectRefused("mixed.vtk --tf ct_bones", "the presets are");
  expectRefused("mixed.vtk --tf missing.json", "missing.json");
  expectRefused("mixed.vtk --unit-distance 0", "--unit-distance");
  expectRefused("mixed.vtk --clip 0,0,0,1", "no direction");
  expectRefused("mixed.vtk --clip 1,0,0", "4 numbers");
  expectRefused("mixed.vtk --clip 1,0,nan,0", "finite");
  expectRefused("mixed.vtk --cross-section 2", "part of the depth");
  expectRefused("mixed.vtk --cross-section 0.5 --backend exact", "native or gl");
  expectRefused("mixed.vtk --exact-boundary --backend gl", "native");
  expectRefused("mixed.vtk --labels a.mha", "--label-image");
  expectRefused("mixed.vtk --background 1,2,3", "from 0 to 1");
  expectRefused("mixed.vtk --out /no/such/folder/a.png", "/no/such/folder/a.png: cannot be written");
  expectRefused("mixed.vtk --out a.jpg", "must end in .png");
  expectRefused("mixed.vtk --unknown", "--unknown");
}

TEST_F(RenderGrid, RefusesDamagedFiles) {
  const std::string whole = kMixedGrid;
  write("cut.vtk", whole.substr(0, whole.find("CELL_TYPES")));
  expectRefused("cut.vtk", "cut.vtk");
  std::string wrong = whole;
  wrong.replace(wrong.find("4 8 11 12 13"), 12, "4 8 11 12 99");
  write("wrong.vtk", wrong);
  expectRefused("wrong.vtk", "wrong.vtk");
  write("none.vtk", whole.substr(0, whole.find("POINT_DATA")));
  expectRefused("none.vtk", "scalars");
  write("empty.vtk", "");
  expectRefused("empty.vtk", "empty.vtk");
  EXPECT_FALSE(exists("cut.png"));
}

std::string bigEndian(const void* value) {
  std::string bytes(static_cast<const char*>(value), 4);
  std::reverse(bytes.begin(), bytes.end());
  return bytes;
}

std::string bigEndian(const std::vector<float>& values) {
  std::string bytes;
  for (const float& value : values)
    bytes += bigEndian(&value);
  return bytes;
}

/// Two cubes beside each other; the scalars of the left one are `left`.
std::string twoCubes(float left) {
  std::string text =
      "# vtk DataFile Version 3.0\ncubes\nBINARY\nDATASET STRUCTURED_GRID\nDIMENSIONS 4 2 2\nPOINTS 16 float\n";
  std::vector<float> points;
  for (const float z : {0.0F, 1.0F}) {
    for (const float y : {0.0F, 1.0F}) {
      for (const float x : {0.0F, 1.0F, 2.0F, 3.0F})
        points.insert(points.end(), {x, y, z});
    }
  }
  std::vector<float> scalars;
  for (int n = 0; n < 16; ++n)
    scalars.push_back(n % 4 < 2 ? left : 1.0F);
  text += bigEndian(points) + "\nPOINT_DATA 16\nSCALARS s float 1\nLOOKUP_TABLE default\n";
  return text + bigEndian(scalars) + "\n";
}

/// NaN draws as nothing and leaves the cells beside it as they are.
TEST_F(RenderProgram, NanScalarsDrawNothing) {
  write("nan.vtk", twoCubes(std::numeric_limits<float>::quiet_NaN()));
  write("one.vtk", twoCubes(1.0F));
  write("fog.yaml", "unit_distance_m: 0.1\npoints: [[0, 1, 1, 1, 0.2], [3, 1, 1, 1, 0.2]]\n");
  for (const char* backend : {"native", "gl", "exact"}) {
    const auto opacities = [&](const std::string& file) {
      expectDone(file + " --tf fog.yaml --size 60x20 --projection parallel --raw a.raw --backend " + backend);
      return floats("a.raw");
    };
    const std::vector<float> all = opacities("one.vtk");
    const std::vector<float> part = opacities("nan.vtk");
    ASSERT_EQ(part.size(), 60U * 20U * 4U);
    for (std::size_t n = 0; n < part.size(); n += 4) {
      ASSERT_TRUE(std::isfinite(part[n]) && std::isfinite(part[n + 3])) << backend;
      const std::size_t column = (n / 4) % 60;
      if (column < 19) {
        EXPECT_LE(part[n + 3], 0.0F) << backend << column;
      } else if (column > 40) {
        EXPECT_NEAR(part[n + 3], all[n + 3], 1e-4F) << backend << column;
      }
    }
  }
}

}  // namespace
}  // namespace soft_volume::core
