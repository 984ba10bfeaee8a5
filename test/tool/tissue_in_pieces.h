#pragma once

#include <algorithm>
#include <memory>
#include <random>
#include <vector>

#include "incision/cut_cases.h"
#include "soft_volume/incision/mesh_topology.h"
#include "soft_volume/tool/patch_contact.h"
#include "tissue_fixture.h"

namespace soft_volume::core {

/// A block of cells of kH with its lowest corner at the origin, cut into pieces, as topology and patch. All of it is
/// tissue unless another volume is given.
struct TissueInPieces {
  explicit TissueInPieces(
      const Vector3i& cells, const Field& intensity = [](const Vector3&) { return 1.0; })
      : block(cells), volume(makeVolume(2 * cells + Vector3i::Ones(), 0.5 * kH, intensity)) {
    publish();
  }

  void cut(const std::vector<SweptQuad>& quads) {
    block.cut(quads);
    publish();
  }

  /// All of the block as the patch, at the positions of now.
  void publish() {
    topology = makeTopology(block.mesh, block.lattice, volume->geometry(), 7);
    topology.revision = patch.revision = patch.revision + 1;
    patch.session = 7;
    patch.tool_id = "probe";
    patch.vertex_ids.resize(topology.vertexCount());
    patch.cell_ids.resize(topology.cellCount());
    std::iota(patch.vertex_ids.begin(), patch.vertex_ids.end(), 0U);
    std::iota(patch.cell_ids.begin(), patch.cell_ids.end(), 0U);
    patch.stiffness_pa.assign(topology.cellCount(), 10000.0F);
    patch.velocities.assign(topology.vertexCount(), Vector3f::Zero());
    move();
  }
  void move() {
    patch.positions.clear();
    for (const Vector3& p : block.positions_m)
      patch.positions.push_back(p.cast<float>());
  }

  /// Moves every vertex from rest by `displacement(rest place, side)`. The side is -1 or 1 where all pieces around the
  /// vertex have their middle on that side of the plane x = `plane_x_m`, and 0 for the front of an incision there.
  template <typename Displacement>
  void part(double plane_x_m, const Displacement& displacement) {
    for (std::uint32_t v = 0; v < block.mesh.vertexCount(); ++v) {
      const Vector3& rest = block.mesh.restPositions()[v];
      block.positions_m[v] = rest + displacement(rest, sideOf(v, plane_x_m));
    }
    move();
  }
  int sideOf(std::uint32_t vertex, double plane_x_m) const {
    int sum = 0;
    const auto& around = block.mesh.piecesAround(vertex);
    for (const std::uint32_t piece : around)
      sum += middleOf(piece).x() < plane_x_m ? -1 : 1;
    return sum == int(around.size()) ? 1 : (sum == -int(around.size()) ? -1 : 0);
  }
  Vector3 middleOf(std::uint32_t piece) const {
    Vector3 sum = Vector3::Zero();
    const auto vertices = block.mesh.verticesOf(piece);
    for (const std::uint32_t v : vertices)
      sum += block.mesh.restPositions()[v];
    return sum / double(vertices.size());
  }
  Vector3 deformed(std::uint32_t vertex) const { return patch.positions[vertex].cast<double>(); }
  std::size_t polyhedra() const {
    return std::size_t(std::count(topology.cell_types.begin(), topology.cell_types.end(), CellType::kPolyhedron));
  }
  PatchContact contact(double threshold = 0.0) const {
    PatchContact contact(volume, threshold);
    contact.update(topology, patch);
    return contact;
  }

  CutBlock block;
  std::shared_ptr<const Volume> volume;
  Topology topology;
  GridPatch patch;
};

/// Planes and squares across the block, at random.
inline void cutAtRandom(TissueInPieces& tissue, int cuts, std::mt19937& random) {
  std::uniform_real_distribution<double> part(0.0, 1.0);
  std::normal_distribution<double> normal;
  for (int n = 0; n < cuts; ++n) {
    const Vector3 at = tissue.block.size().cwiseProduct(Vector3(part(random), part(random), part(random)));
    const double half_m = (n % 2 == 0 ? 20.0 : 1.0 + part(random)) * kH;  // every other one ends inside
    tissue.cut({squareQuad(at, Vector3(normal(random), normal(random), normal(random)), half_m)});
  }
}

/// A smooth, non-linear deformation that warps faces and bends edges.
inline Vector3 warp(const Vector3& p) {
  return {0.25 * kH * std::sin(0.30 * p.z() / kH) + 0.1 * p.y(), 0.2 * kH * std::cos(0.5 * p.x() / kH),
          -0.2 * p.z() + 0.2 * kH * std::sin(0.4 * p.x() / kH) * std::cos(0.35 * p.y() / kH)};
}

}  // namespace soft_volume::core
