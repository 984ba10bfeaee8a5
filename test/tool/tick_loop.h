#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "analytic_volumes.h"
#include "soft_volume/scene/scene.h"
#include "soft_volume/session/session.h"
#include "soft_volume/tool/patch_intake.h"
#include "soft_volume/tool/tool.h"

namespace soft_volume::core {

/// What the tool does in a TickLoop.
enum class TickWork { kFree, kPress, kSlide, kSlideOverCut, kCut, kGrip };

/// A tool that a hand leads over a block of 16 x 16 x 10 cells with patches of 500 cells at 250 Hz: what a haptic loop
/// at 1 kHz does, with the work between two ticks apart from the tick.
class TickLoop {
 public:
  explicit TickLoop(TickWork work)
      : work_(work),
        session_(parseScene(sceneText(), "tick loop", "/"), volume(), nullptr, 1, 1),
        config_(*session_.scene().findTool(toolId(work))),
        tool_(config_),
        intake_(config_.id, config_.tissue_threshold) {
    if (work == TickWork::kSlideOverCut)
      cutFirst();
    tool_.setVolume(session_.volume());
    intake_.setVolume(session_.volume());
    spare_ = intake_.makeEmpty();
  }

  /// All that happens outside of the tick: the tissue moves, and every fourth time a patch of it is made ready.
  void prepare() {
    session_.step();
    if (ticks_ % 4 != 0)
      return;
    if (session_.lattice().revision != shown_revision_) {
      shown_revision_ = session_.lattice().revision;
      const auto topology = std::make_shared<const Topology>(session_.topology());
      intake_.setTopology(topology);
    }
    patch_cells_ = 0;
    const GridPatch patch = session_.patch(config_.id, tip(), config_.patch_radius_m);
    patch_cells_ = patch.cell_ids.size();
    intake_.fill(patch, spare_.get());
    ready_ = std::move(spare_);
  }

  /// The tick alone.
  void tick() {
    if (ready_)
      spare_ = tool_.takePatch(std::move(ready_));
    ToolInput input;
    input.time_s = input.pose_time_s = time();
    input.pose.position_m = tip();
    input.buttons[0] = work_ == TickWork::kCut || (work_ == TickWork::kGrip && time() > 0.5);
    output_ = tool_.update(input);
    ++ticks_;
  }

  /// Hands the tick's commands to the tissue.
  void answer() {
    if (output_.force)
      refused_ += session_.apply(toCommand(config_.id, *output_.force)).applied ? 0 : 1;
    if (output_.cut)
      refused_ += session_.apply(toCommand(config_.id, *output_.cut)).applied ? 0 : 1;
  }

  /// One round of the three.
  void run() {
    prepare();
    tick();
    answer();
  }

  double time() const { return 0.001 * double(ticks_); }
  const ToolOutput& output() const { return output_; }
  std::size_t patchCells() const { return patch_cells_; }
  int refused() const { return refused_; }
  const Session& session() const { return session_; }

 private:
  static constexpr double kSurface_m = 0.059;
  static constexpr double kMiddle_m = 0.047;

  static std::string toolId(TickWork work) {
    return work == TickWork::kCut ? "scalpel" : work == TickWork::kGrip ? "grasper" : "probe";
  }

  static std::shared_ptr<const Volume> volume() {
    return std::make_shared<const Volume>(
        makeVolume({48, 48, 40}, 0.002, [](const Vector3& p) { return p.z() < kSurface_m ? 100.0 : 0.0; }));
  }

  static std::string sceneText() {
    return R"(format: 1
name: tick loop
volume: {file: block.mha}
materials:
  - {name: muscle, intensity: [50, 200], density_kg_m3: 1050, youngs_modulus_pa: 10700, poisson_ratio: 0.45,
     damping_ratio: 0.5, cut_resistance_j_m2: 76, colour: [0.9, 0.6, 0.5], opacity: 0.5}
lattice:
  spacing_m: 0.006
  fixed_regions_m:
    - {min: [-1, -1, -1], max: [1, 1, -0.0005]}
simulation: {dt_s: 0.001, substeps: true}
rendering:
  transfer_function: {from_materials: true}
  cameras: []
tools:
  - {id: probe, tissue_threshold: 50, patch_radius_m: 0.028, friction_coefficient: 0.3}
  - {id: scalpel, kind: scalpel, tissue_threshold: 50, patch_radius_m: 0.028, tip_radius_m: 0.001}
  - {id: grasper, kind: grasper, tissue_threshold: 50, patch_radius_m: 0.028}
device:
  workspace_centre_m: [0, 0, 0]
  way_points:
    - {time_s: 0, position_m: [0, 0, 0]}
)";
  }

  /// A stroke through the middle, along y, before the tool comes.
  void cutFirst() {
    ToolCutCommand cut;
    cut.header.session = session_.id();
    cut.header.revision = session_.lattice().revision;
    cut.header.tool_id = "scalpel";
    cut.header.sequence = 1;
    const auto blade = [](double y, double z) { return Vector3(kMiddle_m + 0.001, y, z); };
    cut.quads = {{blade(0.01, 0.03), blade(0.01, 0.08), blade(0.085, 0.08), blade(0.085, 0.03)}};
    session_.apply(cut);
  }

  /// Down within half a second, then round in circles, to and fro, or up.
  Vector3 tip() const {
    const double t = time();
    const double down = std::min(1.0, t / 0.5);
    const double later = std::max(0.0, t - 0.5);
    const double height = work_ == TickWork::kFree ? 0.006 : 0.01 - 0.018 * down;
    Vector3 tip(kMiddle_m, kMiddle_m, kSurface_m + height);
    if (work_ == TickWork::kSlide)
      tip += 0.012 * Vector3(std::sin(2.0 * later), std::cos(2.0 * later) - 1.0, 0.0);
    if (work_ == TickWork::kSlideOverCut)
      tip.x() += 0.015 * std::sin(2.0 * later);
    if (work_ == TickWork::kGrip)
      tip.z() = kSurface_m + 0.003 + 0.004 * std::min(1.0, later);
    if (work_ == TickWork::kCut)
      tip += Vector3(-0.03 + 0.02 * t, 0.0, -0.01 + 0.018 * (down - 1.0) + 0.018);
    return tip;
  }

  TickWork work_;
  Session session_;
  ToolConfig config_;
  Tool tool_;
  PatchIntake intake_;
  std::unique_ptr<ReadyPatch> spare_;
  std::unique_ptr<ReadyPatch> ready_;
  ToolOutput output_;
  std::uint64_t ticks_ = 0;
  std::uint32_t shown_revision_ = 0;
  std::size_t patch_cells_ = 0;
  int refused_ = 0;
};

}  // namespace soft_volume::core
