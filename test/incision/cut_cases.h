#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <set>
#include <vector>

#include "lattice_blocks.h"
#include "soft_volume/incision/blade_cut.h"
#include "soft_volume/incision/piece_shape.h"

namespace soft_volume::core {

constexpr double kH = 0.005;

/// How many random cases to try.
constexpr int caseCount(int count) {
#ifdef SOFT_VOLUME_FEWER_CASES
  return (count + 11) / 12;
#else
  return count;
#endif
}

/// A block that is cut, at rest or deformed.
struct CutBlock {
  explicit CutBlock(const Vector3i& dims, double h = kH)
      : lattice(makeBlock(dims, Vector3::Constant(h))), mesh(lattice), positions_m(lattice.rest_positions) {}

  BladeCutResult cut(const std::vector<SweptQuad>& quads, Lips& lips) {
    return cutMesh(mesh, lattice, materials, resolution, quads, reach_m, lips, positions_m);
  }
  BladeCutResult cut(const std::vector<SweptQuad>& quads) {
    Lips lips;
    return cut(quads, lips);
  }
  /// Moves every vertex by `displacement(rest)`.
  template <typename Displacement>
  void deform(const Displacement& displacement) {
    for (Vector3& p : positions_m) {
      const Vector3 d = displacement(p);
      reach_m = std::max(reach_m, d.norm());
      p += d;
    }
  }
  Vector3 size() const { return lattice.dims.cast<double>().cwiseProduct(lattice.spacing_m); }

  Lattice lattice;
  std::vector<Material> materials = oneMaterial(1e4);
  CutResolution resolution;
  CutMesh mesh;
  std::vector<Vector3> positions_m;
  double reach_m = 0.0;
};

/// A square of half-width `half_m` around `middle`; `turn_rad` turns it in its plane.
inline SweptQuad squareQuad(const Vector3& middle, const Vector3& normal, double half_m, double turn_rad = 0.0) {
  const Vector3 n = normal.normalized();
  const Vector3 u0 = n.unitOrthogonal();
  const Vector3 u = half_m * (std::cos(turn_rad) * u0 + std::sin(turn_rad) * n.cross(u0));
  const Vector3 v = n.cross(u);
  return {middle - u - v, middle + u - v, middle + u + v, middle - u + v};
}

inline double volumeOfPiece(const CutMesh& mesh, std::uint32_t piece) {
  return volumeOf(solidOf(mesh, piece));
}

inline double totalVolume(const CutMesh& mesh) {
  double sum = 0.0;
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p)
    sum += volumeOfPiece(mesh, p);
  return sum;
}

/// Volumes of what hangs together, smallest first.
inline std::vector<double> islandVolumes(const CutMesh& mesh) {
  const std::vector<std::uint32_t> island = mesh.islands();
  std::vector<double> volumes(island.size(), 0.0);
  for (std::uint32_t p = 0; p < island.size(); ++p)
    volumes[island[p]] += volumeOfPiece(mesh, p);
  volumes.erase(std::remove(volumes.begin(), volumes.end(), 0.0), volumes.end());
  std::sort(volumes.begin(), volumes.end());
  return volumes;
}

struct MeshExtremes {
  double shortest_edge_m = HUGE_VAL;
  double least_width_m = HUGE_VAL;
  double deepest_dent_m = 0.0;
  double least_volume_m3 = HUGE_VAL;
  double farthest_off_face_m = 0.0;  ///< of a face's corner from its plane
};

inline MeshExtremes extremesOf(const CutMesh& mesh) {
  MeshExtremes extremes;
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p) {
    const Polyhedron solid = solidOf(mesh, p);
    extremes.shortest_edge_m = std::min(extremes.shortest_edge_m, shortestEdge(solid));
    extremes.least_width_m = std::min(extremes.least_width_m, leastWidth(solid));
    extremes.deepest_dent_m = std::max(extremes.deepest_dent_m, deepestDent(solid));
    extremes.least_volume_m3 = std::min(extremes.least_volume_m3, volumeOf(solid));
    for (const auto& loop : solid.loops) {
      const Vector3 normal = areaVector(solid.points_m, loop).normalized();
      for (const std::uint32_t v : loop) {
        extremes.farthest_off_face_m =
            std::max(extremes.farthest_off_face_m, std::abs(normal.dot(solid.points_m[v] - solid.points_m[loop[0]])));
      }
    }
  }
  return extremes;
}

/// Faces and pieces name each other, loops are simple, polyhedra closed, and vertices know their pieces.
inline void expectConsistent(const CutMesh& mesh) {
  std::vector<int> named(mesh.faces().size(), 0);
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p) {
    const auto& faces = mesh.pieces()[p].faces;
    ASSERT_TRUE(std::is_sorted(faces.begin(), faces.end()));
    for (const std::uint32_t f : faces) {
      const auto& owners = mesh.faces()[f].pieces;
      ASSERT_TRUE(owners[0] == int(p) || owners[1] == int(p));
      ++named[f];
    }
    ASSERT_TRUE(isClosed(solidOf(mesh, p))) << "piece " << p;
    for (const std::uint32_t v : mesh.verticesOf(p)) {
      const auto& around = mesh.piecesAround(v);
      ASSERT_TRUE(std::binary_search(around.begin(), around.end(), p));
    }
  }
  for (std::uint32_t f = 0; f < mesh.faces().size(); ++f) {
    const auto& face = mesh.faces()[f];
    ASSERT_EQ(named[f], face.pieces[1] == CutMesh::kNone ? 1 : 2);
    ASSERT_EQ(std::set<std::uint32_t>(face.loop.begin(), face.loop.end()).size(), face.loop.size());
    ASSERT_FALSE(face.opened && face.pieces[1] != CutMesh::kNone);
  }
}

/// The pieces that hang together around an edge of a face, through faces with both of its ends. Other pieces at these
/// ends may be across an incision whose front the ends lie on.
inline std::set<std::uint32_t> piecesAroundEdge(const CutMesh& mesh, const CutMesh::Face& face, std::uint32_t a,
                                                std::uint32_t b) {
  const auto has = [](const std::vector<std::uint32_t>& loop, std::uint32_t v) {
    return std::find(loop.begin(), loop.end(), v) != loop.end();
  };
  std::vector<std::uint32_t> waiting = {std::uint32_t(face.pieces[0])};
  std::set<std::uint32_t> found(waiting.begin(), waiting.end());
  while (!waiting.empty()) {
    const std::uint32_t piece = waiting.back();
    waiting.pop_back();
    for (const std::uint32_t f : mesh.pieces()[piece].faces) {
      const auto& loop = mesh.faces()[f].loop;
      const std::int32_t other = mesh.across(f, piece);
      if (other != CutMesh::kNone && has(loop, a) && has(loop, b) && found.insert(std::uint32_t(other)).second)
        waiting.push_back(std::uint32_t(other));
    }
  }
  return found;
}

/// No vertex of the pieces around an edge lies inside it.
inline void expectNoTJunctions(const CutMesh& mesh, double slack_m) {
  const auto& places = mesh.restPositions();
  std::vector<std::vector<std::uint32_t>> vertices;
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p)
    vertices.push_back(mesh.verticesOf(p));
  for (const auto& face : mesh.faces()) {
    for (std::size_t i = 0; i < face.loop.size(); ++i) {
      const std::uint32_t a = face.loop[i];
      const std::uint32_t b = face.loop[(i + 1) % face.loop.size()];
      const Vector3 along = (places[b] - places[a]).normalized();
      const double length = (places[b] - places[a]).norm();
      for (const std::uint32_t p : piecesAroundEdge(mesh, face, a, b)) {
        for (const std::uint32_t v : vertices[p]) {
          const double t = along.dot(places[v] - places[a]);
          const double off = (places[v] - places[a] - t * along).norm();
          ASSERT_FALSE(v != a && v != b && off < slack_m && t > slack_m && t < length - slack_m)
              << "vertex " << v << " on edge " << a << "-" << b;
        }
      }
    }
  }
}

/// The same numbers and bits.
inline void expectSameMesh(const CutMesh& a, const CutMesh& b) {
  ASSERT_EQ(a.restPositions(), b.restPositions());
  ASSERT_EQ(a.faces().size(), b.faces().size());
  ASSERT_EQ(a.pieces().size(), b.pieces().size());
  for (std::size_t f = 0; f < a.faces().size(); ++f) {
    ASSERT_EQ(a.faces()[f].loop, b.faces()[f].loop);
    ASSERT_EQ(a.faces()[f].pieces, b.faces()[f].pieces);
  }
}

inline void expectSound(const CutBlock& block, const MeshExtremes& extremes) {
  ASSERT_NO_FATAL_FAILURE(expectConsistent(block.mesh));
  ASSERT_NO_FATAL_FAILURE(expectNoTJunctions(block.mesh, 1e-6 * kH));
  ASSERT_NEAR(totalVolume(block.mesh) / block.size().prod(), 1.0, 1e-9);
  ASSERT_GE(extremes.shortest_edge_m, (block.resolution.least_edge - 1e-9) * kH);
  ASSERT_GE(extremes.least_width_m, (block.resolution.least_width - 1e-9) * kH);
  ASSERT_LE(extremes.deepest_dent_m, (block.resolution.deepest_dent + 1e-9) * kH);
  ASSERT_LE(extremes.farthest_off_face_m, 1e-9 * kH);
  ASSERT_GT(extremes.least_volume_m3, 0.0);
  ASSERT_EQ(block.positions_m.size(), block.mesh.vertexCount());
  for (std::size_t v = 0; block.reach_m == 0.0 && v < block.positions_m.size(); ++v)
    ASSERT_LT((block.positions_m[v] - block.mesh.restPositions()[v]).norm(), 1e-12 * kH);
}
inline void expectSound(const CutBlock& block) {
  expectSound(block, extremesOf(block.mesh));
}

}  // namespace soft_volume::core
