#include "spring_model.h"

#include <algorithm>
#include <cmath>

#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {
namespace {

std::array<int, 3> directionOffset(std::size_t direction) {
  const int d = static_cast<int>(direction);
  return {d % 3 - 1, (d / 3) % 3 - 1, d / 9 - 1};
}

/// What one cell owns of the spring in each direction.
std::array<double, kDirections> ownedStiffness(const CellSprings& springs) {
  std::array<double, kDirections> stiffness = {};
  for (const CornerPair& pair : kCornerPairs) {
    const double k = springStiffness(springs, pair);
    stiffness[cornerDirection(pair.a, pair.b)] = k;
    stiffness[cornerDirection(pair.b, pair.a)] = k;
  }
  return stiffness;
}

/// Where a vertex has a spring in each direction, while its row is made; beside an incision there may be several.
class RowBuilder {
 public:
  explicit RowBuilder(VertexRow& row) : row_(&row) { first_.fill(-1); }

  MergedSpring& spring(std::uint8_t direction, std::uint32_t neighbour) {
    if (first_[direction] < 0) {
      first_[direction] = row_->count;
      return add(direction, neighbour);
    }
    for (int n = first_[direction]; n < row_->count; ++n) {
      MergedSpring& spring = row_->springs[static_cast<std::size_t>(n)];
      if (spring.direction == direction && spring.neighbour == neighbour)
        return spring;
    }
    return add(direction, neighbour);
  }

 private:
  MergedSpring& add(std::uint8_t direction, std::uint32_t neighbour) {
    MergedSpring& spring = row_->springs[static_cast<std::size_t>(row_->count++)];
    spring = {neighbour, direction, false, 0.0, 0.0};
    return spring;
  }

  VertexRow* row_;
  std::array<int, kDirections> first_;
};

}  // namespace

std::uint8_t cornerDirection(int a, int b) {
  int direction = 13;
  constexpr int kStride[3] = {1, 3, 9};
  for (int d = 0; d < 3; ++d)
    direction += kStride[d] * (kHexahedronCorners[b][d] - kHexahedronCorners[a][d]);
  return static_cast<std::uint8_t>(direction);
}

double VertexRow::stiffness_n_m() const {
  double sum = 0.0;
  for (int n = 0; n < count; ++n)
    sum += springs[static_cast<std::size_t>(n)].stiffness_n_m;
  return sum / 3.0;
}

/// The relief has the same proportion to the springs in every material.
static std::array<double, kDirections> linearShares(const Vector3& spacing_m) {
  const CellSprings springs = isotropicSprings({1.0, 1.0, 0.0}, spacing_m);
  const double relief = bendingRelief(springs, spacing_m);
  std::array<double, kDirections> shares = {};
  for (const CornerPair& pair : kCornerPairs) {
    const double k = springStiffness(springs, pair);
    const double share = k > 0.0 ? relief * bendingReliefShare(pair) / k : 0.0;
    shares[cornerDirection(pair.a, pair.b)] = share;
    shares[cornerDirection(pair.b, pair.a)] = share;
  }
  return shares;
}

/// Every corner's share of the stiffness bound (twice its springs, and its part of the volume energy) over its share of
/// the mass bounds the square of all frequencies.
static double squaredFrequencyBound(const SpringModel::OfMaterial& material,
                                    const std::array<double, kDirections>& linear, const Vector3& h) {
  double springs = 0.0;
  for (int c = 1; c < 8; ++c)
    springs += material.stiffness_n_m[cornerDirection(0, c)] * (1.0 + std::max(0.0, linear[cornerDirection(0, c)]));
  const double volume = material.volume_pa * h.prod() * 0.5 * h.cwiseInverse().squaredNorm();
  return (2.0 * springs + volume) / material.corner_mass_kg;
}

SpringModel makeSpringModel(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule,
                            double damping_frequency_rad_s) {
  SpringModel model;
  model.rule = rule;
  model.shortest_edge_m = lattice.spacing_m.minCoeff();
  for (std::size_t d = 0; d < kDirections; ++d) {
    const std::array<int, 3> offset = directionOffset(d);
    model.offsets_m[d] = Vector3(offset[0], offset[1], offset[2]).cwiseProduct(lattice.spacing_m);
    model.lengths_m[d] = model.offsets_m[d].norm();
  }
  const bool uniform = rule == SpringRule::kDissertation;
  model.strength_n_m = uniform ? dissertationStrength(lattice, materials) : 0.0;
  if (!uniform)
    model.linear = linearShares(lattice.spacing_m);
  std::vector<std::uint8_t> used(materials.size(), 0);
  for (const std::uint16_t m : lattice.materials)
    used[m] = 1;
  double most = 0.0;
  for (const Material& material : materials) {
    const ElasticConstants constants = elasticConstants(material.youngs_modulus_pa, material.poisson_ratio);
    SpringModel::OfMaterial of;
    of.stiffness_n_m.fill(model.strength_n_m);
    if (!uniform)
      of.stiffness_n_m = ownedStiffness(isotropicSprings(constants, lattice.spacing_m));
    of.altitude_n_m = 4.0 * 0.35 * constants.mu_pa * model.shortest_edge_m;
    of.volume_pa = uniform || material.fixed ? 0.0 : constants.volume_pa;
    of.corner_mass_kg = material.density_kg_m3 * lattice.spacing_m.prod() / 8.0;
    of.damping_rate_per_s = uniform ? 0.0 : 2.0 * material.damping_ratio * damping_frequency_rad_s;
    model.has_volume_energy = model.has_volume_energy || (used[model.materials.size()] && of.volume_pa > 0.0);
    model.materials.push_back(of);
    if (!uniform && !material.fixed && used[model.materials.size() - 1])
      most = std::max(most, squaredFrequencyBound(of, model.linear, lattice.spacing_m));
  }
  model.certain_step_s = most > 0.0 ? 2.0 / std::sqrt(most) : 0.0;
  return model;
}

void makeRow(const Lattice& lattice, const LatticeIndex& index, const SpringModel& model, std::uint32_t vertex,
             VertexRow& row) {
  row.count = 0;
  row.mass_kg = 0.0;
  double damping_kg_s = 0.0;
  RowBuilder builder(row);
  std::array<CellCorner, 8> around;
  const int cells = index.cellsOf(vertex, around);
  for (int n = 0; n < cells; ++n) {
    const CellCorner at = around[static_cast<std::size_t>(n)];
    const SpringModel::OfMaterial& material = model.materials[lattice.materials[at.cell]];
    const Vector3& stretch = lattice.rest_stretch[at.cell];
    const bool stretched = stretch != Vector3::Ones();
    row.mass_kg += material.corner_mass_kg;
    damping_kg_s += material.corner_mass_kg * material.damping_rate_per_s;
    for (int c = 0; c < 8; ++c) {
      if (c == at.corner)
        continue;
      const std::uint8_t direction = cornerDirection(at.corner, c);
      MergedSpring& spring = builder.spring(direction, lattice.cells[at.cell][static_cast<std::size_t>(c)]);
      const double k = material.stiffness_n_m[direction];
      spring.stiffness_n_m += k;
      spring.rest_length_m +=
          k * (stretched ? model.offsets_m[direction].cwiseProduct(stretch).norm() : model.lengths_m[direction]);
      spring.stretched = spring.stretched || stretched;
    }
  }
  if (model.rule == SpringRule::kDissertation && lattice.fixed[vertex])
    row.mass_kg *= kDissertationRigidMass;
  for (int n = 0; n < row.count; ++n) {
    MergedSpring& spring = row.springs[static_cast<std::size_t>(n)];
    spring.rest_length_m =
        spring.stretched ? spring.rest_length_m / spring.stiffness_n_m : model.lengths_m[spring.direction];
    if (model.rule == SpringRule::kDissertation)
      spring.stiffness_n_m = model.strength_n_m;  // one spring, however many cells share it
  }
  std::sort(row.springs.begin(), row.springs.begin() + row.count, [](const MergedSpring& a, const MergedSpring& b) {
    return a.direction != b.direction ? a.direction < b.direction : a.neighbour < b.neighbour;
  });
  row.damping_rate_per_s = damping_kg_s / row.mass_kg;
}

}  // namespace soft_volume::core
