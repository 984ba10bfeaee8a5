#pragma once

#include <cstddef>

#include "soft_volume/grid/topology.h"

namespace soft_volume::core {

/// Checks vertices and cells that belong to a grid with so many vertices and cells: their arrays fit together, numbers
/// are in range, positions finite. Throws InputError.
void checkTopology(const Topology& entries, std::size_t vertices, std::size_t cells);

}  // namespace soft_volume::core
