#pragma once

#include <string>

namespace soft_volume::core {

/// Runs a gnuplot script, its data inline (`$name << EOD`); the script sets its own terminal and output, for example
/// `set terminal pngcairo size 900,600` and `set output "error.png"`. Throws Error when gnuplot is missing (with
/// the package to install) or refuses the script. Not to be called from several threads at once.
void plotWithGnuplot(const std::string& script);

}  // namespace soft_volume::core
