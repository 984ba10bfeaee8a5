#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// How positions follow from forces; doc/simulation.md compares them in numbers.
enum class Integrator {
  kSymplecticEuler,  ///< v += dt a; x += dt v. Second order in the period, keeps energy in the mean.
  kDissertation,     ///< Figure 4.4: x += dt v + a dt^2 / 2; stable up to 0.7 of the limit, damps numerically
  kRungeKutta4,      ///< four force passes a step, stable up to 1.41 of the limit, fourth order
  kBackwardEuler,    ///< stable for any step, damps; Newton with a matrix-free conjugate gradient
  kAdaptive,         ///< Runge-Kutta 4 that halves its step until `error_tolerance` is met (section 4.3)
  kQuasiStatic,      ///< statics: masses raised until any step is stable; its transients are not physical
};

/// What keeps cells from turning inside out; safe_move.h says what each guarantees.
enum class SafeMove {
  kWidth,         ///< no corner tetrahedron gets thinner than 0.02 of the shortest cell edge
  kDissertation,  ///< 40 % of the distance to the nearest neighbour (section 4.3); cells may invert in 3D
  kNone,          ///< for comparisons
};

/// Which cells are in the solve.
enum class ActiveSet {
  kGrowth,         ///< grows where the frontier is pulled, shrinks where the tissue has come to rest
  kNeighbourhood,  ///< the dissertation's: cells near a force or cut, for a number of steps (section 4.3)
  kAll,            ///< the whole lattice
};

enum class Precision { kFloat, kDouble };

/// How spring stiffness and masses follow from materials.
enum class SpringRule {
  kIsotropic,     ///< from E, nu and spacing so that the patch test is exact
  kDissertation,  ///< one strength for all springs, rigid tissue 1000 times as heavy instead of fixed (section 4.2)
};

/// A pressure that pushes on the lattice's surface, along the inward normal of the deformed faces.
struct SurfacePressure {
  Box3 region_m;             ///< faces whose centre at rest lies inside
  double pressure_pa = 0.0;  ///< positive: pushes inwards
};

/// How a lattice moves. Defaults are those of the scene file.
struct SimulationSettings {
  Integrator integrator = Integrator::kSymplecticEuler;
  SafeMove safe_move = SafeMove::kWidth;
  ActiveSet active_set = ActiveSet::kGrowth;
  SpringRule spring_rule = SpringRule::kIsotropic;
  Precision precision = Precision::kFloat;
  /// Step of the simulation's time. 0: `dt_fraction` of the stability limit, found when the simulation is made.
  double dt_s = 0.0;
  /// Share of the integrator's own stability limit that an automatic step and a substep take.
  double dt_fraction = 0.6;
  /// Divide a step beyond the limit of an explicit integrator into equal substeps instead of refusing it.
  bool substeps = false;
  /// Neighbourhood: cells within this distance of a force or cut are woken; growth starts from it.
  double activation_radius_m = 0.02;
  /// Growth: the frontier grows where, let go, it would move by more than this share of the largest displacement in the
  /// solve, or of the shortest cell edge where that is smaller.
  double activation_threshold = 3e-3;
  /// For how long a cell stays in the solve: after the last force or cut near it (neighbourhood), after it came to rest
  /// (growth).
  double lifetime_s = 0.3;
  /// Adaptive: largest error of a step, as a fraction of the shortest cell edge.
  double error_tolerance = 1e-5;
  Vector3 gravity_m_s2 = Vector3::Zero();
  std::vector<SurfacePressure> pressures;
};

}  // namespace soft_volume::core
