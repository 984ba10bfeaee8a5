#pragma once

#include <cmath>
#include <sstream>
#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {

/// Throws SceneError unless `value` is in [low, high]; NaN is not. `field` names the owner and the key with its unit.
inline void checkRange(const std::string& field, double value, double low, double high) {
  if (value >= low && value <= high)
    return;
  std::ostringstream text;
  text << field << " is " << value << ", must be from " << low << " to " << high;
  throw SceneError(text.str());
}

}  // namespace soft_volume::core
