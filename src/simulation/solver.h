#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "soft_volume/simulation/simulation.h"
#include "spring_model.h"

namespace soft_volume::core {

/// Where a grip wants a vertex.
struct Target {
  std::uint32_t vertex;
  std::uint32_t order;  ///< of the grip among all grips
  Vector3 displacement_m;
};

/// What acts on the tissue from outside in a step. The vertices are the lattice's.
struct OuterActions {
  std::uint64_t step = 0;         ///< steps done before this one
  std::vector<VertexLoad> loads;  ///< several may name one vertex
  std::vector<Target> targets;    ///< by increasing vertex
  bool loads_changed = true;      ///< since the last step
};

/// How hard the rest of the lattice is held back at the frontier of the solve.
struct FrontierVertex {
  std::uint32_t vertex;  ///< the lattice's
  Vector3 force_n;       ///< that acts on it and would move it
  double stiffness_n_m;  ///< of its springs, averaged over directions
};

/// What keeps a vertex from being at rest.
struct VertexMotion {
  std::uint32_t vertex;  ///< the lattice's
  double speed_m_s;
  double pull_m;  ///< force over stiffness
};

/// What moves the active part of a lattice, in one precision. Not thread-safe; step() allocates nothing in explicit
/// integrators.
class Solver {
 public:
  virtual ~Solver() = default;

  /// Takes the movable vertices of `active_cells` (increasing) into the solve, at the state's places and speeds, and
  /// those contacts of `lips` all of whose vertices have a place in it.
  virtual void build(const SpringModel& model, const std::vector<std::uint32_t>& active_cells, bool with_frontier,
                     const SimulationState& state, const std::vector<LipContact>& lips) = 0;
  /// Writes places and speeds of the vertices in the solve.
  virtual void readState(SimulationState& state, std::vector<Vector3>& positions_m) const = 0;
  virtual void step(const SimulationSettings& settings, double dt_s, const OuterActions& actions,
                    SimulationStats& stats) = 0;
  /// The frontier at the present state.
  virtual void readFrontier(std::vector<FrontierVertex>& frontier) = 0;
  /// The vertices in the solve after a step.
  virtual void readMotion(std::vector<VertexMotion>& motion) const = 0;
  /// The lattice vertices in the solve, increasing.
  virtual std::vector<std::uint32_t> movingVertices() const = 0;
  virtual void addMemory(std::vector<MemoryUse>& table) const = 0;
};

std::unique_ptr<Solver> makeSolver(Precision precision, const Lattice& lattice, const LatticeIndex& index, int threads);

}  // namespace soft_volume::core
