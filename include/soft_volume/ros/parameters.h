#pragma once

#include <ros/node_handle.h>

#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume {

/// A private parameter that a node cannot do without. Throws InputError that says what it is for.
template <typename T>
T requiredParameter(const ros::NodeHandle& node, const std::string& name, const std::string& meaning) {
  T value;
  if (node.getParam(name, value))
    return value;
  throw core::InputError("the parameter " + node.resolveName(name) + " is missing or of a wrong type: " + meaning);
}

/// A private parameter with a default. Throws InputError when it is there with another type.
template <typename T>
T parameter(const ros::NodeHandle& node, const std::string& name, T fallback) {
  T value = fallback;
  if (node.hasParam(name) && !node.getParam(name, value)) {
    throw core::InputError("the parameter " + node.resolveName(name) + " is of a wrong type");
  }
  return value;
}

/// The same with a range, both ends included.
template <typename T>
T parameter(const ros::NodeHandle& node, const std::string& name, T fallback, T min, T max) {
  const T value = parameter<T>(node, name, fallback);
  if (!(value >= min && value <= max)) {
    throw core::InputError("the parameter " + node.resolveName(name) + " is " + std::to_string(value) +
                           "; it must be within [" + std::to_string(min) + ", " + std::to_string(max) + "]");
  }
  return value;
}

}  // namespace soft_volume
