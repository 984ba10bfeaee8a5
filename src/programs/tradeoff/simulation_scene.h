#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "soft_volume/common/geometry.h"
#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"
#include "soft_volume/simulation/simulation.h"

namespace soft_volume::core {

/// A force at a place of the tissue at rest, newton and metres.
struct PointForce {
  Vector3 rest_point_m;
  Vector3 force_n;
};

/// Mean displacement of all probes along a direction when the scene ends.
struct KnownAnswer {
  Vector3 direction;
  double displacement_m;
  std::string source;
};

/// A block of tissue and what happens to it, stated without a lattice, so that lattices of any spacing that divides the
/// block solve the same problem.
struct TradeoffScene {
  std::string name;
  std::string description;  ///< full sentences
  Vector3 size_m;           ///< lowest corner at the origin
  Box3 fixed_m;             ///< vertices inside do not move
  Material material;
  double duration_s = 0.0;
  double sample_s = 0.0;          ///< displacements are compared at every multiple; divides the duration
  std::vector<Vector3> probes_m;  ///< where they are compared, rest positions
  std::function<std::vector<PointForce>(double time_s)> forces;
  std::optional<KnownAnswer> known;
};

/// A footprint of 30 mm presses into a slab on a rigid base, slides with friction and lets go. `quick`: a smaller slab
/// and a shorter course.
TradeoffScene indentationScene(bool quick);

/// A beam of 8:1 with a load at its end, held until it has come to rest: Timoshenko's deflection is known.
TradeoffScene cantileverScene();

/// The scene's block with the base fixed. Spacing must divide the block.
Lattice sceneLattice(const TradeoffScene& scene, double spacing_m);

/// Distributes forces at places to the vertices of the cells around, by trilinear weights: the work done is the same
/// for every lattice. Increasing vertices; none without a force.
std::vector<VertexLoad> vertexLoads(const Lattice& lattice, const std::vector<PointForce>& forces);

/// Displacements at rest points, by trilinear interpolation.
std::vector<Vector3> displacementsAt(const Lattice& lattice, const std::vector<Vector3>& displacements_m,
                                     const std::vector<Vector3>& rest_points_m);

}  // namespace soft_volume::core
