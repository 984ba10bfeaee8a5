#include "soft_volume/grid/topology.h"

#include <algorithm>
#include <string>

#include "check_cells.h"
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
  require(origin_vertices.empty() || origin_vertices.size() == vertices, "one origin per vertex, or none, is needed");
  require(parent_cells.empty() || parent_cells.size() == count, "one parent cell per cell, or none, is needed");
  require(materials.size() == count, "one material per cell is needed");
  const std::size_t faces = checkCells("grid topology", cell_types, cell_offsets, connectivity, vertices);
  require(face_neighbours.size() == faces, "face_neighbours needs one entry per face");
  require(cut_faces.size() == faces, "cut_faces needs one entry per face");
  const auto cell_or_none = [count](std::int32_t n) { return n >= -1 && n < static_cast<std::int64_t>(count); };
  require(std::all_of(face_neighbours.begin(), face_neighbours.end(), cell_or_none), "a face neighbour does not exist");
  const auto is_vertex = [vertices](std::uint32_t v) { return v < vertices; };
  require(std::all_of(origin_vertices.begin(), origin_vertices.end(), is_vertex), "an origin vertex does not exist");
  const auto finite = [](const Vector3f& p) { return p.allFinite(); };
  require(std::all_of(rest_positions.begin(), rest_positions.end(), finite), "a rest position is not finite");
  require(std::all_of(texture_coordinates.begin(), texture_coordinates.end(), finite),
          "a texture coordinate is not finite");
}

}  // namespace soft_volume::core
