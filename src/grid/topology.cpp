#include "soft_volume/grid/topology.h"

#include <algorithm>

#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

void require(bool condition, const char* message) {
  if (!condition)
    throw InputError(std::string("grid topology: ") + message);
}

}  // namespace

void Topology::validate() const {
  const std::size_t vertices = vertexCount();
  const std::size_t count = cellCount();
  require(texture_coordinates.size() == vertices, "one texture coordinate per vertex is needed");
  require(fixed.size() == vertices, "one fixed flag per vertex is needed");
  require(cell_offsets.size() == count + 1, "cell_offsets needs one entry more than there are cells");
  require(cell_offsets.front() == 0 && cell_offsets.back() == connectivity.size(),
          "cell_offsets do not span connectivity");
  require(std::is_sorted(cell_offsets.begin(), cell_offsets.end()), "cell_offsets must not decrease");
  require(materials.size() == count, "one material per cell is needed");
  require(face_neighbours.size() == cut_faces.size(), "face_neighbours and cut_faces differ in size");
  const auto in_range = [vertices](std::uint32_t v) { return v < vertices; };
  require(std::all_of(connectivity.begin(), connectivity.end(), in_range),
          "connectivity names a vertex that does not exist");
  for (std::size_t c = 0; c < count; ++c) {
    require(cell_types[c] == CellType::kHexahedron, "only hexahedra (VTK type 12) are supported by this version");
    require(cell_offsets[c + 1] - cell_offsets[c] == 8, "a hexahedron needs eight vertices");
  }
  require(face_neighbours.size() == 6 * count, "six faces per hexahedron are needed");
  const auto cell_or_none = [count](std::int32_t n) { return n >= -1 && n < static_cast<std::int64_t>(count); };
  require(std::all_of(face_neighbours.begin(), face_neighbours.end(), cell_or_none), "a face neighbour does not exist");
  const auto finite = [](const Vector3f& p) { return p.allFinite(); };
  require(std::all_of(rest_positions.begin(), rest_positions.end(), finite), "a rest position is not finite");
  require(std::all_of(texture_coordinates.begin(), texture_coordinates.end(), finite),
          "a texture coordinate is not finite");
}

}  // namespace soft_volume::core
