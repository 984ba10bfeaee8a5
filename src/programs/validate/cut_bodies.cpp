#include "cut_bodies.h"

#include <algorithm>
#include <cmath>
#include <random>

namespace soft_volume::core::validate {
namespace {

/// The components of a tensor that is symmetric in all four indices, and how often each occurs in it.
struct Component {
  int powers[3];
  double times;
};
constexpr std::array<Component, 15> kComponents{{{{4, 0, 0}, 1},
                                                 {{0, 4, 0}, 1},
                                                 {{0, 0, 4}, 1},
                                                 {{2, 2, 0}, 6},
                                                 {{2, 0, 2}, 6},
                                                 {{0, 2, 2}, 6},
                                                 {{3, 1, 0}, 4},
                                                 {{3, 0, 1}, 4},
                                                 {{1, 3, 0}, 4},
                                                 {{0, 3, 1}, 4},
                                                 {{1, 0, 3}, 4},
                                                 {{0, 1, 3}, 4},
                                                 {{2, 1, 1}, 12},
                                                 {{1, 2, 1}, 12},
                                                 {{1, 1, 2}, 12}}};
using Tensor = Eigen::Matrix<double, 15, 1>;

/// l^2 n n n n, each component times the root of how often it occurs, so that its norm is the tensor's.
Tensor tensorOf(const Vector3& spring_m) {
  const Vector3 n = spring_m.normalized();
  Tensor tensor;
  for (std::size_t i = 0; i < kComponents.size(); ++i) {
    tensor[Eigen::Index(i)] = spring_m.squaredNorm() * std::sqrt(kComponents[i].times);
    for (int d = 0; d < 3; ++d)
      tensor[Eigen::Index(i)] *= std::pow(n[d], kComponents[i].powers[d]);
  }
  return tensor;
}

/// Isotropic with nu = 1/4: C11 = 1.2 E, C12 = C44 = 0.4 E.
Tensor isotropicTensor(double energy_j) {
  Tensor tensor = Tensor::Zero();
  tensor.head<3>().setConstant(1.2 * energy_j);
  tensor.segment<3>(3).setConstant(0.4 * energy_j * std::sqrt(6.0));
  return tensor;
}

constexpr double kTrace = 6.0;  ///< C_iijj / E of isotropic tissue with nu = 1/4

/// x >= 0 with the least |a x - b|^2 + tiny |x - x0|^2: the tiny part chooses among many that are as good. One
/// unknown after the other; the problem is convex, so that this ends in its minimum.
Eigen::VectorXd nonNegative(const Eigen::MatrixXd& a, const Eigen::VectorXd& b, const Eigen::VectorXd& x0) {
  constexpr double kTiny = 1e-6;
  constexpr int kRounds = 4000;
  Eigen::VectorXd x = x0;
  Eigen::VectorXd rest = b - a * x;
  const double tiny = kTiny * a.colwise().squaredNorm().mean();
  for (int round = 0; round < kRounds; ++round) {
    double moved = 0.0;
    for (Eigen::Index i = 0; i < x.size(); ++i) {
      const double slope = a.col(i).dot(rest) - tiny * (x[i] - x0[i]);
      const double next = std::max(0.0, x[i] + slope / (a.col(i).squaredNorm() + tiny));
      rest -= a.col(i) * (next - x[i]);
      moved = std::max(moved, std::abs(next - x[i]));
      x[i] = next;
    }
    if (moved < 1e-9 * x0.maxCoeff())
      break;
  }
  return x;
}

template <typename Visit>
void forEachPair(const std::vector<std::uint32_t>& vertices, const Visit& visit) {
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    for (std::size_t j = i + 1; j < vertices.size(); ++j)
      visit(vertices[i], vertices[j]);
  }
}

}  // namespace

const char* nameOf(PieceStiffness stiffness) {
  switch (stiffness) {
    case PieceStiffness::kEmbedded:
      return "embedded";
    case PieceStiffness::kComplete:
      return "complete, fitted";
    default:
      return "complete, equal";
  }
}

void PieceNetwork::addEqual(const std::vector<Vector3>& places_m, const std::vector<std::uint32_t>& vertices,
                            double volume_m3, double youngs_modulus_pa) {
  double squares_m2 = 0.0;
  forEachPair(vertices,
              [&](std::uint32_t a, std::uint32_t b) { squares_m2 += (places_m[a] - places_m[b]).squaredNorm(); });
  const double stiffness_n_m = kTrace * youngs_modulus_pa * volume_m3 / squares_m2;
  forEachPair(vertices, [&](std::uint32_t a, std::uint32_t b) { springs.push_back({a, b, stiffness_n_m}); });
}

void PieceNetwork::addFitted(const std::vector<Vector3>& places_m, const std::vector<std::uint32_t>& vertices,
                             double volume_m3, double youngs_modulus_pa) {
  const std::size_t first = springs.size();
  addEqual(places_m, vertices, volume_m3, youngs_modulus_pa);
  const auto count = static_cast<Eigen::Index>(springs.size() - first);
  Eigen::MatrixXd tensors(15, count);
  Eigen::VectorXd squares_m2(count);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Spring& spring = springs[first + std::size_t(i)];
    const Vector3 along = places_m[spring.b] - places_m[spring.a];
    tensors.col(i) = tensorOf(along);
    squares_m2[i] = along.squaredNorm();
  }
  const double energy_j = youngs_modulus_pa * volume_m3;
  Eigen::VectorXd stiffness_n_m =
      nonNegative(tensors, isotropicTensor(energy_j), Eigen::VectorXd::Constant(count, springs[first].stiffness_n_m));
  stiffness_n_m *= kTrace * energy_j / squares_m2.dot(stiffness_n_m);
  for (Eigen::Index i = 0; i < count; ++i)
    springs[first + std::size_t(i)].stiffness_n_m = stiffness_n_m[i];
}

CutBody::CutBody(const CutBlock& tissue, PieceStiffness stiffness)
    : tissue_(&tissue), embedded_(stiffness == PieceStiffness::kEmbedded) {
  if (embedded_)
    makeEmbedded();
  else
    makeComplete(stiffness == PieceStiffness::kComplete);
}

void CutBody::makeEmbedded() {
  const Lattice& lattice = tissue_->block.lattice;
  model_ = std::make_unique<OracleModel>(lattice, tissue_->block.materials, SpringRule::kIsotropic);
  places_m_ = lattice.rest_positions;
  masses_kg_ = oracleMasses(lattice, tissue_->block.materials);
  parts_ = latticeParts(lattice);
  fixed_ = lattice.fixed;
  spring_count_ = kCornerPairs.size() * lattice.cellCount();
}

void CutBody::makeComplete(bool fitted) {
  const CutMesh& mesh = tissue_->mesh;
  const Lattice& lattice = tissue_->block.lattice;
  const Material& material = tissue_->block.materials.front();
  places_m_ = mesh.restPositions();
  masses_kg_.assign(mesh.vertexCount(), 0.0);
  parts_.assign(mesh.vertexCount(), 0);
  const std::vector<std::uint32_t> islands = mesh.islands();
  for (std::uint32_t p = 0; p < mesh.pieces().size(); ++p) {
    const std::vector<std::uint32_t> vertices = mesh.verticesOf(p);
    const double volume_m3 = volumeOf(solidOf(mesh, p));
    if (fitted)
      network_.addFitted(places_m_, vertices, volume_m3, material.youngs_modulus_pa);
    else
      network_.addEqual(places_m_, vertices, volume_m3, material.youngs_modulus_pa);
    for (const std::uint32_t v : vertices) {
      masses_kg_[v] += material.density_kg_m3 * volume_m3 / double(vertices.size());
      parts_[v] = mesh.verticesOf(islands[p]).front();
    }
  }
  const double floor_m = lattice.origin_m.z();
  const bool on_floor = std::any_of(lattice.fixed.begin(), lattice.fixed.end(), [](std::uint8_t f) { return f != 0; });
  for (const Vector3& p : places_m_)
    fixed_.push_back(on_floor && std::abs(p.z() - floor_m) < 1e-9 * tissue_->h() ? 1 : 0);
  spring_count_ = network_.springs.size();
}

std::map<std::uint32_t, double> CutBody::weightsOf(std::uint32_t vertex) const {
  if (!embedded_)
    return {{vertex, 1.0}};
  const CutMesh& mesh = tissue_->mesh;
  const Lattice& lattice = tissue_->block.lattice;
  std::map<std::uint32_t, double> weights;
  std::vector<Vector3> unit(lattice.vertexCount(), Vector3::Zero());
  for (const std::uint32_t v : lattice.cells[tissue_->embedding.cellOf(mesh.piecesAround(vertex).front())]) {
    unit[v].x() = 1.0;
    weights[v] = tissue_->embedding.place(mesh, lattice, unit, vertex).x();
    unit[v].x() = 0.0;
  }
  return weights;
}

void CutBody::addForces(const std::vector<Vector3>& displacements_m, std::vector<Vector3>& forces_n) const {
  if (embedded_) {
    model_->addForces(displacements_m, forces_n);
    return;
  }
  for (const PieceNetwork::Spring& spring : network_.springs) {
    const Vector3 rest = places_m_[spring.b] - places_m_[spring.a];
    const Vector3 now = rest + displacements_m[spring.b] - displacements_m[spring.a];
    const double length_m = now.norm();
    const Vector3 force = spring.stiffness_n_m * (length_m - rest.norm()) / length_m * now;
    forces_n[spring.a] += force;
    forces_n[spring.b] -= force;
  }
}

Eigen::MatrixXd CutBody::stiffness() const {
  const auto size = static_cast<Eigen::Index>(3 * nodeCount());
  const double tiny_m = 1e-6 * tissue_->h();
  Eigen::MatrixXd stiffness = Eigen::MatrixXd::Zero(size, size);
  std::vector<Vector3> displacements(nodeCount(), Vector3::Zero());
  std::vector<Vector3> forces(nodeCount());
  for (Eigen::Index column = 0; column < size; ++column) {
    for (const double sign : {1.0, -1.0}) {
      displacements[std::size_t(column / 3)][column % 3] = sign * tiny_m;
      std::fill(forces.begin(), forces.end(), Vector3::Zero());
      addForces(displacements, forces);
      stiffness.col(column) -= sign / (2.0 * tiny_m) * Eigen::Map<const Eigen::VectorXd>(forces.front().data(), size);
    }
    displacements[std::size_t(column / 3)][column % 3] = 0.0;
  }
  return 0.5 * (stiffness + stiffness.transpose());
}

double CutBody::largestFrequency() const {
  const double tiny_m = 1e-6 * tissue_->h();
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  std::vector<Vector3> shape(nodeCount());
  for (Vector3& u : shape)
    u = Vector3(normal(random), normal(random), normal(random));
  std::vector<Vector3> forces(nodeCount());
  std::vector<Vector3> back(nodeCount());
  double squared = 0.0;
  for (int round = 0; round < 3000; ++round) {
    double longest = 0.0;
    for (std::size_t v = 0; v < shape.size(); ++v)
      longest = std::max(longest, fixed_[v] ? 0.0 : shape[v].norm());
    for (std::size_t v = 0; v < shape.size(); ++v)
      shape[v] *= fixed_[v] ? 0.0 : tiny_m / longest;
    std::fill(forces.begin(), forces.end(), Vector3::Zero());
    std::fill(back.begin(), back.end(), Vector3::Zero());
    addForces(shape, forces);
    for (Vector3& u : shape)
      u = -u;
    addForces(shape, back);
    double along = 0.0;
    double whole = 0.0;
    for (std::size_t v = 0; v < shape.size(); ++v) {
      const Vector3 force = 0.5 * (forces[v] - back[v]);  // without what is not linear
      along += fixed_[v] ? 0.0 : force.dot(shape[v]);
      whole += masses_kg_[v] * shape[v].squaredNorm();
      shape[v] = -force / masses_kg_[v];
    }
    const double before = squared;
    squared = along / whole;
    if (round > 50 && std::abs(squared - before) < 1e-7 * squared)
      break;
  }
  return std::sqrt(squared);
}

}  // namespace soft_volume::core::validate
