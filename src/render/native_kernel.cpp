#include "native_kernel.h"

#include <cstdlib>
#include <cstring>

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

const NativeKernel& bestNativeKernel() {
#if defined(SOFT_VOLUME_HAS_AVX2_KERNEL)
  static const NativeKernel& kernel = useAvx2() ? avx2NativeKernel() : portableNativeKernel();
  return kernel;
#else
  return portableNativeKernel();
#endif
}

}  // namespace soft_volume::core
