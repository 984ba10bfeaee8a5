#include "frame_replay.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/messages/conversions.h"

namespace soft_volume {
namespace {

constexpr double kLowestPsnr_db = 40.0;

ReplayDifference frameDifference(const RenderStats& stats, const std::string& text) {
  ReplayDifference difference;
  difference.kind = "frame";
  difference.session = stats.session;
  difference.step = stats.step;
  difference.camera = stats.camera;
  difference.text = "camera " + stats.camera + ": " + text;
  return difference;
}

bool hasShape(const sensor_msgs::Image& recorded, const core::Image& image) {
  return recorded.encoding == "rgb8" && recorded.width == static_cast<std::uint32_t>(image.width) &&
         recorded.height == static_cast<std::uint32_t>(image.height) && recorded.data.size() == image.rgb.size();
}

/// The pixel of the first byte that differs; the sizes are the same.
ReplayDifference pixelDifference(const RenderStats& stats, const sensor_msgs::Image& recorded,
                                 const core::Image& image) {
  const auto first = std::mismatch(image.rgb.begin(), image.rgb.end(), recorded.data.begin());
  const auto index = static_cast<std::size_t>(first.first - image.rgb.begin());
  const auto x = static_cast<std::uint32_t>(index / 3 % static_cast<std::size_t>(image.width));
  const auto y = static_cast<std::uint32_t>(index / 3 / static_cast<std::size_t>(image.width));
  const int levels = std::abs(int(*first.first) - int(*first.second));
  ReplayDifference difference =
      frameDifference(stats, "pixel (" + std::to_string(x) + ", " + std::to_string(y) + ") was recorded with " +
                                 std::to_string(*first.second) + " and is " + std::to_string(*first.first) +
                                 " in channel " + std::to_string(index % 3));
  difference.pixel_x = x;
  difference.pixel_y = y;
  difference.size = levels;
  return difference;
}

std::string fileName(const RenderStats& stats) {
  std::string camera = stats.camera;
  std::replace(camera.begin(), camera.end(), '/', '_');
  char step[32];
  std::snprintf(step, sizeof(step), "_%06llu", static_cast<unsigned long long>(stats.step));
  return camera + step;
}

bool endsWith(const std::string& text, const std::string& ending) {
  return text.size() >= ending.size() && text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

}  // namespace

FrameReplay::FrameReplay(BagContents& contents, const ReplayOptions& options, ReplayReport& report)
    : contents_(&contents), options_(&options), report_(&report), painter_(options.threads) {}

std::optional<ReplayDifference> FrameReplay::check(const core::Session& session, const RenderStats& stats) {
  const auto& cameras = session.scene().rendering.cameras;
  const bool known = std::any_of(cameras.begin(), cameras.end(), [&](const auto& c) { return c.name == stats.camera; });
  if (!known)
    return frameDifference(stats, "the scene has no such camera");
  core::Image image;
  try {
    const core::RenderSettings settings =
        stats.settings.empty() ? session.scene().rendering
                               : core::overrideRendering(session.scene(), stats.settings, "its settings");
    image = render(session, settings, stats);
  } catch (const core::SceneError& error) {
    return frameDifference(stats, std::string("cannot be drawn: ") + error.what());
  }
  ++report_->frames;
  if (!options_->frames_dir.empty())
    writeFrame(stats, image);
  if (!options_->check)
    return std::nullopt;
  const std::optional<sensor_msgs::Image> recorded = findRecorded(stats);
  if (!recorded)
    ++report_->frames_without_image;
  if (options_->on_frame)
    show(stats, recorded, image);
  if (measure_ != nullptr) {
    measureFrame(session, stats, recorded, image);
    return std::nullopt;
  }
  return stats.renderer == painter_.driver() ? compareExactly(image, stats, recorded)
                                             : compareByPsnr(image, stats, recorded);
}

core::Image FrameReplay::render(const core::Session& session, const core::RenderSettings& settings,
                                const RenderStats& stats) {
  const auto camera_settings = std::find_if(settings.cameras.begin(), settings.cameras.end(),
                                            [&](const auto& c) { return c.name == stats.camera; });
  core::Camera camera = camera_settings->camera;
  camera.T_volume_camera = fromPose(stats.pose);
  PaintedState state{
      session.id(), session.lattice().revision, session.volume(), [&] { return session.topology(); }, {}};
  for (const core::Vector3& p : session.drawnPositions())
    state.positions_m.push_back(p.cast<float>());
  return painter_.paint(state, settings, stats.settings, camera, stats.coarseness);
}

void FrameReplay::measureFrame(const core::Session& session, const RenderStats& stats,
                               const std::optional<sensor_msgs::Image>& recorded, const core::Image& image) {
  if (!recorded) {
    measure_->leaveOutFrame(stats, "not recorded as images");
  } else if (!hasShape(*recorded, image)) {
    measure_->leaveOutFrame(stats, "of another size or encoding");
  } else {
    measure_->compareFrame(session, stats, {image.width, image.height, recorded->data}, image);
  }
}

void FrameReplay::show(const RenderStats& stats, const std::optional<sensor_msgs::Image>& recorded,
                       const core::Image& image) const {
  core::Image former;
  const bool comparable = recorded && hasShape(*recorded, image);
  if (comparable)
    former = {image.width, image.height, recorded->data};
  options_->on_frame({stats.camera, stats.session, stats.step, comparable ? &former : nullptr, &image});
}

void FrameReplay::writeFrame(const RenderStats& stats, const core::Image& image) {
  const std::string name = fileName(stats);
  const int times = ++written_[name];
  const std::string suffix = times > 1 ? "_" + std::to_string(times) : "";
  core::writePng(options_->frames_dir + "/" + name + suffix + ".png", image);
}

std::optional<sensor_msgs::Image> FrameReplay::findRecorded(const RenderStats& stats) {
  std::optional<sensor_msgs::Image> found;
  BagImage* taken = nullptr;
  const std::string ending = "/" + stats.camera + "/image_raw";
  for (BagImage& candidate : contents_->images()) {
    const bool fits =
        !candidate.used && candidate.stamp_ns == stats.header.stamp.toNSec() && endsWith("/" + candidate.topic, ending);
    if (!fits)
      continue;
    sensor_msgs::Image image = contents_->read<sensor_msgs::Image>(*candidate.instance);
    const bool same = core::hashVector(image.data) == stats.image_hash;
    // Several views of one state carry the same stamp.
    if (same || taken == nullptr) {
      taken = &candidate;
      found = std::move(image);
    }
    if (same)
      break;
  }
  if (taken != nullptr)
    taken->used = true;
  return found;
}

std::optional<ReplayDifference> FrameReplay::compareExactly(const core::Image& image, const RenderStats& stats,
                                                            const std::optional<sensor_msgs::Image>& recorded) const {
  if (recorded && !hasShape(*recorded, image))
    return frameDifference(stats, "the image has another size or encoding");
  if (recorded && recorded->data != image.rgb)
    return pixelDifference(stats, *recorded, image);
  if (core::hashVector(image.rgb) != stats.image_hash) {
    return frameDifference(stats, "the image does not have the hash that render/stats states");
  }
  return std::nullopt;
}

std::optional<ReplayDifference> FrameReplay::compareByPsnr(const core::Image& image, const RenderStats& stats,
                                                           const std::optional<sensor_msgs::Image>& recorded) {
  if (!recorded)
    return std::nullopt;
  if (!hasShape(*recorded, image))
    return frameDifference(stats, "the image has another size or encoding");
  if (core::hashVector(recorded->data) != stats.image_hash) {
    return frameDifference(stats, "the recorded image does not have the hash that render/stats states");
  }
  const core::ImageDifference apart = core::compareImages(image, {image.width, image.height, recorded->data});
  if (std::isfinite(apart.psnr_db)) {
    const bool first = report_->lowest_psnr_db == 0.0;
    report_->lowest_psnr_db = first ? apart.psnr_db : std::min(report_->lowest_psnr_db, apart.psnr_db);
  }
  if (report_->frames_by_psnr++ == 0) {
    report_->notes.push_back("frames were drawn by \"" + stats.renderer + "\" and here by \"" + painter_.driver() +
                             "\": they are compared by PSNR, at least 40 dB");
  }
  if (apart.psnr_db >= kLowestPsnr_db)
    return std::nullopt;
  ReplayDifference difference =
      frameDifference(stats, "PSNR " + std::to_string(apart.psnr_db) + " dB, below " + std::to_string(kLowestPsnr_db));
  difference.size = apart.largest;
  return difference;
}

}  // namespace soft_volume
