#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

// The words by which scene files, messages, tables and plots call the choices of SimulationSettings.

template <typename Choice>
struct NamedChoice {
  const char* name;
  Choice choice;
};

/// All choices of an enumeration with their names.
template <typename Choice>
constexpr std::array<NamedChoice<Choice>, 0> kChoices{};

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

template <typename Choice>
const char* nameOf(Choice choice) {
  for (const auto& named : kChoices<Choice>) {
    if (named.choice == choice)
      return named.name;
  }
  return "";
}

/// Nothing when no choice has that name.
template <typename Choice>
std::optional<Choice> choiceNamed(const std::string& name) {
  for (const auto& named : kChoices<Choice>) {
    if (name == named.name)
      return named.choice;
  }
  return std::nullopt;
}

template <typename Choice>
std::vector<std::string> choiceNames() {
  std::vector<std::string> names;
  for (const auto& named : kChoices<Choice>)
    names.emplace_back(named.name);
  return names;
}

}  // namespace soft_volume::core
