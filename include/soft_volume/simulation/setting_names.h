#pragma once

#include <array>

#include "soft_volume/common/named_choice.h"
#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

// The names of the choices of SimulationSettings.

template <>
inline constexpr std::array<NamedChoice<Integrator>, 6> kChoices<Integrator>{
    {{"symplectic_euler", Integrator::kSymplecticEuler},
     {"dissertation", Integrator::kDissertation},
     {"runge_kutta_4", Integrator::kRungeKutta4},
     {"backward_euler", Integrator::kBackwardEuler},
     {"adaptive", Integrator::kAdaptive},
     {"quasi_static", Integrator::kQuasiStatic}}};

template <>
inline constexpr std::array<NamedChoice<SafeMove>, 3> kChoices<SafeMove>{
    {{"width", SafeMove::kWidth}, {"dissertation", SafeMove::kDissertation}, {"none", SafeMove::kNone}}};

template <>
inline constexpr std::array<NamedChoice<ActiveSet>, 3> kChoices<ActiveSet>{
    {{"growth", ActiveSet::kGrowth}, {"neighbourhood", ActiveSet::kNeighbourhood}, {"all", ActiveSet::kAll}}};

template <>
inline constexpr std::array<NamedChoice<SpringRule>, 2> kChoices<SpringRule>{
    {{"isotropic", SpringRule::kIsotropic}, {"dissertation", SpringRule::kDissertation}}};

template <>
inline constexpr std::array<NamedChoice<Precision>, 2> kChoices<Precision>{
    {{"float", Precision::kFloat}, {"double", Precision::kDouble}}};

}  // namespace soft_volume::core
