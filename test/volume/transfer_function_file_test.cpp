#include "soft_volume/volume/transfer_function_file.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "../src/volume/colour_space.h"
#include "replay/test_folder.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

class TransferFunctionFiles : public testing::Test {
 protected:
  std::string write(const std::string& name, const std::string& text) const {
    const std::string path = folder_ / name;
    std::ofstream(path, std::ios::binary) << text;
    return path;
  }
  TransferFunctionFile read(const std::string& name, const std::string& text) const {
    return readTransferFunction(write(name, text));
  }
  /// The error must begin with the file's path and hold `part`.
  void expectRefused(const std::string& name, const std::string& text, const std::string& part) const {
    const std::string path = write(name, text);
    try {
      readTransferFunction(path);
      ADD_FAILURE() << "accepted; expected '" << part << "':\n" << text.substr(0, 300);
    } catch (const FileError& error) {
      const std::string message = error.what();
      EXPECT_EQ(message.compare(0, path.size(), path), 0) << message;
      EXPECT_NE(message.find(part), std::string::npos) << message;
    }
  }

  const TestFolder folder_;
};

void expectSample(const TransferFunction& function, double value, const Vector3f& colour, float opacity,
                  float tolerance = 1e-6F) {
  const TransferFunction::Sample sample = function.evaluate(value);
  EXPECT_NEAR((sample.colour - colour).cwiseAbs().maxCoeff(), 0.0F, tolerance)
      << "at " << value << ": " << sample.colour.transpose();
  EXPECT_NEAR(sample.opacity, opacity, tolerance) << "at " << value;
}

// -----------------------------------------------------------------------------------------------------------------
// YAML

constexpr char kYaml[] =
    "about: \"a test\"\nunit_distance_m: 0.002\npoints:\n  - [-100, 0, 0, 0, 0]\n  - [100, 1, 0.5, 0, 0.5]\n";

TEST_F(TransferFunctionFiles, YamlHasTheKeysOfAScene) {
  const TransferFunctionFile file = read("mine.yaml", kYaml);
  EXPECT_EQ(file.name, "mine");
  EXPECT_EQ(file.about, "a test");
  EXPECT_FALSE(file.relative);
  EXPECT_TRUE(file.states_distance);
  EXPECT_EQ(file.function.unit_distance_m, 0.002);
  expectSample(file.function, 0.0, {0.5F, 0.25F, 0.0F}, 0.25F);
}

TEST_F(TransferFunctionFiles, YamlIsReadStrictly) {
  expectRefused("a.yaml", "points: [[0, 0, 0, 0, 0], [1, 1, 1, 1, 1]]\nopacity: 1\n", ":2: unknown key opacity");
  expectRefused("a.yaml", "unit_distance_m: 0.001\n", "points is missing");
  expectRefused("a.yaml", "points: [[0, 0, 0, 0, 0]]\n", "at least two points");
  expectRefused("a.yaml", "points: [[0, 0, 0, 0, 0], [0, 1, 1, 1, 1]]\n", "values must increase");
  expectRefused("a.yaml", "points: [[1, 0, 0, 0, 0], [0, 1, 1, 1, 1]]\n", "values must increase");
  expectRefused("a.yaml", "points: [[0, 0, 0, 0, 0], [1, 1, 1, 1, .nan]]\n", "finite");
  expectRefused("a.yaml", "points: [[0, 0, 0, 0, 0], [1, 1, 1, 2, 1]]\n", "colour components");
  expectRefused("a.yaml", "points: [[0, 0, 0, 0, 0], [1, 1, 1, 1]]\n", "lists of 5 numbers");
  expectRefused("a.yaml", "points: many\n", "list of lists");
  expectRefused("a.yaml", "unit_distance_m: 0\npoints: [[0, 0, 0, 0, 0], [1, 1, 1, 1, 1]]\n", "unit_distance_m");
  expectRefused("a.yaml", "points: [[0, 0, 0", "not valid YAML");
  expectRefused("a.yaml", "just text", "must be a mapping");
  expectRefused("a.yaml", "relative: true\npoints: [[0, 0, 0, 0, 0], [2, 1, 1, 1, 1]]\n", "from 0 to 1");
  expectRefused("a.yaml", std::string(200000, '['), "not valid YAML");
}

// -------------------------------------------------------------------------------------------------------------
// ParaView

TEST_F(TransferFunctionFiles, ParaviewJoinsColoursAndOpacities) {
  const TransferFunctionFile file = read("m.json", R"([{"Name": "Mine", "ColorSpace": "RGB", "NanColor": [1, 0, 0],
      "RGBPoints": [200, 0, 0, 0, 400, 1, 0.5, 0], "Points": [200, 0, 0.5, 0, 300, 0.8, 0.5, 0, 400, 0.2, 0.5, 0]}])");
  EXPECT_EQ(file.name, "Mine");
  EXPECT_FALSE(file.relative);
  EXPECT_FALSE(file.states_distance);
  ASSERT_EQ(file.function.points.size(), 3U);
  expectSample(file.function, 250.0, {0.25F, 0.125F, 0.0F}, 0.4F);
  expectSample(file.function, 400.0, {1.0F, 0.5F, 0.0F}, 0.2F);
}

TEST_F(TransferFunctionFiles, ParaviewMapsForAnyDataAreRelative) {
  const TransferFunctionFile file = read("m.json", R"({"RGBPoints": [-1, 0, 0, 0, 0, 1, 0, 0, 1, 1, 1, 1]})");
  EXPECT_TRUE(file.relative);
  EXPECT_EQ(file.name, "m");
  ASSERT_EQ(file.notes.size(), 1U);
  EXPECT_NE(file.notes[0].find("no opacity"), std::string::npos);
  const TransferFunction function = fitTo(file, {1000.0, 2000.0}, 50.0);
  EXPECT_DOUBLE_EQ(function.unit_distance_m, 0.5);
  expectSample(function, 1500.0, {1.0F, 0.0F, 0.0F}, 0.5F);
  expectSample(function, 2000.0, {1.0F, 1.0F, 1.0F}, 1.0F);
}

TEST_F(TransferFunctionFiles, ParaviewPicksAMapByName) {
  const std::string path = write("all.json", R"([{"Name": "A", "RGBPoints": [0, 0, 0, 0, 1, 1, 0, 0]},
                                                 {"Name": "B b", "RGBPoints": [0, 0, 0, 0, 1, 0, 0, 1]}])");
  EXPECT_EQ(readTransferFunction(path + "#B b").function.evaluate(1.0).colour.z(), 1.0F);
  for (const std::string& source : {path, path + "#C"}) {
    try {
      readTransferFunction(source);
      ADD_FAILURE() << source;
    } catch (const FileError& error) {
      EXPECT_NE(std::string(error.what()).find("A, B b"), std::string::npos) << error.what();
    }
  }
}

TEST_F(TransferFunctionFiles, ParaviewStepsStaySteps) {
  const TransferFunctionFile file = read("m.json", R"({"ColorSpace": "Step", "RGBPoints": [10, 0, 0, 0, 20, 1, 0, 0,
      40, 0, 1, 0], "Points": [10, 0, 0.5, 0, 30, 0, 0.5, 0, 30, 1, 0.5, 0, 40, 1, 0.5, 0]})");
  expectSample(file.function, 15.0, {1.0F, 0.0F, 0.0F}, 0.0F);
  expectSample(file.function, 29.999, {0.0F, 1.0F, 0.0F}, 0.0F);
  expectSample(file.function, 30.001, {0.0F, 1.0F, 0.0F}, 1.0F);
}

/// The numbers are those of vtkPiecewiseFunction (VTK 9.1) for nodes (0, 0.1, midpoint, sharpness) and (1, 0.9).
TEST_F(TransferFunctionFiles, ParaviewMidpointAndSharpnessAreThoseOfVtk) {
  const auto opacities = [this](const std::string& midpoint_sharpness) {
    return read("m.json", R"({"RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1], "Points": [0, 0.1, )" + midpoint_sharpness +
                              ", 1, 0.9, 0.5, 0]}")
        .function;
  };
  const auto expect = [](const TransferFunction& function, float at_2_16, float at_4_16, float at_10_16) {
    EXPECT_NEAR(function.evaluate(0.125).opacity, at_2_16, 2e-6);
    EXPECT_NEAR(function.evaluate(0.25).opacity, at_4_16, 2e-6);
    EXPECT_NEAR(function.evaluate(0.625).opacity, at_10_16, 2e-6);
  };
  expect(opacities("0.3, 0"), 0.266667F, 0.433333F, 0.685714F);
  expect(opacities("0.5, 0.4"), 0.100235F, 0.107732F, 0.830601F);
  expect(opacities("0.3, 0.7"), 0.100109F, 0.148864F, 0.899167F);
  expect(opacities("0.6, 1"), 0.1F, 0.1F, 0.9F);
}

TEST_F(TransferFunctionFiles, ParaviewColourSpacesAreSampled) {
  const TransferFunctionFile file = read("m.json", R"({"ColorSpace": "Diverging",
      "RGBPoints": [0, 0.23, 0.299, 0.754, 1, 0.706, 0.016, 0.15]})");
  EXPECT_EQ(file.function.points.size(), 17U);
  expectSample(file.function, 0.5, {0.865F, 0.865F, 0.865F}, 0.5F, 1e-3F);
  const TransferFunctionFile other = read("n.json", R"({"ColorSpace": "Lab/CIEDE2000",
      "RGBPoints": [0, 0.1, 0.2, 0.9, 1, 0.9, 0.8, 0.1], "Points": [0, 0, 0.5, 0, 1, 1, 0.5, 0]})");
  EXPECT_EQ(other.notes.size(), 1U);
}

TEST_F(TransferFunctionFiles, ParaviewIsReadStrictly) {
  expectRefused("m.json", "[{\"RGBPoints\": [0, 0, 0", "not valid JSON");
  expectRefused("m.json", "[]", "no colour map");
  expectRefused("m.json", "[3]", "no colour map");
  expectRefused("m.json", "[{\"Name\": \"x\"}]", "no RGBPoints");
  expectRefused("m.json", R"([{"IndexedColors": [0, 0, 0, 1, 1, 1], "Name": "x"}])", "categories");
  expectRefused("m.json", R"({"RGBPoints": []})", "4 for each point");
  expectRefused("m.json", R"({"RGBPoints": [0, 0, 0, 0, 1, 1, 1]})", "4 for each point");
  expectRefused("m.json", R"({"RGBPoints": [0, 0, 0, 0, 1, 1, 1, "1"]})", "not a finite number");
  expectRefused("m.json", R"({"RGBPoints": [0, 0, 0, 0, 1, 1, 1, null]})", "not a finite number");
  expectRefused("m.json", R"({"RGBPoints": [0, 0, 0, 0, 1e999, 1, 1, 1]})", "JSON");
  expectRefused("m.json", R"({"RGBPoints": [0, 0, 0, 0, 1, 1, 1, 7]})", "colour components");
  expectRefused("m.json", R"({"RGBPoints": [1, 0, 0, 0, 0, 1, 1, 1]})", "values must increase");
  expectRefused("m.json", R"({"RGBPoints": [1, 0, 0, 0]})", "two points");
  expectRefused("m.json", R"({"ColorSpace": "Munsell", "RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1]})", "Munsell");
  expectRefused("m.json", R"({"RGBPoints": [0, 0, 0, 0, 1, 1, 1, 1], "Points": [0, 0, 1]})", "Points");
}

/// The numbers are those of vtkColorTransferFunction, VTK 9.1.
TEST(ColourSpaces, MixAsVtkDoes) {
  const auto expect = [](const Vector3& mixed, const Vector3& expected) {
    EXPECT_LT((mixed - expected).cwiseAbs().maxCoeff(), 2e-4) << mixed.transpose();
  };
  const Vector3 red(1, 0, 0.2);
  const Vector3 orange(1, 0.5, 0.25);
  expect(mixColours(red, orange, 0.625, ColourSpace::kHsv), {1.0, 0.268750, 0.156250});
  expect(mixColours(red, orange, 0.625, ColourSpace::kHsvNoWrap), {0.156250, 1.0, 0.479687});
  const Vector3 blue(0.1, 0.2, 0.9);
  const Vector3 yellow(0.9, 0.8, 0.1);
  expect(mixColours(blue, yellow, 0.25, ColourSpace::kLab), {0.529480, 0.337298, 0.745754});
  expect(mixColours(blue, yellow, 0.9375, ColourSpace::kLab), {0.881001, 0.759970, 0.217782});
  expect(mixColours(blue, yellow, 0.125, ColourSpace::kStep), yellow);
  const Vector3 cool(0.23, 0.299, 0.754);
  const Vector3 warm(0.706, 0.016, 0.15);
  expect(mixColours(cool, warm, 0.125, ColourSpace::kDiverging), {0.383295, 0.509619, 0.917565});
  expect(mixColours(cool, warm, 0.9375, ColourSpace::kDiverging), {0.795961, 0.241536, 0.220420});
  expect(mixColours({0.865, 0.865, 0.865}, warm, 0.5, ColourSpace::kDiverging), {0.958130, 0.602819, 0.481968});
}

// ------------------------------------------------------------------------------------------------------------ 3D
// Slicer

const std::string kLight = "1\n1\n0.9\n0.1\n0.2\n10\n";

TEST_F(TransferFunctionFiles, SlicerPropertyIsRead) {
  const TransferFunctionFile file = read("bone.vp", kLight +
                                                        "6 -1000 0 200 0 1000 0.5\n4 0 1 255 1\n"
                                                        "8 -1000 0 0 0 1000 1 0.5 0\n");
  EXPECT_EQ(file.name, "bone");
  EXPECT_TRUE(file.notes.empty());
  EXPECT_TRUE(file.states_distance);
  EXPECT_EQ(file.function.unit_distance_m, 0.001);
  ASSERT_EQ(file.function.points.size(), 3U);
  expectSample(file.function, 600.0, {0.8F, 0.4F, 0.0F}, 0.25F);
}

/// As older versions write it: points are counted instead of numbers, lines end as on Windows, steps are doubled
/// values, and what the example of the manual says after "=>".
TEST_F(TransferFunctionFiles, SlicerVariantsAreRead) {
  const TransferFunctionFile file = read("old.VP",
                                         "1 => interpolation type\r\n1\r\n0.9\r\n0.1\r\n0.2\r\n10\r\n\r\n"
                                         "3 0 0 50 0 50 1\r\n2 0 0 100 1\r\n2 0 0 0 0 100 1 1 1 => colour\r\n");
  ASSERT_EQ(file.notes.size(), 1U);
  EXPECT_NE(file.notes[0].find("gradient"), std::string::npos);
  expectSample(file.function, 49.9, {0.499F, 0.499F, 0.499F}, 0.0F, 1e-5F);
  expectSample(file.function, 50.1, {0.501F, 0.501F, 0.501F}, 1.0F, 1e-5F);
}

TEST_F(TransferFunctionFiles, SlicerScenesAreRead) {
  const std::string text =
      "<MRML>\n<VolumePropertyStorage id=\"x\"/>\n<VolumeProperty id=\"v\" name=\"CT-One\"\n shade=\"1\" "
      "scalarOpacity=\"4 0 0 100 0.5\" gradientOpacity=\"4 0 1 255 1\" colorTransfer=\"8 0 0 0 0 100 1 0 0\" />\n"
      "<VolumeProperty name=\"CT-Two\" scalarOpacity=\"4 0 0 100 1\" colorTransfer=\"8 0 0 0 0 100 0 0 1\"/></MRML>";
  const std::string path = write("presets.xml", text);
  EXPECT_EQ(readTransferFunction(path + "#CT-Two").function.evaluate(100.0).colour.z(), 1.0F);
  EXPECT_EQ(readTransferFunction(path + "#CT-One").function.evaluate(100.0).opacity, 0.5F);
  expectRefused("presets.xml", text, "CT-One, CT-Two");
  expectRefused("empty.mrml", "<MRML/>", "VolumeProperty");
}

TEST_F(TransferFunctionFiles, SlicerIsReadStrictly) {
  const std::string gradient = "4 0 1 255 1\n";
  const std::string colour = "8 0 0 0 0 100 1 1 1\n";
  expectRefused("a.vp", "", "empty");
  expectRefused("a.vp", "this is text\n", "line 1");
  expectRefused("a.vp", kLight, "cut off");
  expectRefused("a.vp", kLight + "4 0 0 100 1\n", "cut off");
  expectRefused("a.vp", kLight + "8 0 0 100 1\n" + gradient + colour, "claims 8 numbers, but 4 follow");
  expectRefused("a.vp", kLight + "4 0 0 100\n" + gradient + colour, "2 numbers for each point");
  expectRefused("a.vp", kLight + "4 0 0 nan 1\n" + gradient + colour, "'nan'");
  expectRefused("a.vp", kLight + "4 100 0 0 1\n" + gradient + colour, "values must increase");
  expectRefused("a.vp", kLight + "4 0 0 100 7\n" + gradient + colour, "opacity must be in [0, 1]");
  expectRefused("a.vp", kLight + "4 0 0 100 1\n" + gradient + "8 0 0 0 0 100 1 1\n", "4 numbers for each point");
}

// -------------------------------------------------------------------------------------------------------------- damage

/// A few bytes changed, left out, doubled, or the end cut off.
std::string damaged(std::string text, std::mt19937& random) {
  const auto below = [&random](std::size_t n) { return random() % n; };
  for (std::size_t n = 1 + below(3); n > 0 && !text.empty(); --n) {
    const std::size_t at = below(text.size());
    const std::string chars = "0123456789.-+eE,[]{}\"' \n:#<>naif";
    switch (below(5)) {
      case 0:
        text[at] = chars[below(chars.size())];
        break;
      case 1:
        text[at] = static_cast<char>(below(256));
        break;
      case 2:
        text.erase(at, 1 + below(4));
        break;
      case 3:
        text.insert(at, text.substr(at, 1 + below(8)));
        break;
      default:
        if (below(8) == 0)
          text.resize(at);
    }
  }
  return text;
}

/// Whatever the file holds, the answer is a function that can be used or an error that names the file.
TEST_F(TransferFunctionFiles, DamageIsNoticedOrHarmless) {
  const std::array<std::pair<const char*, std::string>, 4> files{{
      {"a.yaml", std::string("relative: true\n") + "points: [[0, 0, 0, 0, 0], [0.5, 1, 0, 0, 0.1], [1, 1, 1, 1, 1]]\n"},
      {"a.json", R"([{"Name": "N", "ColorSpace": "Diverging", "RGBPoints": [0, 0.2, 0.3, 0.7, 1, 0.7, 0, 0.1],
                      "Points": [0, 0, 0.4, 0.2, 1, 1, 0.5, 0]}])"},
      {"a.vp", kLight + "6 -1000 0 200 0 1000 0.5\n4 0 1 255 1\n8 -1000 0 0 0 1000 1 0.5 0\n"},
      {"a.xml", "<M><VolumeProperty name=\"A\" scalarOpacity=\"4 0 0 9 1\" colorTransfer=\"8 0 0 0 0 9 1 0 0\"/></M>"},
  }};
  std::mt19937 random(4);
  int accepted = 0;
  for (int n = 0; n < 4000; ++n) {
    const auto& [name, text] = files[n % files.size()];
    const std::string path = write(name, damaged(text, random));
    try {
      fitTo(readTransferFunction(path), {-1.0, 1.0}, 1.0).validate();
      ++accepted;
    } catch (const FileError& error) {
      ASSERT_EQ(std::string(error.what()).compare(0, path.size(), path), 0) << error.what();
    }
  }
  EXPECT_GT(accepted, 100);
  EXPECT_LT(accepted, 3900);
}

// -------------------------------------------------------------------------------------------- names, presets, fitting

TEST_F(TransferFunctionFiles, UnknownFilesAreRefused) {
  expectRefused("a.txt", "1", "unknown type");
  EXPECT_THROW(readTransferFunction(folder_ / "missing.yaml"), FileError);
  EXPECT_THROW(readTransferFunction(folder_ / "."), FileError);
  EXPECT_THROW(readTransferFunction(""), FileError);
  try {
    readTransferFunction("ct_bones");
    ADD_FAILURE();
  } catch (const FileError& error) {
    EXPECT_NE(std::string(error.what()).find("ct_bone,"), std::string::npos) << error.what();
  }
}

TEST_F(TransferFunctionFiles, PresetsCanLieElsewhere) {
  write("mine.yaml", kYaml);
  setenv("SOFT_VOLUME_TRANSFER_FUNCTIONS", (folder_ / "").c_str(), 1);
  EXPECT_EQ(transferFunctionPresets(), std::vector<std::string>{"mine"});
  EXPECT_EQ(readTransferFunction("mine").about, "a test");
  setenv("SOFT_VOLUME_TRANSFER_FUNCTIONS", (folder_ / "nowhere").c_str(), 1);
  EXPECT_THROW(readTransferFunction("mine"), FileError);
  unsetenv("SOFT_VOLUME_TRANSFER_FUNCTIONS");
}

TEST(TransferFunctionPresets, AllCanBeReadAndSayWhatTheyAreFor) {
  const std::vector<std::string> names = transferFunctionPresets();
  const std::set<std::string> found(names.begin(), names.end());
  for (const char* name : {"ct_bone", "ct_skin", "ct_soft_tissue", "ct_airways", "mri_t1_head", "mri_brain", "viridis"})
    EXPECT_EQ(found.count(name), 1U) << name;
  for (const std::string& name : names) {
    const TransferFunctionFile file = readTransferFunction(name);
    EXPECT_FALSE(file.about.empty()) << name;
    EXPECT_NO_THROW(fitTo(file, {-5.0, 7.0}, 1.0).validate()) << name;
  }
}

TEST(FitTo, StretchesRelativeValuesAlone) {
  TransferFunctionFile file;
  file.function.points = {{0.25, Vector3f::Zero(), 0.0F}, {1.0, Vector3f::Ones(), 1.0F}};
  file.states_distance = true;
  EXPECT_EQ(fitTo(file, {100.0, 500.0}, 3.0).points[0].value, 0.25);
  EXPECT_EQ(fitTo(file, {100.0, 500.0}, 3.0).unit_distance_m, 0.001);
  file.relative = true;
  EXPECT_EQ(fitTo(file, {100.0, 500.0}, 3.0).points[0].value, 200.0);
  EXPECT_EQ(fitTo(file, {100.0, 500.0}, 3.0).points[1].value, 500.0);
}

TEST(FitTo, ASingleValueLiesInTheMiddle) {
  TransferFunctionFile file;
  file.function.points = {{0.0, Vector3f::Zero(), 0.0F}, {1.0, Vector3f::Ones(), 1.0F}};
  file.relative = true;
  for (const double value : {0.0, -3.0, 1e9}) {
    const TransferFunction function = fitTo(file, {value, value}, 0.0);
    EXPECT_NO_THROW(function.validate()) << value;
    EXPECT_NEAR(function.evaluate(value).opacity, 0.5F, 1e-6F) << value;
  }
}

TEST(FitTo, RefusesWhatIsNotFinite) {
  const TransferFunctionFile file;
  EXPECT_THROW(fitTo(file, {1.0, 0.0}, 1.0), InputError);
  EXPECT_THROW(fitTo(file, {0.0, std::nan("")}, 1.0), InputError);
  EXPECT_THROW(fitTo(file, {0.0, 1.0}, HUGE_VAL), InputError);
}

}  // namespace
}  // namespace soft_volume::core
