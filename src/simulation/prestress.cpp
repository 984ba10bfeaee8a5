#include "prestress.h"

#include <algorithm>

#include "rest_system.h"
#include "soft_volume/grid/hexahedron.h"
#include "soft_volume/simulation/oracle.h"
#include "spring_model.h"

namespace soft_volume::core {
namespace {

/// Of the forces that the tension would exert at rest: what remains moves nothing visibly.
constexpr double kTolerance = 1e-10;

/// The stiffness of lengths and volumes at rest, without what is relieved in bending, which carries no tension.
RestSystem restSystem(const Lattice& lattice, std::vector<Material> materials, SpringRule rule) {
  for (Material& material : materials)
    material.prestretch = 1.0;
  SpringModel model = makeSpringModel(lattice, materials, rule, 0.0);
  model.linear.fill(0.0);
  return RestSystem(lattice, rule, model);
}

}  // namespace

std::vector<Vector3> findSlack(const Lattice& lattice, const std::vector<Material>& materials, SpringRule rule) {
  if (std::all_of(materials.begin(), materials.end(), [](const Material& m) { return m.prestretch == 1.0; }))
    return {};
  const Lattice whole = healed(lattice);
  std::vector<Vector3> slack(whole.vertexCount(), Vector3::Zero());
  std::vector<Vector3> forces = slack;
  OracleModel(whole, materials, rule, slack).addForces(slack, forces);
  Eigen::VectorXd pull = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(3 * slack.size()));
  for (std::uint32_t v = 0; v < slack.size(); ++v) {
    if (!isFixed(whole, rule, v))
      pull.segment<3>(3 * Eigen::Index(v)) = forces[v];
  }
  const Eigen::VectorXd solution = restSystem(whole, materials, rule).answer(pull, kTolerance);
  for (std::uint32_t v = 0; v < slack.size(); ++v)
    slack[v] = solution.segment<3>(3 * Eigen::Index(v));
  extendSlack(lattice, slack);
  return slack;
}

void extendSlack(const Lattice& lattice, std::vector<Vector3>& slack_m) {
  for (std::size_t v = slack_m.size(); v < lattice.vertexCount(); ++v)
    slack_m.push_back(Vector3(slack_m[lattice.origin_vertices[v]]));
}

double slackVolume(const Lattice& lattice, const std::vector<Vector3>& slack_m, double prestretch, std::size_t cell) {
  double growth = 0.0;
  for (std::size_t c = 0; c < 8; ++c) {
    for (int d = 0; d < 3; ++d) {
      const double gradient = (kHexahedronCorners[c][d] != 0 ? 0.25 : -0.25) / lattice.spacing_m[d];
      growth += gradient * slack_m[lattice.cells[cell][c]][d];
    }
  }
  return 1.0 / (1.0 + 3.0 * (1.0 - 1.0 / prestretch) + growth);
}

}  // namespace soft_volume::core
