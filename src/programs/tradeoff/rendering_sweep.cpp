#include "rendering_sweep.h"

#include <malloc.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <map>
#include <utility>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

constexpr double kTouchedPart = 0.1;
/// Frames of a turn: enough for a median, but no longer than this.
constexpr int kMostFrames = 11;
constexpr double kTurn_s = 0.5;

using Clock = std::chrono::steady_clock;

double secondsSince(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

/// What the process has on its heap, that of Mesa included.
double heapBytes() {
  const struct mallinfo2 info = mallinfo2();
  return double(info.uordblks) + double(info.hblkhd);
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// A renderer with one setting, and the frames that its task asks for.
class FrameDrawer {
 public:
  FrameDrawer(const RenderingCase& rendering_case, const RenderingSetting& setting)
      : setting_(setting),
        camera_(rendering_case.view.camera(setting.width, setting.height)),
        positions_{rendering_case.scene->positions, {}} {
    if (setting.task == FrameTask::kTouch)
      positions_[1] = touched(*rendering_case.scene, camera_, kTouchedPart);
    const double before = heapBytes();
    renderer_ = makeRenderer(*rendering_case.scene, setting.backend);
    renderer_->setTransferFunction(rendering_case.function.function);
    compared_ = draw();
    if (setting.task == FrameTask::kTouch) {
      draw();
      compared_ = draw();
    }
    bytes_ = heapBytes() - before;
  }

  /// A frame of the scene's own positions; in a touch the one that takes the touch back.
  const Frame& compared() const { return compared_; }
  double bytes() const { return bytes_; }

  /// Draws the next frame.
  const Frame& draw() {
    if (setting_.full_redraw)
      renderer_->forgetFrame();
    const bool moved = setting_.task == FrameTask::kTouch && drawn_ % 2 == 1;
    ++drawn_;
    return renderer_->render(camera_, positions_[moved ? 1 : 0], setting_.options);
  }

 private:
  const RenderingSetting& setting_;
  Camera camera_;
  std::array<std::vector<Vector3f>, 2> positions_;
  std::unique_ptr<Renderer> renderer_;
  Frame compared_;
  double bytes_ = 0.0;
  int drawn_ = 0;
};

/// What all turns of one setting have in common.
struct Turns {
  std::vector<double> frame_ms;
  Frame compared;
};

void takeTurn(const RenderingCase& rendering_case, RenderingResult& result, Turns& turns) {
  FrameDrawer drawer(rendering_case, result.setting);
  const Clock::time_point begin = Clock::now();
  for (int n = 0; n < kMostFrames && (n == 0 || secondsSince(begin) < kTurn_s); ++n) {
    const Clock::time_point frame_begin = Clock::now();
    const Frame& frame = drawer.draw();
    turns.frame_ms.push_back(1e3 * secondsSince(frame_begin));
    result.planes = frame.slices;
    result.polygons = frame.polygons;
    result.updated_part = double(frame.updated.pixels()) / (double(frame.width) * frame.height);
  }
  result.bytes = std::max(result.bytes, drawer.bytes());
  if (turns.compared.rgba.empty())
    turns.compared = drawer.compared();
}

/// A setting that the renderer refuses is a result too.
void tryTurn(const RenderingCase& rendering_case, RenderingResult& result, Turns& turns) {
  if (!result.failure.empty())
    return;
  try {
    takeTurn(rendering_case, result, turns);
  } catch (const Error& error) {
    result.failure = error.what();
  }
}

void compareWithExact(std::vector<RenderingResult>& results, const std::vector<Turns>& turns) {
  std::map<int, const Frame*> exact;  // by width
  for (std::size_t n = 0; n < results.size(); ++n) {
    if (results[n].setting.backend == Backend::kExact && results[n].failure.empty())
      exact.emplace(results[n].setting.width, &turns[n].compared);
  }
  for (std::size_t n = 0; n < results.size(); ++n) {
    const auto reference = exact.find(results[n].setting.width);
    if (results[n].failure.empty() && reference != exact.end())
      results[n].error_levels = rmseLevels(turns[n].compared, *reference->second);
  }
}

/// For the progress alone: milliseconds, roughly.
double estimatedWork(const RenderingSetting& setting) {
  const double pixels = double(setting.width) * setting.height / (640.0 * 480.0);
  const double frame_ms = setting.backend == Backend::kExact ? 300.0 * pixels
                          : setting.backend == Backend::kGl  ? 2.0 * setting.options.slices * pixels
                                                             : 0.4 * setting.options.slices * pixels;
  return 300.0 + 2.0 * frame_ms + std::min(kMostFrames * frame_ms, 1e3 * kTurn_s);
}

// ------------------------------------------------------------------------------------------------------ the settings

struct ImageSize {
  int width;
  int height;
};
constexpr ImageSize kUsualSize{640, 480};

/// Ways to draw slices; the first is the usual one.
std::vector<RenderOptions> optionsOf(const RenderingScene& scene, Backend backend) {
  std::vector<RenderOptions> all(1);
  all[0].shading = 0.0;  // light hides what the slices do, and costs the same everywhere
  all[0].specular = 0.0;
  RenderOptions other = all[0];
  other.adaptive = true;
  all.push_back(other);
  if (!scene.volume) {
    other = all[0];
    other.lookup = Lookup::kColour;
    all.push_back(other);
  }
  if (backend == Backend::kNative) {
    other = all[0];
    other.exact_boundary = true;
    all.push_back(other);
  }
  return all;
}

class SettingList {
 public:
  explicit SettingList(const RenderingScene& scene) : scene_(scene) {}

  /// Both back ends, `every` option or only the usual ones, on an image of one size.
  void add(ImageSize size, const std::vector<int>& slices, FrameTask task, bool every_option) {
    for (const Backend backend : {Backend::kGl, Backend::kNative}) {
      std::vector<RenderOptions> options = optionsOf(scene_, backend);
      if (!every_option)
        options.resize(1);
      for (const RenderOptions& o : options) {
        for (const int count : slices)
          addTasks({backend, o, size.width, size.height, task, true}, count);
      }
    }
    addTasks({Backend::kExact, optionsOf(scene_, Backend::kExact).front(), size.width, size.height, task, true}, 1);
  }

  std::vector<RenderingSetting> take() { return std::move(settings_); }

 private:
  /// A touch is drawn both ways; exact has one only.
  void addTasks(RenderingSetting setting, int slices) {
    setting.options.slices = slices;
    settings_.push_back(setting);
    setting.full_redraw = false;
    if (setting.task == FrameTask::kTouch && setting.backend != Backend::kExact)
      settings_.push_back(setting);
  }

  const RenderingScene& scene_;
  std::vector<RenderingSetting> settings_;
};

}  // namespace

std::vector<RenderingSetting> renderingSettings(const RenderingScene& scene, bool quick) {
  SettingList list(scene);
  if (quick) {
    list.add({160, 120}, {10, 40}, FrameTask::kView, true);
    list.add({80, 60}, {40}, FrameTask::kView, false);
    list.add({160, 120}, {40}, FrameTask::kTouch, false);
    return list.take();
  }
  list.add(kUsualSize, {25, 50, 100, 200, 400}, FrameTask::kView, true);
  list.add({320, 240}, {50, 100, 200}, FrameTask::kView, false);
  list.add({1280, 960}, {50, 100, 200}, FrameTask::kView, false);
  list.add(kUsualSize, {50, 100, 200}, FrameTask::kTouch, false);
  return list.take();
}

std::vector<RenderingResult> runRenderingSweep(const RenderingCase& rendering_case,
                                               const std::vector<RenderingSetting>& settings, int repeats,
                                               const std::function<void(double done, double total)>& progress) {
  std::vector<RenderingResult> results(settings.size());
  std::vector<Turns> turns(settings.size());
  const double total = renderingWork(settings, repeats);
  double done = 0.0;
  for (int repeat = 0; repeat < repeats; ++repeat) {
    for (std::size_t n = 0; n < settings.size(); ++n) {
      results[n].setting = settings[n];
      tryTurn(rendering_case, results[n], turns[n]);
      done += estimatedWork(settings[n]);
      progress(done, total);
    }
  }
  for (std::size_t n = 0; n < settings.size(); ++n) {
    if (!results[n].failure.empty())
      continue;
    results[n].ms = median(turns[n].frame_ms);
    results[n].frames = int(turns[n].frame_ms.size());
  }
  compareWithExact(results, turns);
  return results;
}

double renderingWork(const std::vector<RenderingSetting>& settings, int repeats) {
  double work = 0.0;
  for (const RenderingSetting& setting : settings)
    work += repeats * estimatedWork(setting);
  return work;
}

}  // namespace soft_volume::core
