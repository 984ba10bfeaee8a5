#pragma once

#include <nlohmann/json.hpp>

#include "soft_volume/replay/compared_quantity.h"

namespace soft_volume {

/// A quantity's figures, without its samples.
inline nlohmann::json quantityJson(const ComparedQuantity& quantity) {
  return {{"key", quantity.key},
          {"subject", quantity.subject},
          {"title", quantity.title},
          {"unit", quantity.unit},
          {"run", quantity.run},
          {"rms", quantity.rms},
          {"largest", quantity.largest},
          {"largest_at_s", quantity.largest_at_s},
          {"scale", quantity.scale},
          {"samples", quantity.samples.size()},
          {"compared", quantity.compared},
          {"left_out", quantity.left_out},
          {"left_out_reason", quantity.left_out_reason},
          {"identical", quantity.identical},
          {"reproducible", quantity.reproducible}};
}

}  // namespace soft_volume
