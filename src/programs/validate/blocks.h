#pragma once

#include <functional>
#include <string>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"
#include "soft_volume/simulation/simulation.h"

namespace soft_volume::core::validate {

/// Tissue of the cases that do not say otherwise: 10 kPa, 1000 kg/m^3.
constexpr double kYoungPa = 1e4;
Material tissue(double poisson_ratio = 0.25, double damping_ratio = 0.0);

/// A full box of cells. A simulation refers to both members, so a block stays where it is.
struct Block {
  Lattice lattice;
  std::vector<Material> materials;

  Block(const Vector3i& cells, const Vector3& spacing_m, const Material& material,
        const Vector3& origin_m = Vector3::Zero());
  Block(const Block&) = delete;
  Block& operator=(const Block&) = delete;

  double edge() const { return lattice.spacing_m.minCoeff(); }
  /// Nodes along each axis, one more than cells. In a full box vertices are numbered as nodes.
  Vector3i node(std::uint32_t vertex) const;
  std::uint32_t vertex(int i, int j, int k) const { return static_cast<std::uint32_t>(lattice.latticeNode(i, j, k)); }
  /// In increasing order.
  std::vector<std::uint32_t> verticesWhere(const std::function<bool(const Vector3i& node)>& choose) const;
  void fixWhere(const std::function<bool(const Vector3i& node)>& choose);
  /// Where the face normal to `axis` at node layer `layer` is.
  std::vector<std::uint32_t> layer(int axis, int layer) const;
  /// Area of the face normal to `axis` that belongs to the vertex, m^2.
  double faceArea(std::uint32_t vertex, int axis) const;
  /// Stiffness of an edge spring that one cell owns times the cell's edge: the unit of the extreme forces, newton.
  double springForce() const;
};

/// The whole lattice in the solve, in double precision.
SimulationSettings exactSettings();
/// The same, for statics.
SimulationSettings staticSettings();
/// Figure 4.4 as written, with the whole lattice in the solve.
SimulationSettings dissertationSettings();

/// Steps until the tissue would not move farther than `tolerance_m` any more, extrapolated from the last moves, at most
/// `max_steps`. Returns false when it did not come to rest.
bool settle(Simulation& simulation, double tolerance_m, int max_steps);

/// Largest distance between corresponding points.
double largestDistance(const std::vector<Vector3>& a, const std::vector<Vector3>& b);
double largestNorm(const std::vector<Vector3>& vectors);
Vector3 totalForce(const Simulation& simulation, const std::vector<std::uint32_t>& vertices);
std::vector<Vector3> positionsOf(const Simulation& simulation, const std::vector<std::uint32_t>& vertices);
/// Sets displacements and velocities, everything else as it is.
void setMotion(Simulation& simulation, const std::vector<Vector3>& displacements_m,
               const std::vector<Vector3>& velocities_m_s);
/// A step that never ends, for forces and grips that stay.
constexpr std::uint64_t kForever = 1ULL << 62;

/// Polylines of gnuplot data: the lattice lines of the node layer `layer` normal to `axis`, in units of `unit_m`.
std::string layerLines(const Block& block, const std::vector<Vector3>& positions_m, int axis, int layer, double unit_m);

}  // namespace soft_volume::core::validate
