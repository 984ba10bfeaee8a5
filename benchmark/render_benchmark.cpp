#include "render_benchmark.h"

#include <benchmark/benchmark.h>
#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "blunt_fin.h"
#include "programs/tradeoff/rendering_scene.h"
#include "soft_volume/common/error.h"
#include "soft_volume/render/option_names.h"
#include "soft_volume/render/renderer.h"

namespace soft_volume::core {
namespace {

constexpr int kWidth = 640;
constexpr int kHeight = 480;
/// Of the native and exact back ends, and of Mesa.
constexpr int kThreads = 2;
/// Of the image, that an incremental update touches.
constexpr double kTouchedPart = 0.1;

// ----------------------------------------------------------------------------------------------------------- subjects

/// A grid of the benchmarks and its renderers, which are made when they are first needed and then stay: to make one
/// takes longer than most frames.
class Subject {
 public:
  explicit Subject(RenderingScene scene) : scene_(std::move(scene)) {}

  const RenderingScene& scene() const { return scene_; }

  Renderer& renderer(Backend backend) {
    std::unique_ptr<Renderer>& renderer = renderers_[backend];
    if (!renderer)
      renderer = makeRenderer(scene_, backend);
    return *renderer;
  }

  /// The exact image of the scene's positions.
  const Frame& reference(const NamedFunction& function, const RenderingView& view) {
    Frame& frame = references_[function.name + "/" + view.name];
    if (frame.rgba.empty()) {
      Renderer& exact = renderer(Backend::kExact);
      exact.setTransferFunction(function.function);
      RenderOptions options;
      options.shading = 0.0;
      frame = exact.render(view.camera(kWidth, kHeight), scene_.positions, options);
    }
    return frame;
  }

  const std::vector<Vector3f>& touchedPositions(const RenderingView& view) {
    std::vector<Vector3f>& positions = touched_[view.name];
    if (positions.empty())
      positions = touched(scene_, view.camera(kWidth, kHeight), kTouchedPart);
    return positions;
  }

 private:
  RenderingScene scene_;
  std::map<Backend, std::unique_ptr<Renderer>> renderers_;
  std::map<std::string, Frame> references_;
  std::map<std::string, std::vector<Vector3f>> touched_;
};

using SubjectPointer = std::shared_ptr<Subject>;

struct FrameCase {
  SubjectPointer subject;
  NamedFunction function;
  RenderingView view;
  Backend backend = Backend::kNative;
  RenderOptions options;
  bool incremental = false;
  bool compare = true;  ///< with the exact image
};

/// The function with opacity in its gaps that no image shows: nothing is skipped any more.
TransferFunction withoutGaps(TransferFunction function) {
  for (TransferFunction::Point& point : function.points)
    point.opacity = std::max(point.opacity, 1e-12F);
  return function;
}

// ---------------------------------------------------------------------------------------------------------- measuring

double median(std::vector<double> values) {
  const auto middle = values.begin() + std::ptrdiff_t(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Medians of the stages of Table 5.1 over the frames of a run.
class Stages {
 public:
  void add(const Frame& frame) {
    const std::array<double, 4> times = {frame.transform_ms, frame.bucket_ms, frame.slice_ms, frame.render_ms};
    for (std::size_t n = 0; n < times.size(); ++n)
      times_[n].push_back(times[n]);
  }
  void report(benchmark::State& state) const {
    const std::array<const char*, 4> names = {"transform_ms", "bucket_ms", "slice_ms", "render_ms"};
    for (std::size_t n = 0; n < names.size(); ++n)
      state.counters[names[n]] = median(times_[n]);
  }

 private:
  std::array<std::vector<double>, 4> times_;
};

/// Draws the frames of a case, every other one touched where only the change is drawn.
class FrameLoop {
 public:
  explicit FrameLoop(const FrameCase& frame_case)
      : frame_case_(frame_case),
        renderer_(frame_case.subject->renderer(frame_case.backend)),
        camera_(frame_case.view.camera(kWidth, kHeight)),
        positions_{&frame_case.subject->scene().positions, &frame_case.subject->scene().positions} {
    renderer_.setTransferFunction(frame_case.function.function);
    if (frame_case.incremental)
      positions_[1] = &frame_case.subject->touchedPositions(frame_case.view);
  }

  const Frame& draw() {
    if (!frame_case_.incremental)
      renderer_.forgetFrame();
    const Frame& frame = renderer_.render(camera_, *positions_[drawn_ % 2], frame_case_.options);
    ++drawn_;
    return frame;
  }

  /// Whether the last frame shows the scene's own positions.
  bool showsScene() const { return !frame_case_.incremental || drawn_ % 2 == 1; }

 private:
  const FrameCase& frame_case_;
  Renderer& renderer_;
  Camera camera_;
  std::array<const std::vector<Vector3f>*, 2> positions_;
  std::size_t drawn_ = 0;
};

void countFrame(benchmark::State& state, const Frame& frame) {
  state.counters["slices"] = frame.slices;
  state.counters["cells"] = double(frame.cells);
  state.counters["polygons"] = double(frame.polygons);
  state.counters["fragments"] = double(frame.fragments);
  state.counters["updated_part"] = double(frame.updated.pixels()) / (double(frame.width) * frame.height);
}

void timeFrames(benchmark::State& state, const FrameCase& frame_case) {
  // The exact image first: it may need the renderer that is about to be measured.
  const Frame* reference =
      frame_case.compare ? &frame_case.subject->reference(frame_case.function, frame_case.view) : nullptr;
  FrameLoop loop(frame_case);
  loop.draw();
  Stages stages;
  const Frame* frame = nullptr;
  for (auto _ : state) {
    frame = &loop.draw();
    stages.add(*frame);
  }
  stages.report(state);
  countFrame(state, *frame);
  if (!loop.showsScene())
    frame = &loop.draw();
  if (reference != nullptr)
    state.counters["error_levels"] = rmseLevels(*frame, *reference);
}

/// Most memory that this process has held so far, as the kernel counts it. (getrusage counts that of the process which
/// started this one too.)
double peakBytes() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0)
      return 1024.0 * std::stod(line.substr(6));
  }
  return 0.0;
}

/// Peak memory of another process of this program that runs one case.
double peakBytesOf(const std::string& case_name) {
  const std::string program = std::filesystem::read_symlink("/proc/self/exe").string();
  const std::string command = "'" + program + "' '--benchmark_filter=^" + case_name +
                              "/process_time/real_time$' --benchmark_min_time=0.01 --benchmark_format=json 2>/dev/null";
  FILE* pipe = popen(command.c_str(), "r");
  std::string output;
  std::array<char, 4096> buffer{};
  while (const std::size_t count = pipe != nullptr ? std::fread(buffer.data(), 1, buffer.size(), pipe) : 0)
    output.append(buffer.data(), count);
  if (pipe == nullptr || pclose(pipe) != 0)
    throw Error(case_name + " does not run in a process of its own");
  return nlohmann::json::parse(output).at("benchmarks").at(0).at("peak_rss_bytes").get<double>();
}

void timeMemory(benchmark::State& state, const std::string& case_name) {
  static std::map<std::string, double> peaks;
  const auto found = peaks.try_emplace(case_name, 0.0);
  if (found.second)
    found.first->second = peakBytesOf(case_name);
  for (auto _ : state)
    benchmark::DoNotOptimize(found.first->second);
  state.counters["peak_rss_bytes"] = found.first->second;
}

// --------------------------------------------------------------------------------------------------------------- names

using Body = std::function<void(benchmark::State&)>;

/// A mistake of the machine (no OpenGL) or of the data fails one case.
void add(const std::string& name, const Body& body) {
  benchmark::RegisterBenchmark(("render/" + name).c_str(),
                               [body](benchmark::State& state) {
                                 try {
                                   body(state);
                                 } catch (const Error& error) {
                                   state.SkipWithError(error.what());
                                 }
                               })
      ->Unit(benchmark::kMicrosecond)
      ->MeasureProcessCPUTime()  // of all threads, Mesa's too
      ->UseRealTime();
}

void addFrame(const std::string& slices, const std::string& variant, const FrameCase& frame_case) {
  add(frame_case.subject->scene().name + "/" + frame_case.function.name + "/" + frame_case.view.name + "/" + slices +
          "/" + variant,
      [frame_case](benchmark::State& state) { timeFrames(state, frame_case); });
}

FrameCase frameCase(const SubjectPointer& subject, const NamedFunction& function, const RenderingView& view,
                    int slices) {
  FrameCase result;
  result.subject = subject;
  result.function = function;
  result.view = view;
  result.options.slices = slices;
  result.options.threads = kThreads;
  result.options.shading = 0.0;  // the functions' own colours: light is a variant of its own
  return result;
}

void addNative(const FrameCase& frame_case) {
  const std::string slices = std::to_string(frame_case.options.slices);
  addFrame(slices, "native", frame_case);
  FrameCase variant = frame_case;
  variant.options.exact_boundary = true;
  addFrame(slices, "native_boundary", variant);
}

void addGl(const FrameCase& frame_case) {
  FrameCase variant = frame_case;
  variant.backend = Backend::kGl;
  addFrame(std::to_string(frame_case.options.slices), "gl", variant);
}

void addExact(const FrameCase& frame_case) {
  FrameCase variant = frame_case;
  variant.backend = Backend::kExact;
  variant.compare = false;
  addFrame("all", "exact", variant);
}

void addUpdate(const FrameCase& frame_case) {
  FrameCase variant = frame_case;
  variant.incremental = true;
  addFrame(std::to_string(frame_case.options.slices), "incremental", variant);
}

void addNoSkip(const FrameCase& frame_case) {
  FrameCase variant = frame_case;
  variant.compare = false;
  variant.function.function = withoutGaps(frame_case.function.function);
  addFrame(std::to_string(frame_case.options.slices), "native_noskip", variant);
}

/// Options whose cost is for a user to know, not for a goal.
void addOptions(const FrameCase& frame_case) {
  const std::string slices = std::to_string(frame_case.options.slices);
  FrameCase variant = frame_case;
  variant.options.adaptive = true;
  addFrame(slices, "native_adaptive", variant);
  variant = frame_case;
  variant.compare = false;
  variant.options.shading = RenderOptions().shading;
  addFrame(slices, "native_shaded", variant);
  variant.backend = Backend::kGl;
  addFrame(slices, "gl_shaded", variant);
}

struct SliceCounts {
  std::vector<int> native;
  std::vector<int> gl;  ///< fewer, as its frames take long
};

/// The first two views in full, the second with every option; in the others what shows that no direction is worse.
void addView(const SubjectPointer& subject, const NamedFunction& function, std::size_t view,
             const SliceCounts& slices) {
  const RenderingScene& scene = subject->scene();
  const auto at = [&](int count) { return frameCase(subject, function, scene.views[view], count); };
  const bool in_full = view < 2 && function.name != "opaque";
  for (const int count : in_full ? slices.native : std::vector<int>{scene.slices / 2, scene.slices})
    addNative(at(count));
  for (const int count : view < 2 ? slices.gl : std::vector<int>{scene.slices})
    addGl(at(count));
  addExact(at(scene.slices));
  if (in_full) {
    addUpdate(at(scene.slices));
    addNoSkip(at(scene.slices));
  }
  if (in_full && view == 1)
    addOptions(at(scene.slices));
}

void addScene(RenderingScene scene, const SliceCounts& slices) {
  const auto subject = std::make_shared<Subject>(std::move(scene));
  for (const NamedFunction& function : subject->scene().functions) {
    for (std::size_t view = 0; view < subject->scene().views.size(); ++view) {
      if (function.name != "opaque" || view < 2)
        addView(subject, function, view, slices);
    }
  }
}

// ----------------------------------------------------------------------------------------------------------- the grids

RenderingView figureView(const BluntFinView& view) {
  const double angle_rad = view.name == "straight" ? 0.0 : M_PI / 4;
  return {view.name, [=](int width, int height) { return bluntFinCamera(angle_rad, width, height); }};
}

RenderingScene bluntFinScene(const std::string& folder) {
  RenderingScene scene;
  scene.name = "blunt_fin";
  scene.grid = readBluntFin(folder);
  scene.positions = scene.grid.points;
  scene.functions = bluntFinFunctions();
  const Box3 box = boundsOf(scene.positions);
  for (const BluntFinView& view : bluntFinViews()) {
    if (view.slices == 50)
      scene.views.push_back(figureView(view));
  }
  scene.views.push_back(parallelView("side", box, Vector3::UnitX(), Vector3::UnitY()));
  scene.views.push_back(parallelView("top", box, Vector3::UnitY(), -Vector3::UnitZ()));
  scene.views.push_back(parallelView("oblique", box, {-0.5, 0.4, 0.8}, Vector3::UnitY()));
  return scene;
}

void addBluntFin() {
  const std::string folder = bluntFinFolder(SOFT_VOLUME_SOURCE_DIR);
  if (folder.empty()) {
    std::fprintf(stderr,
                 "The cases render/blunt_fin/... are left out: there are no bluntfinxyz.bin and bluntfinq.bin "
                 "in $SOFT_VOLUME_DATA/blunt_fin\n");
    return;
  }
  addScene(bluntFinScene(folder), {{25, 50, 100, 200, 400}, {50, 100, 200}});
}

void addMriLattice() {
  std::string why_not;
  if (const auto scene = mriLatticeScene(why_not))
    addScene(std::move(*scene), {{62, 125, 250}, {125}});
  else
    std::fprintf(stderr, "The cases render/mri_lattice/... are left out: %s\n", why_not.c_str());
}

/// Two planes through each layer of cells, at whatever number of cells.
void addLinear(std::size_t cells) {
  const std::string name = "linear/" + std::to_string(cells) + "/native";
  add(name, [cells](benchmark::State& state) {
    static std::map<std::size_t, SubjectPointer> subjects;
    SubjectPointer& subject = subjects[cells];
    if (!subject)
      subject = std::make_shared<Subject>(curvilinearScene(cells));
    const RenderingScene& scene = subject->scene();
    const int slices = int(2.0 * std::cbrt(double(scene.grid.cellCount())));
    FrameCase frame_case = frameCase(subject, scene.functions.front(), scene.views[1], slices);
    frame_case.compare = false;
    timeFrames(state, frame_case);
    state.counters["grid_cells"] = double(scene.grid.cellCount());
    state.counters["peak_rss_bytes"] = peakBytes();  // of this process, whatever else ran in it: timeMemory() asks
  });
  add("memory/" + std::to_string(cells) + "/native",
      [name](benchmark::State& state) { timeMemory(state, "render/" + name); });
}

}  // namespace

void registerRenderBenchmarks() {
  setenv("LP_NUM_THREADS", std::to_string(kThreads).c_str(), 0);
  addBluntFin();
  addMriLattice();
  addScene(curvilinearScene(40000), {{50, 100}, {100}});
  for (const std::size_t cells : {40000, 200000, 1000000})
    addLinear(cells);
}

}  // namespace soft_volume::core
