#pragma once

#include <vtkDataSet.h>

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "soft_volume/grid/irregular_grid.h"

namespace soft_volume::core::reader {

/// The cells of one block that can be drawn, with the block's own vertex numbers.
struct BlockCells {
  std::vector<CellType> types;
  std::vector<std::uint32_t> ends;          ///< per cell, in `connectivity`
  std::vector<std::uint32_t> connectivity;  ///< as IrregularGrid::connectivity
  std::vector<vtkIdType> numbers;           ///< per cell, its number in the block
};

/// What became of a file's cells where it is not what the file says.
struct CellTally {
  std::map<int, std::size_t> linearised;  ///< cells by VTK's type
  std::size_t flat = 0;                   ///< points, lines and surfaces
  std::size_t hidden = 0;                 ///< ghosts and blanked cells
  std::size_t open = 0;                   ///< polyhedra that are not closed
  std::size_t shapeless = 0;              ///< convex point sets and parametric regions: no faces to slice

  /// Sentences for the user.
  std::vector<std::string> notes() const;
};

/// Throws ReadError when the block is not consistent, an index is out of range, a cell has too few vertices or a type
/// that VTK does not define.
BlockCells cellsOf(vtkDataSet* block, CellTally& tally);

/// Calls visit(number) for the vertex numbers among the `connectivity` of one cell.
template <typename Numbers, typename Visit>
void forEachVertex(CellType type, Numbers begin, Numbers end, const Visit& visit) {
  if (type != CellType::kPolyhedron) {
    for (; begin != end; ++begin)
      visit(*begin);
    return;
  }
  for (++begin; begin != end;) {
    for (std::uint32_t left = *begin++; left > 0; --left)
      visit(*begin++);
  }
}

}  // namespace soft_volume::core::reader
