#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "soft_volume/grid/lattice.h"
#include "soft_volume/material/material.h"
#include "soft_volume/simulation/corner_width.h"
#include "soft_volume/simulation/prestress.h"
#include "soft_volume/simulation/settings.h"

namespace soft_volume::core {

/// The clear form of the simulation: scalar, double precision, one cell after the other. The fast engine is tested
/// against it and its speed is measured against it; it is written to be checked by eye, without being wasteful.
///
/// Vectors hold one entry per vertex of the lattice. Displacements are from rest, in metres, so that the place of the
/// lattice in space costs no digits. Nothing here is thread-safe except const functions.

/// What acts inside the tissue: the 28 springs that every cell owns, and its volume energy
/// (1/2) kappa V (J - 1)^2, J the mean of the 8 corner determinants over V, where the material has kappa > 0, and the
/// bending relief (material.h).
class OracleModel {
 public:
  /// Keeps a reference to `lattice`, which must outlive it. Rest lengths and rest volume follow the rest_stretch of cut
  /// cells. By SpringRule::kDissertation every spring has dissertationStrength(), divided among the cells that share
  /// it, and there is no volume energy. Throws SceneError as isotropicSprings(), elasticConstants() and
  /// dissertationStrength() do.
  OracleModel(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule);
  /// The same where the tension of prestretched tissue is known: finding it is what takes long.
  OracleModel(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule, Prestress prestress);

  /// Adds the forces on all vertices, fixed ones included, newton.
  void addForces(const std::vector<Vector3>& displacements_m, std::vector<Vector3>& forces_n) const;
  /// The same for one cell.
  void addCellForces(std::size_t cell, const std::vector<Vector3>& displacements_m,
                     std::vector<Vector3>& forces_n) const;
  /// Elastic energy, joule.
  double energy(const std::vector<Vector3>& displacements_m) const;
  /// Deformed corners of a cell relative to its corner 0 at rest.
  CellCorners corners(std::size_t cell, const std::vector<Vector3>& displacements_m) const;
  /// Sum of the stiffness of the springs that end in each vertex, newton per metre.
  std::vector<double> stiffnessSums() const;

 private:
  using PerPair = std::array<double, kCornerPairs.size()>;
  struct Volume {
    double modulus_pa;
    double rest_m3;
  };

  void useIsotropicRule(const std::vector<Material>& materials);
  void useDissertationRule(double strength_n_m);
  void findRestShapes();
  PerPair restLengths(std::size_t cell) const;
  Volume volume(std::size_t cell) const;

  const Lattice* lattice_;
  CellCorners rest_corners_;
  // Cells that are alike share a row: of stiffness by material (or their own, where springs are shared), of rest
  // lengths unless an incision stretched them.
  std::vector<PerPair> stiffness_n_m_;
  std::vector<PerPair> rest_length_m_;
  std::vector<std::uint32_t> stiffness_row_;
  std::vector<std::uint32_t> length_row_;
  std::vector<double> volume_modulus_pa_;  ///< per material
  std::vector<double> relief_n_m_;         ///< per material, bendingRelief()
  Prestress prestress_;
};

std::vector<Vector3> oracleForces(const Lattice& lattice, const std::vector<Material>& materials,
                                  const std::vector<Vector3>& displacements_m,
                                  SpringRule rule = SpringRule::kIsotropic);
double oracleEnergy(const Lattice& lattice, const std::vector<Material>& materials,
                    const std::vector<Vector3>& displacements_m, SpringRule rule = SpringRule::kIsotropic);
/// An eighth of every cell around each vertex, kg. By SpringRule::kDissertation fixed vertices are
/// kDissertationRigidMass times as heavy.
std::vector<double> oracleMasses(const Lattice& lattice, const std::vector<Material>& materials,
                                 SpringRule rule = SpringRule::kIsotropic);
/// Least width of all corner tetrahedra, metres.
double oracleMinWidth(const Lattice& lattice, const std::vector<Vector3>& displacements_m);

struct OracleSettings {
  double dt_s = 1e-4;
  double damping_per_s = 0.0;  ///< rate at which velocity decays, taken implicitly
  Vector3 gravity_m_s2 = Vector3::Zero();
  SpringRule spring_rule = SpringRule::kIsotropic;
  bool guard = true;  ///< the width guard, altitude springs and the bound of input forces
};

/// Symplectic Euler on the whole lattice with the width guard in its global form. With h the shortest cell edge:
///
/// - a vertex moves at most 0.4 of its shortest edge and at most 0.5 h in a step;
/// - a step is rejected where a corner tetrahedron would end thinner than 0.02 h and thinner than it was. The moves of
///   its vertices are halved, twice at most, then capped at 0.499 (w - 0.02 h), w the least width around the vertex
///   before the step. All tetrahedra are tried again until none fails, because a shorter move can spoil what was right
///   before; after kGuardRounds tries every vertex is capped;
/// - the velocity is that of the move made;
/// - altitude springs of 4 k, k = 0.35 mu h, push apart corner tetrahedra thinner than 0.3 h;
/// - a force from outside is bounded by a quarter of h times the summed stiffness of the springs of its vertex.
///
/// A tetrahedron that starts at 0.02 h or above never ends below it, to rounding. One that starts below (a state that
/// was given) never gets thinner. Tissue comes back from any force that a tool's footprint can press into it; a whole
/// surface pulled over by forces at their bound can fold into a state that does not open by itself.
class OracleSimulation {
 public:
  static constexpr int kGuardRounds = 16;

  /// Keeps a reference to `lattice`, which must outlive it. Throws as OracleModel does.
  OracleSimulation(const Lattice& lattice, const std::vector<Material>& materials, const OracleSettings& settings);

  /// Forces from outside, newton, in effect until they are replaced.
  void setForces(const std::vector<Vector3>& forces_n);
  /// Starts from another state.
  void setState(const std::vector<Vector3>& displacements_m, const std::vector<Vector3>& velocities_m_s);
  /// Advances by one time step; allocates nothing.
  void step();

  const std::vector<Vector3>& displacements() const { return displacements_m_; }
  const std::vector<Vector3>& velocities() const { return velocities_m_s_; }
  const std::vector<double>& masses() const { return masses_kg_; }
  /// How often the guard shortened the move of a vertex, since the start.
  std::uint64_t limitedMoves() const { return limited_moves_; }

 private:
  void boundForces();
  void findRoom();
  void proposeMoves();
  void guardMoves();
  bool flagFailures();
  void shortenFlagged();
  void shorten(std::size_t vertex, double longest_m);
  void applyMoves();

  const Lattice* lattice_;
  OracleSettings settings_;
  OracleModel model_;
  double shortest_edge_m_;
  std::vector<AltitudeSpring> altitude_springs_;  ///< per material
  std::vector<double> masses_kg_;
  std::vector<std::uint8_t> movable_;
  std::vector<double> force_bounds_n_;

  std::vector<Vector3> displacements_m_;
  std::vector<Vector3> velocities_m_s_;
  std::vector<Vector3> external_n_;
  std::uint64_t limited_moves_ = 0;

  // Scratch of a step.
  std::vector<Vector3> forces_n_;
  std::vector<Vector3> moves_m_;
  std::vector<Vector3> ends_m_;                  ///< displacements that the moves lead to
  std::vector<std::array<double, 8>> widths_m_;  ///< per cell and corner tetrahedron, before the step
  std::vector<double> room_m_;                   ///< per vertex, least width around it
  std::vector<double> shortest_squared_m2_;      ///< per vertex, its shortest edge
  std::vector<std::uint8_t> tries_;              ///< per vertex, how often its move was shortened by the guard
  std::vector<std::uint8_t> flagged_;
};

}  // namespace soft_volume::core
