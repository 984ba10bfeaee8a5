#pragma once

#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {

/// Cells and where they are, as GridSlicer takes them.
struct CellGrid {
  std::vector<CellType> types;
  std::vector<std::uint32_t> offsets = {0};
  std::vector<std::uint32_t> connectivity;
  std::vector<Vector3f> points;

  void add(CellType type, const std::vector<std::uint32_t>& numbers) {
    types.push_back(type);
    connectivity.insert(connectivity.end(), numbers.begin(), numbers.end());
    offsets.push_back(std::uint32_t(connectivity.size()));
  }
  std::uint32_t addPoint(const Vector3f& point) {
    points.push_back(point);
    return std::uint32_t(points.size() - 1);
  }
};

using Faces = std::vector<std::vector<std::uint32_t>>;

inline void addPolyhedron(CellGrid& grid, const Faces& faces) {
  std::vector<std::uint32_t> stream = {std::uint32_t(faces.size())};
  for (const auto& face : faces) {
    stream.push_back(std::uint32_t(face.size()));
    stream.insert(stream.end(), face.begin(), face.end());
  }
  grid.add(CellType::kPolyhedron, stream);
}

/// The corners of cell (i, j, k) of a block in a hexahedron's order.
using Corners = std::array<std::uint32_t, 8>;

/// A block of `cells` unit cubes from `origin` on; `fill(grid, i, j, k, corners)` puts cells into each.
template <typename Fill>
CellGrid makeCells(const Vector3f& origin, const Vector3i& cells, const Fill& fill) {
  CellGrid grid;
  const Vector3i size = cells + Vector3i::Ones();
  for (int k = 0; k < size.z(); ++k) {
    for (int j = 0; j < size.y(); ++j) {
      for (int i = 0; i < size.x(); ++i)
        grid.addPoint(origin + Vector3f(float(i), float(j), float(k)));
    }
  }
  const auto number = [&](int i, int j, int k) { return std::uint32_t(i + size.x() * (j + size.y() * k)); };
  for (int k = 0; k < cells.z(); ++k) {
    for (int j = 0; j < cells.y(); ++j) {
      for (int i = 0; i < cells.x(); ++i) {
        fill(grid, i, j, k,
             Corners{number(i, j, k), number(i + 1, j, k), number(i + 1, j + 1, k), number(i, j + 1, k),
                     number(i, j, k + 1), number(i + 1, j, k + 1), number(i + 1, j + 1, k + 1),
                     number(i, j + 1, k + 1)});
      }
    }
  }
  return grid;
}

inline void addHexahedron(CellGrid& grid, const Corners& c) {
  grid.add(CellType::kHexahedron, {c.begin(), c.end()});
}

/// As a hexahedron that counts its corners from another one, so that neighbours see their edges in other directions.
inline void addTurnedHexahedron(CellGrid& grid, Corners c, int turn) {
  std::rotate(c.begin(), c.begin() + turn, c.begin() + 4);
  std::rotate(c.begin() + 4, c.begin() + 4 + turn, c.end());
  addHexahedron(grid, c);
}

inline void addVoxel(CellGrid& grid, const Corners& c) {
  grid.add(CellType::kVoxel, {c[0], c[1], c[3], c[2], c[4], c[5], c[7], c[6]});
}

/// Two wedges whose triangles split the faces at the bottom and top along 0-2 and 4-6.
inline void addWedges(CellGrid& grid, const Corners& c) {
  grid.add(CellType::kWedge, {c[0], c[2], c[1], c[4], c[6], c[5]});
  grid.add(CellType::kWedge, {c[0], c[3], c[2], c[4], c[7], c[6]});
}

/// Six tetrahedra around the diagonal 0-6, which fit those of neighbours.
inline void addTetrahedra(CellGrid& grid, const Corners& c) {
  for (const auto& [a, b] : {std::pair{1, 2}, {2, 3}, {3, 7}, {7, 4}, {4, 5}, {5, 1}})
    grid.add(CellType::kTetrahedron, {c[0], c[std::size_t(a)], c[std::size_t(b)], c[6]});
}

/// A pyramid from a new vertex in the middle to each face; where `split`, two tetrahedra to the bottom and top, which
/// fit wedges.
inline void addFan(CellGrid& grid, const Corners& c, bool split) {
  Vector3f middle = Vector3f::Zero();
  for (const std::uint32_t corner : c)
    middle += grid.points[corner] / 8.0F;
  const std::uint32_t m = grid.addPoint(middle);
  const CellShape& shape = shapeOf(CellType::kHexahedron);
  for (std::size_t f = 0; f < 6; ++f) {
    std::array<std::uint32_t, 4> q{};
    for (std::size_t i = 0; i < 4; ++i)
      q[i] = c[shape.faces[f][3 - i]];  // seen from the middle
    if (!split || f < 4) {
      grid.add(CellType::kPyramid, {q[0], q[1], q[2], q[3], m});
      continue;
    }
    const std::size_t d = q[0] == c[0] || q[2] == c[0] || q[0] == c[4] || q[2] == c[4] ? 0 : 1;
    grid.add(CellType::kTetrahedron, {q[d], q[d + 1], q[d + 2], m});
    grid.add(CellType::kTetrahedron, {q[d], q[d + 2], q[(d + 3) % 4], m});
  }
}

/// The cube as a polyhedron; where `split`, with triangles at the bottom and top that fit wedges.
inline void addCube(CellGrid& grid, const Corners& c, bool split) {
  Faces faces = {
      {c[0], c[4], c[7], c[3]}, {c[1], c[2], c[6], c[5]}, {c[0], c[1], c[5], c[4]}, {c[3], c[7], c[6], c[2]}};
  if (split) {
    faces.insert(faces.end(), {{c[0], c[2], c[1]}, {c[0], c[3], c[2]}, {c[4], c[5], c[6]}, {c[4], c[6], c[7]}});
  } else {
    faces.insert(faces.end(), {{c[0], c[3], c[2], c[1]}, {c[4], c[5], c[6], c[7]}});
  }
  addPolyhedron(grid, faces);
}

/// A block of all types that fit together: columns along z either have quadrilaterals between their cells or triangles.
inline CellGrid makeMixedCells(const Vector3f& origin, const Vector3i& cells, std::mt19937& random) {
  return makeCells(origin, cells, [&](CellGrid& grid, int i, int j, int, const Corners& c) {
    const bool split = (i + j) % 2 == 1;
    switch (random() % (split ? 3 : 4)) {
      case 0:
        return addFan(grid, c, split);
      case 1:
        return addCube(grid, c, split);
      case 2:
        return split ? addWedges(grid, c) : addTurnedHexahedron(grid, c, int(random() % 4));
      default:
        return addVoxel(grid, c);
    }
  });
}

inline std::vector<Vector3f> jittered(const std::vector<Vector3f>& points, float distance, std::mt19937& random) {
  std::uniform_real_distribution<float> offset(-distance, distance);
  std::vector<Vector3f> moved = points;
  for (Vector3f& p : moved) {
    for (int axis = 0; axis < 3; ++axis)
      p[axis] += offset(random);
  }
  return moved;
}

/// Vertices of the blunt fin (PLOT3D, big-endian): three dimensions, then all x, all y, all z. Empty when missing.
inline std::vector<Vector3f> readBluntFin() {
  const char* folder = std::getenv("SOFT_VOLUME_DATA");
  const std::string data = folder != nullptr ? folder : std::string(SOFT_VOLUME_SOURCE_DIR) + "/../shared/data";
  std::ifstream file(data + "/blunt_fin/bluntfinxyz.bin", std::ios::binary);
  std::vector<std::uint8_t> bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  const std::size_t count = 40 * 32 * 32;
  std::vector<Vector3f> points;
  if (bytes.size() < 12 + count * 12)
    return points;
  const auto valueAt = [&](std::size_t number) {
    std::uint32_t bits = 0;
    for (std::size_t i = 0; i < 4; ++i)
      bits = bits << 8 | bytes[12 + number * 4 + i];
    float value = 0.0F;
    std::memcpy(&value, &bits, 4);
    return value;
  };
  for (std::size_t i = 0; i < count; ++i)
    points.emplace_back(valueAt(i), valueAt(count + i), valueAt(2 * count + i));
  return points;
}

}  // namespace soft_volume::core
