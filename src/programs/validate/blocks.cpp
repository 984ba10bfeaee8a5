#include "blocks.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <sstream>

#include "soft_volume/simulation/presets.h"

namespace soft_volume::core::validate {

Material tissue(double poisson_ratio, double damping_ratio) {
  Material material;
  material.name = "tissue";
  material.youngs_modulus_pa = kYoungPa;
  material.poisson_ratio = poisson_ratio;
  material.density_kg_m3 = 1000.0;
  material.damping_ratio = damping_ratio;
  return material;
}

Block::Block(const Vector3i& cells, const Vector3& spacing_m, const Material& material, const Vector3& origin_m)
    : lattice(makeLattice(cells, spacing_m, origin_m,
                          std::vector<std::int32_t>(static_cast<std::size_t>(cells.prod()), 0))),
      materials{material} {}

Vector3i Block::node(std::uint32_t vertex) const {
  const Vector3i nodes = lattice.dims + Vector3i::Ones();
  const int v = static_cast<int>(vertex);
  return {v % nodes.x(), (v / nodes.x()) % nodes.y(), v / (nodes.x() * nodes.y())};
}

std::vector<std::uint32_t> Block::verticesWhere(const std::function<bool(const Vector3i& node)>& choose) const {
  std::vector<std::uint32_t> chosen;
  for (std::uint32_t v = 0; v < lattice.vertexCount(); ++v) {
    if (choose(node(v)))
      chosen.push_back(v);
  }
  return chosen;
}

void Block::fixWhere(const std::function<bool(const Vector3i& node)>& choose) {
  for (const std::uint32_t v : verticesWhere(choose))
    lattice.fixed[v] = 1;
}

std::vector<std::uint32_t> Block::layer(int axis, int layer) const {
  return verticesWhere([&](const Vector3i& n) { return n[axis] == layer; });
}

double Block::faceArea(std::uint32_t vertex, int axis) const {
  const Vector3i n = node(vertex);
  double area = 1.0;
  for (int a = 0; a < 3; ++a) {
    const bool end = n[a] == 0 || n[a] == lattice.dims[a];
    area *= a == axis ? 1.0 : lattice.spacing_m[a] * (end ? 0.5 : 1.0);
  }
  return area;
}

double Block::springForce() const {
  const Material& material = materials.front();
  const ElasticConstants constants = elasticConstants(material.youngs_modulus_pa, material.poisson_ratio);
  return isotropicSprings(constants, lattice.spacing_m).edge_n_m[0] * edge();
}

SimulationSettings exactSettings() {
  SimulationSettings settings;
  settings.active_set = ActiveSet::kAll;
  settings.precision = Precision::kDouble;
  return settings;
}

SimulationSettings staticSettings() {
  SimulationSettings settings = exactSettings();
  settings.integrator = Integrator::kQuasiStatic;
  return settings;
}

SimulationSettings dissertationSettings() {
  SimulationSettings settings = simulationPreset("reed1997");
  settings.active_set = ActiveSet::kAll;
  return settings;
}

bool settle(Simulation& simulation, double tolerance_m, int max_steps) {
  std::vector<Vector3> before = simulation.positions();
  double last_change = 0.0;
  for (int done = 0; done < max_steps;) {
    // Longer windows for slower tissue, so that a window tells more than rounding.
    const int window = std::min(max_steps - done, std::max(50, done / 8));
    for (int n = 0; n < window; ++n)
      simulation.step();
    done += window;
    const double change = largestDistance(before, simulation.positions());
    before = simulation.positions();
    const double ratio = last_change > 0.0 ? change / last_change : 1.0;
    // What a geometric series of such windows still holds.
    const double remaining = ratio < 0.98 ? change * ratio / (1.0 - ratio) : std::max(change, 100.0 * tolerance_m);
    if (change == 0.0 || (change < tolerance_m && remaining < tolerance_m))
      return true;
    last_change = change;
  }
  return false;
}

double largestDistance(const std::vector<Vector3>& a, const std::vector<Vector3>& b) {
  std::vector<Vector3> differences(a.size());
  std::transform(a.begin(), a.end(), b.begin(), differences.begin(), std::minus<>());
  return largestNorm(differences);
}

double largestNorm(const std::vector<Vector3>& vectors) {
  double squared = 0.0;
  for (const Vector3& v : vectors) {
    if (!isFinite(v))  // std::max would lose it
      return std::numeric_limits<double>::quiet_NaN();
    squared = std::max(squared, v.squaredNorm());
  }
  return std::sqrt(squared);
}

Vector3 totalForce(const Simulation& simulation, const std::vector<std::uint32_t>& vertices) {
  Vector3 total = Vector3::Zero();
  for (const std::uint32_t v : vertices)
    total += simulation.forceOn(v);
  return total;
}

std::vector<Vector3> positionsOf(const Simulation& simulation, const std::vector<std::uint32_t>& vertices) {
  std::vector<Vector3> chosen;
  for (const std::uint32_t v : vertices)
    chosen.push_back(simulation.positions()[v]);
  return chosen;
}

void setMotion(Simulation& simulation, const std::vector<Vector3>& displacements_m,
               const std::vector<Vector3>& velocities_m_s) {
  SimulationState state = simulation.state();
  state.displacements_m = displacements_m;
  state.velocities_m_s = velocities_m_s;
  simulation.restore(std::move(state));
}

std::string layerLines(const Block& block, const std::vector<Vector3>& positions_m, int axis, int layer,
                       double unit_m) {
  const int u = (axis + 1) % 3;
  const int w = (axis + 2) % 3;
  const int across = std::min(u, w);
  const int up = std::max(u, w);
  std::ostringstream lines;
  const auto polyline = [&](int along, int other, int line) {
    Vector3i n;
    n[axis] = layer;
    n[other] = line;
    for (n[along] = 0; n[along] <= block.lattice.dims[along]; ++n[along]) {
      const Vector3& p = positions_m[block.vertex(n.x(), n.y(), n.z())];
      lines << p[across] / unit_m << " " << p[up] / unit_m << "\n";
    }
    lines << "\n";
  };
  for (int line = 0; line <= block.lattice.dims[up]; ++line)
    polyline(across, up, line);
  for (int line = 0; line <= block.lattice.dims[across]; ++line)
    polyline(up, across, line);
  return lines.str();
}

}  // namespace soft_volume::core::validate
