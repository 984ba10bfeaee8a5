#pragma once

#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "simulation_scene.h"
#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

/// A lattice and settings to measure. Explicit integrators take the automatic step of their settings.
struct SweepSetting {
  double spacing_m;
  SimulationSettings simulation;
  std::string preset;  ///< name of the simulation preset that the settings are, else empty
  bool is_reference = false;
  bool is_lattice_reference = false;  ///< as the reference, but for the spacing: tells errors in space from others
};

/// What a setting costs and how wrong it is.
struct SweepResult {
  SweepSetting setting;
  std::size_t cells = 0;
  std::size_t vertices = 0;
  double dt_s = 0.0;
  double limit_s = 0.0;            ///< stability limit of the lattice
  double mean_active_cells = 0.0;  ///< over the scene's time
  double bytes_per_vertex = 0.0;
  double largest_displacement_m = 0.0;  ///< of the probes
  std::uint64_t limited_moves = 0;      ///< by the safe move
  int repeats = 0;
  double ms_per_simulated_s = std::numeric_limits<double>::infinity();
  double reference_error = std::numeric_limits<double>::infinity();
  /// Against the lattice reference of the same spacing: what the error would be without that of the spacing.
  std::optional<double> same_lattice_error;
  std::optional<double> known_error;
  std::string failure;  ///< why the setting cannot run this scene, else empty
};

/// The settings that are compared in a scene; the last one is the reference: finest lattice, double precision,
/// Runge-Kutta 4 at a short step, the whole lattice in the solve.
std::vector<SweepSetting> sweepSettings(bool quick);

/// Runs all settings of a scene `repeats` times in turns, those that take long once, so that a busy machine slows all
/// of them alike. The cost is the sum over the scene's time of the medians over the repeats; it counts setLoads() and
/// step() and not the making of the lattice. Errors: root mean square over probes and times of the difference from the
/// reference, as a fraction of the reference's largest displacement. `progress(done, total)` is called often.
std::vector<SweepResult> runSweep(const TradeoffScene& scene, const std::vector<SweepSetting>& settings, int repeats,
                                  const std::function<void(double done, double total)>& progress);

/// Whether the integrator's step has a stability limit, of which the settings take a fraction.
bool isExplicit(Integrator integrator);

/// Work of a sweep in the units of its progress, to join several.
double sweepWork(const TradeoffScene& scene, const std::vector<SweepSetting>& settings, int repeats);

}  // namespace soft_volume::core
