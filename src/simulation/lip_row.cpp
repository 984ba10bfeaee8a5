#include "lip_row.h"

#include <algorithm>
#include <map>

#include "soft_volume/grid/hexahedron.h"

namespace soft_volume::core {
namespace {

/// Of a corner's trilinear weight at a place in its cell; `derivative` is the axis along which it is taken, or -1.
double cornerWeight(const Vector3& place, std::size_t corner, int derivative) {
  double weight = 1.0;
  for (int d = 0; d < 3; ++d) {
    const bool high = kHexahedronCorners[corner][d] != 0;
    if (d == derivative)
      weight *= high ? 1.0 : -1.0;
    else
      weight *= high ? place[d] : 1.0 - place[d];
  }
  return weight;
}

double weightAlong(const Vector3& place, std::size_t corner, const Vector3& direction, const Vector3& spacing_m) {
  double along = 0.0;
  for (int d = 0; d < 3; ++d)
    along += direction[d] / spacing_m[d] * cornerWeight(place, corner, d);
  return along;
}

}  // namespace

LipRow makeLipRow(const Lattice& lattice, const LipContact& contact) {
  LipRow row;
  row.tangents[0] = contact.normal.unitOrthogonal();
  row.tangents[1] = contact.normal.cross(row.tangents[0]);
  std::map<std::uint32_t, LipRow::Corner> corners;
  for (std::size_t side = 0; side < 2; ++side) {
    const Vector3& place = contact.places[side];
    for (std::size_t c = 0; c < 8; ++c) {
      const std::uint32_t v = lattice.cells[contact.cells[side]][c];
      LipRow::Corner& corner = corners.emplace(v, LipRow::Corner{v, 0.0, {0.0, 0.0}}).first->second;
      corner.weight += (side == 0 ? -1.0 : 1.0) * cornerWeight(place, c, -1);
      for (std::size_t k = 0; k < 2; ++k)
        corner.along[k] += 0.5 * weightAlong(place, c, row.tangents[k], lattice.spacing_m);
    }
  }
  constexpr double kRounding = 1e-12;
  const bool parted = std::any_of(corners.begin(), corners.end(),
                                  [](const auto& entry) { return std::abs(entry.second.weight) > kRounding; });
  const double least = kRounding / lattice.spacing_m.maxCoeff();
  for (const auto& entry : corners) {
    const LipRow::Corner& corner = entry.second;
    if (parted &&
        (std::abs(corner.weight) > kRounding || std::abs(corner.along[0]) > least || std::abs(corner.along[1]) > least))
      row.corners.push_back(corner);
  }
  return row;
}

LipState lipState(const LipRow& row, const std::vector<Vector3>& displacements_m, double shortest_edge_m) {
  Vector3 apart = Vector3::Zero();
  std::array<Vector3, 2> tangents = row.tangents;
  for (const LipRow::Corner& corner : row.corners) {
    const Vector3& u = displacements_m[corner.vertex];
    apart += corner.weight * u;
    tangents[0] += corner.along[0] * u;
    tangents[1] += corner.along[1] * u;
  }
  return lipState(apart, tangents, shortest_edge_m);
}

double lipEnergy(double stiffness_n_m, double gap_m, double most_m) {
  const double depth = -gap_m;
  if (depth <= 0.0)
    return 0.0;
  const double within = std::min(depth, most_m);
  return stiffness_n_m * within * (0.5 * within + (depth - within));
}

}  // namespace soft_volume::core
