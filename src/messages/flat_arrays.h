#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <vector>

#include "soft_volume/common/error.h"
#include "soft_volume/common/geometry.h"

namespace soft_volume {

// How messages keep rows of numbers: one after the other. What comes back throws InputError, with the field's name, for
// an incomplete row.

template <std::size_t N, typename T>
std::vector<std::array<T, N>> rows(const std::vector<T>& values, const char* name) {
  if (values.size() % N != 0)
    throw core::InputError(std::string(name) + " has an incomplete row");
  std::vector<std::array<T, N>> result(values.size() / N);
  for (std::size_t n = 0; n < values.size(); ++n)
    result[n / N][n % N] = values[n];
  return result;
}

template <std::size_t N, typename T>
std::vector<T> flatten(const std::vector<std::array<T, N>>& rows) {
  std::vector<T> values;
  values.reserve(N * rows.size());
  for (const std::array<T, N>& row : rows)
    values.insert(values.end(), row.begin(), row.end());
  return values;
}

inline std::vector<double> flatten(const std::vector<core::Vector3>& vectors) {
  std::vector<double> values;
  values.reserve(3 * vectors.size());
  for (const core::Vector3& v : vectors)
    values.insert(values.end(), v.data(), v.data() + 3);
  return values;
}

inline std::vector<core::Vector3> unflatten(const std::vector<double>& values, const char* name) {
  std::vector<core::Vector3> vectors;
  for (const std::array<double, 3>& row : rows<3>(values, name))
    vectors.emplace_back(row[0], row[1], row[2]);
  return vectors;
}

}  // namespace soft_volume
