#include "soft_volume/simulation/simulation.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <optional>

#include "lattice_index.h"
#include "lip_row.h"
#include "rest_system.h"
#include "safe_move.h"
#include "soft_volume/common/error.h"
#include "soft_volume/common/hash.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/simulation/corner_width.h"
#include "soft_volume/simulation/oracle.h"
#include "soft_volume/simulation/prestress.h"
#include "solver.h"

namespace soft_volume::core {
namespace {

/// Inputs beyond this are mistakes of their sender: their squares would not be numbers in single precision.
constexpr double kLargestInput = 1e15;
/// The active set is looked at every so many steps.
constexpr std::uint64_t kReviewSteps = 8;
/// Deformations below this share of the shortest cell edge are not followed more finely.
constexpr double kLeastDeformation = 1e-4;
/// In how many lifetimes a deformation that is over stops to be the measure.
constexpr double kFadingLifetimes = 5.0;
/// Rings of cells by which the frontier grows where it is pulled.
constexpr int kGrowthRings = 2;
/// Displacement of a half-space's surface at distance R from a force F is about 0.37 F / (E R): what a frontier there
/// holds back.
constexpr double kHalfSpaceYield = 0.37;
/// Symplectic Euler has a resonance at omega dt / 2 = sin(60 degrees) where large motions never fade: chips stay below
/// this share of their limit.
constexpr double kChipStep = 0.8;

bool usable(const Vector3& v) {
  return isFinite(v) && v.cwiseAbs().maxCoeff() <= kLargestInput;
}

void require(bool condition, const char* what) {
  if (!condition)
    throw InputError(what);
}

double footprintWeight(double distance_m, double radius_m) {
  const double r = distance_m / radius_m;
  const double w = 1.0 - r * r;
  return w > 0.0 ? w * w : 0.0;
}

/// How many cells a vertex is away from the nearest of some cells' places; 0 for their corners.
int ringsApart(const Lattice& lattice, const std::vector<std::uint32_t>& cells, std::uint32_t vertex) {
  const Vector3i nodes = lattice.dims + Vector3i::Ones();
  const int node = static_cast<int>(lattice.lattice_nodes[vertex]);
  const Vector3i place(node % nodes.x(), (node / nodes.x()) % nodes.y(), node / (nodes.x() * nodes.y()));
  int least = std::numeric_limits<int>::max();
  for (const std::uint32_t cell : cells) {
    const Vector3i low = lattice.cellIndex(lattice.parent_cells[cell]);
    const Vector3i beyond = (low - place).cwiseMax(place - low - Vector3i::Ones());
    least = std::min(least, std::max(0, beyond.maxCoeff()));
  }
  return least;
}

Box3 boxAround(const Vector3& point_m, double radius_m) {
  const Vector3 r = Vector3::Constant(radius_m);
  return {Vector3(point_m - r), Vector3(point_m + r)};
}

/// How far beyond that of symplectic Euler the stability limit of an integrator lies; infinite where it has none.
double limitFactor(Integrator integrator) {
  switch (integrator) {
    case Integrator::kSymplecticEuler:
      return 1.0;
    case Integrator::kDissertation:
      return std::sqrt(0.5);
    case Integrator::kRungeKutta4:
      return std::sqrt(2.0);
    default:
      return std::numeric_limits<double>::infinity();
  }
}

/// An automatic step of integrators without a limit, in units of symplectic Euler's.
double usualSteps(Integrator integrator) {
  return integrator == Integrator::kBackwardEuler ? 10.0 : 1.0;
}

/// Two digits, towards zero: a number that people can read, and times in messages that add up.
double roundDown(double value) {
  const double unit = std::pow(10.0, std::floor(std::log10(value)) - 1.0);
  return std::floor(value / unit * (1.0 + 1e-12)) * unit;
}

std::string shortText(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.3g", value);
  return text;
}

void checkMaterial(const Material& material) {
  const auto in = [](double value, double from, double to) { return value >= from && value <= to; };
  const std::string name = "material '" + material.name + "': ";
  if (!in(material.density_kg_m3, 1e-6, 1e9))
    throw SceneError(name + "density_kg_m3 must be a number in [1e-6, 1e9]");
  if (!in(material.youngs_modulus_pa, 1e-6, 1e15))
    throw SceneError(name + "youngs_modulus_pa must be a number in [1e-6, 1e15]");
  if (!in(material.poisson_ratio, 0.25, 0.49))
    throw SceneError(name + "poisson_ratio must be a number in [0.25, 0.49]");
  if (!in(material.prestretch, 1.0, 1.5))
    throw SceneError(name + "prestretch must be a number in [1, 1.5]");
  if (!in(material.damping_ratio, 0.0, 1e6))
    throw SceneError(name + "damping_ratio must be a number in [0, 1e6]");
}

void checkSettings(const SimulationSettings& settings) {
  const auto positive = [](double value) { return std::isfinite(value) && value > 0.0; };
  if (!(settings.dt_s >= 0.0 && settings.dt_s <= 1e6))
    throw SceneError("dt_s must be a positive number of seconds, or 0 for an automatic step");
  if (!(settings.dt_fraction > 0.0 && settings.dt_fraction <= 1.0))
    throw SceneError("dt_fraction must be in (0, 1]");
  if (!positive(settings.activation_threshold) || !positive(settings.error_tolerance))
    throw SceneError("activation_threshold and error_tolerance must be positive numbers");
  if (!(settings.activation_radius_m >= 0.0 && settings.activation_radius_m <= kLargestInput))
    throw SceneError("activation_radius_m must be a number of metres that is not negative");
  if (!positive(settings.lifetime_s))
    throw SceneError("lifetime_s must be a positive number of seconds");
  if (!usable(settings.gravity_m_s2))
    throw SceneError("gravity_m_s2 must be three finite numbers");
  for (const SurfacePressure& pressure : settings.pressures) {
    if (!std::isfinite(pressure.pressure_pa) || std::abs(pressure.pressure_pa) > kLargestInput)
      throw SceneError("a pressure must be a finite number of pascals");
  }
}

}  // namespace

struct Simulation::Impl {
  Impl(const Lattice& lattice, const std::vector<Material>& materials, const SimulationSettings& settings, int threads);

  double dampingFrequency() const;
  void chooseStep();
  double copiesLimit() const;
  bool hasChips() const;
  void findPressedFaces();
  double stabilityLimit() const;
  void adoptTopology();
  void setLips(std::vector<LipContact> contacts);
  void wakeOtherLips();
  void rebuild();
  void review();
  double threshold();
  void growWhere(const std::vector<FrontierVertex>& frontier, double threshold_m);
  void rest(double threshold_m);
  void wakeCell(std::uint32_t cell);
  void wake(const Box3& rest_box_m);
  void wakeAround(const std::vector<std::uint32_t>& vertices);
  void wakeForPressures();
  void expire();
  void gatherActions();
  void addPressures();
  void gatherTargets();
  void sync() const;
  void touch() { forces_current = false; }
  bool keepsLifetimes() const { return settings.active_set != ActiveSet::kAll; }
  double frontierError() const;
  void addAltitudeForces(const OracleModel& oracle) const;
  double altitudeEnergy(const OracleModel& oracle) const;
  void addLipForces() const;
  double lipsEnergy() const;
  const OracleModel& oracleModel() const;
  const std::vector<Vector3>& forces() const;
  std::vector<std::uint32_t> verticesNear(const Vector3& point_m, double radius_m) const;
  std::vector<std::uint32_t> joinedTo(const std::vector<std::uint32_t>& cells,
                                      const std::vector<std::uint32_t>& vertices) const;
  void hold(const std::string& tool_id, HeldGrip grip);

  const Lattice* lattice;
  const std::vector<Material>* materials;
  SimulationSettings settings;
  int threads;
  LatticeIndex index;
  SpringModel model;
  std::unique_ptr<Solver> solver;
  mutable std::optional<double> limit_s;
  mutable std::optional<double> cell_limit_s;  ///< of one cell by itself
  int substeps = 1;
  std::uint32_t lifetime_steps = 1;

  mutable SimulationState state;
  mutable std::vector<Vector3> positions_m;
  mutable bool current = true;  ///< state holds what the solver holds
  mutable double reach_m = 0.0;

  std::vector<std::uint32_t> active_cells;
  std::vector<std::uint32_t> moving;
  bool active_changed = true;
  std::vector<std::uint8_t> restless;  ///< per vertex, scratch of rest()
  std::vector<VertexMotion> motion;
  std::vector<FrontierVertex> frontier;

  std::vector<LipContact> lips;
  std::vector<LipRow> lip_rows;  ///< of these

  OuterActions actions;
  std::vector<std::array<std::uint32_t, 4>> pressed_faces;
  std::vector<double> pressed_pa;
  SimulationStats stats;
  mutable std::unique_ptr<OracleModel> oracle;
  mutable std::vector<Vector3> forces_n;  ///< on all vertices, for forceOn()
  mutable bool forces_current = false;
};

Simulation::Impl::Impl(const Lattice& l, const std::vector<Material>& m, const SimulationSettings& s, int t)
    : lattice(&l), materials(&m), settings(s), threads(t), index(l) {
  checkSettings(settings);
  for (const Material& material : *materials)
    checkMaterial(material);
  model = makeSpringModel(*lattice, *materials, settings.spring_rule, 0.0);
  const bool damped =
      settings.spring_rule == SpringRule::kIsotropic && std::any_of(m.begin(), m.end(), [](const Material& material) {
        return !material.fixed && material.damping_ratio > 0.0;
      });
  if (damped) {
    const double frequency = dampingFrequency();
    model = makeSpringModel(*lattice, *materials, settings.spring_rule, frequency);
  }
  model.prestress = findPrestress(*lattice, *materials, settings.spring_rule);
  chooseStep();
  solver = makeSolver(settings.precision, *lattice, index, threads);
  state.displacements_m.assign(lattice->vertexCount(), Vector3::Zero());
  state.velocities_m_s.assign(lattice->vertexCount(), Vector3::Zero());
  state.lifetimes.assign(lattice->cellCount(), 0);
  positions_m = lattice->rest_positions;
  findPressedFaces();
  wakeForPressures();
}

/// The slowest mode of the lattice: to it damping ratios refer. A free lattice stretches along its longest side.
double Simulation::Impl::dampingFrequency() const {
  const double lowest = RestSystem(healed(*lattice), settings.spring_rule, model).lowestFrequency();
  if (lowest > 0.0)
    return lowest;
  double speed = std::numeric_limits<double>::infinity();
  for (const Material& material : *materials)
    speed = std::min(speed, std::sqrt(material.youngs_modulus_pa / material.density_kg_m3));
  return M_PI * speed / lattice->spacing_m.cwiseProduct(lattice->dims.cast<double>()).maxCoeff();
}

double Simulation::Impl::stabilityLimit() const {
  if (!limit_s) {
    const double frequency = RestSystem(healed(*lattice), settings.spring_rule, model).largestFrequency();
    limit_s = frequency > 0.0 ? 2.0 / frequency : std::numeric_limits<double>::infinity();
  }
  return *limit_s;
}

/// Copies of cells (incision/embedding.h) may move as freely as a cell by itself, whose limit is lower than that of a
/// whole lattice; it cannot get lower still because stiffness and mass of a copy have the same share. Infinite without
/// copies.
double Simulation::Impl::copiesLimit() const {
  if (std::all_of(lattice->shares.begin(), lattice->shares.end(), [](double share) { return share == 1.0; }))
    return std::numeric_limits<double>::infinity();
  if (!cell_limit_s) {
    double most = 0.0;
    SpringModel slack = model;
    slack.prestress = {};
    for (std::size_t m = 0; m < materials->size(); ++m) {
      if ((*materials)[m].fixed)
        continue;
      const Lattice cell =
          makeLattice(Vector3i::Ones(), lattice->spacing_m, Vector3::Zero(), {static_cast<std::int32_t>(m)});
      most = std::max(most, RestSystem(cell, settings.spring_rule, slack).largestFrequency());
    }
    cell_limit_s = most > 0.0 ? 2.0 / most : std::numeric_limits<double>::infinity();
  }
  return *cell_limit_s;
}

/// Copies that hang on at most one neighbour vibrate almost as freely as a cell by itself.
bool Simulation::Impl::hasChips() const {
  for (std::size_t cell = 0; cell < lattice->cellCount(); ++cell) {
    const auto& neighbours = lattice->face_neighbours[cell];
    if (lattice->shares[cell] < 1.0 &&
        std::count(neighbours.begin(), neighbours.end(), Lattice::kNone) >= std::ptrdiff_t(neighbours.size() - 1))
      return true;
  }
  return false;
}

void Simulation::Impl::chooseStep() {
  const double factor = limitFactor(settings.integrator);
  const bool limited = std::isfinite(factor);
  substeps = 1;
  if (settings.dt_s == 0.0) {
    const double limit = stabilityLimit() * (limited ? factor : usualSteps(settings.integrator));
    settings.dt_s = std::isfinite(limit) ? roundDown(settings.dt_fraction * limit) : 0.001;
  }
  // Figure 4.4 as written knows no limit.
  const bool as_written =
      settings.integrator == Integrator::kDissertation && settings.safe_move == SafeMove::kDissertation;
  if (limited && !as_written && settings.dt_s > factor * model.certain_step_s) {
    const double limit = factor * stabilityLimit();
    if (settings.dt_s > limit && !settings.substeps) {
      throw SceneError("simulation.dt_s " + shortText(settings.dt_s) + " s is beyond the stability limit of " +
                       shortText(limit) +
                       " s: choose a smaller step, `dt_s: auto`, `substeps: true` or the integrator backward_euler");
    }
    if (settings.dt_s > limit)
      substeps = static_cast<int>(std::ceil(settings.dt_s / (settings.dt_fraction * limit)));
  }
  const double reserve = settings.integrator == Integrator::kSymplecticEuler && hasChips() ? kChipStep : 1.0;
  if (limited && !as_written && settings.dt_s > reserve * factor * copiesLimit())
    substeps = std::max(substeps,
                        static_cast<int>(std::ceil(settings.dt_s / (settings.dt_fraction * factor * copiesLimit()))));
  const double steps = std::round(settings.lifetime_s / settings.dt_s);
  lifetime_steps = static_cast<std::uint32_t>(std::min(std::max(steps, 1.0), 4e9));
}

// --- the active set

void Simulation::Impl::wakeCell(std::uint32_t cell) {
  active_changed = active_changed || state.lifetimes[cell] == 0;
  state.lifetimes[cell] = lifetime_steps;
}

void Simulation::Impl::wake(const Box3& rest_box_m) {
  const Vector3 radius = Vector3::Constant(settings.activation_radius_m);
  const Box3 grown(Vector3(rest_box_m.min() - radius), Vector3(rest_box_m.max() + radius));
  forEachCell(*lattice, latticeBox(*lattice, grown), [this](std::uint32_t cell) { wakeCell(cell); });
}

void Simulation::Impl::wakeAround(const std::vector<std::uint32_t>& vertices) {
  Box3 box;
  for (const std::uint32_t v : vertices)
    box.extend(lattice->rest_positions[v]);
  if (!vertices.empty())
    wake(box);
}

/// What presses on a lip belongs into the solve with it.
void Simulation::Impl::wakeOtherLips() {
  for (bool changed = true; changed;) {
    changed = false;
    for (const LipContact& lip : lips) {
      std::uint32_t& a = state.lifetimes[lip.cells[0]];
      std::uint32_t& b = state.lifetimes[lip.cells[1]];
      changed = changed || (a == 0) != (b == 0);
      if (a == 0 || b == 0)
        a = b = std::max(a, b);
    }
  }
}

void Simulation::Impl::rebuild() {
  sync();
  wakeOtherLips();
  active_cells.clear();
  for (std::uint32_t cell = 0; cell < lattice->cellCount(); ++cell) {
    if (settings.active_set == ActiveSet::kAll || state.lifetimes[cell] > 0)
      active_cells.push_back(cell);
  }
  const std::vector<std::uint32_t> before = std::move(moving);
  solver->build(model, active_cells, keepsLifetimes(), state, lips);
  moving = solver->movingVertices();
  for (const std::uint32_t v : before) {
    if (!std::binary_search(moving.begin(), moving.end(), v))
      state.velocities_m_s[v].setZero();
  }
  stats.active_cells = static_cast<std::uint32_t>(active_cells.size());
  stats.active_vertices = static_cast<std::uint32_t>(moving.size());
  actions.loads_changed = true;
  active_changed = false;
}

/// What counts as a move worth following: a share of the deformation that there is or was a moment ago. A slender part
/// answers a small pull with a large move, so the measure cannot be the cell size alone; and the waves that a release
/// leaves are small against what they come from.
double Simulation::Impl::threshold() {
  sync();
  const double h = model.shortest_edge_m;
  double squared = 0.0;
  for (const std::uint32_t v : moving)
    squared = std::max(squared, state.displacements_m[v].squaredNorm());
  const double kept = std::max(0.0, 1.0 - kReviewSteps * settings.dt_s / (kFadingLifetimes * settings.lifetime_s));
  state.deformation_m = std::max(std::sqrt(squared), kept * state.deformation_m);
  return settings.activation_threshold * std::min(h, std::max(kLeastDeformation * h, state.deformation_m));
}

void Simulation::Impl::growWhere(const std::vector<FrontierVertex>& pulled, double threshold_m) {
  const Vector3 rings = (kGrowthRings - 0.5) * lattice->spacing_m;
  for (const FrontierVertex& vertex : pulled) {
    if (vertex.force_n.norm() <= threshold_m * vertex.stiffness_n_m)
      continue;
    const Vector3& at = lattice->rest_positions[vertex.vertex];
    forEachCell(*lattice, latticeBox(*lattice, Box3(Vector3(at - rings), Vector3(at + rings))),
                [this](std::uint32_t cell) { wakeCell(cell); });
  }
}

/// Cells come to rest when none of their vertices would go farther than the threshold within their lifetime, nor is
/// pulled farther.
void Simulation::Impl::rest(double threshold_m) {
  const double span_s = settings.lifetime_s;
  restless.resize(lattice->vertexCount(), 0);
  solver->readMotion(motion);
  for (const VertexMotion& vertex : motion)
    restless[vertex.vertex] = vertex.speed_m_s * span_s > threshold_m || vertex.pull_m > threshold_m ? 1 : 0;
  for (const std::uint32_t cell : active_cells) {
    const auto& vertices = lattice->cells[cell];
    std::uint32_t& lifetime = state.lifetimes[cell];
    if (std::any_of(vertices.begin(), vertices.end(), [this](std::uint32_t v) { return restless[v] != 0; }))
      lifetime = lifetime_steps;
    else
      lifetime -= std::min(lifetime, static_cast<std::uint32_t>(kReviewSteps));
    active_changed = active_changed || lifetime == 0;
  }
  for (const std::uint32_t v : moving)
    restless[v] = 0;
}

/// After every step: who leaves the solve, and who joins.
void Simulation::Impl::review() {
  if (settings.active_set == ActiveSet::kNeighbourhood) {
    for (const std::uint32_t cell : active_cells)
      active_changed = --state.lifetimes[cell] == 0 || active_changed;
  } else if (settings.active_set == ActiveSet::kGrowth && (state.step + 1) % kReviewSteps == 0) {
    const double threshold_m = threshold();
    rest(0.5 * threshold_m);
    solver->readFrontier(frontier);
    growWhere(frontier, threshold_m);
  }
}

/// Summed over everything that is held where it is, not only at the frontier of today: what went to sleep may still
/// lean on what never moved.
double Simulation::Impl::frontierError() const {
  if (!keepsLifetimes())
    return 0.0;
  sync();
  std::vector<Vector3> held_n(lattice->vertexCount(), Vector3::Zero());
  std::vector<std::uint8_t> deformed(lattice->vertexCount(), 0);
  double modulus_pa = 0.0;
  double cells = 0.0;
  for (std::size_t cell = 0; cell < lattice->cellCount(); ++cell) {
    const auto& vertices = lattice->cells[cell];
    const bool at_rest = std::all_of(vertices.begin(), vertices.end(),
                                     [this](std::uint32_t v) { return state.displacements_m[v].isZero(0.0); });
    if (!at_rest || !model.prestress.empty())
      oracleModel().addCellForces(cell, state.displacements_m, held_n);
    if (at_rest)
      continue;
    modulus_pa += lattice->shares[cell] * (*materials)[lattice->materials[cell]].youngs_modulus_pa;
    cells += lattice->shares[cell];
    for (const std::uint32_t v : vertices)
      deformed[v] = 1;
  }
  for (const VertexLoad& load : actions.loads)
    held_n[load.vertex] += load.force_n;
  for (const std::uint32_t v : moving)
    deformed[v] = 0;
  Vector3 force = Vector3::Zero();
  for (std::uint32_t v = 0; v < lattice->vertexCount(); ++v) {
    if (deformed[v] && !isFixed(*lattice, settings.spring_rule, v))
      force += held_n[v];
  }
  if (cells <= 0.0)
    return 0.0;
  const double radius_m = std::cbrt(1.5 / M_PI * cells * lattice->spacing_m.prod());
  return kHalfSpaceYield * force.norm() / (modulus_pa / cells * radius_m);
}

// --- what acts from outside

void Simulation::Impl::expire() {
  for (auto it = state.forces.begin(); it != state.forces.end();) {
    const bool over = it->second.expires_at_step <= state.step;
    actions.loads_changed = actions.loads_changed || over;
    it = over ? state.forces.erase(it) : std::next(it);
  }
  for (auto it = state.grips.begin(); it != state.grips.end();)
    it = it->second.expires_at_step <= state.step ? state.grips.erase(it) : std::next(it);
}

/// The faces of the surface (not of incisions) whose centre lies in the region of a pressure.
void Simulation::Impl::findPressedFaces() {
  for (const SurfacePressure& pressure : settings.pressures) {
    for (std::size_t cell = 0; cell < lattice->cellCount(); ++cell) {
      for (std::size_t face = 0; face < 6; ++face) {
        if (lattice->face_neighbours[cell][face] != Lattice::kNone || lattice->cut_faces[cell][face])
          continue;
        std::array<std::uint32_t, 4> vertices;
        Vector3 centre = Vector3::Zero();
        for (std::size_t n = 0; n < 4; ++n) {
          vertices[n] = lattice->cells[cell][static_cast<std::size_t>(kHexahedronFaces[face][n])];
          centre += 0.25 * lattice->rest_positions[vertices[n]];
        }
        if (!pressure.region_m.contains(centre))
          continue;
        pressed_faces.push_back(vertices);
        pressed_pa.push_back(lattice->surface_shares[cell][face] * pressure.pressure_pa);
      }
    }
  }
}

/// Gravity and pressures act from the start.
void Simulation::Impl::wakeForPressures() {
  if (!settings.gravity_m_s2.isZero(0.0)) {
    for (std::uint32_t cell = 0; cell < lattice->cellCount(); ++cell)
      wakeCell(cell);
  }
  for (const auto& face : pressed_faces)
    wakeAround({face.begin(), face.end()});
}

/// p A n / 4 on each vertex of a face, from its deformed shape.
void Simulation::Impl::addPressures() {
  for (std::size_t n = 0; n < pressed_faces.size(); ++n) {
    const auto& face = pressed_faces[n];
    const Vector3 area =
        0.5 * (positions_m[face[2]] - positions_m[face[0]]).cross(positions_m[face[3]] - positions_m[face[1]]);
    for (const std::uint32_t v : face)
      actions.loads.push_back({v, Vector3(-0.25 * pressed_pa[n] * area)});
  }
}

void Simulation::Impl::gatherTargets() {
  actions.targets.clear();
  std::uint32_t order = 0;
  for (const auto& entry : state.grips) {
    const HeldGrip& grip = entry.second;
    for (std::size_t n = 0; n < grip.vertices.size(); ++n) {
      const std::uint32_t v = grip.vertices[n];
      actions.targets.push_back({v, order, grip.pose * grip.anchors_m[n] - lattice->rest_positions[v]});
    }
    ++order;
  }
  // Where two grips hold a vertex, the first one by name has it.
  std::sort(actions.targets.begin(), actions.targets.end(), [](const Target& a, const Target& b) {
    return a.vertex != b.vertex ? a.vertex < b.vertex : a.order < b.order;
  });
  const auto same = [](const Target& a, const Target& b) { return a.vertex == b.vertex; };
  actions.targets.erase(std::unique(actions.targets.begin(), actions.targets.end(), same), actions.targets.end());
}

void Simulation::Impl::gatherActions() {
  if (!state.grips.empty() || !actions.targets.empty())
    gatherTargets();
  if (!pressed_faces.empty()) {
    sync();
    actions.loads_changed = true;
  }
  if (!actions.loads_changed)
    return;
  actions.loads = state.loads;
  for (const auto& entry : state.forces) {
    const HeldForce& held = entry.second;
    for (std::size_t n = 0; n < held.vertices.size(); ++n)
      actions.loads.push_back({held.vertices[n], Vector3(held.weights[n] * held.force_n)});
  }
  addPressures();
}

void Simulation::Impl::sync() const {
  if (current)
    return;
  solver->readState(state, positions_m);
  double squared = reach_m * reach_m;
  for (const std::uint32_t v : moving)
    squared = std::max(squared, state.displacements_m[v].squaredNorm());
  reach_m = std::sqrt(squared);
  current = true;
}

void Simulation::Impl::adoptTopology() {
  sync();
  for (std::size_t v = state.displacements_m.size(); v < lattice->vertexCount(); ++v) {
    const std::uint32_t origin = lattice->origin_vertices[v];
    state.displacements_m.push_back(state.displacements_m[origin]);
    state.velocities_m_s.push_back(state.velocities_m_s[origin]);
    positions_m.push_back(positions_m[origin]);
  }
  for (std::size_t cell = state.lifetimes.size(); cell < lattice->cellCount(); ++cell)
    state.lifetimes.push_back(state.lifetimes[std::size_t(lattice->cell_at[lattice->parent_cells[cell]])]);
  if (!model.prestress.empty())
    model.prestress.extend(*lattice);
  chooseStep();
  index.refresh();
  oracle.reset();
  pressed_faces.clear();
  pressed_pa.clear();
  findPressedFaces();
  active_changed = true;
}

void Simulation::Impl::setLips(std::vector<LipContact> contacts) {
  for (const LipContact& lip : contacts) {
    require(std::max(lip.cells[0], lip.cells[1]) < lattice->cellCount() && lip.cells[0] != lip.cells[1] &&
                usable(lip.places[0]) && usable(lip.places[1]) && usable(lip.normal) && lip.area_m2 > 0.0 &&
                lip.stiffness_n_m > 0.0 && std::isfinite(lip.opening_n),
            "a contact between lips does not fit the lattice");
  }
  lips = std::move(contacts);
  lip_rows.clear();
  for (const LipContact& lip : lips)
    lip_rows.push_back(makeLipRow(*lattice, lip));
  active_changed = true;
}

/// Kept once it was asked for: tests and validation ask often, the nodes never do.
const OracleModel& Simulation::Impl::oracleModel() const {
  if (!oracle)
    oracle = std::make_unique<OracleModel>(*lattice, *materials, settings.spring_rule, model.prestress);
  return *oracle;
}

const std::vector<Vector3>& Simulation::Impl::forces() const {
  if (forces_current)
    return forces_n;
  sync();
  const OracleModel& oracle = oracleModel();
  forces_n.assign(lattice->vertexCount(), Vector3::Zero());
  oracle.addForces(state.displacements_m, forces_n);
  const std::vector<double> masses = oracleMasses(*lattice, *materials, settings.spring_rule);
  for (std::size_t v = 0; v < forces_n.size(); ++v)
    forces_n[v] += masses[v] * settings.gravity_m_s2;
  std::vector<VertexLoad> loads = state.loads;
  for (const auto& entry : state.forces) {
    const HeldForce& held = entry.second;
    for (std::size_t n = 0; n < held.vertices.size(); ++n)
      loads.push_back({held.vertices[n], Vector3(held.weights[n] * held.force_n)});
  }
  for (const VertexLoad& load : loads)
    forces_n[load.vertex] += load.force_n;
  if (settings.safe_move == SafeMove::kWidth)
    addAltitudeForces(oracle);
  addLipForces();
  forces_current = true;
  return forces_n;
}

/// Altitude springs in the clear form, on all cells.
void Simulation::Impl::addAltitudeForces(const OracleModel& oracle) const {
  for (std::uint32_t cell = 0; cell < lattice->cellCount(); ++cell) {
    const AltitudeSpring spring{altitudeStiffness(*lattice, model, cell), kAltitudeWidth * model.shortest_edge_m};
    const CellCorners corners = oracle.corners(cell, state.displacements_m);
    for (int t = 0; t < 8; ++t) {
      const CornerWidth width = cornerWidthGradient(cornerEdges(corners, t));
      for (std::size_t n = 0; n < 4; ++n)
        forces_n[lattice->cells[cell][kCornerTetrahedra[t][n]]] += spring.force(width.width_m) * width.gradient[n];
    }
  }
}

double Simulation::Impl::altitudeEnergy(const OracleModel& oracle) const {
  double energy = 0.0;
  for (std::uint32_t cell = 0; cell < lattice->cellCount(); ++cell) {
    const AltitudeSpring spring{altitudeStiffness(*lattice, model, cell), kAltitudeWidth * model.shortest_edge_m};
    const CellCorners corners = oracle.corners(cell, state.displacements_m);
    for (int t = 0; t < 8; ++t)
      energy += spring.energy(cornerWidth(cornerEdges(corners, t)));
  }
  return energy;
}

/// Those of the penalty, which are all that there is in equilibrium.
void Simulation::Impl::addLipForces() const {
  const double h = model.shortest_edge_m;
  for (std::size_t n = 0; n < lips.size(); ++n) {
    const LipState lip = lipState(lip_rows[n], state.displacements_m, h);
    const double pressed_n = lip.hold * lipForce(lips[n].stiffness_n_m, lip.gap_m, kLipDepth * h);
    const double energy_j = lipEnergy(lips[n].stiffness_n_m, lip.gap_m, kLipDepth * h);
    for (const LipRow::Corner& corner : lip_rows[n].corners) {
      Vector3 force = corner.weight * ((pressed_n + lips[n].opening_n) * lip.normal + energy_j * lip.slide);
      for (std::size_t k = 0; k < 2; ++k)
        force += corner.along[k] * (pressed_n * lip.tilt[k] + energy_j * lip.shrink[k]);
      forces_n[corner.vertex] += force;
    }
  }
}

double Simulation::Impl::lipsEnergy() const {
  const double h = model.shortest_edge_m;
  double energy = 0.0;
  for (std::size_t n = 0; n < lips.size(); ++n) {
    const LipState lip = lipState(lip_rows[n], state.displacements_m, h);
    energy += lip.hold * lipEnergy(lips[n].stiffness_n_m, lip.gap_m, kLipDepth * h);
  }
  return energy;
}

std::vector<std::uint32_t> Simulation::Impl::verticesNear(const Vector3& point_m, double radius_m) const {
  sync();
  std::vector<std::uint32_t> found;
  const LatticeBox box = latticeBox(*lattice, boxAround(point_m, radius_m + reach_m));
  for (int k = box.begin.z(); k <= box.end.z(); ++k) {
    for (int j = box.begin.y(); j <= box.end.y(); ++j) {
      for (int i = box.begin.x(); i <= box.end.x(); ++i) {
        index.forEachVertex(lattice->latticeNode(i, j, k), [&](std::uint32_t v) {
          if ((positions_m[v] - point_m).squaredNorm() < radius_m * radius_m)
            found.push_back(v);
        });
      }
    }
  }
  std::sort(found.begin(), found.end());
  return found;
}

// Of some vertices, increasing, those that are as many cells away from given cells through tissue as they are through
// space, or one more: an incision between them makes the way longer. Without replicas there is no incision near.
std::vector<std::uint32_t> Simulation::Impl::joinedTo(const std::vector<std::uint32_t>& cells,
                                                      const std::vector<std::uint32_t>& vertices) const {
  const auto whole = [this](std::uint32_t v) { return lattice->origin_vertices[v] == v; };
  if (std::all_of(vertices.begin(), vertices.end(), whole))
    return vertices;
  constexpr int kFar = std::numeric_limits<int>::max();
  std::vector<int> rings(vertices.size(), kFar);
  std::vector<std::uint8_t> seen(lattice->cellCount(), 0);
  std::vector<std::uint32_t> now = cells;
  std::vector<std::uint32_t> next;
  for (int ring = 0; !now.empty(); ++ring, now.swap(next)) {
    next.clear();
    for (const std::uint32_t cell : now)
      seen[cell] = 1;
    for (const std::uint32_t cell : now) {
      for (const std::uint32_t v : lattice->cells[cell]) {
        const auto at = std::lower_bound(vertices.begin(), vertices.end(), v);
        if (at == vertices.end() || *at != v || rings[std::size_t(at - vertices.begin())] != kFar ||
            ring > ringsApart(*lattice, cells, v) + 1)
          continue;
        rings[std::size_t(at - vertices.begin())] = ring;
        index.forEachCell(v, [&](const CellCorner& around) {
          if (seen[around.cell] == 0)
            next.push_back(around.cell);
        });
      }
    }
    std::sort(next.begin(), next.end());
    next.erase(std::unique(next.begin(), next.end()), next.end());
  }
  std::vector<std::uint32_t> joined;
  for (std::size_t n = 0; n < vertices.size(); ++n) {
    if (rings[n] != kFar)
      joined.push_back(vertices[n]);
  }
  return joined;
}

void Simulation::Impl::hold(const std::string& tool_id, HeldGrip grip) {
  wakeAround(grip.vertices);
  state.grips[tool_id] = std::move(grip);
  touch();
}

// --- the public face

Simulation::Simulation(const Lattice& lattice, const std::vector<Material>& materials,
                       const SimulationSettings& settings, int threads)
    : impl_(std::make_unique<Impl>(lattice, materials, settings, threads)) {}
Simulation::Simulation(Simulation&&) noexcept = default;
Simulation& Simulation::operator=(Simulation&&) noexcept = default;
Simulation::~Simulation() = default;

bool Simulation::holdForce(const std::string& tool_id, const Vector3& force_n, const Vector3& point_m, double radius_m,
                           std::uint64_t expires_at_step, const std::vector<std::uint32_t>& cells) {
  require(usable(force_n), "a force must be three finite numbers of newtons");
  require(usable(point_m) && radius_m > 0.0 && radius_m <= kLargestInput,
          "the place of a force must be a finite point and a positive radius");
  HeldForce held;
  held.vertices = impl_->verticesNear(point_m, radius_m);
  if (!cells.empty())
    held.vertices = impl_->joinedTo(cells, held.vertices);
  double total = 0.0;
  for (const std::uint32_t v : held.vertices) {
    const double distance = (impl_->positions_m[v] - point_m).norm();
    held.weights.push_back(mass(v) * footprintWeight(distance, radius_m));
    total += held.weights.back();
  }
  if (total <= 0.0)
    return false;
  Vector3 rest_centre = Vector3::Zero();
  for (std::size_t n = 0; n < held.vertices.size(); ++n) {
    held.weights[n] /= total;
    rest_centre += held.weights[n] * impl_->lattice->rest_positions[held.vertices[n]];
  }
  held.force_n = force_n;
  held.point_m = point_m;
  held.expires_at_step = expires_at_step;
  if (impl_->settings.active_set == ActiveSet::kGrowth)
    impl_->wakeAround(held.vertices);
  else
    impl_->wake(boxAround(rest_centre, 0.0));
  impl_->state.forces[tool_id] = std::move(held);
  impl_->actions.loads_changed = true;
  impl_->touch();
  return true;
}

void Simulation::releaseForce(const std::string& tool_id) {
  const auto it = impl_->state.forces.find(tool_id);
  if (it == impl_->state.forces.end())
    return;
  impl_->wakeAround(it->second.vertices);
  impl_->state.forces.erase(it);
  impl_->actions.loads_changed = true;
  impl_->touch();
}

bool Simulation::closeGrip(const std::string& tool_id, const Vector3& point_m, double radius_m, const Pose& pose,
                           std::uint64_t expires_at_step) {
  require(usable(point_m) && radius_m > 0.0 && radius_m <= kLargestInput,
          "the place of a grip must be a finite point and a positive radius");
  const std::vector<std::uint32_t> vertices = impl_->verticesNear(point_m, radius_m);
  if (vertices.empty())
    return false;
  gripVertices(tool_id, vertices, pose, expires_at_step);
  return true;
}

void Simulation::gripVertices(const std::string& tool_id, const std::vector<std::uint32_t>& vertices, const Pose& pose,
                              std::uint64_t expires_at_step) {
  std::vector<Vector3> targets;
  for (const std::uint32_t v : vertices) {
    require(v < impl_->lattice->vertexCount(), "a grip names a vertex that does not exist");
    targets.push_back(positions()[v]);
  }
  require(isUsable(pose) && usable(pose.position_m), "a grip's pose must be finite with a unit quaternion");
  leadVertices(tool_id, vertices, targets, expires_at_step);
  HeldGrip& grip = impl_->state.grips[tool_id];
  grip.pose = {pose.position_m, pose.orientation.normalized()};
  const Pose inverse = grip.pose.inverse();
  for (Vector3& anchor : grip.anchors_m)
    anchor = inverse * anchor;
}

void Simulation::leadVertices(const std::string& tool_id, const std::vector<std::uint32_t>& vertices,
                              const std::vector<Vector3>& targets_m, std::uint64_t expires_at_step) {
  require(vertices.size() == targets_m.size(), "a grip needs one place for every vertex");
  HeldGrip grip;
  grip.expires_at_step = expires_at_step;
  std::map<std::uint32_t, Vector3> sorted;
  for (std::size_t n = 0; n < vertices.size(); ++n) {
    require(vertices[n] < impl_->lattice->vertexCount(), "a grip names a vertex that does not exist");
    require(usable(targets_m[n]), "a grip's place must be three finite numbers");
    if (!isFixed(*impl_->lattice, impl_->settings.spring_rule, vertices[n]))
      sorted[vertices[n]] = targets_m[n];
  }
  for (const auto& entry : sorted) {
    grip.vertices.push_back(entry.first);
    grip.anchors_m.push_back(entry.second);
  }
  impl_->hold(tool_id, std::move(grip));
}

bool Simulation::moveGrip(const std::string& tool_id, const Pose& pose, std::uint64_t expires_at_step) {
  require(isUsable(pose) && usable(pose.position_m), "a grip's pose must be finite with a unit quaternion");
  const auto it = impl_->state.grips.find(tool_id);
  if (it == impl_->state.grips.end())
    return false;
  it->second.pose = {pose.position_m, pose.orientation.normalized()};
  it->second.expires_at_step = expires_at_step;
  impl_->wakeAround(it->second.vertices);
  return true;
}

void Simulation::releaseGrip(const std::string& tool_id) {
  const auto it = impl_->state.grips.find(tool_id);
  if (it == impl_->state.grips.end())
    return;
  impl_->wakeAround(it->second.vertices);
  impl_->state.grips.erase(it);
}

void Simulation::setLoads(const std::vector<VertexLoad>& loads) {
  for (const VertexLoad& load : loads) {
    require(load.vertex < impl_->lattice->vertexCount(), "a load names a vertex that does not exist");
    require(usable(load.force_n), "a load must be three finite numbers of newtons");
  }
  for (const VertexLoad& load : impl_->state.loads)
    impl_->wakeAround({load.vertex});
  for (const VertexLoad& load : loads)
    impl_->wakeAround({load.vertex});
  impl_->state.loads = loads;
  std::stable_sort(impl_->state.loads.begin(), impl_->state.loads.end(),
                   [](const VertexLoad& a, const VertexLoad& b) { return a.vertex < b.vertex; });
  impl_->actions.loads_changed = true;
  impl_->touch();
}

void Simulation::wake(const Box3& rest_box_m) {
  impl_->wake(rest_box_m);
}

void Simulation::wakeAll() {
  for (std::uint32_t cell = 0; cell < impl_->lattice->cellCount(); ++cell)
    impl_->wakeCell(cell);
}

void Simulation::step() {
  Impl& impl = *impl_;
  impl.expire();
  if (impl.active_changed)
    impl.rebuild();
  impl.gatherActions();
  impl.actions.step = impl.state.step;
  const double part_s = impl.settings.dt_s / impl.substeps;
  for (int n = 0; n < impl.substeps; ++n) {
    impl.solver->step(impl.settings, part_s, impl.actions, impl.stats);
    impl.actions.loads_changed = false;
  }
  impl.current = false;
  impl.touch();
  impl.review();
  // Now rather than with the next step: what leaves the solve comes to rest, and a state saved here must say so.
  if (impl.active_changed)
    impl.rebuild();
  ++impl.state.step;
}

void Simulation::setIntegrator(Integrator integrator, double dt_s) {
  const SimulationSettings before = impl_->settings;
  impl_->settings.integrator = integrator;
  impl_->settings.dt_s = dt_s;
  try {
    checkSettings(impl_->settings);
    impl_->chooseStep();
    impl_->sync();
    // A new one: what only the integrator before needed goes with the old.
    impl_->solver = makeSolver(before.precision, *impl_->lattice, impl_->index, impl_->threads);
    impl_->active_changed = true;
  } catch (const Error&) {
    impl_->settings = before;
    impl_->chooseStep();
    throw;
  }
}

void Simulation::adoptTopology() {
  impl_->adoptTopology();
  impl_->touch();
}

void Simulation::setLips(std::vector<LipContact> lips) {
  impl_->setLips(std::move(lips));
  impl_->touch();
}

void Simulation::restore(SimulationState state) {
  const Lattice& lattice = *impl_->lattice;
  const auto allUsable = [](const std::vector<Vector3>& values) {
    return std::all_of(values.begin(), values.end(), usable);
  };
  const auto exists = [&](std::uint32_t v) { return v < lattice.vertexCount(); };
  const auto allExist = [&](const std::vector<std::uint32_t>& v) { return std::all_of(v.begin(), v.end(), exists); };
  require(state.displacements_m.size() == lattice.vertexCount() &&
              state.velocities_m_s.size() == lattice.vertexCount() && state.lifetimes.size() == lattice.cellCount(),
          "the saved state belongs to another lattice: its vertex or cell count differs");
  require(std::isfinite(state.deformation_m) && state.deformation_m >= 0.0,
          "the saved state's largest deformation is not a number of metres");
  require(allUsable(state.displacements_m) && allUsable(state.velocities_m_s),
          "the saved state holds a displacement or velocity that is not a finite number");
  for (const auto& entry : state.forces) {
    const HeldForce& held = entry.second;
    require(held.vertices.size() == held.weights.size() && usable(held.force_n) && usable(held.point_m) &&
                allExist(held.vertices) &&
                std::all_of(held.weights.begin(), held.weights.end(), [](double w) { return w >= 0.0 && w <= 1.0; }),
            "the saved state holds a force that does not fit the lattice");
  }
  for (const auto& entry : state.grips) {
    const HeldGrip& grip = entry.second;
    require(grip.vertices.size() == grip.anchors_m.size() && allUsable(grip.anchors_m) && allExist(grip.vertices) &&
                isUsable(grip.pose) && usable(grip.pose.position_m),
            "the saved state holds a grip that does not fit the lattice");
  }
  for (const VertexLoad& load : state.loads)
    require(exists(load.vertex) && usable(load.force_n), "the saved state holds a load that does not fit the lattice");
  impl_->state = std::move(state);
  impl_->chooseStep();
  impl_->current = true;
  impl_->moving.clear();
  for (std::size_t v = 0; v < lattice.vertexCount(); ++v)
    impl_->positions_m[v] = lattice.rest_positions[v] + impl_->state.displacements_m[v];
  impl_->reach_m = maxDisplacement();
  impl_->actions.loads_changed = true;
  impl_->active_changed = true;
  impl_->touch();
}

const SimulationState& Simulation::state() const {
  impl_->sync();
  return impl_->state;
}

const std::vector<Vector3>& Simulation::positions() const {
  impl_->sync();
  return impl_->positions_m;
}

const SimulationSettings& Simulation::settings() const {
  return impl_->settings;
}

int Simulation::threads() const {
  return impl_->threads;
}

std::uint64_t Simulation::steps() const {
  return impl_->state.step;
}

SimulationStats Simulation::stats() const {
  SimulationStats stats = impl_->stats;
  stats.frontier_error_m = impl_->frontierError();
  return stats;
}

double Simulation::stabilityLimit() const {
  return impl_->stabilityLimit();
}

int Simulation::substeps() const {
  return impl_->substeps;
}

double Simulation::reach() const {
  impl_->sync();
  return impl_->reach_m;
}

std::size_t Simulation::activeCells() const {
  return impl_->active_cells.size();
}

double Simulation::maxDisplacement() const {
  double squared = 0.0;
  for (const Vector3& u : state().displacements_m)
    squared = std::max(squared, u.squaredNorm());
  return std::sqrt(squared);
}

double Simulation::maxSpeed() const {
  double squared = 0.0;
  for (const Vector3& v : velocities())
    squared = std::max(squared, v.squaredNorm());
  return std::sqrt(squared);
}

std::vector<std::uint32_t> Simulation::verticesNear(const Vector3& point_m, double radius_m) const {
  return impl_->verticesNear(point_m, radius_m);
}

std::vector<std::uint32_t> Simulation::cellsNear(const Vector3& point_m, double radius_m) const {
  const std::vector<Vector3>& positions_m = positions();
  std::vector<std::uint32_t> found;
  const LatticeBox box = latticeBox(*impl_->lattice, boxAround(point_m, radius_m + impl_->reach_m));
  forEachCell(*impl_->lattice, box, [&](std::uint32_t cell) {
    const auto near = [&](std::uint32_t v) { return (positions_m[v] - point_m).squaredNorm() < radius_m * radius_m; };
    const auto& vertices = impl_->lattice->cells[cell];
    if (std::any_of(vertices.begin(), vertices.end(), near))
      found.push_back(cell);
  });
  return found;
}

double Simulation::minWidth() const {
  return oracleMinWidth(*impl_->lattice, state().displacements_m);
}

Vector3 Simulation::forceOn(std::uint32_t vertex) const {
  return impl_->forces()[vertex];
}

double Simulation::mass(std::uint32_t vertex) const {
  const Lattice& lattice = *impl_->lattice;
  double mass_kg = 0.0;
  impl_->index.forEachCell(vertex, [&](const CellCorner& at) {
    mass_kg += lattice.shares[at.cell] * impl_->model.materials[lattice.materials[at.cell]].corner_mass_kg;
  });
  const bool heavy = impl_->settings.spring_rule == SpringRule::kDissertation && impl_->lattice->fixed[vertex];
  return heavy ? kDissertationRigidMass * mass_kg : mass_kg;
}

Mechanics Simulation::mechanics() const {
  const Impl& impl = *impl_;
  const SimulationState& now = state();
  const OracleModel& oracle = impl.oracleModel();
  Mechanics mechanics;
  mechanics.elastic_j = oracle.energy(now.displacements_m);
  if (impl.settings.safe_move == SafeMove::kWidth)
    mechanics.elastic_j += impl.altitudeEnergy(oracle);
  mechanics.elastic_j += impl.lipsEnergy();
  const std::vector<double> masses = oracleMasses(*impl.lattice, *impl.materials, impl.settings.spring_rule);
  for (std::size_t v = 0; v < masses.size(); ++v) {
    const Vector3 momentum = masses[v] * now.velocities_m_s[v];
    mechanics.kinetic_j += 0.5 * momentum.dot(now.velocities_m_s[v]);
    mechanics.linear_momentum_kg_m_s += momentum;
    mechanics.angular_momentum_kg_m2_s += impl.positions_m[v].cross(momentum);
  }
  return mechanics;
}

std::vector<MemoryUse> Simulation::memory() const {
  const Impl& impl = *impl_;
  const Lattice& lattice = *impl.lattice;
  const auto bytes = [](const auto& values) { return values.capacity() * sizeof(values[0]); };
  std::vector<MemoryUse> table;
  table.push_back({"lattice", bytes(lattice.cells) + bytes(lattice.parent_cells) + bytes(lattice.materials) +
                                  bytes(lattice.rest_stretch) + bytes(lattice.face_neighbours) +
                                  bytes(lattice.cut_faces) + bytes(lattice.rest_positions) + bytes(lattice.fixed) +
                                  bytes(lattice.origin_vertices) + bytes(lattice.lattice_nodes) +
                                  bytes(lattice.cell_at) + bytes(lattice.shares) + bytes(lattice.surface_shares) +
                                  bytes(lattice.next_cells) + impl.index.bytes()});
  table.push_back({"state", bytes(impl.state.displacements_m) + bytes(impl.state.velocities_m_s) +
                                bytes(impl.state.lifetimes) + bytes(impl.positions_m)});
  table.push_back({"active set", bytes(impl.active_cells) + bytes(impl.moving) + bytes(impl.restless) +
                                     bytes(impl.motion) + bytes(impl.frontier)});
  impl.solver->addMemory(table);
  return table;
}

std::uint64_t Simulation::stateHash() const {
  return hashVector(state().velocities_m_s, hashVector(state().displacements_m));
}

}  // namespace soft_volume::core
