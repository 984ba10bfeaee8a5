#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/render/renderer.h"

namespace soft_volume::core::render_program {

enum class Mode {
  kTexture,  ///< a volume as a texture on cells
  kScalar,   ///< scalars at vertices, looked up for every sample
  kColour,   ///< scalars at vertices, looked up there
};

/// The command line.
struct Arguments {
  std::vector<std::string> files;  ///< what is drawn, then a solution (PLOT3D) and an output in any order
  std::string solution;
  std::string out;
  bool list_arrays = false;
  bool list_presets = false;

  std::string array;
  int component = -1;  ///< -1: the vector's length
  std::string labels;  ///< path of a segmentation

  std::string transfer_function;               ///< file or preset; empty: by the data
  std::optional<std::array<double, 2>> range;  ///< that relative transfer functions are stretched over
  std::optional<double> unit_distance;         ///< in the grid's unit of length
  std::optional<Mode> mode;                    ///< by the data where not given
  Backend backend = Backend::kNative;
  RenderOptions options;
  std::optional<int> slices;    ///< by the data where not given
  std::optional<double> shade;  ///< by the data where not given
  Vector3f background = Vector3f::Zero();

  int width = 640;
  int height = 480;
  std::string camera;  ///< path; the view's other members are not used then
  Projection projection = Projection::kPerspective;
  double azimuth_deg = 0.0;
  double elevation_deg = 0.0;
  double zoom = 1.0;
  std::vector<double> cross_section;  ///< empty, a part of the depth, or a plane: normal and offset

  std::string depth;  ///< paths
  std::string label_image;
  std::string raw;
  std::string json;
  int turntable = 0;  ///< frames of a turn; 0: one picture
  int repeat = 1;
  bool no_progress = false;
};

/// Fills `arguments`. Returns what the program has to exit with, or nothing when it is to go on. Throws InputError when
/// options do not fit together.
std::optional<int> parseArguments(int argc, char** argv, Arguments& arguments);

}  // namespace soft_volume::core::render_program
