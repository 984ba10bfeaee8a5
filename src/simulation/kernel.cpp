#include "kernel.h"

#include <cstdlib>
#include <cstring>

#include "soft_volume/simulation/kernel.h"

namespace soft_volume::core {
namespace {

bool useAvx2() {
#if defined(SOFT_VOLUME_HAS_AVX2_KERNEL)
  const char* wanted = std::getenv("SOFT_VOLUME_KERNEL");
  if (wanted != nullptr && std::strcmp(wanted, "portable") == 0)
    return false;
  return __builtin_cpu_supports("avx2") != 0;
#else
  return false;
#endif
}

}  // namespace

#if defined(SOFT_VOLUME_HAS_AVX2_KERNEL)
template <>
const Kernel<float>& bestKernel<float>() {
  static const Kernel<float>& kernel = useAvx2() ? avx2KernelFloat() : portableKernelFloat();
  return kernel;
}
template <>
const Kernel<double>& bestKernel<double>() {
  static const Kernel<double>& kernel = useAvx2() ? avx2KernelDouble() : portableKernelDouble();
  return kernel;
}
#else
template <>
const Kernel<float>& bestKernel<float>() {
  return portableKernelFloat();
}
template <>
const Kernel<double>& bestKernel<double>() {
  return portableKernelDouble();
}
#endif

const char* kernelName() {
  return useAvx2() ? "avx2" : "portable";
}

}  // namespace soft_volume::core
