#pragma once

#include <cstdint>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/incision/cut_mesh.h"

namespace soft_volume::core {

/// A polyhedron by itself: points and the loops of its faces, counter-clockwise seen from outside.
struct Polyhedron {
  std::vector<Vector3> points_m;
  std::vector<std::vector<std::uint32_t>> loops;
};

/// A piece of a cut mesh at rest; its points are the piece's vertices in increasing order.
Polyhedron solidOf(const CutMesh& mesh, std::uint32_t piece);

/// Every edge belongs to exactly two faces, which run along it in opposite directions.
bool isClosed(const Polyhedron& solid);

/// Whether a vertex lies nearer than this to the inside of an edge that it is no end of.
bool touchesOwnEdge(const Polyhedron& solid, double distance_m);

/// Enclosed volume, m3: exact for planar faces.
double volumeOf(const Polyhedron& solid);

double shortestEdge(const Polyhedron& solid);

/// How deep the edge between two faces lies in a closed polyhedron at most: the less of the heights of either over the
/// plane of the other, metres; 0 exactly for convex ones, infinite where one face is folded onto the other (within
/// 3.6 degrees).
double deepestDent(const Polyhedron& solid);

/// Least distance of two parallel planes that have a closed polyhedron's convex hull between them, metres. Stops early,
/// with a number below `enough_m`, once that is certain.
double leastWidth(const Polyhedron& solid, double enough_m = 0.0);

/// Whether leastWidth() is at least this; settled by a ball inside in most cases, which is much faster.
bool isWide(const Polyhedron& solid, double width_m);

/// Sum of the cross products along a loop: twice its area, along its normal (Newell).
Vector3 areaVector(const std::vector<Vector3>& points_m, const std::vector<std::uint32_t>& loop);

}  // namespace soft_volume::core
