#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"
#include "soft_volume/simulation/spring_network.h"

namespace soft_volume::core {

enum class Integrator {
  kSymplecticEuler,  ///< v += dt a; x += dt v
  kDissertation,     ///< Figure 4.4: x += dt v + a dt^2 / 2, stable up to 0.7 of the limit, damps numerically
};

/// How a lattice moves. Defaults are those of the scene file.
struct SimulationSettings {
  Integrator integrator = Integrator::kSymplecticEuler;
  double dt_s = 0.001;
  /// A vertex moves at most this fraction of the distance to its nearest neighbour in one step (section 4.3).
  double safe_move_fraction = 0.4;
  /// Cells within this distance of a force or cut are in the solve.
  double activation_radius_m = 0.06;
  /// Steps for which a cell stays in the solve after the last force or cut near it.
  std::uint32_t lifetime_steps = 3000;
};

/// A force in effect, spread over vertices.
struct HeldForce {
  Vector3 force_n = Vector3::Zero();
  Vector3 point_m = Vector3::Zero();    ///< centre of the footprint, volume frame
  std::uint64_t expires_at_step = 0;    ///< first step in which it no longer acts
  std::vector<std::uint32_t> vertices;  ///< increasing
  std::vector<double> weights;          ///< share of each vertex; they sum to 1
};

/// State that a bit-exact continuation needs beside lattice and settings.
struct SimulationState {
  std::uint64_t step = 0;
  std::vector<Vector3> positions_m;
  std::vector<Vector3> velocities_m_s;
  std::vector<std::uint32_t> lifetimes;     ///< per cell, steps left, 0 = asleep
  std::map<std::string, HeldForce> forces;  ///< by tool
};

/// The mass-spring simulation of chapter 4: fixed time step, active cells with lifetimes, safe moves.
///
/// Deterministic: the same lattice, settings and sequence of calls give the same bits for any number of threads. Not
/// thread-safe; step() allocates nothing once the active set has reached its size, and takes no lock.
class Simulation {
 public:
  /// Keeps a reference to `lattice` and `materials`, which must outlive it. After an incision changed the lattice, call
  /// adoptTopology().
  Simulation(const Lattice& lattice, const std::vector<Material>& materials, const SimulationSettings& settings,
             int threads);

  /// Spreads a force over the vertices within `radius_m` of `point_m` (weight mass * (1 - r^2/R^2)^2, deformed
  /// positions), replacing the tool's previous force, and wakes the cells around. The mass keeps a corner that hangs on
  /// one cell from getting the load of eight, which would push it through its cell. Returns false and changes nothing
  /// when no vertex lies within the radius.
  bool holdForce(const std::string& tool_id, const Vector3& force_n, const Vector3& point_m, double radius_m,
                 std::uint64_t expires_at_step);
  /// Lets a tool's force end now.
  void releaseForce(const std::string& tool_id) { state_.forces.erase(tool_id); }

  /// Puts the cells whose rest place lies within the activation radius of the box (rest positions) into the solve.
  void wake(const Box3& rest_box_m);

  /// Advances by one time step.
  void step();

  /// Takes over vertices that an incision added (they start where the vertex that they replicate is, with its velocity)
  /// and the changed springs.
  void adoptTopology();

  /// Replaces the state, as taken from state(). Throws InputError when it does not fit the lattice or is not finite.
  void restore(SimulationState state);

  const SimulationState& state() const { return state_; }
  const std::vector<Vector3>& positions() const { return state_.positions_m; }
  const std::vector<Vector3>& velocities() const { return state_.velocities_m_s; }
  const SimulationSettings& settings() const { return settings_; }
  int threads() const { return threads_; }
  /// No vertex is farther from rest than this, in metres.
  double reach() const { return reach_m_; }
  std::size_t activeCells() const { return active_cells_.size(); }
  std::uint64_t limitedMoves() const { return limited_moves_; }
  /// Largest distance of any vertex from rest, in metres.
  double maxDisplacement() const;
  double maxSpeed() const;
  /// Vertices in the box that they occupy now, found through the lattice; increasing order.
  std::vector<std::uint32_t> verticesNear(const Vector3& point_m, double radius_m) const;
  /// Cells with a vertex within the radius, increasing order.
  std::vector<std::uint32_t> cellsNear(const Vector3& point_m, double radius_m) const;
  /// Sum of spring forces and held forces on a vertex, newton. For tests.
  Vector3 forceOn(std::uint32_t vertex) const;
  /// XXH3-64 of all positions and velocities.
  std::uint64_t stateHash() const;

 private:
  void indexNodes();
  void rebuildActiveSet();
  void ageCells();
  void dropExpiredForces();
  void gatherExternalForces();
  void moveVertex(std::size_t active_index);
  void applyMoves();

  const Lattice* lattice_;
  const std::vector<Material>* materials_;
  SimulationSettings settings_;
  int threads_;
  SpringNetwork springs_;
  SimulationState state_;
  std::vector<std::uint32_t> node_begin_;       ///< per lattice node: range in node_vertices_
  std::vector<std::uint32_t> node_vertices_;    ///< vertices by lattice node, replicas included
  std::vector<std::uint32_t> active_cells_;     ///< increasing
  std::vector<std::uint32_t> active_vertices_;  ///< increasing, none fixed
  std::vector<std::uint8_t> in_solve_;  ///< per vertex, scratch of rebuildActiveSet()
  bool active_changed_ = false;

  std::vector<Vector3> external_n_;    ///< per vertex
  std::vector<std::uint32_t> loaded_;  ///< vertices with an entry in external_n_
  std::vector<Vector3> moves_;         ///< per active vertex, scratch
  std::vector<std::uint8_t> limited_;  ///< per active vertex, scratch
  std::uint64_t limited_moves_ = 0;
  /// No vertex is farther from rest than this; it only grows, so that searches by rest place find everything.
  double reach_m_ = 0.0;
};

}  // namespace soft_volume::core
