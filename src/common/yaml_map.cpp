#include "yaml_map.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <utility>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

std::string describe(const Range& range) {
  std::ostringstream text;
  const bool above = range.min > std::numeric_limits<double>::lowest();
  const bool below = range.max < std::numeric_limits<double>::max();
  if (above && below) {
    text << "must be within [" << range.min << ", " << range.max << "]";
  } else if (above) {
    text << "must be at least " << range.min;
  } else if (below) {
    text << "must be at most " << range.max;
  } else {
    text << "must be a finite number";
  }
  if (*range.unit != '\0')
    text << " " << range.unit;
  return text.str();
}

}  // namespace

YamlMap::YamlMap(const YAML::Node& node, std::string path, std::string origin)
    : node_(node), path_(std::move(path)), origin_(std::move(origin)) {
  if (!node_.IsMap()) {
    throw SceneError(place(node_) + ": " + (path_.empty() ? "the file" : path_) +
                     " must be a mapping of keys to values");
  }
  std::set<std::string> keys;
  for (const auto& entry : node_) {
    const std::string key = entry.first.Scalar();
    if (!keys.insert(key).second)
      throw SceneError(place(entry.first) + ": the key " + name(key) + " is there twice");
  }
}

std::string YamlMap::place(const YAML::Node& node) const {
  const YAML::Mark mark = node.IsDefined() ? node.Mark() : YAML::Mark::null_mark();
  return mark.is_null() ? origin_ : origin_ + ":" + std::to_string(mark.line + 1);
}

void YamlMap::fail(const std::string& key, const std::string& message) const {
  const YAML::Node node = node_[key];
  throw SceneError(place(node.IsDefined() ? node : node_) + ": " + name(key) + " " + message);
}

YAML::Node YamlMap::take(const std::string& key) {
  read_.insert(key);
  return node_[key];
}

YAML::Node YamlMap::required(const std::string& key) {
  const YAML::Node node = take(key);
  if (!node.IsDefined())
    fail(key, "is missing");
  return node;
}

double YamlMap::toNumber(const YAML::Node& node, const std::string& key, const Range& range) const {
  double value = 0.0;
  try {
    value = node.as<double>();
  } catch (const YAML::Exception&) {
    fail(key, "is not a number; it " + describe(range));
  }
  if (!std::isfinite(value) || value < range.min || value > range.max) {
    fail(key, "is " + node.Scalar() + "; it " + describe(range));
  }
  return value;
}

double YamlMap::number(const std::string& key, const Range& range) {
  return toNumber(required(key), key, range);
}

double YamlMap::number(const std::string& key, const Range& range, double fallback) {
  return has(key) ? number(key, range) : fallback;
}

double YamlMap::numberOrAuto(const std::string& key, const Range& range, double fallback) {
  if (!has(key))
    return fallback;
  const YAML::Node node = take(key);
  if (node.IsScalar() && node.Scalar() == "auto")
    return 0.0;
  try {
    node.as<double>();
  } catch (const YAML::Exception&) {
    fail(key, "is neither auto nor a number; it " + describe(range));
  }
  return toNumber(node, key, range);
}

std::int64_t YamlMap::integer(const std::string& key, const Range& range) {
  const double value = number(key, range);
  if (value != std::floor(value))
    fail(key, "must be a whole number");
  return static_cast<std::int64_t>(value);
}

std::int64_t YamlMap::integer(const std::string& key, const Range& range, std::int64_t fallback) {
  return has(key) ? integer(key, range) : fallback;
}

bool YamlMap::flag(const std::string& key, bool fallback) {
  if (!has(key))
    return fallback;
  try {
    return take(key).as<bool>();
  } catch (const YAML::Exception&) {
    fail(key, "must be true or false");
  }
}

std::string YamlMap::text(const std::string& key) {
  const YAML::Node node = required(key);
  if (!node.IsScalar())
    fail(key, "must be text");
  return node.Scalar();
}

std::string YamlMap::text(const std::string& key, const std::string& fallback) {
  return has(key) ? text(key) : fallback;
}

std::vector<double> YamlMap::numbers(const std::string& key, std::size_t count, const Range& range) {
  const YAML::Node node = required(key);
  if (!node.IsSequence() || (count != 0 && node.size() != count)) {
    fail(key, "must be a list of " + (count != 0 ? std::to_string(count) + " " : std::string()) + "numbers");
  }
  std::vector<double> values;
  for (const auto& item : node)
    values.push_back(toNumber(item, key, range));
  return values;
}

Vector3 YamlMap::vector(const std::string& key, const Range& range) {
  const std::vector<double> values = numbers(key, 3, range);
  return {values[0], values[1], values[2]};
}

Vector3 YamlMap::vector(const std::string& key, const Range& range, const Vector3& fallback) {
  return has(key) ? vector(key, range) : fallback;
}

Vector3 YamlMap::numberOrVector(const std::string& key, const Range& range) {
  return has(key) && node_[key].IsSequence() ? vector(key, range) : Vector3::Constant(number(key, range));
}

Vector3i YamlMap::indices(const std::string& key, const Range& range, const Vector3i& fallback) {
  if (!has(key))
    return fallback;
  const Vector3 value = vector(key, range);
  if (value != value.array().floor().matrix())
    fail(key, "must be a list of 3 whole numbers");
  return value.cast<int>();
}

std::string YamlMap::choice(const std::string& key, const std::vector<std::string>& words,
                            const std::string& fallback) {
  const std::string value = text(key, fallback);
  if (std::find(words.begin(), words.end(), value) != words.end())
    return value;
  std::string list;
  for (const std::string& word : words)
    list += (list.empty() ? "" : ", ") + word;
  fail(key, "is '" + value + "'; it must be one of: " + list);
}

YamlMap YamlMap::map(const std::string& key) {
  const YAML::Node node = take(key);
  return {node.IsDefined() ? node : YAML::Node(YAML::NodeType::Map), name(key), origin_};
}

std::vector<YamlMap> YamlMap::maps(const std::string& key) {
  std::vector<YamlMap> result;
  const YAML::Node node = take(key);
  if (!node.IsDefined())
    return result;
  if (!node.IsSequence())
    fail(key, "must be a list");
  for (const auto& item : node)
    result.emplace_back(item, name(key) + "[" + std::to_string(result.size()) + "]", origin_);
  return result;
}

std::vector<std::vector<double>> YamlMap::rows(const std::string& key, std::size_t count) {
  std::vector<std::vector<double>> result;
  const YAML::Node node = required(key);
  if (!node.IsSequence())
    fail(key, "must be a list of lists of " + std::to_string(count) + " numbers");
  constexpr Range kAny{std::numeric_limits<double>::lowest(), std::numeric_limits<double>::max()};
  for (const auto& item : node) {
    if (!item.IsSequence() || item.size() != count) {
      fail(key, "must be a list of lists of " + std::to_string(count) + " numbers");
    }
    result.emplace_back();
    for (const auto& value : item)
      result.back().push_back(toNumber(value, key, kAny));
  }
  return result;
}

void YamlMap::finish() const {
  for (const auto& entry : node_) {
    if (read_.count(entry.first.Scalar()) == 0) {
      throw SceneError(place(entry.first) + ": unknown key " + name(entry.first.Scalar()));
    }
  }
}

}  // namespace soft_volume::core
