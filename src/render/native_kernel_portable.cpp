#define SOFT_VOLUME_KERNEL_SPACE portable
#include "native_kernel_impl.h"

namespace soft_volume::core {

const NativeKernel& portableNativeKernel() {
  return portable::kNativeKernel;
}

}  // namespace soft_volume::core
