#pragma once

namespace soft_volume::core {

/// Registers the cases `tool/tick/500/<what the tool does>`.
void registerToolBenchmarks();

}  // namespace soft_volume::core
