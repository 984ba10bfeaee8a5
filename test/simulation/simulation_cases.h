#pragma once

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <random>
#include <vector>

#include "lattice_blocks.h"
#include "soft_volume/incision/blade_cut.h"
#include "soft_volume/incision/cut_tissue.h"
#include "soft_volume/incision/embedding.h"
#include "soft_volume/simulation/corner_width.h"
#include "soft_volume/simulation/simulation.h"

// What the tests of the simulation share: lattices, settings, random vectors and measures.
namespace soft_volume::core {

constexpr double kH = 0.005;       ///< edge of a cell, metres
constexpr double kModulus = 10e3;  ///< Young's modulus, pascal

/// Fixes the vertices of the lowest layer along an axis.
inline Lattice standing(Lattice lattice, int axis = 2) {
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    lattice.fixed[v] = lattice.rest_positions[v][axis] < 1e-9 ? 1 : 0;
  return lattice;
}

/// The lattice parted along the plane x = `x_m` between two heights (whole breadth in y).
inline Lattice cutAcross(Lattice lattice, const std::vector<Material>& materials, double x_m, double z_from_m,
                         double z_to_m, double rest_fraction) {
  const SweptQuad quad = {Vector3(x_m, -1.0, z_from_m), Vector3(x_m, -1.0, z_to_m), Vector3(x_m, 1.0, z_to_m),
                          Vector3(x_m, 1.0, z_from_m)};
  CutTissue(lattice, {IncisionMethod::kFaces, rest_fraction})
      .cut(lattice, materials, std::vector<Vector3>(lattice.rest_positions), 0.0, "scalpel", {quad}, true);
  return lattice;
}

/// The lattice with cells that cuts divide into copies: one slanting cut through everything, and one that ends inside
/// the tissue, where copies of a cell meet in a vertex as the same corner.
inline Lattice cutIntoPieces(Lattice lattice, const std::vector<Material>& materials) {
  const Vector3 size = lattice.dims.cast<double>().cwiseProduct(lattice.spacing_m);
  const auto at = [&](double x, double y, double z) { return Vector3(size.cwiseProduct(Vector3(x, y, z))); };
  std::vector<Vector3> positions = lattice.rest_positions;
  CutMesh mesh(lattice);
  Embedding embedding(mesh);
  for (const SweptQuad& quad : {SweptQuad{at(-1, -1, 0.3), at(2, -1, 0.5), at(2, 2, 0.9), at(-1, 2, 0.7)},
                                SweptQuad{at(0.45, -1, -1), at(0.45, -1, 2), at(0.4, 0.7, 2), at(0.4, 0.7, -1)}}) {
    Lips lips;
    cutMesh(mesh, lattice, materials, CutResolution(), {quad}, 0.0, lips, positions);
    embedding.update(mesh, lattice);
  }
  return lattice;
}

/// The whole lattice in the solve.
inline SimulationSettings wholeLattice(Precision precision = Precision::kDouble,
                                       Integrator integrator = Integrator::kSymplecticEuler) {
  SimulationSettings settings;
  settings.active_set = ActiveSet::kAll;
  settings.precision = precision;
  settings.integrator = integrator;
  return settings;
}

/// Reproducible vectors. A distribution's bits differ between standard libraries, so bounds must not hang on them.
class Random {
 public:
  explicit Random(unsigned seed) : engine_(seed) {}

  double number(double from, double to) { return std::uniform_real_distribution<double>(from, to)(engine_); }
  Vector3 direction() {
    std::normal_distribution<double> normal;
    return Vector3(normal(engine_), normal(engine_), normal(engine_)).normalized();
  }
  /// Each of length `size`.
  std::vector<Vector3> vectors(std::size_t count, double size) {
    std::vector<Vector3> all(count);
    for (Vector3& v : all)
      v = size * direction();
    return all;
  }
  /// Each component in [-size, size].
  std::vector<Vector3> boxed(std::size_t count, double size) {
    std::vector<Vector3> all(count);
    for (Vector3& v : all)
      v = Vector3(number(-size, size), number(-size, size), number(-size, size));
    return all;
  }

 private:
  std::mt19937 engine_;
};

inline std::vector<Vector3> noVectors(const Lattice& lattice) {
  return std::vector<Vector3>(lattice.vertexCount(), Vector3::Zero());
}

inline double largest(const std::vector<Vector3>& values) {
  double squared = 0.0;
  for (const Vector3& v : values)
    squared = std::max(squared, v.squaredNorm());
  return std::sqrt(squared);
}

inline double largestDifference(const std::vector<Vector3>& a, const std::vector<Vector3>& b) {
  double squared = 0.0;
  for (std::size_t n = 0; n < a.size(); ++n)
    squared = std::max(squared, (a[n] - b[n]).squaredNorm());
  return std::sqrt(squared);
}

inline void run(Simulation& simulation, int steps) {
  for (int n = 0; n < steps; ++n)
    simulation.step();
}

/// Goes on from the present state with other displacements and velocities.
inline void place(Simulation& simulation, const std::vector<Vector3>& displacements_m,
                  const std::vector<Vector3>& velocities_m_s) {
  SimulationState state = simulation.state();
  state.displacements_m = displacements_m;
  state.velocities_m_s = velocities_m_s;
  simulation.restore(state);
}

inline std::vector<Vector3> displacements(const Simulation& simulation) {
  return simulation.state().displacements_m;
}

/// The vertices for which `chosen(rest position)` holds.
inline std::vector<std::uint32_t> verticesWhere(const Lattice& lattice,
                                                const std::function<bool(const Vector3&)>& chosen) {
  std::vector<std::uint32_t> found;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    if (chosen(lattice.rest_positions[v]))
      found.push_back(v);
  }
  return found;
}

inline std::uint32_t vertexAt(const Lattice& lattice, const Vector3& rest_m) {
  std::uint32_t nearest = 0;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    if ((lattice.rest_positions[v] - rest_m).squaredNorm() < (lattice.rest_positions[nearest] - rest_m).squaredNorm())
      nearest = v;
  }
  return nearest;
}

}  // namespace soft_volume::core
