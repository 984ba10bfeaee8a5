#pragma once

#include <yaml-cpp/yaml.h>

#include <optional>
#include <set>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"

namespace soft_volume::core {

/// The values that a key may take, both ends included, and their unit ("" for plain numbers).
struct Range {
  double min;
  double max;
  const char* unit = "";
};

/// One mapping of a YAML document. Every key is read exactly once: finish() refuses the keys that nobody read, so a
/// typo fails instead of leaving a default in place. All errors are SceneError with file, line, full key, unit and
/// range.
class YamlMap {
 public:
  /// `path` is the dotted name of the mapping, empty at the top. Refuses a node that is no mapping and duplicate keys.
  YamlMap(const YAML::Node& node, std::string path, std::string origin);

  bool has(const std::string& key) const { return node_[key].IsDefined(); }
  /// Whether the key is there with a single value, not with a list or a mapping.
  bool isText(const std::string& key) const { return node_[key].IsDefined() && node_[key].IsScalar(); }

  double number(const std::string& key, const Range& range);
  double number(const std::string& key, const Range& range, double fallback);
  /// A number, or the word `auto`, which reads as 0.
  double numberOrAuto(const std::string& key, const Range& range, double fallback);
  std::int64_t integer(const std::string& key, const Range& range);
  std::int64_t integer(const std::string& key, const Range& range, std::int64_t fallback);
  bool flag(const std::string& key, bool fallback);
  std::string text(const std::string& key);
  std::string text(const std::string& key, const std::string& fallback);
  /// A list of exactly `count` numbers, or of any number of them when count is 0.
  std::vector<double> numbers(const std::string& key, std::size_t count, const Range& range);
  Vector3 vector(const std::string& key, const Range& range);
  Vector3 vector(const std::string& key, const Range& range, const Vector3& fallback);
  /// One number for all three components, or a list of three.
  Vector3 numberOrVector(const std::string& key, const Range& range);
  Vector3i indices(const std::string& key, const Range& range, const Vector3i& fallback);
  /// One of the named words.
  std::string choice(const std::string& key, const std::vector<std::string>& words, const std::string& fallback);

  /// A nested mapping; a missing one reads as empty, so that its own required keys complain.
  YamlMap map(const std::string& key);
  /// The mappings of a list; a missing list is empty.
  std::vector<YamlMap> maps(const std::string& key);
  /// The lists of numbers of a list, `count` each.
  std::vector<std::vector<double>> rows(const std::string& key, std::size_t count);

  /// Refuses keys that were not read. Call once everything was.
  void finish() const;

  /// Throws SceneError about a key of this mapping: "FILE:LINE: PATH.KEY MESSAGE".
  [[noreturn]] void fail(const std::string& key, const std::string& message) const;

 private:
  YAML::Node take(const std::string& key);
  YAML::Node required(const std::string& key);
  std::string name(const std::string& key) const { return path_.empty() ? key : path_ + "." + key; }
  std::string place(const YAML::Node& node) const;
  double toNumber(const YAML::Node& node, const std::string& key, const Range& range) const;

  YAML::Node node_;
  std::string path_;
  std::string origin_;
  std::set<std::string> read_;
};

}  // namespace soft_volume::core
