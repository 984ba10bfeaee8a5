#include "soft_volume/grid/topology.h"

#include <algorithm>
#include <string>

#include "check_cells.h"
#include "check_topology.h"
#include "soft_volume/common/error.h"

namespace soft_volume::core {
namespace {

void require(bool condition, const char* message) {
  if (!condition)
    throw InputError(std::string("grid topology: ") + message);
}

}  // namespace

void checkTopology(const Topology& t, std::size_t vertices, std::size_t cells) {
  const std::size_t own_vertices = t.vertexCount();
  const std::size_t own_cells = t.cellCount();
  require(t.texture_coordinates.size() == own_vertices, "one texture coordinate per vertex is needed");
  require(t.fixed.size() == own_vertices, "one fixed flag per vertex is needed");
  require(t.origin_vertices.empty() || t.origin_vertices.size() == own_vertices,
          "one origin per vertex, or none, is needed");
  require(t.parent_cells.empty() || t.parent_cells.size() == own_cells, "one parent cell per cell, or none, is needed");
  require(t.materials.size() == own_cells, "one material per cell is needed");
  const std::size_t faces = checkCells("grid topology", t.cell_types, t.cell_offsets, t.connectivity, vertices);
  require(t.face_neighbours.size() == faces, "face_neighbours needs one entry per face");
  require(t.cut_faces.size() == faces, "cut_faces needs one entry per face");
  const auto all = [](const auto& values, const auto& good) { return std::all_of(values.begin(), values.end(), good); };
  const auto is_cell_or_none = [cells](std::int32_t n) { return n >= -1 && n < static_cast<std::int64_t>(cells); };
  require(all(t.face_neighbours, is_cell_or_none), "a face neighbour does not exist");
  require(all(t.origin_vertices, [vertices](std::uint32_t v) { return v < vertices; }),
          "an origin vertex does not exist");
  const auto is_finite = [](const Vector3f& p) { return p.allFinite(); };
  require(all(t.rest_positions, is_finite), "a rest position is not finite");
  require(all(t.texture_coordinates, is_finite), "a texture coordinate is not finite");
}

void Topology::validate() const {
  checkTopology(*this, vertexCount(), cellCount());
}

}  // namespace soft_volume::core
