#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

namespace soft_volume::core {

// The words by which scene files, messages, programs, tables and plots call the choices of an enumeration.

template <typename Choice>
struct NamedChoice {
  const char* name;
  Choice choice;
};

/// All choices of an enumeration with their names; specialised beside each enumeration that has names.
template <typename Choice>
constexpr std::array<NamedChoice<Choice>, 0> kChoices{};

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
