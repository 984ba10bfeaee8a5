#pragma once

#include <array>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "arguments.h"
#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/render/renderer.h"
#include "soft_volume/volume/volume.h"

namespace soft_volume::core::render_program {

/// What is drawn: a volume as a texture, or a grid with scalars.
struct Subject {
  std::shared_ptr<const Volume> volume;  ///< null: the grid is drawn
  std::shared_ptr<const Volume> labels;  ///< or null
  IrregularGrid grid;
  Box3 bounds;
  std::array<double, 2> range{};       ///< of the finite scalars; {0, 0} without any
  Matrix3 view = Matrix3::Identity();  ///< columns: right, up and towards the viewer at azimuth and elevation 0
  double shading = 0.0;                ///< this and the next two: where the user says nothing
  int slices = 200;
  std::string default_transfer_function;  ///< name of the preset
  nlohmann::json facts;                   ///< about the file
};

/// Reads the input. Throws as readVolume() and readGrid(), and InputError when the mode does not fit it.
Subject readSubject(const Arguments& arguments);

/// Prints what a file holds.
void listArrays(const Arguments& arguments);

/// Gives the renderer what is drawn.
void showSubject(const Subject& subject, Renderer& renderer);

}  // namespace soft_volume::core::render_program
