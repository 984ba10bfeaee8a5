#pragma once

#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/topology.h"

namespace soft_volume {

/// Numbers at the points or cells of a grid.
struct VtuArray {
  std::string name;
  int components = 1;
  std::variant<std::vector<float>, std::vector<std::uint32_t>, std::vector<std::uint8_t>> values;
};

/// An unstructured grid as VTK keeps it.
struct VtuGrid {
  std::vector<core::Vector3f> points;
  std::vector<std::uint8_t> types;          ///< per cell
  std::vector<std::int64_t> connectivity;   ///< points of the cells; of polyhedra each once
  std::vector<std::int64_t> offsets;        ///< per cell, the end of its points
  std::vector<std::int64_t> faces;          ///< VTK's face streams of the polyhedra; empty without any
  std::vector<std::int64_t> faces_offsets;  ///< per cell, the end of its face stream, -1 for other cells; or empty
  std::vector<VtuArray> point_arrays;
  std::vector<VtuArray> cell_arrays;
};

/// A deformed grid: `displacement` [m] and `fixed` at its points, `material` and `lattice_cell` (the cell that a piece
/// comes from) at its cells. Cells that were taken away are left out.
VtuGrid deformedGrid(const core::Topology& topology, const std::vector<core::Vector3f>& positions_m);

/// Points as cells of a single vertex each, so that every program shows them.
VtuGrid pointGrid(std::vector<core::Vector3f> points_m);

/// Writes a .vtu: appended raw data, compressed with zlib. Written here and not by VTK, which only the readers' child
/// process links: it is a page of code, while VTK's writers would bring 20 shared libraries into every replay.
/// Throws core::FileError.
void writeVtu(const std::string& path, const VtuGrid& grid);

/// One file of a series of them.
struct VtuSeriesEntry {
  double time_s = 0.0;
  std::string file;  ///< relative to the series' folder
};

/// Writes a .pvd, ParaView's list of files over time; `remark` becomes a comment in it. Throws core::FileError.
void writePvd(const std::string& path, const std::vector<VtuSeriesEntry>& entries, const std::string& remark);

}  // namespace soft_volume
