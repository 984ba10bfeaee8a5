#include "frame_source.h"

#include <algorithm>
#include <memory>

#include "soft_volume/replay/state_renderer.h"

namespace soft_volume::replay_program {
namespace {

std::vector<ShownFrame> drawnFrames(const std::vector<DrawnFrame>& drawn) {
  std::vector<ShownFrame> frames;
  for (const DrawnFrame& frame : drawn) {
    if (frame.camera == drawn.front().camera)
      frames.push_back({frame.time_s, [path = frame.file] { return core::readPng(path); }});
  }
  return frames;
}

std::vector<ShownFrame> recordedFrames(const RecordedRun& run, int threads) {
  std::vector<ShownFrame> frames;
  std::shared_ptr<StateRenderer> renderer;
  for (std::size_t n = 0; n < run.frames().size(); ++n) {
    const RecordedFrame& frame = run.frames()[n];
    if (frame.stats.camera != run.frames().front().stats.camera)
      continue;
    if (run.hasImage(n)) {
      frames.push_back({frame.time_s, [&run, n] { return run.image(n); }});
      continue;
    }
    if (renderer == nullptr)
      renderer = std::make_shared<StateRenderer>(run, threads);
    if (renderer->cameraOf(frame) && renderer->stateOf(frame))
      frames.push_back({frame.time_s, [renderer, frame] { return *renderer->drawAgain(frame); }});
  }
  return frames;
}

}  // namespace

std::vector<ShownFrame> framesOfVideo(const RecordedRun& run, const Findings& findings, int threads) {
  std::vector<ShownFrame> frames = findings.drawn.empty() ? recordedFrames(run, threads) : drawnFrames(findings.drawn);
  std::stable_sort(frames.begin(), frames.end(), [](const auto& a, const auto& b) { return a.time_s < b.time_s; });
  return frames;
}

}  // namespace soft_volume::replay_program
