#pragma once

#include <algorithm>
#include <cstdlib>
#include <iterator>
#include <random>
#include <string>

namespace soft_volume::core::testing_volume {

/// The first number at or after a place, in a text, becomes one that programs stumble over.
inline std::string withBadNumber(std::string bytes, std::size_t at, std::mt19937& random) {
  static const char* const kBad[] = {"-1", "0", "2147483648", "4294967296", "9223372036854775807", "1e308", "nan", "x"};
  const std::size_t begin = bytes.find_first_of("0123456789", at);
  if (begin == std::string::npos)
    return bytes;
  const std::size_t end = std::min(bytes.find_first_not_of("0123456789.", begin), bytes.size());
  return bytes.replace(begin, end - begin, kBad[random() % std::size(kBad)]);
}

/// Damages one file in one of six ways.
inline std::string damaged(std::string bytes, std::mt19937& random) {
  const auto below = [&random](std::size_t count) { return random() % count; };
  const std::size_t at = below(bytes.size());
  switch (below(6)) {
    case 0:
      return bytes.substr(0, at);
    case 1:
      return bytes.replace(at, std::min<std::size_t>(1 + below(40), bytes.size() - at), below(40), '\0');
    case 2:
      return bytes.insert(at, bytes.substr(below(bytes.size()), below(60)));
    case 3:
      return bytes.erase(at, below(30));
    case 4:
      return withBadNumber(bytes, at, random);
    default:
      for (std::size_t i = 0, count = 1 + below(8); i < count; ++i) {
        bytes[below(std::min<std::size_t>(bytes.size(), 500))] = static_cast<char>(below(256));
      }
      return bytes;
  }
}

/// The number of rounds can be raised for a longer search: SOFT_VOLUME_FUZZ_ROUNDS=1000.
inline int fuzzRounds(int by_default) {
  const char* rounds = std::getenv("SOFT_VOLUME_FUZZ_ROUNDS");
  return rounds != nullptr ? std::atoi(rounds) : by_default;
}

}  // namespace soft_volume::core::testing_volume
