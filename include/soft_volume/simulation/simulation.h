#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/grid/lip_contact.h"
#include "soft_volume/material/material.h"
#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

/// A force in effect, spread over vertices.
struct HeldForce {
  Vector3 force_n = Vector3::Zero();
  Vector3 point_m = Vector3::Zero();    ///< centre of the footprint, volume frame
  std::uint64_t expires_at_step = 0;    ///< first step in which it no longer acts
  std::vector<std::uint32_t> vertices;  ///< increasing
  std::vector<double> weights;          ///< share of each vertex; they sum to 1
};

/// Vertices that jaws or a plate hold: each is led to pose * anchor through the safe move.
struct HeldGrip {
  Pose pose;                            ///< of the jaws, volume frame
  std::uint64_t expires_at_step = 0;    ///< first step in which it no longer holds
  std::vector<std::uint32_t> vertices;  ///< increasing
  std::vector<Vector3> anchors_m;       ///< of each vertex, frame of the jaws
};

/// A force on one vertex that stays until it is replaced.
struct VertexLoad {
  std::uint32_t vertex = 0;
  Vector3 force_n = Vector3::Zero();
};

/// State that a bit-exact continuation needs beside lattice and settings.
struct SimulationState {
  std::uint64_t step = 0;
  std::vector<Vector3> displacements_m;  ///< from rest, per vertex
  std::vector<Vector3> velocities_m_s;
  std::vector<std::uint32_t> lifetimes;  ///< per cell, steps left, 0 = asleep
  /// Largest displacement of late, which what counts as a move worth following is measured by; fades over the lifetime.
  double deformation_m = 0.0;
  std::map<std::string, HeldForce> forces;  ///< by tool
  std::map<std::string, HeldGrip> grips;    ///< by tool
  std::vector<VertexLoad> loads;            ///< by increasing vertex
};

/// What happened since the simulation was made, and how wrong the answer may be.
struct SimulationStats {
  std::uint32_t active_cells = 0;
  std::uint32_t active_vertices = 0;
  std::uint64_t limited_moves = 0;      ///< vertex moves shortened by the safe move
  std::uint64_t guard_fallbacks = 0;    ///< steps in which every vertex was held to the pure width rule
  std::uint64_t saturated_forces = 0;   ///< vertex forces cut to the largest that the tissue can carry
  std::uint64_t rejected_steps = 0;     ///< adaptive: tries that were backed up
  std::uint64_t solver_iterations = 0;  ///< backward Euler: conjugate gradient iterations
  double grip_lag_m = 0.0;              ///< largest distance between a gripped vertex and where its grip wants it, now
  /// Estimate of how much farther the tissue would move if the whole lattice were in the solve, metres; 0 when it is.
  double frontier_error_m = 0.0;
};

/// Energies in joule, momenta about the volume frame's origin. For tests and validation: a pass over the lattice.
struct Mechanics {
  double kinetic_j = 0.0;
  double elastic_j = 0.0;  ///< of springs, volumes and what presses lips together
  Vector3 linear_momentum_kg_m_s = Vector3::Zero();
  Vector3 angular_momentum_kg_m2_s = Vector3::Zero();
};

/// One line of the table of what holds memory.
struct MemoryUse {
  std::string what;
  std::size_t bytes = 0;
};

/// The mass-spring simulation of chapter 4, in the variants of SimulationSettings.
///
/// Deterministic: the same lattice, settings and sequence of calls give the same bits for any number of threads and on
/// processors with and without AVX2. Not thread-safe; step() allocates nothing while the active set stays the same, and
/// takes no lock. Every input is checked: values that are not finite or absurdly large (beyond 1e30) throw InputError
/// and leave the state as it was.
class Simulation {
 public:
  /// Keeps a reference to `lattice` and `materials`, which must outlive it. After an incision changed the lattice, call
  /// adoptTopology(). Throws SceneError for materials or settings that are out of range, and for a step beyond the
  /// stability limit of an explicit integrator unless substeps are wanted.
  Simulation(const Lattice& lattice, const std::vector<Material>& materials, const SimulationSettings& settings,
             int threads);
  Simulation(Simulation&&) noexcept;
  Simulation& operator=(Simulation&&) noexcept;
  ~Simulation();

  /// Spreads a force over the vertices within `radius_m` of `point_m` (weight mass * (1 - r^2/R^2)^2, deformed
  /// positions), replacing the tool's previous force, and wakes the cells around. The mass keeps a corner that hangs on
  /// one cell from getting the load of eight, which would push it through its cell. Returns false and changes nothing
  /// when no vertex lies within the radius. Each vertex's share is saturated at a bound that scales with its stiffness
  /// times the cell edge. Where cells of the lattice are given, vertices that an incision parts from them take no part:
  /// those that are more than one cell farther from them through tissue than through space.
  bool holdForce(const std::string& tool_id, const Vector3& force_n, const Vector3& point_m, double radius_m,
                 std::uint64_t expires_at_step, const std::vector<std::uint32_t>& cells = {});
  /// Lets a tool's force end now.
  void releaseForce(const std::string& tool_id);

  /// Closes jaws at `pose` on the vertices within `radius_m` of `point_m` (deformed positions). Returns false and
  /// changes nothing when there are none. Replaces the tool's previous grip.
  bool closeGrip(const std::string& tool_id, const Vector3& point_m, double radius_m, const Pose& pose,
                 std::uint64_t expires_at_step);
  /// The same for given vertices: a plate. Ignores fixed vertices.
  void gripVertices(const std::string& tool_id, const std::vector<std::uint32_t>& vertices, const Pose& pose,
                    std::uint64_t expires_at_step);
  /// The same with a place of its own for every vertex (volume frame).
  void leadVertices(const std::string& tool_id, const std::vector<std::uint32_t>& vertices,
                    const std::vector<Vector3>& targets_m, std::uint64_t expires_at_step);
  /// Moves closed jaws. Returns false when the tool holds nothing.
  bool moveGrip(const std::string& tool_id, const Pose& pose, std::uint64_t expires_at_step);
  void releaseGrip(const std::string& tool_id);

  /// Replaces the forces on single vertices. Wakes the cells around those that changed.
  void setLoads(const std::vector<VertexLoad>& loads);

  /// Puts the cells whose rest place lies within the activation radius of the box (rest positions) into the solve.
  void wake(const Box3& rest_box_m);
  void wakeAll();

  /// Advances by one time step.
  void step();

  /// Changes the integrator and its step while the state stays. `dt_s` 0: automatic. Throws as the constructor does.
  void setIntegrator(Integrator integrator, double dt_s);

  /// Takes over vertices that an incision added (they start where the vertex that they replicate is, with its velocity)
  /// and the changed springs. Steps that are too long for copies of cells are divided from now on.
  void adoptTopology();

  /// Replaces the contacts between the lips of incisions (incision/lip_contacts.h): pressed together they do not pass
  /// through each other, slide freely, and are in the solve together. They belong to the topology, not to the state:
  /// to be set after every adoptTopology() and when a cut lattice is taken up again. They do not shorten the stable
  /// step; the integrators other than backward Euler and quasi-statics see impacts of lips as inelastic. Throws
  /// InputError when a contact does not fit the lattice.
  void setLips(std::vector<LipContact> lips);

  /// Replaces the state, as taken from state(). Throws InputError when it does not fit the lattice or is not finite.
  void restore(SimulationState state);

  const SimulationState& state() const;
  /// Deformed positions, volume frame. Valid until the next call that is not const.
  const std::vector<Vector3>& positions() const;
  const std::vector<Vector3>& velocities() const { return state().velocities_m_s; }
  /// As given, with the resolved time step.
  const SimulationSettings& settings() const;
  int threads() const;
  std::uint64_t steps() const;
  SimulationStats stats() const;
  /// Largest stable step of the undamped explicit integrators, by power iteration on the whole lattice without its
  /// incisions; infinite when nothing can move.
  double stabilityLimit() const;
  /// How many parts a step is divided into.
  int substeps() const;

  /// No vertex is farther from rest than this, in metres.
  double reach() const;
  std::size_t activeCells() const;
  std::uint64_t limitedMoves() const { return stats().limited_moves; }
  /// Largest distance of any vertex from rest, in metres.
  double maxDisplacement() const;
  double maxSpeed() const;
  /// Vertices in the box that they occupy now, found through the lattice; increasing order.
  std::vector<std::uint32_t> verticesNear(const Vector3& point_m, double radius_m) const;
  /// Cells with a vertex within the radius, increasing order.
  std::vector<std::uint32_t> cellsNear(const Vector3& point_m, double radius_m) const;
  /// Least width of all corner tetrahedra in metres (negative: inverted), from the definition, in double precision.
  double minWidth() const;
  /// Sum of inner and outer forces on a vertex, newton, in double precision. For tests and validation.
  Vector3 forceOn(std::uint32_t vertex) const;
  /// Mass of a vertex, kg.
  double mass(std::uint32_t vertex) const;
  Mechanics mechanics() const;
  std::vector<MemoryUse> memory() const;
  /// XXH3-64 of all displacements and velocities.
  std::uint64_t stateHash() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace soft_volume::core
