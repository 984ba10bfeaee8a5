#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "soft_volume/grid/irregular_grid.h"
#include "soft_volume/volume/volume_reader.h"

namespace soft_volume::core {

/// Which array of a file becomes the grid's scalar, and what else belongs to the file.
struct GridReadOptions {
  static constexpr int kMagnitude = -1;

  /// Name of an array of GridFile::arrays; at points before cells, and in any case of letters where none fits exactly.
  /// Empty: the scalars that the file marks as active, else its first array.
  std::string array;
  /// Component of an array with several, from 0, or the length of the vector.
  int component = kMagnitude;
  /// PLOT3D: path of the solution (Q) file, without which the grid has no scalars. Empty for the other formats.
  std::string solution;
};

/// An array of numbers in a file.
struct GridArray {
  enum class Place : std::uint8_t { kPoints = 0, kCells = 1 };

  std::string name;
  Place place = Place::kPoints;
  int components = 1;
  /// Of its finite values, of its vectors' lengths where there are several components; {0, 0} when none is finite.
  std::array<double, 2> range{};
};

/// What a file holds: its grid with one scalar, and what a user should know about it.
struct GridFile {
  IrregularGrid grid;
  std::vector<GridArray> arrays;   ///< those at points first, in the file's order
  std::size_t taken = 0;           ///< entry of `arrays` that became the grid's scalar
  std::vector<std::string> notes;  ///< sentences: what was linearised or left out
};

/// Reads a grid in the child process that readVolume() uses too (`soft_volume_read_file`):
/// - legacy VTK (.vtk, ASCII or binary): UNSTRUCTURED_GRID, STRUCTURED_GRID, RECTILINEAR_GRID, STRUCTURED_POINTS;
/// - VTK's XML files .vtu, .vts, .vtr and .vti;
/// - binary PLOT3D (.xyz, .x, .p3d, .bin, .g, .grd; not as text) with its solution, of any byte order and
///   precision, one or more blocks. Its arrays are Density, Momentum, StagnationEnergy, and, for an ideal gas of
///   ratio 1.4 in PLOT3D's units, Pressure, Temperature, Velocity and VelocityMagnitude.
///
/// Tetrahedra, voxels, hexahedra, wedges, pyramids and polyhedra are kept, in the file's order; curvilinear and
/// rectilinear cells become hexahedra, the cells of regular grids voxels, prisms with five or six sides polyhedra,
/// whose faces are turned outward. Cells of higher order become linear ones between their corners. Left out are cells
/// that are no volumes, blanked and ghost cells, polyhedra that are not closed, and vertices that no cell uses; `notes`
/// says how many. Cells of zero volume stay. Scalars that are NaN, infinite or beyond float stay as NaN.
///
/// Throws FileError with the path and the reason: missing, unknown type, truncated, an index out of range, a cell type
/// that VTK does not define, a used vertex that is not finite, no scalars, an array that is not there (the message
/// lists those that are), the child's death, or a limit reached. Blocks; not real-time safe; safe to call from several
/// threads.
GridFile readGrid(const std::string& path, const GridReadOptions& options = {}, const ReadLimits& limits = {});

}  // namespace soft_volume::core
