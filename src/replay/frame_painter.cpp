#include "frame_painter.h"

namespace soft_volume {

core::Image FramePainter::paint(const PaintedState& state, const core::RenderSettings& settings,
                                const std::string& settings_text, const core::Camera& camera,
                                std::uint32_t coarseness) {
  update(state, settings, settings_text);
  core::RenderOptions options = settings.coarser(coarseness);
  options.threads = threads_;
  // Always the whole frame: where the node drew only what had changed, equal hashes say that both are the same.
  renderer_->forgetFrame();
  return renderer_->render(camera, state.positions_m, options).toRgb8(settings.background);
}

void FramePainter::update(const PaintedState& state, const core::RenderSettings& settings,
                          const std::string& settings_text) {
  if (!renderer_ || backend_ != settings.backend) {
    renderer_ = std::make_unique<core::Renderer>(settings.backend);
    backend_ = settings.backend;
    drawn_session_ = 0;
  }
  if (drawn_session_ != state.session)
    renderer_->setVolume(state.volume);
  if (drawn_session_ != state.session || drawn_settings_ != settings_text)
    renderer_->setTransferFunction(settings.transfer_function);
  if (drawn_session_ != state.session || drawn_revision_ != state.revision)
    renderer_->setTopology(state.topology());
  drawn_session_ = state.session;
  drawn_revision_ = state.revision;
  drawn_settings_ = settings_text;
}

}  // namespace soft_volume
