#include "soft_volume/tool/proxy.h"

namespace soft_volume::core {

Contact Proxy::update(const PatchContact& field, const Vector3& tip_m, double tip_radius_m, double /*friction*/) {
  return tracker_.query(field, tip_m, tip_radius_m);
}

}  // namespace soft_volume::core
