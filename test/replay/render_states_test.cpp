// soft_volume_replay --render and --video.

#include <gtest/gtest.h>
#include <sensor_msgs/Image.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "recorded_run.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/recorded_run.h"
#include "test_folder.h"

namespace soft_volume {
namespace {

class RenderStates : public testing::Test {
 protected:
  void SetUp() override { recordBag(folder_ / "run.bag", {}); }

  /// What the program says of the pictures that it made.
  nlohmann::json rendered(const std::string& arguments, const std::string& bag = "run.bag") {
    const ProgramResult result = replay(
        folder_ / bag, "--render '" + folder_ / "pictures" + "' --json '" + folder_ / "out.json" + "' " + arguments);
    EXPECT_EQ(result.code, 0) << result.output;
    std::ifstream file(folder_ / "out.json");
    return nlohmann::json::parse(file)["rendered"];
  }

  const TestFolder folder_;
};

TEST_F(RenderStates, ThatAreNotChangedGiveTheRecordedPictures) {
  const nlohmann::json frames = rendered("");
  ASSERT_EQ(frames.size(), 4U);
  const RecordedBag bag(folder_ / "run.bag");
  for (std::size_t n = 0; n < 4; ++n) {
    EXPECT_EQ(frames[n]["step"], 60 + 100 * n);
    EXPECT_EQ(frames[n]["rmse"], 0.0);
    EXPECT_EQ(frames[n]["ssim"], 1.0);
    EXPECT_EQ(core::readPng(frames[n]["file"]).rgb, bag.longest().image(n).rgb);
  }
  EXPECT_EQ(frames[1]["file"], folder_ / "pictures/camera_00000160.png");
}

TEST_F(RenderStates, ThatAreChangedSayByHowMuch) {
  for (const char* change : {"--slices 12", "--backend exact", "--tf ct_bone", "--shade 0", "--clip 1,0,0,0.02",
                             "--unit-distance 0.1", "--background 0,1,0"}) {
    const nlohmann::json frames = rendered(change);
    ASSERT_EQ(frames.size(), 4U) << change;
    EXPECT_GT(frames[0]["rmse"], 0.05) << change;
    EXPECT_LT(frames[0]["ssim"], 1.0) << change;
  }
}

TEST_F(RenderStates, SeenInAnotherSizeAreNotCompared) {
  const nlohmann::json frames = rendered("--size 96x80");
  EXPECT_FALSE(frames[0].contains("rmse"));
  const core::Image large = core::readPng(frames[0]["file"]);
  EXPECT_EQ(large.width, 96);
  // The same view: four pixels of it in the place of each.
  const core::Image small = core::readPng(rendered("")[0]["file"]);
  core::Image halved{48, 40, {}};
  for (int v = 0; v < 40; ++v) {
    for (int u = 0; u < 48; ++u) {
      for (int c = 0; c < 3; ++c) {
        const auto at = [&](int x, int y) { return int(large.rgb[std::size_t(3 * (96 * y + x) + c)]); };
        halved.rgb.push_back(std::uint8_t(
            (at(2 * u, 2 * v) + at(2 * u + 1, 2 * v) + at(2 * u, 2 * v + 1) + at(2 * u + 1, 2 * v + 1)) / 4));
      }
    }
  }
  EXPECT_LT(core::compareImages(small, halved).rmse, 3.0);
}

TEST_F(RenderStates, AreSeenFromElsewhere) {
  const nlohmann::json frames = rendered("--azimuth 35 --size 32x32 --every 0.1");
  ASSERT_FALSE(frames.empty());
  for (std::size_t n = 0; n < frames.size(); ++n) {
    EXPECT_EQ(frames[n]["camera"], "view");
    EXPECT_GE(frames[n]["time_s"], 0.1 * double(n) - 1e-9);
    EXPECT_LT(frames[n]["time_s"], 0.1 * double(n) + 0.1);
  }
  const core::Image side = core::readPng(frames[0]["file"]);
  EXPECT_GT(core::compareImages(side, core::readPng(rendered("--azimuth 0 --size 32x32 --every 0.1")[0]["file"])).rmse,
            0.0);
}

TEST_F(RenderStates, AreSeenByACameraFromAFile) {
  std::ofstream(folder_ / "camera.yaml") << "eye_m: [0.1, 0.02, 0.03]\ntarget_m: [0.019, 0.019, 0.019]\n"
                                            "up: [0, 0, 1]\nvertical_fov_rad: 0.6\nwidth: 48\nheight: 40\n";
  const nlohmann::json frames = rendered("--camera '" + folder_ / "camera.yaml" + "'");
  ASSERT_EQ(frames.size(), 4U);
  EXPECT_LT(frames[0]["rmse"], 1.0) << "it is the recorded camera";
}

TEST_F(RenderStates, RefuseWhatCannotBeDrawn) {
  const std::string render = "--render '" + folder_ / "pictures" + "' ";
  for (const char* bad : {"--clip 1,0", "--background 2,0,0", "--tf no_such", "--size 0x0", "--camera no.yaml"})
    EXPECT_EQ(replay(folder_ / "run.bag", render + bad).code, 2) << bad;
  EXPECT_EQ(replay(folder_ / "run.bag", "--slices 12").code, 2) << "nothing is drawn";
}

std::string output(const std::string& command) {
  FILE* pipe = popen(command.c_str(), "r");
  char text[256] = {};
  const std::size_t size = std::fread(text, 1, sizeof text - 1, pipe);
  pclose(pipe);
  return {text, size};
}

/// Its duration is that of the simulated time from the first frame to the last, and its size is even.
TEST_F(RenderStates, BecomeAVideoWithAndWithoutRecordedImages) {
  rewriteBag(folder_ / "run.bag", folder_ / "blind.bag",
             [](RawMessage& raw) { return raw.type != ros::message_traits::datatype<sensor_msgs::Image>(); });
  const RecordedBag bag(folder_ / "run.bag");
  const auto& frames = bag.longest().frames();
  const long count = 1 + std::lround((frames.back().time_s - frames.front().time_s) * 30.0);
  for (const char* name : {"run.bag", "blind.bag"}) {
    const std::string video = folder_ / "it's a video.mp4";
    const ProgramResult result = replay(folder_ / name, "--video \"" + video + "\"");
    EXPECT_EQ(result.code, 0) << result.output;
    EXPECT_EQ(output("ffprobe -v error -select_streams v -count_frames -show_entries "
                     "stream=width,height,nb_read_frames -of csv=p=0 \"" +
                     video + "\""),
              "48,40," + std::to_string(count) + "\n");
    std::filesystem::remove(video);
  }
  EXPECT_EQ(replay(folder_ / "run.bag", "--video /no/such/folder/video.mp4").code, 2);
}

}  // namespace
}  // namespace soft_volume
