#pragma once

#include <cmath>
#include <optional>
#include <unordered_map>
#include <vector>

#include "blade_patch.h"
#include "soft_volume/incision/cut_mesh.h"

namespace soft_volume::core {

/// On which side of a plane vertices lie, the same for all pieces around them. Vertices nearer than the snap distance
/// lie on the plane. `positions_m` may grow; what is there stays.
class PlaneSides {
 public:
  PlaneSides(const Plane& plane, double snap_m, const std::vector<Vector3>& positions_m)
      : plane_(plane), snap_m_(snap_m), farthest_snap_m_(snap_m), positions_m_(&positions_m) {}

  double distance(std::uint32_t vertex) const { return sideOf(vertex).distance_m; }
  /// -1, 0 or 1.
  int sign(std::uint32_t vertex) const { return sideOf(vertex).sign; }
  /// For a vertex that was made on the plane.
  void putOn(std::uint32_t vertex) { put_on_[vertex] = 0.0; }
  /// Takes vertices nearer than this to lie on the plane as well; returns those that were not.
  std::vector<std::uint32_t> snap(const std::vector<std::uint32_t>& vertices, double snap_m);
  /// Undoes it.
  void release(const std::vector<std::uint32_t>& vertices);

 private:
  struct Side {
    double distance_m;
    int sign;
  };
  Side sideOf(std::uint32_t vertex) const {
    const double d = plane_.distance((*positions_m_)[vertex]);
    if (std::abs(d) <= farthest_snap_m_) {
      if (const auto put_on = put_on_.find(vertex); put_on != put_on_.end())
        return {put_on->second, 0};
      if (std::abs(d) <= snap_m_)
        return {d, 0};
    }
    return {d, d < 0.0 ? -1 : 1};
  }

  Plane plane_;
  double snap_m_;
  double farthest_snap_m_;  // no vertex was put on the plane from farther away
  const std::vector<Vector3>* positions_m_;
  std::unordered_map<std::uint32_t, double> put_on_;  // and the distance
};

/// What every piece keeps, in metres at rest.
struct ShapeLimits {
  double least_edge_m;
  double least_width_m;
  double deepest_dent_m;
  double flat_m;  ///< sections that are flatter stay polygons; others become triangles
};

/// How a plane splits a piece. The parts behind (-) and in front (+) of it keep to the limits.
struct PieceSplit {
  struct Chord {
    std::uint32_t face;
    std::uint32_t from;  ///< the part behind the plane runs from here
    std::uint32_t to;    ///< to here
  };
  std::vector<CutMesh::Source> points;              ///< new vertices on edges, numbered from the mesh's count on
  std::vector<Chord> chords;                        ///< through the piece's faces
  std::vector<std::vector<std::uint32_t>> section;  ///< the new faces, outward of the part behind
};

/// Nothing when the plane does not part the piece in two or a part would break the limits. Changes nothing.
std::optional<PieceSplit> planSplit(const CutMesh& mesh, std::uint32_t piece, PlaneSides& sides,
                                    const ShapeLimits& limits);

/// Does it; the neighbours' faces are cut, too. Returns the part in front. `positions_m` gets the new vertices.
std::uint32_t applySplit(const PieceSplit& split, std::uint32_t piece, CutMesh& mesh, PlaneSides& sides,
                         std::vector<Vector3>& positions_m);

}  // namespace soft_volume::core
