#pragma once

namespace soft_volume::core {

/// Registers the cases `simulation/<what>/<size>/<variant>`.
void registerSimulationBenchmarks();

}  // namespace soft_volume::core
