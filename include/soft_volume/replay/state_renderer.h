#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "soft_volume/render/camera.h"
#include "soft_volume/render/image_io.h"
#include "soft_volume/replay/recorded_run.h"
#include "soft_volume/scene/scene.h"

namespace soft_volume {

/// Draws recorded states: what was recorded is shown, nothing is computed again. Not thread-safe.
class StateRenderer {
 public:
  /// `threads` as in core::RenderOptions; never changes a picture. Throws ReplayError when the run lacks scene or
  /// volume.
  StateRenderer(const RecordedRun& run, int threads);
  ~StateRenderer();

  /// The settings that a frame was drawn with; those of the scene when parameters did not change them.
  core::RenderSettings settingsOf(const RecordedFrame& frame) const;
  /// The camera of a frame, where it was then; nothing when the scene does not have it.
  std::optional<core::Camera> cameraOf(const RecordedFrame& frame) const;
  /// The state that a frame shows; nothing when it, its key frame or its topology is not in the bag.
  std::optional<std::size_t> stateOf(const RecordedFrame& frame) const;
  /// Whether a state can be drawn.
  bool canDraw(std::size_t state) const;

  /// Draws a state. Equal `settings_name` stand for equal transfer functions. Throws core::SceneError and ReplayError.
  core::Image draw(std::size_t state, const core::RenderSettings& settings, const std::string& settings_name,
                   const core::Camera& camera, std::uint32_t coarseness = 1);
  /// Draws what a frame shows as it was drawn; nothing where settings, camera or state cannot be had.
  std::optional<core::Image> drawAgain(const RecordedFrame& frame);

  const core::Scene& scene() const;
  const std::shared_ptr<const core::Volume>& volume() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soft_volume
