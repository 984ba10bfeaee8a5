#pragma once

#include <functional>
#include <vector>

#include "findings.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/recorded_run.h"

namespace soft_volume::replay_program {

/// A picture of a run at a time; made or read when it is asked for.
struct ShownFrame {
  double time_s = 0.0;
  std::function<core::Image()> image;
};

/// What a video shows: what --render drew, else what was recorded, drawn again where no image was. One camera, the
/// first one; in the order of time. Valid as long as `run`.
std::vector<ShownFrame> framesOfVideo(const RecordedRun& run, const Findings& findings, int threads);

}  // namespace soft_volume::replay_program
