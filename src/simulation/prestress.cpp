#include "soft_volume/simulation/prestress.h"

#include <algorithm>

#include <Eigen/Eigenvalues>

#include "rest_system.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/simulation/oracle.h"
#include "spring_model.h"

namespace soft_volume::core {
namespace {

/// Of the forces that the tension would exert at rest: what remains moves nothing visibly.
constexpr double kTolerance = 1e-10;
/// Of its stiffness without tension that a vertex keeps at least. Below it, motion of the neighbours may let it buckle.
constexpr double kLeastStiffness = 1.0 / 3.0;

/// The stiffness of lengths and volumes at rest, without what is relieved in bending, which carries no tension.
RestSystem restSystem(const Lattice& lattice, SpringModel model) {
  model.linear.fill(0.0);
  return RestSystem(lattice, model.rule, model);
}

/// Releases what does not balance.
void release(const Lattice& whole, const std::vector<Material>& materials, const RestSystem& system, SpringRule rule,
             Prestress& prestress) {
  prestress.slack_m.assign(whole.vertexCount(), Vector3::Zero());
  std::vector<Vector3> forces = prestress.slack_m;
  OracleModel(whole, materials, rule, prestress).addForces(prestress.slack_m, forces);
  Eigen::VectorXd pull = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(3 * forces.size()));
  for (std::uint32_t v = 0; v < forces.size(); ++v) {
    if (!isFixed(whole, rule, v))
      pull.segment<3>(3 * Eigen::Index(v)) = forces[v];
  }
  const Eigen::VectorXd solution = system.answer(pull, kTolerance);
  for (std::uint32_t v = 0; v < forces.size(); ++v)
    prestress.slack_m[v] = solution.segment<3>(3 * Eigen::Index(v));
}

/// The least stiffness of a vertex in any direction while its neighbours stay, N/m.
class VertexStiffness {
 public:
  VertexStiffness(const Lattice& lattice, const LatticeIndex& index) : lattice_(&lattice), index_(&index) {}

  double least(const SpringModel& model, std::uint32_t vertex) {
    makeRow(*lattice_, *index_, model, vertex, row_);
    Eigen::Matrix3d stiffness = Eigen::Matrix3d::Zero();
    for (const MergedSpring& spring : row_.springs) {
      const double tension = 1.0 - spring.rest_length_m / model.lengths_m[spring.direction];
      const Vector3 along = model.offsets_m[spring.direction].normalized();
      stiffness += spring.stiffness_n_m * ((1.0 - tension) * along * along.transpose() +
                                           (tension + model.linear[spring.direction]) * Eigen::Matrix3d::Identity());
    }
    // The volume is linear in the place of one vertex, so its tension adds nothing.
    index_->forEachCell(vertex, [&](const CellCorner& at) { addVolume(model, at, stiffness); });
    return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(stiffness, Eigen::EigenvaluesOnly).eigenvalues()[0];
  }

 private:
  void addVolume(const SpringModel& model, const CellCorner& at, Eigen::Matrix3d& stiffness) const {
    const double volume_m3 = lattice_->spacing_m.prod();
    Vector3 gradient = volume_m3 / 4.0 * lattice_->spacing_m.cwiseInverse();
    for (int d = 0; d < 3; ++d)
      gradient[d] *= kHexahedronCorners[at.corner][d] != 0 ? 1.0 : -1.0;
    stiffness += model.materials[lattice_->materials[at.cell]].volume_pa / volume_m3 * gradient * gradient.transpose();
  }

  const Lattice* lattice_;
  const LatticeIndex* index_;
  VertexRow row_;
};

/// Takes the tension from cells with a vertex that it may let buckle. Returns whether there were any.
bool slacken(const Lattice& whole, const SpringModel& plain, Prestress& prestress) {
  SpringModel taut = plain;
  taut.prestress = prestress;
  const LatticeIndex index(whole);
  VertexStiffness stiffness(whole, index);
  bool any = false;
  for (std::uint32_t v = 0; v < whole.vertexCount(); ++v) {
    if (isFixed(whole, plain.rule, v) || stiffness.least(taut, v) >= kLeastStiffness * stiffness.least(plain, v))
      continue;
    index.forEachCell(v, [&](const CellCorner& at) {
      any = any || prestress.stretch[at.cell] > 1.0;
      prestress.stretch[at.cell] = 1.0;
    });
  }
  return any;
}

}  // namespace

double Prestress::volume(const Lattice& lattice, std::size_t cell) const {
  double growth = 0.0;
  for (std::size_t c = 0; c < 8; ++c) {
    for (int d = 0; d < 3; ++d) {
      const double gradient = (kHexahedronCorners[c][d] != 0 ? 0.25 : -0.25) / lattice.spacing_m[d];
      growth += gradient * slack_m[lattice.cells[cell][c]][d];
    }
  }
  return 1.0 / (1.0 + 3.0 * (1.0 - 1.0 / stretchOf(lattice, cell)) + growth);
}

void Prestress::extend(const Lattice& lattice) {
  for (std::size_t v = slack_m.size(); v < lattice.vertexCount(); ++v)
    slack_m.push_back(Vector3(slack_m[lattice.origin_vertices[v]]));
}

Prestress findPrestress(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule) {
  if (std::all_of(materials.begin(), materials.end(), [](const Material& m) { return m.prestretch == 1.0; }))
    return {};
  const Lattice whole = healed(lattice);
  const SpringModel plain = makeSpringModel(whole, materials, rule, 0.0);
  const RestSystem system = restSystem(whole, plain);
  Prestress prestress;
  for (const std::uint16_t material : whole.materials)
    prestress.stretch.push_back(materials[material].prestretch);
  do {
    release(whole, materials, system, rule, prestress);
  } while (slacken(whole, plain, prestress));
  prestress.extend(lattice);
  return prestress;
}

}  // namespace soft_volume::core
