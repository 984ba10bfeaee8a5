#pragma once

#include <array>
#include <string>
#include <vector>

#include "soft_volume/volume/transfer_function.h"

namespace soft_volume::core {

/// A transfer function as a file states it. Files leave open what depends on the data: fitTo() settles it.
struct TransferFunctionFile {
  TransferFunction function;
  std::string name;                ///< as the file states it, else the file's own name
  std::string about;               ///< one line; or empty
  bool relative = false;           ///< values are parts of the data's range, from 0 to 1
  bool states_distance = false;    ///< else `function.unit_distance_m` means nothing
  std::vector<std::string> notes;  ///< what the file states and the function cannot
};

/// Reads a transfer function. `source` is the name of a preset (listed by transferFunctionPresets()) or a path of
///
/// - our YAML (.yaml, .yml): `points` and `unit_distance_m` as in a scene, and `about` and `relative` (true or false,
///   default false), with which values go from 0 to 1;
/// - a ParaView colour map (.json): RGBPoints with Points for opacity, else a ramp from 0 to 1. Colour spaces other
///   than RGB are sampled. Maps from 0 to 1 or -1 to 1 are relative. Colours of categories are refused. PATH#NAME
///   picks one of several maps;
/// - a volume property of 3D Slicer (.vp), or of its scenes and list of presets (.mrml, .xml; PATH#NAME picks one).
///   Its opacities are those of 1 mm. Of its light nothing is taken, and of opacity by gradient only a note is left.
///
/// Throws FileError: a file that is missing, damaged or of an unknown type; a name that no preset has; fewer than two
/// points, values that do not increase, numbers that are not finite or out of range.
TransferFunctionFile readTransferFunction(const std::string& source);

/// The function for data from range[0] to range[1] in a grid whose diagonal is `diagonal_m`: relative values are
/// stretched over the range (around it where it is a single value), and a unit distance that is not stated becomes a
/// hundredth of the diagonal. Throws InputError when range or diagonal are not finite or range[0] > range[1].
TransferFunction fitTo(const TransferFunctionFile& file, const std::array<double, 2>& range, double diagonal_m);

/// The same points with their values moved linearly, such that 0 becomes range[0] and 1 becomes range[1].
TransferFunction stretched(const TransferFunction& function, const std::array<double, 2>& range);

/// The presets' names, sorted. They are the YAML files of the first of these folders that exists: the environment
/// variable SOFT_VOLUME_TRANSFER_FUNCTIONS, share/soft_volume/config/transfer_functions beside the running program's
/// folder, config/transfer_functions of the sources, the installation's.
std::vector<std::string> transferFunctionPresets();

}  // namespace soft_volume::core
