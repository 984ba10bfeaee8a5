#include "soft_volume/replay/state_renderer.h"

#include <algorithm>

#include "frame_painter.h"
#include "soft_volume/common/error.h"

namespace soft_volume {

class StateRenderer::Impl {
 public:
  Impl(const RecordedRun& run, int threads)
      : run(&run), scene(run.scene()), volume(run.volume().volume), painter(threads) {}

  const RecordedRun* run;
  core::Scene scene;
  std::shared_ptr<const core::Volume> volume;
  FramePainter painter;
};

StateRenderer::StateRenderer(const RecordedRun& run, int threads) : impl_(std::make_unique<Impl>(run, threads)) {}

StateRenderer::~StateRenderer() = default;

const core::Scene& StateRenderer::scene() const {
  return impl_->scene;
}

const std::shared_ptr<const core::Volume>& StateRenderer::volume() const {
  return impl_->volume;
}

core::RenderSettings StateRenderer::settingsOf(const RecordedFrame& frame) const {
  return frame.stats.settings.empty() ? impl_->scene.rendering
                                      : core::overrideRendering(impl_->scene, frame.stats.settings, "its settings");
}

std::optional<core::Camera> StateRenderer::cameraOf(const RecordedFrame& frame) const {
  const auto& cameras = impl_->scene.rendering.cameras;
  const auto found =
      std::find_if(cameras.begin(), cameras.end(), [&](const auto& c) { return c.name == frame.stats.camera; });
  if (found == cameras.end())
    return std::nullopt;
  core::Camera camera = found->camera;
  camera.T_volume_camera = fromPose(frame.stats.pose);
  return camera;
}

bool StateRenderer::canDraw(std::size_t state) const {
  return impl_->run->hasPositions(state) && impl_->run->topology(impl_->run->states()[state].revision) != nullptr;
}

std::optional<std::size_t> StateRenderer::stateOf(const RecordedFrame& frame) const {
  const auto& states = impl_->run->states();
  auto found = std::lower_bound(states.begin(), states.end(), frame.stats.step,
                                [](const RecordedState& state, std::uint64_t step) { return state.step < step; });
  for (; found != states.end() && found->step == frame.stats.step; ++found) {
    const auto state = static_cast<std::size_t>(found - states.begin());
    if (found->revision == frame.stats.revision && canDraw(state))
      return state;
  }
  return std::nullopt;
}

core::Image StateRenderer::draw(std::size_t state, const core::RenderSettings& settings,
                                const std::string& settings_name, const core::Camera& camera,
                                std::uint32_t coarseness) {
  const RecordedRun& run = *impl_->run;
  const std::uint32_t revision = run.states().at(state).revision;
  const PaintedState painted{run.session(), revision, impl_->volume, [&] { return *run.topology(revision); },
                             run.positions(state)};
  return impl_->painter.paint(painted, settings, settings_name, camera, coarseness);
}

std::optional<core::Image> StateRenderer::drawAgain(const RecordedFrame& frame) {
  const auto state = stateOf(frame);
  const auto camera = cameraOf(frame);
  if (!state || !camera)
    return std::nullopt;
  return draw(*state, settingsOf(frame), frame.stats.settings, *camera, frame.stats.coarseness);
}

}  // namespace soft_volume
