#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "soft_volume/render/renderer.h"
#include "soft_volume/session/session.h"

namespace soft_volume::core::reed_5_2 {

/// Steps between two frames, as in the dissertation.
constexpr int kStepsPerFrame = 2;

/// What a frame of an experiment cost, medians; milliseconds. An experiment that showed nothing has no frames.
struct Cost {
  std::size_t frames = 0;
  double step_ms = 0.0;
  double frame_ms = 0.0;    ///< drawn from nothing
  double updated_ms = 0.0;  ///< only what moved (section 4.5)
  double active_cells = 0.0;
};

/// A picture that an experiment leaves, named for its file.
struct Picture {
  std::string name;
  Image image;
};

/// The three experiments of section 5.2, each on a lattice of its own, and what they leave.
struct Results {
  Cost growth;
  Cost push;
  Cost incision;
  std::size_t cells = 0;
  double dt_s = 0.0;
  std::size_t cells_cut = 0;  ///< split by the incision
  double grown_m = 0.0;       ///< largest displacement by the growth
  double pushed_m = 0.0;      ///< by the push
  double opened_m = 0.0;      ///< by the incision
  std::vector<Picture> pictures;
};

/// What the program knows of a scene's run, from 0 to 1.
using Progress = std::function<void(double)>;

/// Runs all of it. The scene has the tools grow_left, grow_right and so on, a camera for the skin, a parallel one
/// called section, and a script of the hand that presses and then cuts. Throws SceneError when something is missing,
/// and Error when the session refuses an input.
Results runExperiments(const Scene& scene, int threads, const Progress& progress);

}  // namespace soft_volume::core::reed_5_2
