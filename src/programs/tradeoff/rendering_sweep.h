#pragma once

#include <functional>
#include <limits>
#include <string>
#include <vector>

#include "rendering_scene.h"

namespace soft_volume::core {

/// What a frame is asked for in a sweep: a new view, or the same view after a touch.
enum class FrameTask {
  kView,   ///< everything is drawn
  kTouch,  ///< positions that show on a tenth of the image changed since the frame before
};

/// One way to draw a frame.
struct RenderingSetting {
  Backend backend = Backend::kNative;
  RenderOptions options;
  int width = 640;
  int height = 480;
  FrameTask task = FrameTask::kView;
  bool full_redraw = true;  ///< of a touch: the last frame is forgotten
};

/// Scene, transfer function and view that settings are compared in. Frames of other size or task are another case.
struct RenderingCase {
  const RenderingScene* scene;
  NamedFunction function;
  RenderingView view;
};

struct RenderingResult {
  RenderingSetting setting;
  double ms = std::numeric_limits<double>::infinity();            ///< a frame, wall time
  double error_levels = std::numeric_limits<double>::infinity();  ///< RMSE against exact
  double bytes = 0.0;                                             ///< that the renderer holds, the scene not counted
  int planes = 0;                                                 ///< drawn
  std::size_t polygons = 0;
  double updated_part = 1.0;  ///< of the image, drawn anew
  int frames = 0;             ///< in the median
  std::string failure;        ///< why it cannot be drawn, else empty
};

/// The settings that are compared in a case. The exact back end, which is the reference, is one of them for every size
/// and task.
std::vector<RenderingSetting> renderingSettings(const RenderingScene& scene, bool quick);

/// Draws all settings `repeats` times in turns, so that a busy machine slows all of them alike; every turn makes a new
/// renderer and draws some frames after a first one that is not timed. The cost is the median of all frames.
/// `progress(done, total)` is called after every turn.
std::vector<RenderingResult> runRenderingSweep(const RenderingCase& rendering_case,
                                               const std::vector<RenderingSetting>& settings, int repeats,
                                               const std::function<void(double done, double total)>& progress);

/// Work of a sweep in the units of its progress, to join several.
double renderingWork(const std::vector<RenderingSetting>& settings, int repeats);

}  // namespace soft_volume::core
