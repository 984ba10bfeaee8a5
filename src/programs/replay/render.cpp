// --render: recorded states drawn with another camera, transfer function, back end or number of slices.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include "findings.h"
#include "folders.h"
#include "option_values.h"
#include "progress_bar.h"
#include "render/view.h"
#include "soft_volume/render/option_names.h"
#include "soft_volume/replay/state_renderer.h"
#include "soft_volume/volume/transfer_function_file.h"

namespace soft_volume::replay_program {
namespace {

using core::Camera;
using core::RenderSettings;

/// A picture to draw.
struct Planned {
  std::size_t state = 0;
  std::string camera;
  const RecordedFrame* recorded = nullptr;  ///< that it is compared with; or null
  std::size_t recorded_index = 0;
};

bool hasOwnView(const RenderArguments& a) {
  return !a.camera.empty() || a.azimuth_deg || a.elevation_deg || a.zoom || !a.projection.empty();
}

/// The wanted changes of how frames are made.
class Look {
 public:
  Look(const RenderArguments& arguments, const core::Volume& volume) : arguments_(arguments) {
    if (!arguments.transfer_function.empty())
      function_ = readFunction(volume);
    for (const std::string& plane : arguments.clip)
      clip_planes_.push_back(core::parsePlane(plane, "--clip"));
    if (!arguments.background.empty())
      background_ = core::parseColour(arguments.background, "--background");
  }

  RenderSettings apply(RenderSettings settings) const {
    const RenderArguments& a = arguments_;
    if (function_)
      settings.transfer_function = *function_;
    if (a.unit_distance_m)
      settings.transfer_function.unit_distance_m = *a.unit_distance_m;
    if (!a.backend.empty())
      settings.backend = *core::choiceNamed<core::Backend>(a.backend);
    if (a.slices || a.step_m)
      settings.options.step_m = a.step_m.value_or(0.0);
    settings.options.slices = a.slices.value_or(settings.options.slices);
    settings.options.shading = a.shade.value_or(settings.options.shading);
    settings.background = background_.value_or(settings.background);
    auto& planes = settings.options.clip_planes;
    planes.insert(planes.end(), clip_planes_.begin(), clip_planes_.end());
    settings.options.validate();
    return settings;
  }

 private:
  core::TransferFunction readFunction(const core::Volume& volume) const {
    core::TransferFunctionFile file = core::readTransferFunction(arguments_.transfer_function);
    if (arguments_.unit_distance_m) {
      file.function.unit_distance_m = *arguments_.unit_distance_m;
      file.states_distance = true;
    }
    return core::fitTo(file, volume.range(), volume.geometry().bounds().diagonal().norm());
  }

  const RenderArguments& arguments_;
  std::optional<core::TransferFunction> function_;
  std::vector<core::ClipPlane> clip_planes_;
  std::optional<core::Vector3f> background_;
};

/// The same field of view from top to bottom in a picture of another size.
Camera resized(Camera camera, int width, int height) {
  const double scale = double(height) / camera.height;
  camera.cx = 0.5 * (width - 1) + scale * (camera.cx - 0.5 * (camera.width - 1));
  camera.cy = 0.5 * (height - 1) + scale * (camera.cy - 0.5 * (camera.height - 1));
  camera.fx *= scale;
  camera.fy *= scale;
  camera.width = width;
  camera.height = height;
  return camera;
}

/// A view of the whole grid at rest, as soft_volume_render has it.
Camera viewOfGrid(const RenderArguments& a, const StateRenderer& renderer, const core::Topology& topology) {
  namespace rp = core::render_program;
  rp::Subject subject;
  subject.bounds = core::boundsOf(topology.rest_positions);
  subject.view = rp::patientView(renderer.volume()->geometry());
  rp::Arguments view;
  view.width = a.width.value_or(view.width);
  view.height = a.height.value_or(view.height);
  view.camera = a.camera;
  view.projection = a.projection.empty() ? view.projection : *core::choiceNamed<core::Projection>(a.projection);
  view.azimuth_deg = a.azimuth_deg.value_or(0.0);
  view.elevation_deg = a.elevation_deg.value_or(0.0);
  view.zoom = a.zoom.value_or(1.0);
  return rp::viewOf(view, subject);
}

/// Draws what is planned, and compares.
class StatePictures {
 public:
  StatePictures(const Arguments& arguments, const RecordedRun& run)
      : arguments_(arguments),
        a_(arguments.render),
        run_(run),
        renderer_(run, arguments.threads),
        look_(a_, *renderer_.volume()) {
    const bool drawable = !run.states().empty() && renderer_.canDraw(0);
    if (hasOwnView(a_) && !drawable)
      throw ReplayError(arguments.bag + ": the bag lacks the first state or its topology, so there is nothing to see");
    if (hasOwnView(a_))
      own_view_ = viewOfGrid(a_, renderer_, *run.topology(run.states().front().revision));
  }

  std::vector<Planned> plan(std::vector<std::string>& notes) const {
    const bool where_recorded = !a_.every_s && !run_.frames().empty();
    std::vector<Planned> planned = where_recorded ? planRecorded(notes) : planStates(notes);
    std::stable_sort(planned.begin(), planned.end(), [](const auto& a, const auto& b) { return a.state < b.state; });
    return planned;
  }

  DrawnFrame draw(const Planned& planned) {
    const RecordedState& state = run_.states()[planned.state];
    DrawnFrame drawn;
    drawn.camera = planned.camera;
    drawn.step = state.step;
    drawn.time_s = state.time_s;
    drawn.file = fileName(planned.camera, state);
    const core::Image image = picture(planned);
    core::writePng(drawn.file, image);
    if (planned.recorded != nullptr && run_.hasImage(planned.recorded_index)) {
      const core::Image recorded = run_.image(planned.recorded_index);
      if (recorded.width == image.width && recorded.height == image.height)
        drawn.difference = core::compareImages(recorded, image);
    }
    return drawn;
  }

 private:
  /// One for each recorded frame; one for each of their states where all are seen by the same camera.
  std::vector<Planned> planRecorded(std::vector<std::string>& notes) const {
    std::vector<Planned> planned;
    std::set<std::size_t> seen;
    std::size_t lost = 0;
    for (std::size_t n = 0; n < run_.frames().size(); ++n) {
      const RecordedFrame& frame = run_.frames()[n];
      const auto state = renderer_.stateOf(frame);
      if (!state || (!own_view_ && !renderer_.cameraOf(frame)))
        ++lost;
      else if (!own_view_ || seen.insert(*state).second)
        planned.push_back({*state, own_view_ ? "view" : frame.stats.camera, &frame, n});
    }
    if (lost > 0)
      notes.push_back(std::to_string(lost) +
                      " recorded frames were not drawn: the state that they show, or its "
                      "camera, is not in the bag");
    return planned;
  }

  /// States that are so far apart, or all of them.
  std::vector<Planned> planStates(std::vector<std::string>& notes) const {
    std::vector<Planned> planned;
    std::size_t lost = 0;
    double next_s = -HUGE_VAL;
    for (std::size_t state = 0; state < run_.states().size(); ++state) {
      const double time_s = run_.states()[state].time_s;
      if (time_s < next_s - 1e-9)
        continue;
      if (!renderer_.canDraw(state)) {
        ++lost;
        continue;
      }
      next_s = a_.every_s ? (std::floor(time_s / *a_.every_s + 1e-6) + 1.0) * *a_.every_s : time_s;
      addViews(state, planned);
    }
    if (lost > 0)
      notes.push_back(std::to_string(lost) + " states were not drawn: their key frame or topology is not in the bag");
    return planned;
  }

  void addViews(std::size_t state, std::vector<Planned>& planned) const {
    if (own_view_)
      planned.push_back({state, "view", nullptr, 0});
    for (const core::CameraSettings& camera : renderer_.scene().rendering.cameras) {
      if (!own_view_)
        planned.push_back({state, camera.name, nullptr, 0});
    }
  }

  core::Image picture(const Planned& planned) {
    const RecordedFrame* frame = planned.recorded;
    const std::string key = frame != nullptr ? frame->stats.settings : std::string();
    auto settings = settings_.find(key);
    if (settings == settings_.end()) {
      const RenderSettings base = frame != nullptr ? renderer_.settingsOf(*frame) : renderer_.scene().rendering;
      settings = settings_.emplace(key, look_.apply(base)).first;
    }
    const std::uint32_t coarseness = frame != nullptr ? frame->stats.coarseness : 1;
    return renderer_.draw(planned.state, settings->second, key, cameraOf(planned), coarseness);
  }

  Camera cameraOf(const Planned& planned) const {
    if (own_view_)
      return *own_view_;
    const auto& cameras = renderer_.scene().rendering.cameras;
    const Camera camera = planned.recorded != nullptr
                              ? *renderer_.cameraOf(*planned.recorded)
                              : std::find_if(cameras.begin(), cameras.end(), [&](const auto& c) {
                                  return c.name == planned.camera;
                                })->camera;
    return a_.width ? resized(camera, *a_.width, *a_.height) : camera;
  }

  /// Several frames of one camera may show one step.
  std::string fileName(std::string camera, const RecordedState& state) {
    std::replace(camera.begin(), camera.end(), '/', '_');
    char step[32];
    std::snprintf(step, sizeof step, "_%08llu", static_cast<unsigned long long>(state.step));
    const std::string name = arguments_.render.dir + "/" + camera + step;
    const int times = ++written_[name];
    return name + (times > 1 ? "_" + std::to_string(times) : std::string()) + ".png";
  }

  const Arguments& arguments_;
  const RenderArguments& a_;
  const RecordedRun& run_;
  StateRenderer renderer_;
  Look look_;
  std::optional<Camera> own_view_;
  std::map<std::string, RenderSettings> settings_;
  std::map<std::string, int> written_;
};

void printDifferences(const std::vector<DrawnFrame>& drawn) {
  std::size_t compared = 0;
  double mean_rmse = 0.0;
  core::ImageDifference worst;
  for (const DrawnFrame& frame : drawn) {
    if (!frame.difference)
      continue;
    ++compared;
    mean_rmse += frame.difference->rmse;
    worst.rmse = std::max(worst.rmse, frame.difference->rmse);
    worst.largest = std::max(worst.largest, frame.difference->largest);
    worst.ssim = std::min(worst.ssim, frame.difference->ssim);
  }
  if (compared == 0)
    return;
  std::printf(
      "  %zu compared with recorded ones: RMSE %.3g levels in the mean and %.3g at most, one pixel %d levels, "
      "SSIM %.5f at least\n",
      compared, mean_rmse / double(compared), worst.rmse, worst.largest, worst.ssim);
}

}  // namespace

void render(const Arguments& arguments, Findings& findings) {
  if (arguments.render.dir.empty())
    return;
  const RecordedBag bag(arguments.bag);
  makeFolder(arguments.render.dir);
  StatePictures pictures(arguments, bag.longest());
  const std::vector<Planned> planned = pictures.plan(findings.notes);
  if (planned.empty())
    throw ReplayError(arguments.bag + ": the bag holds no state that can be drawn");
  core::ProgressBar bar(arguments.no_progress);
  for (const Planned& next : planned) {
    findings.drawn.push_back(pictures.draw(next));
    bar.update(double(findings.drawn.size()), double(planned.size()));
  }
  std::printf("  %s: %zu frames\n", arguments.render.dir.c_str(), findings.drawn.size());
  printDifferences(findings.drawn);
}

}  // namespace soft_volume::replay_program
