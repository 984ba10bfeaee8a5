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

/// Makes the springs of a vertex; beside an incision there may be several in a direction.
class RowBuilder {
 public:
  RowBuilder(const Lattice& lattice, const SpringModel& model, VertexRow& row)
      : lattice_(&lattice), model_(&model), row_(&row) {
    first_.fill(-1);
    row.springs.clear();
    row.mass_kg = 0.0;
  }

  void add(const CellCorner& at) {
    const SpringModel::OfMaterial& material = model_->materials[lattice_->materials[at.cell]];
    const double share = lattice_->shares[at.cell];
    row_->mass_kg += share * material.corner_mass_kg;
    damping_kg_s_ += share * material.corner_mass_kg * material.damping_rate_per_s;
    for (int c = 0; c < 8; ++c) {
      if (c != at.corner)
        addSpring(at, c, share, material);
    }
  }

  void finish(bool heavy) {
    if (heavy)
      row_->mass_kg *= kDissertationRigidMass;
    for (MergedSpring& spring : row_->springs) {
      spring.rest_length_m =
          spring.stretched ? spring.rest_length_m / spring.stiffness_n_m : model_->lengths_m[spring.direction];
      // One spring, however many cells share it.
      if (model_->rule == SpringRule::kDissertation)
        spring.stiffness_n_m = model_->strength_n_m * (spring.shares / spring.places);
    }
    std::sort(row_->springs.begin(), row_->springs.end(), [](const MergedSpring& a, const MergedSpring& b) {
      return a.direction != b.direction ? a.direction < b.direction : a.neighbour < b.neighbour;
    });
    row_->damping_rate_per_s = damping_kg_s_ / row_->mass_kg;
  }

 private:
  void addSpring(const CellCorner& at, int corner, double share, const SpringModel::OfMaterial& material) {
    const std::uint8_t direction = cornerDirection(at.corner, corner);
    MergedSpring& spring = find(direction, lattice_->cells[at.cell][static_cast<std::size_t>(corner)]);
    const Vector3& stretch = lattice_->rest_stretch[at.cell];
    const bool taut = !model_->prestress.empty();
    const bool stretched = taut || stretch != Vector3::Ones();
    const double k = share * material.stiffness_n_m[direction];
    spring.stiffness_n_m += k;
    const double length =
        stretched ? model_->offsets_m[direction].cwiseProduct(stretch).norm() : model_->lengths_m[direction];
    spring.rest_length_m += k * (taut ? length * slackLength(at, corner, direction) : length);
    spring.stretched = spring.stretched || stretched;
    spring.shares += share;
    spring.places = static_cast<std::uint8_t>(spring.places + (spring.last_corner != at.corner ? 1 : 0));
    spring.last_corner = static_cast<std::int8_t>(at.corner);
  }

  /// Rest length of a prestretched spring in units of its imaged length.
  double slackLength(const CellCorner& at, int corner, std::uint8_t direction) const {
    const auto& vertices = lattice_->cells[at.cell];
    const Prestress& prestress = model_->prestress;
    const Vector3 slack_m =
        prestress.slack_m[vertices[static_cast<std::size_t>(corner)]] - prestress.slack_m[vertices[at.corner]];
    const double length_m = model_->lengths_m[direction];
    return 1.0 / prestress.stretchOf(*lattice_, at.cell) -
           model_->offsets_m[direction].dot(slack_m) / (length_m * length_m);
  }

  /// The spring to a neighbour, new or not.
  MergedSpring& find(std::uint8_t direction, std::uint32_t neighbour) {
    const std::size_t count = row_->springs.size();
    for (std::size_t n = first_[direction] < 0 ? count : std::size_t(first_[direction]); n < count; ++n) {
      if (row_->springs[n].direction == direction && row_->springs[n].neighbour == neighbour)
        return row_->springs[n];
    }
    if (first_[direction] < 0)
      first_[direction] = static_cast<int>(count);
    row_->springs.push_back({neighbour, direction, false, -1, 0, 0.0, 0.0, 0.0});
    return row_->springs.back();
  }

  const Lattice* lattice_;
  const SpringModel* model_;
  VertexRow* row_;
  double damping_kg_s_ = 0.0;
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
  for (const MergedSpring& spring : springs)
    sum += spring.stiffness_n_m;
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
  RowBuilder builder(lattice, model, row);
  index.forEachCell(vertex, [&](const CellCorner& at) { builder.add(at); });
  builder.finish(model.rule == SpringRule::kDissertation && lattice.fixed[vertex] != 0);
}

}  // namespace soft_volume::core
