#include "rest_system.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {
namespace {

constexpr int kPowerIterations = 1000;
constexpr double kPowerTolerance = 1e-7;

/// Gradient of J V at the corners of a box: an eighth of the sum of the corner determinants.
std::array<Vector3, 8> restVolumeGradient(const Vector3& h) {
  const Vector3 areas(h.y() * h.z(), h.z() * h.x(), h.x() * h.y());
  std::array<Vector3, 8> gradient;
  for (std::size_t c = 0; c < 8; ++c) {
    for (int d = 0; d < 3; ++d)
      gradient[c][d] = (kHexahedronCorners[c][d] != 0 ? 0.25 : -0.25) * areas[d];
  }
  return gradient;
}

}  // namespace

Lattice healed(const Lattice& lattice) {
  Lattice whole = lattice;
  std::size_t vertices = 0;
  while (vertices < lattice.vertexCount() && lattice.origin_vertices[vertices] == vertices)
    ++vertices;
  std::size_t cells = 0;
  while (cells < lattice.cellCount() && lattice.cell_at[lattice.parent_cells[cells]] == std::int32_t(cells))
    ++cells;
  whole.cells.resize(cells);
  whole.parent_cells.resize(cells);
  whole.materials.resize(cells);
  whole.face_neighbours.resize(cells);
  whole.cut_faces.resize(cells);
  whole.surface_shares.assign(cells, {1.0, 1.0, 1.0, 1.0, 1.0, 1.0});
  whole.rest_stretch.assign(cells, Vector3::Ones());
  whole.shares.assign(cells, 1.0);
  whole.next_cells.assign(cells, Lattice::kNone);
  for (auto& cell : whole.cells) {
    for (std::uint32_t& v : cell) {
      while (lattice.origin_vertices[v] != v)
        v = lattice.origin_vertices[v];
    }
  }
  whole.rest_positions.resize(vertices);
  // Of the parts of a fixed vertex those that hold no more are free.
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    std::uint32_t origin = v;
    while (lattice.origin_vertices[origin] != origin)
      origin = lattice.origin_vertices[origin];
    whole.fixed[origin] = whole.fixed[origin] | lattice.fixed[v];
  }
  whole.fixed.resize(vertices);
  std::replace(whole.fixed.begin(), whole.fixed.end(), Lattice::kRemoved, std::uint8_t(0));
  whole.origin_vertices.resize(vertices);
  whole.lattice_nodes.resize(vertices);
  return whole;
}

RestSystem::RestSystem(const Lattice& lattice, SpringRule rule, const SpringModel& model) {
  const LatticeIndex index(lattice);
  for (std::size_t d = 0; d < kDirections; ++d)
    unit_[d] = model.offsets_m[d].normalized();
  linear_ = model.linear;
  mass_kg_ = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(3 * lattice.vertexCount()));
  row_begin_.push_back(0);
  VertexRow row;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    if (!isFixed(lattice, rule, v)) {
      makeRow(lattice, index, model, v, row);
      mass_kg_.segment<3>(3 * Eigen::Index(v)).setConstant(row.mass_kg);
      for (const MergedSpring& spring : row.springs)
        entries_.push_back(
            {spring.neighbour, spring.direction, spring.stiffness_n_m,
             model.prestress.empty() ? 0.0 : 1.0 - spring.rest_length_m / model.lengths_m[spring.direction]});
    }
    row_begin_.push_back(static_cast<std::uint32_t>(entries_.size()));
  }
  if (!model.has_volume_energy)
    return;
  volume_gradient_ = restVolumeGradient(lattice.spacing_m);
  for (std::size_t c = 0; c < lattice.cellCount(); ++c) {
    const double modulus_pa = lattice.shares[c] * model.materials[lattice.materials[c]].volume_pa;
    if (modulus_pa <= 0.0)
      continue;
    cells_.push_back(lattice.cells[c]);
    cell_modulus_n_m_.push_back(modulus_pa / lattice.spacing_m.prod());
  }
}

void RestSystem::product(const Eigen::VectorXd& x, Eigen::VectorXd& y) const {
  const Eigen::Index vertices = x.size() / 3;
  for (Eigen::Index v = 0; v < vertices; ++v) {
    const Vector3 own = x.segment<3>(3 * v);
    Vector3 sum = Vector3::Zero();
    for (std::uint32_t e = row_begin_[std::size_t(v)]; e < row_begin_[std::size_t(v) + 1]; ++e) {
      const Vector3& unit = unit_[entries_[e].direction];
      const Vector3 apart = own - x.segment<3>(3 * Eigen::Index(entries_[e].neighbour));
      const double across = entries_[e].tension;
      sum += entries_[e].stiffness_n_m *
             ((1.0 - across) * unit.dot(apart) * unit + (linear_[entries_[e].direction] + across) * apart);
    }
    y.segment<3>(3 * v) = sum;
  }
  for (std::size_t n = 0; n < cells_.size(); ++n) {
    double along = 0.0;
    for (std::size_t c = 0; c < 8; ++c)
      along += volume_gradient_[c].dot(x.segment<3>(3 * Eigen::Index(cells_[n][c])));
    for (std::size_t c = 0; c < 8; ++c)
      y.segment<3>(3 * Eigen::Index(cells_[n][c])) += cell_modulus_n_m_[n] * along * volume_gradient_[c];
  }
  for (Eigen::Index n = 0; n < y.size(); ++n)
    y[n] = mass_kg_[n] > 0.0 ? y[n] : 0.0;
}

double RestSystem::largestFrequency() const {
  const auto root = [](double m) { return m > 0.0 ? 1.0 / std::sqrt(m) : 0.0; };
  const Eigen::VectorXd scale = mass_kg_.unaryExpr(root);
  if (scale.size() == 0 || scale.maxCoeff() <= 0.0)
    return 0.0;
  std::mt19937 random(1);
  Eigen::VectorXd x(scale.size());
  // Raw bits, not a distribution: those differ between standard libraries.
  for (Eigen::Index n = 0; n < x.size(); ++n)
    x[n] = scale[n] > 0.0 ? double(random()) / 4294967296.0 - 0.5 : 0.0;
  Eigen::VectorXd y(x.size());
  double eigenvalue = 0.0;
  for (int n = 0; n < kPowerIterations; ++n) {
    x /= x.norm();
    product(scale.cwiseProduct(x), y);
    y = y.cwiseProduct(scale);
    const double next = y.norm();
    const bool converged = next - eigenvalue < kPowerTolerance * next;
    eigenvalue = next;
    x.swap(y);
    if (converged && n > 20)
      break;
  }
  return std::sqrt(eigenvalue);
}

LinearProblem RestSystem::problem() const {
  LinearProblem problem;
  problem.stiffness_product = [this](const Eigen::VectorXd& x, Eigen::VectorXd& y) { product(x, y); };
  problem.diagonal = Eigen::VectorXd::Zero(mass_kg_.size());
  problem.preconditioner = Eigen::VectorXd::Ones(mass_kg_.size());
  for (std::size_t v = 0; v + 1 < row_begin_.size(); ++v) {
    Vector3 diagonal = Vector3::Zero();
    for (std::uint32_t e = row_begin_[v]; e < row_begin_[v + 1]; ++e)
      diagonal += entries_[e].stiffness_n_m *
                  (unit_[entries_[e].direction].cwiseAbs2() + Vector3::Constant(linear_[entries_[e].direction]));
    if (diagonal.minCoeff() > 0.0)
      problem.preconditioner.segment<3>(3 * Eigen::Index(v)) = diagonal.cwiseInverse();
  }
  return problem;
}

Eigen::VectorXd RestSystem::answer(const Eigen::VectorXd& force, double tolerance) const {
  Eigen::VectorXd x = Eigen::VectorXd::Zero(force.size());
  if (force.size() > 0 && !force.isZero(0.0))
    solveConjugateGradient(problem(), force, tolerance, x);
  return x;
}

double RestSystem::lowestFrequency() const {
  if (mass_kg_.size() == 0 || mass_kg_.minCoeff() > 0.0)
    return 0.0;  // nothing holds the lattice
  const LinearProblem linear = problem();
  double lowest = 0.0;
  for (int axis = 0; axis < 3; ++axis) {
    Eigen::VectorXd force = Eigen::VectorXd::Zero(mass_kg_.size());
    for (Eigen::Index n = axis; n < force.size(); n += 3)
      force[n] = mass_kg_[n];
    Eigen::VectorXd x;
    solveConjugateGradient(linear, force, 1e-4, x);
    const double squared = force.dot(x) / mass_kg_.dot(x.cwiseAbs2());
    if (std::isfinite(squared) && squared > 0.0)
      lowest = lowest > 0.0 ? std::min(lowest, std::sqrt(squared)) : std::sqrt(squared);
  }
  return lowest;
}

}  // namespace soft_volume::core
