#define SOFT_VOLUME_KERNEL_SPACE avx2
#include "native_kernel_impl.h"

namespace soft_volume::core {

const NativeKernel& avx2NativeKernel() {
  return avx2::kNativeKernel;
}

}  // namespace soft_volume::core
