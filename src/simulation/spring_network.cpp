#include "soft_volume/simulation/spring_network.h"

#include <algorithm>

#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {
namespace {

struct Spring {
  std::uint32_t neighbour;
  double stiffness_n_m;
  double stiffness_times_length_n;
};

double springStiffness(const CellSprings& springs, int axes) {
  return axes == 1 ? springs.edge_n_m : axes == 2 ? springs.face_n_m : springs.body_n_m;
}

double restLength(const Lattice& lattice, std::size_t cell, const CornerPair& pair) {
  Vector3 offset;
  for (int d = 0; d < 3; ++d)
    offset[d] = kHexahedronCorners[pair.b][d] - kHexahedronCorners[pair.a][d];
  return offset.cwiseProduct(lattice.spacing_m).cwiseProduct(lattice.rest_stretch[cell]).norm();
}

/// Springs of all cells by vertex, not yet merged, in the order of cells.
std::vector<std::vector<Spring>> springsByVertex(const Lattice& lattice, const std::vector<Material>& materials) {
  std::vector<std::vector<Spring>> rows(lattice.vertexCount());
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    const Material& material = materials[lattice.materials[cell]];
    const CellSprings springs = isotropicSprings(material.youngs_modulus_pa, lattice.spacing_m.x());
    for (const CornerPair& pair : kCornerPairs) {
      const std::uint32_t a = lattice.cells[cell][pair.a];
      const std::uint32_t b = lattice.cells[cell][pair.b];
      if (lattice.fixed[a] && lattice.fixed[b])
        continue;
      const double k = springStiffness(springs, pair.axes);
      const double kl = k * restLength(lattice, cell, pair);
      rows[a].push_back({b, k, kl});
      rows[b].push_back({a, k, kl});
    }
  }
  return rows;
}

void appendMerged(std::vector<Spring>& row, SpringNetwork& network) {
  // A stable sort keeps the order of cells within one neighbour, so the sums have one order and one result.
  std::stable_sort(row.begin(), row.end(), [](const Spring& a, const Spring& b) { return a.neighbour < b.neighbour; });
  for (std::size_t s = 0; s < row.size();) {
    Spring merged = row[s];
    for (++s; s < row.size() && row[s].neighbour == merged.neighbour; ++s) {
      merged.stiffness_n_m += row[s].stiffness_n_m;
      merged.stiffness_times_length_n += row[s].stiffness_times_length_n;
    }
    network.neighbours.push_back(merged.neighbour);
    network.stiffness_n_m.push_back(merged.stiffness_n_m);
    network.rest_length_m.push_back(merged.stiffness_times_length_n / merged.stiffness_n_m);
  }
  network.row_begin.push_back(static_cast<std::uint32_t>(network.neighbours.size()));
}

void addMasses(const Lattice& lattice, const std::vector<Material>& materials, SpringNetwork& network) {
  network.mass_kg.assign(lattice.vertexCount(), 0.0);
  network.damping_kg_s.assign(lattice.vertexCount(), 0.0);
  const double share_m3 = lattice.spacing_m.prod() / 8.0;
  for (std::size_t cell = 0; cell < lattice.cellCount(); ++cell) {
    const Material& material = materials[lattice.materials[cell]];
    const double mass = material.density_kg_m3 * share_m3;
    for (const std::uint32_t v : lattice.cells[cell]) {
      network.mass_kg[v] += mass;
      network.damping_kg_s[v] += mass * material.damping_per_s;
    }
  }
}

}  // namespace

SpringNetwork buildSpringNetwork(const Lattice& lattice, const std::vector<Material>& materials) {
  SpringNetwork network;
  std::vector<std::vector<Spring>> rows = springsByVertex(lattice, materials);
  network.row_begin.push_back(0);
  for (std::vector<Spring>& row : rows)
    appendMerged(row, network);
  addMasses(lattice, materials, network);
  return network;
}

}  // namespace soft_volume::core
