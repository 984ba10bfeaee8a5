#include "check_cells.h"

#include <algorithm>

#include "soft_volume/common/error.h"
#include "soft_volume/grid/cell_shape.h"

namespace soft_volume::core {
namespace {

constexpr std::uint32_t kFewestFaces = 4;
constexpr std::uint32_t kFewestFaceVertices = 3;

bool isKnown(CellType type) {
  switch (type) {
    case CellType::kEmpty:
    case CellType::kTetrahedron:
    case CellType::kVoxel:
    case CellType::kHexahedron:
    case CellType::kWedge:
    case CellType::kPyramid:
    case CellType::kPolyhedron:
      return true;
  }
  return false;
}

/// One cell at a time: its numbers from begin to end of the connectivity.
class CellCheck {
 public:
  CellCheck(const std::string& grid, std::size_t vertices) : grid_(grid), vertices_(vertices) {}

  /// Returns the number of faces.
  std::size_t check(std::size_t cell, CellType type, const std::uint32_t* begin, const std::uint32_t* end) {
    cell_ = cell;
    require(isKnown(type),
            "is of VTK type " + std::to_string(int(type)) +
                "; known are empty cells (0), tetrahedra (10), voxels (11), hexahedra (12), wedges (13), pyramids (14) "
                "and polyhedra (42)");
    if (type == CellType::kPolyhedron)
      return checkFaceStream(begin, end);
    const CellShape& shape = shapeOf(type);
    require(
        std::size_t(end - begin) == shape.vertex_count,
        "has " + std::to_string(end - begin) + " vertices where its type has " + std::to_string(shape.vertex_count));
    checkVertices(begin, end);
    return shape.face_count;
  }

 private:
  void require(bool good, const std::string& what) const {
    if (!good)
      throw InputError(grid_ + ": cell " + std::to_string(cell_) + " " + what);
  }

  void checkVertices(const std::uint32_t* begin, const std::uint32_t* end) const {
    const auto bad = std::find_if(begin, end, [this](std::uint32_t v) { return v >= vertices_; });
    if (bad != end) {
      require(false,
              "names vertex " + std::to_string(*bad) + " of a grid with " + std::to_string(vertices_) + " vertices");
    }
  }

  std::size_t checkFaceStream(const std::uint32_t* at, const std::uint32_t* end) const {
    const std::uint32_t faces = at == end ? 0 : *at++;
    require(faces >= kFewestFaces, "is a polyhedron with fewer than four faces");
    for (std::uint32_t face = 0; face < faces; ++face) {
      const std::uint32_t size = at == end ? 0 : *at++;
      require(size >= kFewestFaceVertices, "is a polyhedron with a face of fewer than three vertices");
      require(size <= std::size_t(end - at), "is a polyhedron whose face stream is too short");
      checkVertices(at, at + size);
      at += size;
    }
    require(at == end, "is a polyhedron whose face stream is too long");
    return faces;
  }

  const std::string& grid_;
  std::size_t vertices_;
  std::size_t cell_ = 0;
};

}  // namespace

std::size_t checkCells(const std::string& grid, const std::vector<CellType>& types,
                       const std::vector<std::uint32_t>& offsets, const std::vector<std::uint32_t>& connectivity,
                       std::size_t vertices) {
  if (offsets.size() != types.size() + 1)
    throw InputError(grid + ": cell_offsets needs one entry more than there are cells");
  if (offsets.front() != 0 || offsets.back() != connectivity.size())
    throw InputError(grid + ": cell_offsets do not span connectivity");
  if (!std::is_sorted(offsets.begin(), offsets.end()))
    throw InputError(grid + ": cell_offsets must not decrease");
  CellCheck check(grid, vertices);
  std::size_t faces = 0;
  for (std::size_t cell = 0; cell < types.size(); ++cell) {
    faces +=
        check.check(cell, types[cell], connectivity.data() + offsets[cell], connectivity.data() + offsets[cell + 1]);
  }
  return faces;
}

}  // namespace soft_volume::core
