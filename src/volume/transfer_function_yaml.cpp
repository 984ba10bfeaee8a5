#include "transfer_function_yaml.h"

#include <string>

#include "soft_volume/common/error.h"

namespace soft_volume::core {

std::vector<TransferFunction::Point> readPoints(YamlMap& map) {
  std::vector<TransferFunction::Point> points;
  for (const std::vector<double>& row : map.rows("points", 5)) {
    const Vector3f colour = Vector3(row[1], row[2], row[3]).cast<float>();
    points.push_back({row[0], colour, static_cast<float>(row[4])});
  }
  return points;
}

void finishTransferFunction(const YamlMap& map, const TransferFunction& function) {
  try {
    function.validate();
  } catch (const SceneError& error) {
    map.fail("points", std::string("cannot be used: ") + error.what());
  }
  map.finish();
}

}  // namespace soft_volume::core
