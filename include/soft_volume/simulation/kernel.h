#pragma once

namespace soft_volume::core {

/// Which set of force kernels this process uses: "avx2", or "portable" on processors without it or where the
/// environment says SOFT_VOLUME_KERNEL=portable. Both give the same bits; only the speed differs.
const char* kernelName();

}  // namespace soft_volume::core
