#include "experiment.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <map>
#include <utility>

#include "scripted_run.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core::reed_5_2 {
namespace {

/// Where the growth starts, how far from there its forces act, and their size. The middle of the head at the height of
/// the lateral ventricles; volume frame of the scene.
const Vector3 kGrowthCentre_m{0.038, 0.100, 0.062};
constexpr double kGrowthRadius_m = 0.020;
constexpr double kGrowthForce_n = 0.8;
constexpr double kGrowthTime_s = 0.3;
/// Of so many frames one is timed.
constexpr int kTimedFrames = 10;
/// The growth takes so much of the whole time.
constexpr double kGrowthShare = 0.15;

struct Growth {
  const char* tool_id;
  Vector3 direction;
};
const std::array<Growth, 6> kGrowth{{{"grow_right", Vector3::UnitX()},
                                     {"grow_left", -Vector3::UnitX()},
                                     {"grow_front", Vector3::UnitY()},
                                     {"grow_back", -Vector3::UnitY()},
                                     {"grow_up", Vector3::UnitZ()},
                                     {"grow_down", -Vector3::UnitZ()}}};

using Clock = std::chrono::steady_clock;

double millisecondsSince(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

double median(std::vector<double> values) {
  if (values.empty())
    return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// The costs of frames, until their medians are wanted.
struct Costs {
  std::vector<double> step_ms, frame_ms, updated_ms, active_cells;

  Cost medians() const {
    return {frame_ms.size(), median(step_ms), median(frame_ms), median(updated_ms), median(active_cells)};
  }
};

const Camera& cameraOf(const Scene& scene, const std::string& name) {
  for (const CameraSettings& camera : scene.rendering.cameras) {
    if (camera.name == name)
      return camera.camera;
  }
  throw SceneError("the scene " + scene.name + " has no camera '" + name + "'");
}

/// Draws a session twice: with a renderer that knows the frame before, and with one that forgets it. It times one frame
/// of ten, so that the simulation has most of the time.
class Painter {
 public:
  Painter(const Session& session, int threads)
      : session_(session), options_(session.scene().rendering.options), skin_(cameraOf(session.scene(), "camera")) {
    options_.threads = threads;
    for (Renderer* renderer : {&updating_, &forgetful_}) {
      renderer->setVolume(session.volume());
      renderer->setTransferFunction(session.scene().rendering.transfer_function);
    }
  }

  /// To be called for every frame. What it returns is valid until the next call; null for frames that are not timed.
  const Frame* measure(Costs& costs) {
    const int turn = ++frames_ % kTimedFrames;
    if (turn == kTimedFrames - 1) {
      follow();
      updating_.render(skin_, positions_, options_);
    }
    return turn == 0 ? time(costs) : nullptr;
  }

  Image shown(const Frame& frame) const { return frame.toRgb8(session_.scene().rendering.background); }

  Image skin() {
    follow();
    return shown(forgetful_.render(skin_, positions_, options_));
  }

  /// The slice through a point (figure 5.2).
  Image section(const Vector3& point_m) {
    follow();
    const Camera& camera = cameraOf(session_.scene(), "section");
    const double depth_m = (camera.T_volume_camera.inverse() * point_m).z();
    return shown(forgetful_.renderCrossSection(camera, positions_, depth_m));
  }

 private:
  const Frame* time(Costs& costs) {
    follow();
    costs.updated_ms.push_back(updating_.render(skin_, positions_, options_).totalMs());
    forgetful_.forgetFrame();
    const Frame& frame = forgetful_.render(skin_, positions_, options_);
    costs.frame_ms.push_back(frame.totalMs());
    return &frame;
  }
  void follow() {
    const Topology topology = session_.topology();
    if (topology.revision != revision_) {
      revision_ = topology.revision;
      updating_.setTopology(topology);
      forgetful_.setTopology(topology);
    }
    positions_.clear();
    for (const Vector3& p : session_.drawnPositions())
      positions_.push_back(p.cast<float>());
  }

  const Session& session_;
  RenderOptions options_;
  Camera skin_;
  Renderer updating_{Backend::kNative};
  Renderer forgetful_{Backend::kNative};
  std::uint32_t revision_ = 0;
  int frames_ = 0;
  std::vector<Vector3f> positions_;
};

/// The steps of a frame, timed; `prepare` comes before each and does not count.
template <typename Prepare>
void advance(Session& session, Costs& costs, const Prepare& prepare) {
  for (int n = 0; n < kStepsPerFrame; ++n) {
    prepare();
    const Clock::time_point start = Clock::now();
    session.step();
    costs.step_ms.push_back(millisecondsSince(start));
  }
  costs.active_cells.push_back(static_cast<double>(session.simulation().activeCells()));
}

void push(Session& session, const Growth& growth, std::uint64_t sequence) {
  ToolForceCommand command;
  command.header.session = session.id();
  command.header.revision = session.topology().revision;
  command.header.step = session.steps();
  command.header.tool_id = growth.tool_id;
  command.header.sequence = sequence;
  command.hold_steps = kStepsPerFrame;
  command.force_n = kGrowthForce_n * growth.direction;
  command.point_m = kGrowthCentre_m + kGrowthRadius_m * growth.direction;
  const ToolConfig* tool = session.scene().findTool(growth.tool_id);
  if (tool == nullptr)
    throw SceneError("the scene " + session.scene().name + " has no tool '" + growth.tool_id + "'");
  command.footprint_radius_m = tool->footprint_radius_m;
  const Verdict verdict = session.apply(command);
  if (!verdict.applied)
    throw Error(std::string(growth.tool_id) + " was refused: " + verdict.reason);
}

void grow(Session& session, int threads, Results& results, const Progress& progress) {
  Painter painter(session, threads);
  results.pictures.push_back({"growth_before", painter.section(kGrowthCentre_m)});
  Costs costs;
  std::uint64_t sequence = 0;
  while (session.simulationTime() < kGrowthTime_s) {
    progress(kGrowthShare * session.simulationTime() / kGrowthTime_s);
    ++sequence;
    for (const Growth& growth : kGrowth)
      push(session, growth, sequence);
    advance(session, costs, [] {});
    painter.measure(costs);
  }
  results.growth = costs.medians();
  results.grown_m = session.simulation().maxDisplacement();
  results.pictures.push_back({"growth_after", painter.section(kGrowthCentre_m)});
}

std::size_t countSplitCells(const Session& session) {
  std::size_t count = 0;
  for (std::uint32_t cell = 0; cell < session.lattice().cellCount(); ++cell)
    count += session.tissue().mesh().piecesOfCell(cell).size() > 1 ? 1 : 0;
  return count;
}

/// The scripted hand's part: it presses with the probe, lets go, and cuts with the scalpel.
class Hand {
 public:
  Hand(Session& session, int threads) : session_(session), painter_(session, threads), run_(session) {}

  void play(Results& results, const Progress& progress) {
    keep(results, "push_before", painter_.skin());
    const double end_s = session_.scene().device.way_points.back().time_s;
    while (!run_.scriptEnded()) {
      progress(kGrowthShare + (1.0 - kGrowthShare) * session_.simulationTime() / end_s);
      playFrame(results);
    }
    if (run_.refused() > 0)
      throw Error("the session refused an input of the hand: " + run_.refusal());
    results.push = pressing_.medians();
    results.incision = cutting_.medians();
    results.cells_cut = countSplitCells(session_);
    keep(results, "push", std::move(pressed_));
    keep(results, "incision", std::move(cut_));
    keep(results, "incision_open", painter_.skin());
  }

 private:
  static void keep(Results& results, const char* name, Image image) {
    results.pictures.push_back({name, std::move(image)});
  }

  void playFrame(Results& results) {
    Costs idle;
    Costs& costs = phase(idle);
    advance(session_, costs, [this] { run_.move(); });
    if (&costs == &idle)
      return;
    results.opened_m = session_.cutOpening();
    const Frame* frame = painter_.measure(costs);
    if (frame == nullptr)
      return;
    const double moved_m = session_.simulation().maxDisplacement();
    if (&costs == &pressing_ && moved_m > results.pushed_m) {
      results.pushed_m = moved_m;
      pressed_ = painter_.shown(*frame);
    }
    if (run_.output().cutting)
      cut_ = painter_.shown(*frame);
  }

  /// Frames count for the push while the probe touches, and for the incision from its first cut on.
  Costs& phase(Costs& idle) {
    if (session_.topology().revision > 1)
      return cutting_;
    return run_.output().contact.touching ? pressing_ : idle;
  }

  Session& session_;
  Painter painter_;
  ScriptedRun run_;
  Costs pressing_, cutting_;
  Image pressed_, cut_;
};

}  // namespace

Results runExperiments(const Scene& scene, int threads, const Progress& progress) {
  const SceneVolumes volumes = readVolumes(scene);
  Results results;
  {
    Session session(scene, volumes.volume, volumes.labels, 1, threads);
    results.cells = session.lattice().cellCount();
    results.dt_s = session.timeStep();
    grow(session, threads, results, progress);
  }
  Session session(scene, volumes.volume, volumes.labels, 1, threads);
  Hand(session, threads).play(results, progress);
  return results;
}

}  // namespace soft_volume::core::reed_5_2
