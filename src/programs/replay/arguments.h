#pragma once

#include <optional>
#include <string>
#include <vector>

namespace soft_volume::replay_program {

constexpr int kWithin = 0;      ///< identical, or within the tolerances
constexpr int kDifferent = 1;   ///< something differs, or by more than it may
constexpr int kImpossible = 2;  ///< bad arguments, a bag that cannot be used

/// How --render draws the recorded states. Options as soft_volume_render names them; what is not given is as recorded.
struct RenderArguments {
  std::string dir;     ///< empty: nothing is drawn
  std::string camera;  ///< YAML file with the keys of a scene's camera
  std::optional<int> width;
  std::optional<int> height;
  std::optional<double> azimuth_deg;  ///< a view of the whole grid from there instead of the recorded camera
  std::optional<double> elevation_deg;
  std::optional<double> zoom;
  std::string projection;
  std::string transfer_function;  ///< preset or file
  std::optional<double> unit_distance_m;
  std::string backend;
  std::optional<int> slices;
  std::optional<double> step_m;
  std::optional<double> shade;
  std::string background;         ///< R,G,B
  std::vector<std::string> clip;  ///< NX,NY,NZ,OFFSET each
  std::optional<double> every_s;  ///< simulated time between frames; not given: where frames were recorded
};

/// The command line.
struct Arguments {
  std::string bag;

  bool check = false;
  std::string against;                    ///< another bag
  std::optional<std::string> resimulate;  ///< KEY=VALUE,...; empty: nothing is changed
  std::string output;                     ///< the bag that --resimulate writes
  std::string device;                     ///< file of the recorded device, for --resimulate
  std::string tolerance;                  ///< KEY=LIMIT,... or a YAML file; empty: bit for bit

  RenderArguments render;
  std::string frames_dir;
  std::string video;
  std::string vtu_dir;
  std::string csv_dir;

  std::string json;
  std::string report;
  int threads = 1;
  bool no_progress = false;
};

/// Fills `arguments`. Returns what the program has to exit with, or nothing when it is to go on. Throws ReplayError
/// when options do not fit together.
std::optional<int> parseArguments(int argc, char** argv, Arguments& arguments);

}  // namespace soft_volume::replay_program
