#pragma once

#include <map>
#include <random>
#include <string>
#include <vector>

#include "render/cell_grids.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/grid/irregular_grid.h"

namespace soft_volume::core {

/// What the cubes of a warped grid are made of.
enum class CubeParts { kTetrahedra, kVoxels, kHexahedra, kWedges, kPyramids, kPolyhedra, kPentagons, kMixed };

inline std::string nameOf(CubeParts parts) {
  const std::array<const char*, 8> names = {"tetrahedra", "voxels",    "hexahedra", "wedges",
                                            "pyramids",   "polyhedra", "pentagons", "mixed"};
  return names[std::size_t(parts)];
}

/// A cube as six pyramids to its middle.
inline void addPyramids(CellGrid& grid, const Corners& c) {
  Vector3f middle = Vector3f::Zero();
  for (const std::uint32_t corner : c)
    middle += 0.125F * grid.points[corner];
  const std::uint32_t apex = grid.addPoint(middle);
  for (const auto& f : kHexahedronFaces)
    grid.add(CellType::kPyramid,
             {c[std::size_t(f[0])], c[std::size_t(f[1])], c[std::size_t(f[2])], c[std::size_t(f[3])], apex});
}

/// A cube as the polyhedron of its sides.
inline void addBox(CellGrid& grid, const Corners& c) {
  Faces faces;
  for (const auto& f : kHexahedronFaces)
    faces.push_back({c[std::size_t(f[0])], c[std::size_t(f[1])], c[std::size_t(f[2])], c[std::size_t(f[3])]});
  addPolyhedron(grid, faces);
}

/// Prisms that touch in pairs along x: the edges along y between them have a vertex in their middle, so that their
/// lower and upper faces are pentagons.
class PentagonPrisms {
 public:
  void add(CellGrid& grid, bool left, const Corners& c) {
    Faces faces(2);
    if (left) {
      faces[0] = {c[0], c[1], middle(grid, c[1], c[2]), c[2], c[3]};
      faces[1] = {c[4], c[5], middle(grid, c[5], c[6]), c[6], c[7]};
    } else {
      faces[0] = {c[0], c[1], c[2], c[3], middle(grid, c[0], c[3])};
      faces[1] = {c[4], c[5], c[6], c[7], middle(grid, c[4], c[7])};
    }
    for (std::size_t i = 0; i < 5; ++i)
      faces.push_back({faces[0][i], faces[0][(i + 1) % 5], faces[1][(i + 1) % 5], faces[1][i]});
    std::reverse(faces[0].begin(), faces[0].end());
    addPolyhedron(grid, faces);
  }

 private:
  std::uint32_t middle(CellGrid& grid, std::uint32_t a, std::uint32_t b) {
    const auto known = middles_.find({a, b});
    if (known != middles_.end())
      return known->second;
    return middles_[{a, b}] = grid.addPoint(0.5F * (grid.points[a] + grid.points[b]));
  }
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles_;
};

inline void addParts(CubeParts parts, CellGrid& grid, const Corners& c) {
  switch (parts) {
    case CubeParts::kTetrahedra:
      return addTetrahedra(grid, c);
    case CubeParts::kVoxels:
      return addVoxel(grid, c);
    case CubeParts::kWedges:
      return addWedges(grid, c);
    case CubeParts::kPyramids:
      return addPyramids(grid, c);
    case CubeParts::kPolyhedra:
      return addBox(grid, c);
    default:
      return addHexahedron(grid, c);
  }
}

/// A conforming grid of `side`^3 unit cubes in parts, centred at the origin, with random scalars in [0, 1]. Every
/// vertex is moved by up to `warp` along each axis, so that no face is plane; voxels stay what they are.
inline IrregularGrid makeWarpedGrid(CubeParts parts, int side, float warp, unsigned seed) {
  std::mt19937 random(seed);
  PentagonPrisms pentagons;
  const auto fill = [&](CellGrid& grid, int i, int j, int k, const Corners& c) {
    constexpr std::array<CubeParts, 3> kMix = {CubeParts::kHexahedra, CubeParts::kPyramids, CubeParts::kPolyhedra};
    if (parts == CubeParts::kPentagons)
      return pentagons.add(grid, i % 2 == 0, c);
    addParts(parts == CubeParts::kMixed ? kMix[std::size_t(i + j + k) % 3] : parts, grid, c);
  };
  const CellGrid cells = makeCells(Vector3f::Constant(-0.5F * float(side)), Vector3i::Constant(side), fill);
  IrregularGrid grid;
  grid.points = parts == CubeParts::kVoxels ? cells.points : jittered(cells.points, warp, random);
  grid.cell_types = cells.types;
  grid.cell_offsets = cells.offsets;
  grid.connectivity = cells.connectivity;
  std::uniform_real_distribution<float> scalar(0.0F, 1.0F);
  for (std::size_t i = 0; i < grid.points.size(); ++i)
    grid.point_scalars.push_back(scalar(random));
  return grid;
}

}  // namespace soft_volume::core
