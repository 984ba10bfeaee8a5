#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/grid/topology.h"

namespace soft_volume::core {

/// Checks the cells of a grid: offsets that span the connectivity, types that exist, the right number of vertices, face
/// streams that end where their cell ends, and vertex numbers below `vertices`. Throws InputError that begins with
/// `grid` ("grid topology") and names the first bad cell. Returns the number of faces of all cells.
std::size_t checkCells(const std::string& grid, const std::vector<CellType>& types,
                       const std::vector<std::uint32_t>& offsets, const std::vector<std::uint32_t>& connectivity,
                       std::size_t vertices);

}  // namespace soft_volume::core
