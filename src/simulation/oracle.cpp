#include "soft_volume/simulation/oracle.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <utility>

#include "soft_volume/simulation/prestress.h"

namespace soft_volume::core {
namespace {

constexpr double kEdgeFraction = 0.4;         // of its shortest edge that a vertex may move in a step
constexpr double kMoveCap = 0.5;              // of h
constexpr double kLeastWidth = 0.02;          // of h
constexpr double kWidthFraction = 0.499;      // of the width above the least that a capped vertex may move
constexpr double kAltitudeLimit = 0.3;        // of h
constexpr double kAltitudeStiffness = 4.0;    // of k
constexpr double kCubicEdgeStiffness = 0.35;  // k / (mu h), the edge of a cubic cell
constexpr double kForceBound = 0.25;          // of h times the stiffness of a vertex's springs
constexpr int kHalvings = 2;                  // before a move is capped

/// Products of the signs of a corner's coordinates along two axes: y z, z x, x y.
constexpr double kHourglassSigns[8][3] = {{1, 1, 1},   {1, -1, -1}, {-1, -1, 1}, {-1, 1, -1},
                                          {-1, -1, 1}, {-1, 1, -1}, {1, 1, 1},   {1, -1, -1}};

Vector3 cornerOffset(int corner, const Vector3& spacing_m) {
  const int* c = kHexahedronCorners[corner];
  return spacing_m.cwiseProduct(Vector3(c[0], c[1], c[2]));
}

CellCorners boxCorners(const Vector3& spacing_m) {
  CellCorners corners;
  for (int c = 0; c < 8; ++c)
    corners[c] = cornerOffset(c, spacing_m);
  return corners;
}

CellCorners noForces() {
  CellCorners forces;
  forces.fill(Vector3::Zero());
  return forces;
}

/// Of the springs of a cell, on its corners.
void addSpringForces(const CellCorners& corners, const std::array<double, 28>& stiffness_n_m,
                     const std::array<double, 28>& rest_length_m, CellCorners& forces_n) {
  for (std::size_t s = 0; s < kCornerPairs.size(); ++s) {
    const CornerPair& pair = kCornerPairs[s];
    const Vector3 d = corners[pair.b] - corners[pair.a];
    const double length = d.norm();
    if (length <= 0.0)
      continue;  // no direction to push in; the other springs part the two
    const Vector3 force = (stiffness_n_m[s] * (length - rest_length_m[s]) / length) * d;
    forces_n[pair.a] += force;
    forces_n[pair.b] -= force;
  }
}

/// Sums of g x of bendingRelief(), one for each pair of axes.
std::array<Vector3, 3> hourglassSums(const CellCorners& corners) {
  std::array<Vector3, 3> sums = {Vector3::Zero(), Vector3::Zero(), Vector3::Zero()};
  for (int c = 0; c < 8; ++c) {
    for (int mode = 0; mode < 3; ++mode)
      sums[mode] += kHourglassSigns[c][mode] * corners[c];
  }
  return sums;
}

void addReliefForces(const CellCorners& corners, double relief_n_m, CellCorners& forces_n) {
  const std::array<Vector3, 3> sums = hourglassSums(corners);
  for (int c = 0; c < 8; ++c) {
    for (int mode = 0; mode < 3; ++mode)
      forces_n[c] += relief_n_m / 8.0 * kHourglassSigns[c][mode] * sums[mode];
  }
}

double reliefEnergy(const CellCorners& corners, double relief_n_m) {
  double squared = 0.0;
  for (const Vector3& sum : hourglassSums(corners))
    squared += sum.squaredNorm();
  return -relief_n_m / 16.0 * squared;
}

double meanDeterminant(const CellCorners& corners) {
  double sum = 0.0;
  for (int t = 0; t < 8; ++t)
    sum += cornerEdges(corners, t).determinant();
  return sum / 8.0;
}

/// -kappa (J - 1) times the gradient of the mean determinant.
void addVolumeForces(const CellCorners& corners, double modulus_pa, double rest_m3, CellCorners& forces_n) {
  const double scale = -modulus_pa * (meanDeterminant(corners) / rest_m3 - 1.0) / 8.0;
  for (int t = 0; t < 8; ++t) {
    const CornerEdges e = cornerEdges(corners, t);
    const Vector3 a = scale * e.b.cross(e.c);
    const Vector3 b = scale * e.c.cross(e.a);
    const Vector3 c = scale * e.a.cross(e.b);
    const std::uint8_t* v = kCornerTetrahedra[t];
    forces_n[v[0]] -= a + b + c;
    forces_n[v[1]] += a;
    forces_n[v[2]] += b;
    forces_n[v[3]] += c;
  }
}

double springEnergy(const CellCorners& corners, const std::array<double, 28>& stiffness_n_m,
                    const std::array<double, 28>& rest_length_m) {
  double energy = 0.0;
  for (std::size_t s = 0; s < kCornerPairs.size(); ++s) {
    const double stretch = (corners[kCornerPairs[s].b] - corners[kCornerPairs[s].a]).norm() - rest_length_m[s];
    energy += 0.5 * stiffness_n_m[s] * stretch * stretch;
  }
  return energy;
}

std::array<double, 28> pairLengths(const CellCorners& corners) {
  std::array<double, 28> lengths{};
  for (std::size_t s = 0; s < kCornerPairs.size(); ++s)
    lengths[s] = (corners[kCornerPairs[s].b] - corners[kCornerPairs[s].a]).norm();
  return lengths;
}

std::pair<std::uint32_t, std::uint32_t> pairVertices(const Lattice& lattice, std::size_t cell, const CornerPair& pair) {
  return std::minmax({lattice.cells[cell][pair.a], lattice.cells[cell][pair.b]});
}

}  // namespace

OracleModel::OracleModel(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule)
    : OracleModel(lattice, materials, rule, findPrestress(lattice, materials, rule)) {}

OracleModel::OracleModel(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule,
                         Prestress prestress)
    : lattice_(&lattice), rest_corners_(boxCorners(lattice.spacing_m)), prestress_(std::move(prestress)) {
  if (rule == SpringRule::kDissertation) {
    volume_modulus_pa_.assign(materials.size(), 0.0);
    relief_n_m_.assign(materials.size(), 0.0);
    useDissertationRule(dissertationStrength(lattice, materials));
  } else {
    useIsotropicRule(materials);
  }
  findRestShapes();
}

void OracleModel::useIsotropicRule(const std::vector<Material>& materials) {
  for (const Material& material : materials) {
    const ElasticConstants constants = elasticConstants(material.youngs_modulus_pa, material.poisson_ratio);
    const CellSprings springs = isotropicSprings(constants, lattice_->spacing_m);
    PerPair row{};
    for (std::size_t s = 0; s < row.size(); ++s)
      row[s] = springStiffness(springs, kCornerPairs[s]);
    stiffness_n_m_.push_back(row);
    volume_modulus_pa_.push_back(constants.volume_pa);
    relief_n_m_.push_back(bendingRelief(springs, lattice_->spacing_m));
  }
  stiffness_row_.assign(lattice_->materials.begin(), lattice_->materials.end());
}

void OracleModel::useDissertationRule(double strength_n_m) {
  // Cells at one place count once: together they are one cell.
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::set<std::uint32_t>> owners;
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    for (const CornerPair& pair : kCornerPairs)
      owners[pairVertices(*lattice_, cell, pair)].insert(lattice_->parent_cells[cell]);
  }
  stiffness_n_m_.resize(lattice_->cellCount());
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    for (std::size_t s = 0; s < kCornerPairs.size(); ++s)
      stiffness_n_m_[cell][s] = strength_n_m / double(owners[pairVertices(*lattice_, cell, kCornerPairs[s])].size());
    stiffness_row_.push_back(static_cast<std::uint32_t>(cell));
  }
}

void OracleModel::findRestShapes() {
  rest_length_m_.push_back(pairLengths(rest_corners_));
  length_row_.assign(lattice_->cellCount(), 0);
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    if (prestress_.empty() && lattice_->rest_stretch[cell] == Vector3::Ones())
      continue;
    length_row_[cell] = static_cast<std::uint32_t>(rest_length_m_.size());
    rest_length_m_.push_back(restLengths(cell));
  }
}

OracleModel::PerPair OracleModel::restLengths(std::size_t cell) const {
  PerPair lengths = pairLengths(boxCorners(lattice_->spacing_m.cwiseProduct(lattice_->rest_stretch[cell])));
  for (std::size_t s = 0; s < kCornerPairs.size() && !prestress_.empty(); ++s) {
    const CornerPair& pair = kCornerPairs[s];
    const Vector3 way = rest_corners_[pair.b] - rest_corners_[pair.a];
    const Vector3 slack =
        prestress_.slack_m[lattice_->cells[cell][pair.b]] - prestress_.slack_m[lattice_->cells[cell][pair.a]];
    lengths[s] *= 1.0 / prestress_.stretchOf(*lattice_, cell) - way.dot(slack) / way.squaredNorm();
  }
  return lengths;
}

OracleModel::Volume OracleModel::volume(std::size_t cell) const {
  const std::uint16_t material = lattice_->materials[cell];
  const double slack = prestress_.empty() ? 1.0 : prestress_.volume(*lattice_, cell);
  return {volume_modulus_pa_[material], lattice_->spacing_m.prod() * lattice_->rest_stretch[cell].prod() * slack};
}

CellCorners OracleModel::corners(std::size_t cell, const std::vector<Vector3>& displacements_m) const {
  CellCorners corners = rest_corners_;
  for (int c = 0; c < 8; ++c)
    corners[c] += displacements_m[lattice_->cells[cell][c]];
  return corners;
}

void OracleModel::addCellForces(std::size_t cell, const std::vector<Vector3>& displacements_m,
                                std::vector<Vector3>& forces_n) const {
  const CellCorners here = corners(cell, displacements_m);
  const double share = lattice_->shares[cell];
  CellCorners forces = noForces();
  addSpringForces(here, stiffness_n_m_[stiffness_row_[cell]], rest_length_m_[length_row_[cell]], forces);
  addReliefForces(here, relief_n_m_[lattice_->materials[cell]], forces);
  const Volume rest = volume(cell);
  if (rest.modulus_pa > 0.0)
    addVolumeForces(here, rest.modulus_pa, rest.rest_m3, forces);
  for (int c = 0; c < 8; ++c)
    forces_n[lattice_->cells[cell][c]] += share * forces[c];
}

void OracleModel::addForces(const std::vector<Vector3>& displacements_m, std::vector<Vector3>& forces_n) const {
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell)
    addCellForces(cell, displacements_m, forces_n);
}

double OracleModel::energy(const std::vector<Vector3>& displacements_m) const {
  double energy = 0.0;
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    const double share = lattice_->shares[cell];
    const CellCorners here = corners(cell, displacements_m);
    energy += share * springEnergy(here, stiffness_n_m_[stiffness_row_[cell]], rest_length_m_[length_row_[cell]]);
    energy += share * reliefEnergy(here, relief_n_m_[lattice_->materials[cell]]);
    const Volume rest = volume(cell);
    const double growth = meanDeterminant(here) / rest.rest_m3 - 1.0;
    energy += share * (0.5 * rest.modulus_pa * rest.rest_m3 * growth * growth);
  }
  return energy;
}

std::vector<double> OracleModel::stiffnessSums() const {
  std::vector<double> sums(lattice_->vertexCount(), 0.0);
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    for (std::size_t s = 0; s < kCornerPairs.size(); ++s) {
      const double k = lattice_->shares[cell] * stiffness_n_m_[stiffness_row_[cell]][s];
      sums[lattice_->cells[cell][kCornerPairs[s].a]] += k;
      sums[lattice_->cells[cell][kCornerPairs[s].b]] += k;
    }
  }
  return sums;
}

std::vector<Vector3> oracleForces(const Lattice& lattice, const std::vector<Material>& materials,
                                  const std::vector<Vector3>& displacements_m, SpringRule rule) {
  std::vector<Vector3> forces(lattice.vertexCount(), Vector3::Zero());
  OracleModel(lattice, materials, rule).addForces(displacements_m, forces);
  return forces;
}

double oracleEnergy(const Lattice& lattice, const std::vector<Material>& materials,
                    const std::vector<Vector3>& displacements_m, SpringRule rule) {
  return OracleModel(lattice, materials, rule).energy(displacements_m);
}

std::vector<double> oracleMasses(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule) {
  std::vector<double> masses(lattice.vertexCount(), 0.0);
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    for (const std::uint32_t v : lattice.cells[cell])
      masses[v] +=
          lattice.shares[cell] * (materials[lattice.materials[cell]].density_kg_m3 * lattice.spacing_m.prod() / 8.0);
  }
  if (rule != SpringRule::kDissertation)
    return masses;
  for (std::size_t v = 0; v < masses.size(); ++v)
    masses[v] *= lattice.fixed[v] ? kDissertationRigidMass : 1.0;
  return masses;
}

double oracleMinWidth(const Lattice& lattice, const std::vector<Vector3>& displacements_m) {
  double least = std::numeric_limits<double>::infinity();
  for (const auto& cell : lattice.cells) {
    CellCorners corners = boxCorners(lattice.spacing_m);
    for (int c = 0; c < 8; ++c)
      corners[c] += displacements_m[cell[c]];
    least = std::min(least, cellMinWidth(corners));
  }
  return least;
}

OracleSimulation::OracleSimulation(const Lattice& lattice, const std::vector<Material>& materials,
                                   const OracleSettings& settings)
    : lattice_(&lattice),
      settings_(settings),
      model_(lattice, materials, settings.spring_rule),
      shortest_edge_m_(lattice.spacing_m.minCoeff()),
      masses_kg_(oracleMasses(lattice, materials, settings.spring_rule)),
      movable_(lattice.vertexCount(), 1),
      force_bounds_n_(model_.stiffnessSums()) {
  for (const Material& material : materials) {
    const double k = kCubicEdgeStiffness * shortest_edge_m_ *
                     elasticConstants(material.youngs_modulus_pa, material.poisson_ratio).mu_pa;
    altitude_springs_.push_back({kAltitudeStiffness * k, kAltitudeLimit * shortest_edge_m_});
  }
  for (double& bound : force_bounds_n_)
    bound *= kForceBound * shortest_edge_m_;
  if (settings.spring_rule == SpringRule::kIsotropic) {
    for (std::size_t v = 0; v < movable_.size(); ++v)
      movable_[v] = lattice.fixed[v] ? 0 : 1;
  }
  for (auto* per_vertex : {&displacements_m_, &velocities_m_s_, &external_n_, &forces_n_, &moves_m_, &ends_m_})
    per_vertex->assign(lattice.vertexCount(), Vector3::Zero());
  widths_m_.resize(lattice.cellCount());
  room_m_.resize(lattice.vertexCount());
  shortest_squared_m2_.resize(lattice.vertexCount());
  tries_.resize(lattice.vertexCount());
  flagged_.resize(lattice.vertexCount());
}

void OracleSimulation::setForces(const std::vector<Vector3>& forces_n) {
  assert(forces_n.size() == lattice_->vertexCount());
  external_n_ = forces_n;
  if (settings_.guard)
    boundForces();
}

void OracleSimulation::boundForces() {
  for (std::size_t v = 0; v < external_n_.size(); ++v) {
    const double largest = external_n_[v].cwiseAbs().maxCoeff();
    if (largest <= 0.0)
      continue;
    const double length = (external_n_[v] / largest).norm();  // the square of 1e200 is beyond double
    if (largest > force_bounds_n_[v] / length)
      external_n_[v] *= force_bounds_n_[v] / length / largest;
  }
}

void OracleSimulation::setState(const std::vector<Vector3>& displacements_m,
                                const std::vector<Vector3>& velocities_m_s) {
  assert(displacements_m.size() == lattice_->vertexCount() && velocities_m_s.size() == lattice_->vertexCount());
  displacements_m_ = displacements_m;
  velocities_m_s_ = velocities_m_s;
}

void OracleSimulation::step() {
  std::fill(forces_n_.begin(), forces_n_.end(), Vector3::Zero());
  model_.addForces(displacements_m_, forces_n_);
  if (settings_.guard)
    findRoom();
  proposeMoves();
  if (settings_.guard)
    guardMoves();
  applyMoves();
}

/// Widths and edges before the step, and the altitude springs that need the widths.
void OracleSimulation::findRoom() {
  std::fill(room_m_.begin(), room_m_.end(), std::numeric_limits<double>::infinity());
  std::fill(shortest_squared_m2_.begin(), shortest_squared_m2_.end(), std::numeric_limits<double>::infinity());
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    const CellCorners corners = model_.corners(cell, displacements_m_);
    AltitudeSpring spring = altitude_springs_[lattice_->materials[cell]];
    spring.stiffness_n_m *= lattice_->shares[cell];
    for (int t = 0; t < 8; ++t) {
      const CornerEdges edges = cornerEdges(corners, t);
      const double width = cornerWidth(edges);
      widths_m_[cell][t] = width;
      for (const std::uint8_t c : kCornerTetrahedra[t])
        room_m_[lattice_->cells[cell][c]] = std::min(room_m_[lattice_->cells[cell][c]], width);
      double& shortest = shortest_squared_m2_[lattice_->cells[cell][kCornerTetrahedra[t][0]]];
      shortest = std::min({shortest, edges.a.squaredNorm(), edges.b.squaredNorm(), edges.c.squaredNorm()});
      if (width >= spring.limit_m)
        continue;
      const CornerWidth gradient = cornerWidthGradient(edges);
      for (int n = 0; n < 4; ++n)
        forces_n_[lattice_->cells[cell][kCornerTetrahedra[t][n]]] += spring.force(width) * gradient.gradient[n];
    }
  }
}

void OracleSimulation::proposeMoves() {
  const double dt = settings_.dt_s;
  for (std::size_t v = 0; v < displacements_m_.size(); ++v) {
    if (!movable_[v])
      continue;
    const Vector3 acceleration = (forces_n_[v] + external_n_[v]) / masses_kg_[v] + settings_.gravity_m_s2;
    velocities_m_s_[v] = (velocities_m_s_[v] + dt * acceleration) / (1.0 + dt * settings_.damping_per_s);
    moves_m_[v] = dt * velocities_m_s_[v];
  }
}

void OracleSimulation::guardMoves() {
  std::fill(tries_.begin(), tries_.end(), 0);
  for (std::size_t v = 0; v < moves_m_.size(); ++v)
    shorten(v, std::min(kEdgeFraction * std::sqrt(shortest_squared_m2_[v]), kMoveCap * shortest_edge_m_));
  for (int round = 0; flagFailures(); ++round) {
    if (round == kGuardRounds) {
      // Every move is capped now, so nothing can fail beyond rounding.
      std::fill(flagged_.begin(), flagged_.end(), 1);
      std::fill(tries_.begin(), tries_.end(), kHalvings);
      shortenFlagged();
      return;
    }
    shortenFlagged();
  }
}

/// Flags the vertices of all corner tetrahedra that the moves would make too thin. True when there are any.
bool OracleSimulation::flagFailures() {
  const double least = kLeastWidth * shortest_edge_m_;
  for (std::size_t v = 0; v < ends_m_.size(); ++v)
    ends_m_[v] = displacements_m_[v] + moves_m_[v];
  std::fill(flagged_.begin(), flagged_.end(), 0);
  bool any = false;
  for (std::size_t cell = 0; cell < lattice_->cellCount(); ++cell) {
    const CellCorners corners = model_.corners(cell, ends_m_);
    for (int t = 0; t < 8; ++t) {
      const double width = cornerWidth(cornerEdges(corners, t));
      if (width >= least || width >= widths_m_[cell][t])
        continue;
      any = true;
      for (const std::uint8_t c : kCornerTetrahedra[t])
        flagged_[lattice_->cells[cell][c]] = 1;
    }
  }
  return any;
}

void OracleSimulation::shortenFlagged() {
  for (std::size_t v = 0; v < moves_m_.size(); ++v) {
    if (!flagged_[v])
      continue;
    if (tries_[v] < kHalvings) {
      ++tries_[v];
      shorten(v, 0.5 * moves_m_[v].norm());
    } else {
      shorten(v, std::max(0.0, kWidthFraction * (room_m_[v] - kLeastWidth * shortest_edge_m_)));
    }
  }
}

/// The velocity follows the move: a velocity that the vertex did not have would wind up momentum.
void OracleSimulation::shorten(std::size_t vertex, double longest_m) {
  const double length = moves_m_[vertex].norm();
  if (length <= longest_m)
    return;
  moves_m_[vertex] *= longest_m / length;
  velocities_m_s_[vertex] = moves_m_[vertex] / settings_.dt_s;
  ++limited_moves_;
}

void OracleSimulation::applyMoves() {
  for (std::size_t v = 0; v < displacements_m_.size(); ++v)
    displacements_m_[v] += moves_m_[v];
}

}  // namespace soft_volume::core
