#pragma once

namespace soft_volume::core {

/// Registers the cases `render/<grid>/<transfer function>/<view>/<slices>/<variant>`, `render/linear/<cells>/<variant>`
/// and `render/memory/<cells>/<variant>`. Says which grids are left out because their data are missing. Sets Mesa's
/// number of threads, so it comes before the first OpenGL context.
void registerRenderBenchmarks();

}  // namespace soft_volume::core
