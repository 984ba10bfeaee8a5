#pragma once

#include <functional>
#include <string>
#include <vector>

#include "soft_volume/grid/irregular_grid.h"

namespace soft_volume::core::testing_grid {

/// One cell of each type side by side, the polyhedron a box with a cut corner; a scalar at every vertex, all of them
/// used. Numbers are short binary fractions, so that text holds them exactly.
IrregularGrid mixedGrid();
/// The same with a scalar in each cell.
IrregularGrid mixedGridWithCellScalars();

/// An array for a file: one line of numbers.
struct FileArray {
  std::string name;
  int components = 1;
  std::vector<double> values;
};

/// What the writers put into a file; starts as a grid and can be spoiled or extended.
struct FileContents {
  std::vector<Vector3> points;
  std::vector<int> types;
  std::vector<std::vector<long>> cells;  ///< vertices; of a polyhedron its face stream
  std::vector<FileArray> point_arrays;
  std::vector<FileArray> cell_arrays;
  std::vector<int> cell_ghosts;  ///< VTK's ghost marks; empty for none

  FileContents() = default;
  /// With the grid's scalars as an array "scalar".
  explicit FileContents(const IrregularGrid& grid);
};

std::string legacyFile(const FileContents& contents);
/// Numbers in big-endian binary: float points, int cells, float arrays.
std::string binaryLegacyFile(const FileContents& contents);
std::string vtuFile(const FileContents& contents);
/// The arrays behind the XML, as raw bytes.
std::string appendedVtuFile(const FileContents& contents);

/// A structured grid of points; x fastest.
struct Block {
  Vector3i dims{3, 4, 5};
  std::vector<int> blanks;  ///< per point as PLOT3D's IBLANK, or empty
  Vector3 offset = Vector3::Zero();

  std::size_t count() const { return std::size_t(dims.prod()); }
  /// Curved, but with short binary fractions.
  Vector3 point(int i, int j, int k) const;
  static double value(int i, int j, int k) { return i + 10 * j + 100 * k; }
  void forEach(const std::function<void(int, int, int)>& visit) const;
};

std::string legacyStructuredFile(const Block& block);
std::string legacyRectilinearFile(const Block& block);
std::string legacyImageFile(const Block& block);
std::string vtsFile(const Block& block);
std::string vtrFile(const Block& block);
std::string vtiGridFile(const Block& block);

struct Plot3dOptions {
  bool big_endian = true;
  bool double_precision = false;
  bool record_marks = false;  ///< Fortran's byte counts
  bool block_count = false;   ///< the number of blocks comes first; always so with several
};
std::string plot3dGrid(const std::vector<Block>& blocks, const Plot3dOptions& options = {});
/// Density = Block::value, momentum = (3, 4, 12) * density, energy = density / 2.
std::string plot3dSolution(const std::vector<Block>& blocks, const Plot3dOptions& options = {});

}  // namespace soft_volume::core::testing_grid
