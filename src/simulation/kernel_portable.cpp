#define SOFT_VOLUME_KERNEL_SPACE portable
#include "kernel_impl.h"

namespace soft_volume::core {

const Kernel<float>& portableKernelFloat() {
  return portable::kKernel<float>;
}
const Kernel<double>& portableKernelDouble() {
  return portable::kKernel<double>;
}

}  // namespace soft_volume::core
