#include "report_frames.h"

#include <soft_volume/ToolForce.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>

#include "report_page.h"
#include "soft_volume/messages/conversions.h"

namespace soft_volume::replay_program {
namespace {

/// White, yellow, orange, red, dark red at equal distances.
constexpr std::array<std::array<std::uint8_t, 3>, 5> kScaleColours = {
    {{255, 255, 255}, {255, 236, 130}, {250, 150, 50}, {205, 30, 30}, {80, 0, 20}}};

std::array<std::uint8_t, 3> scaleColour(double part) {
  const double place = std::clamp(part, 0.0, 1.0) * double(kScaleColours.size() - 1);
  const auto below = std::min(static_cast<std::size_t>(place), kScaleColours.size() - 2);
  std::array<std::uint8_t, 3> colour{};
  for (std::size_t c = 0; c < 3; ++c) {
    const double mixed =
        kScaleColours[below][c] + (place - double(below)) * (kScaleColours[below + 1][c] - kScaleColours[below][c]);
    colour[c] = static_cast<std::uint8_t>(std::lround(mixed));
  }
  return colour;
}

int pixelDifference(const core::Image& a, const core::Image& b, std::size_t pixel) {
  int largest = 0;
  for (std::size_t i = 3 * pixel; i < 3 * pixel + 3; ++i)
    largest = std::max(largest, std::abs(int(a.rgb[i]) - int(b.rgb[i])));
  return largest;
}

std::optional<double> timeOfLargestDisplacement(const RecordedRun& run) {
  std::optional<double> time_s;
  double largest = 0.0;
  for (std::size_t n = 0; n < run.states().size(); ++n) {
    const std::optional<double> displacement = largestDisplacement(run, n);
    if (displacement && *displacement > largest) {
      largest = *displacement;
      time_s = run.states()[n].time_s;
    }
  }
  return time_s;
}

std::optional<double> timeOfLargestForce(const RecordedRun& run) {
  std::optional<double> time_s;
  double largest = 0.0;
  for (const auto& recorded : run.messages<ToolForce>()) {
    const double force = fromVector(recorded.message.force).squaredNorm();
    if (force > largest) {
      largest = force;
      time_s = run.timeOf(recorded.message.header.stamp);
    }
  }
  return time_s;
}

std::optional<double> timeAmidCuts(const RecordedRun& run) {
  const auto& states = run.states();
  if (states.empty() || states.front().revision == states.back().revision)
    return std::nullopt;
  const double wanted = states.front().revision + 0.75 * (states.back().revision - states.front().revision);
  for (const RecordedState& state : states) {
    if (state.revision >= wanted)
      return state.time_s;
  }
  return std::nullopt;
}

/// What the scene's first camera would have shown of every state.
std::vector<RecordedFrame> framesOfStates(const RecordedRun& run) {
  const core::Scene scene = run.scene();
  std::vector<RecordedFrame> frames;
  for (const RecordedState& state : run.states()) {
    if (scene.rendering.cameras.empty())
      break;
    const core::CameraSettings& camera = scene.rendering.cameras.front();
    RecordedFrame frame;
    frame.time_s = state.time_s;
    frame.stats.camera = camera.name;
    frame.stats.pose = toPose(camera.camera.T_volume_camera);
    frame.stats.session = run.session();
    frame.stats.step = state.step;
    frame.stats.revision = state.revision;
    frame.stats.coarseness = 1;
    frames.push_back(std::move(frame));
  }
  return frames;
}

/// The frame of the first camera that is nearest to a time.
std::size_t nearestFrame(const std::vector<RecordedFrame>& frames, double time_s) {
  std::size_t nearest = 0;
  for (std::size_t n = 1; n < frames.size(); ++n) {
    const bool same_camera = frames[n].stats.camera == frames.front().stats.camera;
    if (same_camera && std::abs(frames[n].time_s - time_s) < std::abs(frames[nearest].time_s - time_s))
      nearest = n;
  }
  return nearest;
}

}  // namespace

std::optional<double> largestDisplacement(const RecordedRun& run, std::size_t state) {
  const auto topology = run.hasPositions(state) ? run.topology(run.states()[state].revision) : nullptr;
  if (topology == nullptr)
    return std::nullopt;
  const std::vector<core::Vector3f> positions = run.positions(state);
  if (positions.size() != topology->vertexCount())
    return std::nullopt;
  float largest = 0.0F;
  for (std::size_t v = 0; v < positions.size(); ++v)
    largest = std::max(largest, (positions[v] - topology->rest_positions[v]).squaredNorm());
  return std::sqrt(double(largest));
}

std::vector<Moment> chooseMoments(const RecordedRun& run, std::optional<double> worst_s) {
  const bool recorded = !run.frames().empty();
  const std::vector<RecordedFrame> frames = recorded ? run.frames() : framesOfStates(run);
  if (frames.empty())
    return {};
  std::map<std::size_t, std::string> captions;
  const auto add = [&](std::optional<double> time_s, const char* caption) {
    if (!time_s)
      return;
    std::string& text = captions[nearestFrame(frames, *time_s)];
    text += (text.empty() ? "" : ", ") + std::string(caption);
  };
  add(frames.front().time_s, "first frame");
  add(timeOfLargestDisplacement(run), "largest displacement");
  add(timeOfLargestForce(run), "largest force");
  add(timeAmidCuts(run), "amid the cuts");
  add(worst_s, "largest difference");
  add(frames.back().time_s, "last frame");
  std::vector<Moment> moments;
  for (const auto& [frame, caption] : captions)
    moments.push_back({frames[frame], recorded ? std::optional<std::size_t>(frame) : std::nullopt, caption});
  return moments;
}

void compare(FrameTriplet& triplet) {
  const core::Image& a = triplet.first;
  const core::Image& b = triplet.second;
  if (!a.rgb.empty() && a.width == b.width && a.height == b.height)
    triplet.difference = core::compareImages(a, b);
}

ReplayedFrames::ReplayedFrames(const RecordedBag& bag) {
  const RecordedRun& run = bag.longest();
  session_ = run.session();
  for (const RecordedFrame& frame : run.frames())
    times_s_[frame.stats.step] = frame.time_s;
  for (const Moment& moment : chooseMoments(run, std::nullopt)) {
    if (moment.index)
      wanted_[{moment.frame.stats.camera, moment.frame.stats.step}] = moment.caption;
  }
}

FrameTriplet ReplayedFrames::tripletOf(const ReplayedFrame& frame, const std::string& what) const {
  const auto time = times_s_.find(frame.step);
  FrameTriplet triplet;
  triplet.caption = (time == times_s_.end() ? "" : number(time->second, 5) + " s, ") + "step " + count(frame.step) +
                    ", seen by " + frame.camera + ": " + what;
  triplet.first_name = frame.recorded != nullptr ? "recorded" : "replayed; no image was recorded";
  triplet.first = frame.recorded != nullptr ? *frame.recorded : *frame.replayed;
  if (frame.recorded != nullptr) {
    triplet.second_name = "replayed";
    triplet.second = *frame.replayed;
    compare(triplet);
  }
  return triplet;
}

void ReplayedFrames::add(const ReplayedFrame& frame) {
  if (frame.session != session_)
    return;
  const auto wanted = wanted_.find({frame.camera, frame.step});
  const bool differs = frame.recorded != nullptr && frame.recorded->rgb != frame.replayed->rgb;
  if (wanted == wanted_.end() && !differs)
    return;
  const bool known = std::any_of(kept_.begin(), kept_.end(), [&](const Kept& other) {
    return other.step == frame.step && other.camera == frame.camera;
  });
  if (known && !differs)
    return;  // drawn twice
  Kept kept{frame.step, frame.camera, tripletOf(frame, wanted == wanted_.end() ? "differs most" : wanted->second)};
  if (wanted != wanted_.end() && !known)
    kept_.push_back(kept);
  else if (!worst_ || worst_->triplet.difference->rmse < kept.triplet.difference->rmse)
    worst_ = std::move(kept);
}

std::vector<FrameTriplet> ReplayedFrames::take() {
  if (worst_)
    kept_.push_back(std::move(*worst_));
  std::stable_sort(kept_.begin(), kept_.end(), [](const Kept& a, const Kept& b) { return a.step < b.step; });
  std::vector<FrameTriplet> triplets;
  for (Kept& kept : kept_)
    triplets.push_back(std::move(kept.triplet));
  return triplets;
}

/// All but one in 200 of the pixels that differ are below it, so that a single one does not hide what others show.
int differenceScale(const FrameTriplet& triplet) {
  std::array<std::size_t, 256> counts{};
  for (std::size_t pixel = 0; pixel < triplet.first.rgb.size() / 3; ++pixel)
    ++counts[std::size_t(pixelDifference(triplet.first, triplet.second, pixel))];
  std::size_t above = 0;
  int level = 255;
  while (level > 0 && above + counts[std::size_t(level)] <= triplet.difference->pixels / 200)
    above += counts[std::size_t(level--)];
  for (const int round : {4, 8, 16, 32, 64, 128}) {
    if (level <= round)
      return round;
  }
  return 255;
}

core::Image differenceMap(const core::Image& first, const core::Image& second, int scale) {
  core::Image map{first.width, first.height, {}};
  map.rgb.reserve(first.rgb.size());
  for (std::size_t pixel = 0; pixel < first.rgb.size() / 3; ++pixel) {
    const auto colour = scaleColour(double(pixelDifference(first, second, pixel)) / scale);
    map.rgb.insert(map.rgb.end(), colour.begin(), colour.end());
  }
  return map;
}

std::string scaleGradient() {
  std::string gradient = "linear-gradient(to right";
  for (const auto& colour : kScaleColours) {
    char text[32];
    std::snprintf(text, sizeof text, ", rgb(%d,%d,%d)", colour[0], colour[1], colour[2]);
    gradient += text;
  }
  return gradient + ")";
}

}  // namespace soft_volume::replay_program
