#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "soft_volume/grid/topology.h"
#include "soft_volume/render/renderer.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

/// What a frame shows.
struct PaintedState {
  std::uint64_t session = 0;  ///< a number for each volume; not 0
  std::uint32_t revision = 0;
  std::shared_ptr<const core::Volume> volume;
  std::function<core::Topology()> topology;  ///< called when another revision was drawn before
  std::vector<core::Vector3f> positions_m;
};

/// Draws whole frames one after the other and gives the renderer only what changed in between.
class FramePainter {
 public:
  explicit FramePainter(int threads) : threads_(threads) {}

  /// `settings_text` tells settings apart: equal texts of one session stand for equal transfer functions. `coarseness`
  /// as in RenderStats. Throws as core::Renderer::render(), SceneError too.
  core::Image paint(const PaintedState& state, const core::RenderSettings& settings, const std::string& settings_text,
                    const core::Camera& camera, std::uint32_t coarseness);
  /// Of the last frame, as in RenderStats.renderer.
  std::string driver() const { return renderer_->driver(); }
  void forget() { drawn_session_ = 0; }

 private:
  void update(const PaintedState& state, const core::RenderSettings& settings, const std::string& settings_text);

  int threads_;
  std::unique_ptr<core::Renderer> renderer_;
  core::Backend backend_{};
  std::uint64_t drawn_session_ = 0;
  std::uint32_t drawn_revision_ = 0;
  std::string drawn_settings_;
};

}  // namespace soft_volume
