// soft_volume_replay --report: one page that needs no other file.

#include <gtest/gtest.h>
#include <sensor_msgs/Image.h>
#include <soft_volume/RecorderStatus.h>
#include <soft_volume/RenderStats.h>
#include <soft_volume/Scene.h>

#include <fstream>
#include <iterator>

#include "recorded_run.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/replay_bag.h"
#include "test_folder.h"

namespace soft_volume {
namespace {

class Report : public testing::Test {
 protected:
  void SetUp() override { recordBag(folder_ / "run.bag", {}); }

  std::string page(const std::string& bag, const std::string& arguments, int code) {
    const std::string path = folder_ / "report.html";
    const ProgramResult result = replay(folder_ / bag, arguments + " --report '" + path + "'");
    EXPECT_EQ(result.code, code) << result.output;
    std::ifstream file(path);
    return {std::istreambuf_iterator<char>(file), {}};
  }

  const TestFolder folder_;
};

std::size_t countOf(const std::string& text, const std::string& part) {
  std::size_t count = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1))
    ++count;
  return count;
}

void expectComplete(const std::string& html) {
  EXPECT_EQ(html.find("<!DOCTYPE html>"), 0U);
  EXPECT_EQ(countOf(html, "src="), countOf(html, "src=\"data:image/")) << "nothing is fetched";
  EXPECT_EQ(countOf(html, "http"), 0U);
  for (const char* element : {"table", "tr", "td", "div", "figure", "ul", "main", "html"})
    EXPECT_EQ(countOf(html, std::string("<") + element), countOf(html, std::string("</") + element + ">")) << element;
}

TEST_F(Report, OfACheckSaysThatItIsIdentical) {
  const std::string html = page("run.bag", "--check", 0);
  expectComplete(html);
  EXPECT_EQ(countOf(html, "<b>Identical, bit for bit</b>"), 1U);
  EXPECT_NE(html.find(" 21 states, "), std::string::npos);
  // First, during the cut and last; each is recorded, replayed and their difference, which is none.
  EXPECT_GE(countOf(html, "seen by camera"), 2U);
  EXPECT_EQ(countOf(html, "no difference, byte for byte</figcaption>"), countOf(html, ">replayed</figcaption>"));
  EXPECT_EQ(countOf(html, "data:image/jpeg"), 2 * countOf(html, "data:image/png"));
  EXPECT_GE(countOf(html, "data:image/svg+xml"), 2U) << "displacement and force";
}

TEST_F(Report, OfACheckShowsTheFrameThatDiffers) {
  rewriteMessage<sensor_msgs::Image>(folder_ / "run.bag", folder_ / "bad.bag", 1, [](sensor_msgs::Image& image) {
    for (std::size_t n = 3000; n < 3300; ++n)
      image.data[n] = 255;
  });
  const std::string html = page("bad.bag", "--check", 1);
  expectComplete(html);
  EXPECT_NE(html.find("<b>Different: 1 difference was found</b>"), std::string::npos);
  EXPECT_NE(html.find("First difference: step 160, frame: camera camera: pixel"), std::string::npos);
  EXPECT_NE(html.find("step 160, seen by camera: "), std::string::npos);
  EXPECT_NE(html.find("difference: RMSE "), std::string::npos);
}

/// Another force from step 100 on.
TEST_F(Report, OfAComparisonTellsWhatIsBeyondItsLimit) {
  RunSettings settings;
  settings.grips = true;
  recordBag(folder_ / "grips.bag", settings);
  const std::string html =
      page("run.bag", "--against '" + folder_ / "grips.bag" + "' --tolerance positions=1e-6,force=1", 1);
  expectComplete(html);
  EXPECT_NE(html.find("<b>Different: 1 of 2 limits exceeded</b>"), std::string::npos);
  EXPECT_NE(html.find("grips.bag"), std::string::npos);
  EXPECT_NE(html.find("<tr class=\"bad\"><td><code>positions</code>"), std::string::npos);
  EXPECT_NE(html.find("<tr class=\"good\"><td><code>force</code>"), std::string::npos);
  EXPECT_NE(html.find("largest difference"), std::string::npos) << "its frame is shown";
  const std::string wide = page("run.bag", "--against '" + folder_ / "grips.bag" + "' --tolerance positions=100", 0);
  EXPECT_NE(wide.find("<b>Within the limits: 1 limit held</b>"), std::string::npos);
}

TEST_F(Report, OfARecordingAloneShowsIt) {
  const std::string html = page("run.bag", "", 0);
  expectComplete(html);
  EXPECT_NE(html.find("<b>A recording; nothing was compared</b>"), std::string::npos);
  EXPECT_EQ(countOf(html, "data:image/png"), 0U);
  EXPECT_NE(html.find("<td>tool/force</td><td>refused: "), std::string::npos) << "a force that was not a number";
}

TEST_F(Report, DrawsTheStatesOfABagWithoutFrames) {
  rewriteBag(folder_ / "run.bag", folder_ / "blind.bag", [](RawMessage& raw) {
    return raw.type != ros::message_traits::datatype<sensor_msgs::Image>() &&
           raw.type != ros::message_traits::datatype<RenderStats>();
  });
  const std::string html = page("blind.bag", "--against '" + folder_ / "run.bag" + "' --tolerance positions=1", 0);
  expectComplete(html);
  EXPECT_GE(countOf(html, "recorded state, drawn again</figcaption>"), 3U);
  EXPECT_EQ(countOf(html, "no difference, byte for byte</figcaption>"), countOf(html, "run.bag</figcaption>"));
}

/// What a bag says is shown, and never taken for html.
TEST_F(Report, EscapesWhatABagSays) {
  rewriteMessage<Scene>(folder_ / "run.bag", folder_ / "odd.bag", 0,
                        [](Scene& scene) { scene.name = "<script>alert(\"&\")</script>"; });
  const std::string html = page("odd.bag", "", 0);
  expectComplete(html);
  EXPECT_EQ(countOf(html, "<script"), 0U);
  EXPECT_NE(html.find("&lt;script&gt;alert(&quot;&amp;&quot;)&lt;/script&gt;"), std::string::npos);
}

TEST_F(Report, TellsWhatTheRecorderSaw) {
  BagRecorderSettings settings;
  settings.file = folder_ / "events.bag";
  settings.reserve_bytes = 1 << 20;
  BagRecorder recorder(settings);
  recordRun(recorder, {});
  RecorderStatus status;
  status.events.resize(1);
  status.events[0].stamp = ros::Time(1700000000.0);
  status.events[0].kind = RecorderEvent::LOST;
  status.events[0].text = "12 messages of /tool/force never came";
  recorder.write("/recorder/status", ros::Time(1200.0), status);
  recorder.close("the test ended");
  const std::string html = page("events.bag", "", 0);
  expectComplete(html);
  EXPECT_NE(html.find("<td>lost</td><td>12 messages of /tool/force never came</td>"), std::string::npos);
}

TEST_F(Report, SaysWhyABagCannotBeReplayed) {
  std::ofstream(folder_ / "no.bag") << "this is no bag";
  const std::string html = page("no.bag", "--check", 2);
  expectComplete(html);
  EXPECT_NE(html.find("<b>It could not be done</b>"), std::string::npos);
  EXPECT_EQ(replay(folder_ / "run.bag", "--report /no/such/folder/report.html").code, 2);
}

}  // namespace
}  // namespace soft_volume
