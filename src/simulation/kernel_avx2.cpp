#define SOFT_VOLUME_KERNEL_SPACE avx2
#include "kernel_impl.h"

namespace soft_volume::core {

const Kernel<float>& avx2KernelFloat() {
  return avx2::kKernel<float>;
}
const Kernel<double>& avx2KernelDouble() {
  return avx2::kKernel<double>;
}

}  // namespace soft_volume::core
