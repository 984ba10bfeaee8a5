// Cuts single cells with cutMesh() and writes what became of them.

#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "soft_volume/incision/blade_cut.h"

namespace soft_volume::core {
namespace {

constexpr double kEdge_m = 0.005;

/// Where normal . p = offset, in cell edges from the cell's lowest corner.
struct Plane {
  Vector3 normal;
  double offset;
};

struct Case {
  std::string name;
  std::vector<Plane> planes;
};

/// By how many of the corners lie on the plane's side with fewer of them, and how they hang together (figure 3.5).
std::vector<Case> allCases() {
  return {{"1 corner: a triangle", {{{1.0, 1.0, 1.0}, 0.95}}},
          {"2 corners: a quadrilateral", {{{1.0, 1.0, 0.15}, 0.65}}},
          {"3 corners: a pentagon", {{{1.0, 1.0, 1.8}, 1.4}}},
          {"4 of a face: a quadrilateral", {{{0.25, 0.1, 1.0}, 0.7}}},
          {"4 around a corner: a hexagon", {{{1.0, 1.0, 1.0}, 1.5}}},
          {"cut three times", {{{0.2, 0.1, 1.0}, 0.62}, {{1.0, 0.2, 0.15}, 0.65}, {{-0.15, 1.0, 0.25}, 0.6}}}};
}

/// A blade that reaches far beyond the cell.
SweptQuad bladeIn(const Plane& plane) {
  const Vector3 n = plane.normal.normalized();
  const Vector3 centre = Vector3::Constant(0.5);
  const Vector3 middle = kEdge_m * (centre + (plane.offset / plane.normal.norm() - n.dot(centre)) * n);
  const Vector3 u = 3.0 * kEdge_m * n.unitOrthogonal();
  const Vector3 v = n.cross(u);
  return {middle - u - v, middle + u - v, middle + u + v, middle - u + v};
}

nlohmann::json describe(const CutMesh& mesh, std::uint32_t piece) {
  nlohmann::json faces = nlohmann::json::array();
  for (const std::uint32_t face : mesh.pieces()[piece].faces) {
    nlohmann::json corners = nlohmann::json::array();
    for (const std::uint32_t v : mesh.outwardLoop(face, piece)) {
      const Vector3 p = mesh.restPositions()[v] / kEdge_m;
      corners.push_back({p.x(), p.y(), p.z()});
    }
    faces.push_back({{"corners", corners},
                     {"cut", mesh.faces()[face].opened},
                     {"joined", mesh.across(face, piece) != CutMesh::kNone}});
  }
  return faces;
}

nlohmann::json cutCell(const Case& cell) {
  const Lattice lattice =
      makeLattice(Vector3i::Ones(), Vector3::Constant(kEdge_m), Vector3::Zero(), std::vector<std::int32_t>{0});
  CutMesh mesh(lattice);
  std::vector<Vector3> positions_m = lattice.rest_positions;
  CutResolution resolution;
  resolution.least_island = 0.0;  // in a cell by itself all parts are small
  for (const Plane& plane : cell.planes) {
    Lips lips;
    cutMesh(mesh, lattice, {Material()}, resolution, {bladeIn(plane)}, 0.0, lips, positions_m);
  }
  nlohmann::json pieces = nlohmann::json::array();
  for (std::uint32_t piece = 0; piece < mesh.pieces().size(); ++piece)
    pieces.push_back(describe(mesh, piece));
  return {{"name", cell.name}, {"pieces", pieces}};
}

}  // namespace
}  // namespace soft_volume::core

int main(int argc, char** argv) {
  CLI::App app(
      "Writes the pieces of cells that are cut in each of the five ways, and of one that is cut three times, "
      "as JSON: per piece its faces, counter-clockwise seen from outside, in cell edges.");
  CLI11_PARSE(app, argc, argv);
  try {
    nlohmann::json cells = nlohmann::json::array();
    for (const auto& cell : soft_volume::core::allCases())
      cells.push_back(soft_volume::core::cutCell(cell));
    std::puts(cells.dump(1).c_str());
  } catch (const std::exception& error) {
    std::fprintf(stderr, "soft_volume_cut_cells: %s\n", error.what());
    return 1;
  }
  return 0;
}
